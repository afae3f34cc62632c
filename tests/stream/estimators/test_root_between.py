"""Roots: those of scipy, to the tolerance that is asked for, in about as many calls."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from stream.estimators.noise.root_between import root_between

numbers = st.floats(-1e3, 1e3)


@given(root=numbers, below=st.floats(1e-3, 1e4), above=st.floats(1e-3, 1e4), power=st.sampled_from([1, 3, 5]))
def test_a_root_is_where_the_function_is_zero(root: float, below: float, above: float, power: int) -> None:
    calls = 0

    def function(x: float) -> float:
        nonlocal calls
        calls += 1
        return float((x - root) ** power + 1e-3 * math.expm1((x - root) / 1e4))

    found = root_between(function, root - below, root + above, absolute=1e-9, relative=1e-9)
    assert abs(found - root) <= 1e-9 + 1e-9 * abs(root)
    ours, calls = calls, 0
    brentq(function, root - below, root + above, xtol=1e-9, rtol=1e-9)
    assert ours <= 1.5 * calls + 5


def test_a_root_at_an_end_or_none() -> None:
    assert root_between(lambda x: x, 0.0, 5.0) == 0.0
    assert root_between(lambda x: x - 5.0, 0.0, 5.0) == 5.0
    with pytest.raises(ValueError, match="no change of sign between"):
        root_between(lambda x: x, 1.0, 5.0)
