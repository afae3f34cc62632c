"""Wire form of a sample batch: Protobuf, its arrays as little-endian bytes (``samples.proto``)."""

from typing import Any
from uuid import UUID

import numpy as np
import numpy.typing as npt
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError

from stream import samples_pb2
from stream.batch import SampleBatch
from stream.errors import BadInput, NewerSchema, WireError

SAMPLE_SCHEMA = 1
MAX_SAMPLES_PER_BATCH = 1_000_000


def encode_batch(batch: SampleBatch) -> bytes:
    """Put a batch into its wire form.

    Examples
    --------
    >>> batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10_000_000, "deg/s",
    ...                     counts=np.array([1, 2, 3], np.int32), scale=0.5)
    >>> decode_batch(encode_batch(batch)) == batch
    True
    """
    message = samples_pb2.SampleBatch(
        schema=SAMPLE_SCHEMA,
        unit=batch.unit,
        signal=batch.signal,
        run=batch.run,
        epoch=batch.epoch.bytes,
        seq=batch.seq,
        samples=len(batch),
        t0_ns=batch.t0_ns,
        dt_ns=batch.dt_ns,
        irregular=batch.irregular,
        unit_of_measure=batch.unit_of_measure,
        scale=batch.scale,
        offset=batch.offset,
        times_ns=_bytes(batch.times_ns, "<i8"),
        counts=_bytes(batch.counts, "<i4"),
        values=_bytes(batch.values, "<f8"),
        flags=_bytes(batch.flags, "u1"),
    )
    return bytes(message.SerializeToString())


def decode_batch(payload: bytes) -> SampleBatch:
    """Read a batch from its wire form.

    Raises
    ------
    NewerSchema
        If it was written by a newer gyrofleet.
    WireError
        If it is not a batch, or not a whole one.
    """
    try:
        message = samples_pb2.SampleBatch.FromString(payload)
    except DecodeError as error:
        raise WireError(f"not a sample batch ({len(payload)} bytes): {error}") from error
    if message.schema > SAMPLE_SCHEMA:
        raise NewerSchema(
            f"sample batch of schema {message.schema}, this gyrofleet reads up to {SAMPLE_SCHEMA}: upgrade this side"
        )
    n = message.samples
    if message.schema < 1 or not 1 <= n <= MAX_SAMPLES_PER_BATCH or len(message.epoch) != 16:
        raise WireError(f"not a sample batch: schema {message.schema}, {n} samples, epoch {len(message.epoch)} bytes")
    try:
        return SampleBatch(
            unit=message.unit,
            signal=message.signal,
            run=message.run,
            epoch=UUID(bytes=message.epoch),
            seq=message.seq,
            t0_ns=message.t0_ns,
            dt_ns=message.dt_ns,
            unit_of_measure=message.unit_of_measure,
            counts=_array(message.counts, "<i4", n, "counts"),
            values=_array(message.values, "<f8", n, "values"),
            times_ns=_array(message.times_ns, "<i8", n, "times_ns"),
            irregular=message.irregular,
            scale=message.scale,
            offset=message.offset,
            flags=_array(message.flags, "u1", n, "flags"),
        )
    except BadInput as error:
        raise WireError(f"not a sample batch: {error}") from error


def encode_preview(value: float, unit_of_measure: str) -> bytes:
    """One sample in the form that plotting tools read."""
    return bytes(samples_pb2.Preview(value=value, unit_of_measure=unit_of_measure).SerializeToString())


def sample_descriptors() -> bytes:
    """The serialised FileDescriptorSet that makes a recording readable for other tools."""
    file = descriptor_pb2.FileDescriptorProto()
    samples_pb2.DESCRIPTOR.CopyToProto(file)
    return bytes(descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString())


def _bytes(array: npt.NDArray[np.generic] | None, dtype: str) -> bytes:
    return b"" if array is None else array.astype(dtype, copy=False).tobytes()


def _array(data: bytes, dtype: str, n: int, name: str) -> Any:
    if not data:
        return None
    if len(data) != n * np.dtype(dtype).itemsize:
        raise WireError(f"not a whole sample batch: {len(data)} bytes of {name} for {n} samples")
    return np.frombuffer(data, dtype)
