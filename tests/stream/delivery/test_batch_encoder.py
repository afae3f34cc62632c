"""Batches of one stream, encoded one after the other, have the bytes that each has alone."""

from dataclasses import replace
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stream.batch import SampleBatch
from stream.wire.batches import encode_batch
from stream.wire.encoder import BatchEncoder

floats = st.floats(width=64, allow_nan=True, allow_infinity=True)


@st.composite
def batches(draw: st.DrawFn) -> SampleBatch:
    n = draw(st.integers(1, 60))
    is_counts = draw(st.booleans())
    return SampleBatch(
        unit=draw(st.sampled_from(["U1", "陀螺-2"])),
        signal=draw(st.sampled_from(["rate", "temperature"])),
        run=draw(st.sampled_from(["r1", "r" * 120])),
        epoch=UUID(int=draw(st.sampled_from([0, 1, 2**128 - 1]))),
        seq=draw(st.integers(0, 2**52)),
        t0_ns=draw(st.integers(-(2**61), 2**61)),
        dt_ns=draw(st.sampled_from([1, 10**7, 10**15])),
        unit_of_measure=draw(st.sampled_from(["deg/s", ""])),
        counts=draw(hnp.arrays(np.int32, n)) if is_counts else None,
        values=None if is_counts else draw(hnp.arrays(np.float64, n, elements=floats)),
        times_ns=draw(st.none() | hnp.arrays(np.int64, n, elements=st.integers(-(2**61), 2**61))),
        irregular=draw(st.booleans()),
        scale=draw(st.sampled_from([1.0, 0.0, -0.0, 5e-5])),
        offset=draw(st.sampled_from([0.0, -0.0, 1.0])),
        flags=draw(st.none() | hnp.arrays(np.uint8, n)),
    )


@pytest.mark.long
@given(st.lists(batches(), min_size=1, max_size=6))
@settings(deadline=None)
def test_the_bytes_do_not_depend_on_what_was_encoded_before(sent: list[SampleBatch]) -> None:
    encoder = BatchEncoder()
    for batch in sent:
        assert encoder.encode(batch) == encode_batch(batch)
        assert encoder.encode(batch) == encode_batch(batch)


def test_long_arrays_and_signs_of_zero() -> None:
    encoder = BatchEncoder()
    batch = SampleBatch("U", "rate", "r", UUID(int=1), 0, 0, 1, "deg/s", counts=np.arange(100_000, dtype=np.int32))
    for each in (batch, replace(batch, offset=-0.0), replace(batch, scale=0.0), replace(batch, seq=0, t0_ns=-1)):
        assert encoder.encode(each) == encode_batch(each)
