"""The running median against that of scipy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import median_filter

from analytics.loop.tracing.whitening.running_median import running_median


@given(
    values=st.lists(st.one_of(st.floats(-1e6, 1e6), st.sampled_from([0.0, 1.0, 2.0])), min_size=1, max_size=60),
    half=st.integers(0, 12),
)
def test_it_is_that_of_scipy_whose_ends_are_repeated(values: list[float], half: int) -> None:
    series, width = np.array(values), 2 * half + 1
    np.testing.assert_array_equal(running_median(series, width), median_filter(series, width, mode="nearest"))


def test_of_nothing_there_is_none() -> None:
    assert running_median(np.empty(0), 5).size == 0
