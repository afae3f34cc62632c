"""Counts come back from their differences as they were, and take as few bytes as hold them; so do older forms."""

import zlib
from uuid import UUID

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stream.batch import SampleBatch
from stream.errors import WireError
from stream.wire import samples_pb2
from stream.wire.batches import decode_batch, encode_batch, read_wire_batch
from stream.wire.count_planes import join_planes, residuals_of
from stream.wire.count_residuals import join_counts, split_counts
from tests.stream.examples import examples

near_borders = st.sampled_from([1 << 6, 1 << 7, 1 << 15, 1 << 23, 1 << 31]).flatmap(
    lambda border: st.sampled_from([border - 1, border, border + 1, -border, -border - 1, -border + 1])
)
counts = st.one_of(st.integers(-(2**31), 2**31 - 1), st.integers(-200, 200), near_borders).filter(
    lambda count: -(2**31) <= count < 2**31
)


@examples(30, 100, hnp.arrays(np.int32, st.integers(1, 40), elements=counts))
def test_any_counts_come_back_from_as_few_bytes_as_hold_them(sent: npt.NDArray[np.int32]) -> None:
    residuals = split_counts(sent)
    assert np.array_equal(join_counts(residuals, len(sent)), sent)
    # Python's own numbers, which do not overflow
    numbers = sent.tolist()
    mean = int.from_bytes(residuals[:4], "little", signed=True)
    assert abs(sum(numbers) / len(numbers) - mean) <= 0.5 + 1e-6
    wrapped = [(number - mean + 2**31) % 2**32 - 2**31 for number in numbers]
    zigzag = [2 * each if each >= 0 else -2 * each - 1 for each in wrapped]
    needed = max(1, *((each.bit_length() + 7) // 8 for each in zigzag))
    as_bytes = [each.to_bytes(needed, "little") for each in zigzag]
    assert residuals[4:] == b"".join(bytes(each[plane] for each in as_bytes) for plane in range(needed))


@given(st.integers(1, 9), st.integers(1, 4), st.data())
@settings(deadline=None)
def test_planes_of_older_versions_are_read(n: int, width: int, data: st.DataObject) -> None:
    planes = data.draw(st.binary(min_size=n * width, max_size=n * width))
    expected = [int.from_bytes(planes[i::n], "little", signed=True) for i in range(n)]
    assert join_planes(planes, n).tolist() == expected
    assert join_counts(residuals_of(planes, b"", n), n).tolist() == expected


@pytest.mark.parametrize("step", [2, -1])
def test_arrays_that_are_no_row_in_memory_are_taken(step: int) -> None:
    sent = np.arange(-300, 300, dtype=np.int32)[::step]
    assert np.array_equal(join_counts(split_counts(sent), len(sent)), sent)


@pytest.mark.parametrize("bias", [0, 127, 20_000, -(2**31) + 400])
def test_white_noise_about_any_bias_compresses_to_its_entropy(bias: int) -> None:
    sigma, n = 50.0, 100_000
    noise = np.round(np.random.default_rng(1).normal(0.0, sigma, n)).astype(np.int64)
    sent = split_counts((noise + bias).astype(np.int32))
    # differential entropy of a normal variable, in bits a sample of unit steps
    entropy_bytes = np.log2(sigma * np.sqrt(2.0 * np.pi * np.e)) / 8.0
    # Huffman codes of a Gaussian are within 1 % of it; a plane of the rare large differences takes the rest
    assert len(zlib.compress(sent, 6)) / n < 1.07 * entropy_bytes


def test_batches_of_all_schemas_have_the_same_counts() -> None:
    sent = np.array([5, -70_000, 300], np.int32)
    batch = SampleBatch("U1", "rate", "r1", UUID(int=7), 0, 0, 10, "deg/s", counts=sent, scale=0.5)
    payload = encode_batch(batch)
    message = samples_pb2.SampleBatch.FromString(payload)
    assert message.schema == 3
    for schema, name, data in (
        (1, "counts", sent.astype("<i4").tobytes()),
        (
            2,
            "count_planes",
            b"".join(bytes(int(c).to_bytes(3, "little", signed=True)[k] for c in sent) for k in range(3)),
        ),
    ):
        message.ClearField("count_residuals")
        message.schema = schema
        setattr(message, name, data)
        older = bytes(message.SerializeToString())
        message.ClearField(name)
        assert decode_batch(older) == batch
        assert read_wire_batch(older) == read_wire_batch(payload)


@pytest.mark.parametrize("beside", [b"\x01", b"\x01\x00\x00", bytes(4), bytes(6)])
def test_a_batch_has_values_or_counts_and_not_both(beside: bytes) -> None:
    batch = SampleBatch("U1", "rate", "r1", UUID(int=7), 0, 0, 10, "deg/s", values=np.ones(2))
    message = samples_pb2.SampleBatch.FromString(encode_batch(batch))
    message.count_residuals = beside
    with pytest.raises(WireError, match=r"count_residuals|either counts or values"):
        decode_batch(message.SerializeToString())


def test_a_batch_of_values_is_understood_by_the_version_before() -> None:
    batch = SampleBatch("U1", "rate", "r1", UUID(int=7), 0, 0, 10, "deg/s", values=np.ones(2))
    assert samples_pb2.SampleBatch.FromString(encode_batch(batch)).schema == 2
