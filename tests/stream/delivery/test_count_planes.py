"""Counts come back from their planes as they were, and take as few bytes as hold them."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stream.wire.count_planes import join_counts, split_counts

near_borders = st.sampled_from([1 << 7, 1 << 15, 1 << 23, 1 << 31]).flatmap(
    lambda border: st.sampled_from([border - 1, border, border + 1, -border, -border - 1, -border + 1])
)
counts = st.one_of(st.integers(-(2**31), 2**31 - 1), st.integers(-200, 200), near_borders).filter(
    lambda count: -(2**31) <= count < 2**31
)


@given(hnp.arrays(np.int32, st.integers(1, 40), elements=counts))
@settings(deadline=None)
def test_any_counts_come_back_from_as_few_bytes_as_hold_them(sent: npt.NDArray[np.int32]) -> None:
    planes = split_counts(sent)
    assert np.array_equal(join_counts(planes, len(sent)), sent)
    # Python's own: the least bytes of a signed number
    needed = max((int(~count if count < 0 else count).bit_length() // 8 + 1) for count in sent.tolist())
    assert len(planes) == needed * len(sent)
    as_bytes = [int(count).to_bytes(needed, "little", signed=True) for count in sent.tolist()]
    assert planes == b"".join(bytes(each[plane] for each in as_bytes) for plane in range(needed))


@given(st.integers(1, 9), st.integers(1, 4), st.data())
@settings(deadline=None)
def test_more_bytes_than_needed_are_read_as_well(n: int, width: int, data: st.DataObject) -> None:
    planes = data.draw(st.binary(min_size=n * width, max_size=n * width))
    expected = [int.from_bytes(planes[i::n], "little", signed=True) for i in range(n)]
    assert join_counts(planes, n).tolist() == expected


@pytest.mark.parametrize("step", [2, -1])
def test_arrays_that_are_no_row_in_memory_are_taken(step: int) -> None:
    sent = np.arange(-300, 300, dtype=np.int32)[::step]
    assert np.array_equal(join_counts(split_counts(sent), len(sent)), sent)
