"""Times to nanoseconds, exactly rounded."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ingest.tables.times import (
    MAX_NS,
    UTC_FROM_NS,
    RunClock,
    decimal_places,
    ns_from_decimals,
    ns_from_floats,
    ns_from_index,
    ns_from_integers,
    ns_from_text,
    ns_per_unit,
)
from stream.errors import BadInput

UNITS = [1, 10**3, 10**6, 10**9, 60 * 10**9]


@given(st.floats(-4e9, 4e9), st.sampled_from(UNITS))
def test_floats_are_rounded_once(time: float, ns: int) -> None:
    exact = Fraction(time) * ns
    if abs(exact) > MAX_NS:
        return
    times_ns, wrong = ns_from_floats(np.array([time]), ns)
    assert not wrong[0]
    assert abs(int(times_ns[0]) - exact) <= Fraction(1, 2) + Fraction(1, 10**6)


@given(st.decimals(-4 * 10**9, 4 * 10**9, places=15), st.sampled_from([1, 10**3, 10**6, 10**9]))
def test_text_and_decimals_are_rounded_half_to_even(time: Decimal, ns: int) -> None:
    places = decimal_places(ns)
    assert places is not None
    exact = round(Fraction(time) * ns)
    times_ns, wrong = ns_from_decimals(pa.array([time], pa.decimal128(38, 24)), places)
    assert ns_from_text(str(time), ns) == (exact if abs(exact) <= MAX_NS else None)
    assert wrong[0] == (abs(exact) > MAX_NS)
    assert wrong[0] or times_ns[0] == exact


def test_integers_do_not_pass_through_float() -> None:
    times_ns, wrong = ns_from_integers(np.array([1763683200000000001, 2**63 - 1, -(2**63)]), 1)
    assert times_ns[0] == 1763683200000000001
    assert wrong.tolist() == [False, True, True]


@pytest.mark.parametrize("text", ["1e300", "-1e300", "9e9", "1e999999999"])
def test_text_out_of_range_is_none(text: str) -> None:
    assert ns_from_text(text, 10**9) is None


@pytest.mark.parametrize(("text", "ns"), [("1e-300", 0), ("0.0000000005", 0), ("0.0000000015", 2), ("1e-999999999", 0)])
def test_tiny_text(text: str, ns: int) -> None:
    assert ns_from_text(text, 10**9) == ns


def test_floats_that_are_no_times() -> None:
    assert ns_from_floats(np.array([np.nan, np.inf, -np.inf, 1e30, 0.0]), 10**9)[1].tolist() == [True] * 4 + [False]


@given(st.integers(0, 10**9), st.sampled_from([0.1, 1.0, 3.0, 100.0, 102.4, 200.0, 1000.0]))
def test_index_over_rate(index: int, rate_hz: float) -> None:
    exact = Fraction(index) / Fraction(rate_hz) * 10**9
    if exact > UTC_FROM_NS:
        return
    assert abs(int(ns_from_index(np.array([index]), rate_hz)[0]) - exact) <= Fraction(1, 2) + Fraction(1, 10**5)


@pytest.mark.parametrize("unit", ["deg", "ps", "degC", "1"])
def test_units_that_are_no_time(unit: str) -> None:
    with pytest.raises(BadInput):
        ns_per_unit(unit)


def test_the_first_time_decides_for_the_file() -> None:
    clock = RunClock(None)
    clock.settle(10**17)
    assert clock.date_known
    assert clock.misplaced(np.array([10**17 - 1, 10**17])).tolist() == [True, False]
    with pytest.raises(BadInput, match="leave out --start"):
        RunClock(0).settle(10**17)
