"""Wire form of sample batches: Protobuf, arrays as little-endian bytes (``samples.proto``)."""

import functools
import struct
from math import isfinite
from typing import NamedTuple
from uuid import UUID

import numpy as np
import numpy.typing as npt
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError

from stream.batch import INT64_MAX, CountArray, SampleBatch, are_moments, checked_batch
from stream.bounds import MAX_INTERVAL_NS, MAX_MOMENT_NS, MAX_NAME_CHARS, MAX_SEQ, MIN_MOMENT_NS
from stream.errors import NewerSchema, WireError
from stream.wire import samples_pb2
from stream.wire.count_planes import join_planes
from stream.wire.count_residuals import MEAN_BYTES, first_count, join_counts, split_counts

SAMPLE_SCHEMA = 3
VALUES_SCHEMA = 2  # of batches without counts, which older readers understand
MAX_SAMPLES_PER_BATCH = 1_000_000

_ITEM_BYTES = {"counts": (4,), "count_planes": (1, 2, 3, 4), "values": (8,), "times_ns": (8,), "flags": (1,)}


def encode_batch(batch: SampleBatch) -> bytes:
    """The wire form of a batch.

    >>> batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, 10_000_000, "deg/s",
    ...                     counts=np.array([1, 2, 3], np.int32), scale=0.5)
    >>> decode_batch(encode_batch(batch)) == batch
    True
    """
    message = samples_pb2.SampleBatch(
        schema=schema_of(batch), unit=batch.unit, signal=batch.signal, run=batch.run, epoch=batch.epoch.bytes,
        seq=batch.seq, samples=len(batch), t0_ns=batch.t0_ns, dt_ns=batch.dt_ns, irregular=batch.irregular,
        unit_of_measure=batch.unit_of_measure, scale=batch.scale, offset=batch.offset,
        times_ns=_bytes(batch.times_ns, "<i8"), values=_bytes(batch.values, "<f8"), flags=_bytes(batch.flags, "u1"),
        count_residuals=b"" if batch.counts is None else split_counts(batch.counts),
    )  # fmt: skip
    return bytes(message.SerializeToString())


def schema_of(batch: SampleBatch) -> int:
    """The schema that a reader of the batch must know."""
    return VALUES_SCHEMA if batch.counts is None else SAMPLE_SCHEMA


class WireBatchHead(NamedTuple):
    """Head of a sample batch on the wire; `epoch` in hexadecimal digits."""

    unit: str
    signal: str
    run: str
    epoch: str
    seq: int
    next_seq: int
    t0_ns: int
    last_ns: int
    dt_ns: int


class WireBatch(NamedTuple):
    """A sample batch as received, checked, its arrays still bytes, empty where there is none.

    `meaning` must be equal in batches that are joined: epoch, interval in nanoseconds, unit of measure, whether
    irregular, scale, offset.
    """

    unit: str
    signal: str
    run: str
    seq: int
    next_seq: int
    t0_ns: int
    last_ns: int
    meaning: tuple[bytes, int, str, bool, float, float]
    counts: bytes
    values: bytes
    times_ns: bytes

    @property
    def unit_of_measure(self) -> str:
        """Unit of measure of the samples."""
        return self.meaning[2]


class RawBatch(NamedTuple):
    """A sample batch as logged, its arrays still bytes; checked but for bounds, which numbers of old logs exceed.

    `last_ns` is the time of its last sample.
    """

    message: samples_pb2.SampleBatch
    last_ns: int

    @property
    def like(self) -> "RawBatch":
        """Itself: what continues a batch has the like of it."""
        return self

    @property
    def t0_ns(self) -> int:
        """Time of its first sample."""
        return self.message.t0_ns

    def check_bounds(self) -> None:
        """WireError if a number is beyond its bounds."""
        message = self.message
        _check_bounds(message, message.seq, message.t0_ns, message.dt_ns, self.last_ns, message.times_ns)

    def decoded(self) -> SampleBatch:
        """The batch with its arrays."""
        return _decoded(self.message)


def read_raw_batch(payload: bytes) -> RawBatch:
    """Read a batch of the log."""
    return RawBatch(*_checked(payload, bounded=False))


def read_batch_head(payload: bytes) -> WireBatchHead:
    """Read a batch's head, checked like a whole one."""
    message, last_ns = _checked(payload)
    seq = message.seq
    return WireBatchHead(
        message.unit, message.signal, message.run, message.epoch.hex(), seq, seq + message.samples, message.t0_ns,
        last_ns, message.dt_ns,
    )  # fmt: skip


def read_wire_batch(payload: bytes) -> WireBatch:
    """Read a batch whose samples will be joined to others: checked as by `decode_batch`, arrays left as bytes."""
    message, last_ns = _checked(payload)
    seq, counts = message.seq, _counts(message)
    return WireBatch(
        message.unit, message.signal, message.run, seq, seq + message.samples, message.t0_ns, last_ns,
        (message.epoch, message.dt_ns, message.unit_of_measure, message.irregular, message.scale, message.offset),
        b"" if counts is None else counts.tobytes(), message.values, message.times_ns,
    )  # fmt: skip


def decode_batch(payload: bytes) -> SampleBatch:
    """Read a batch from its wire form; NewerSchema if a newer gyrofleet wrote it, WireError if it is no whole one."""
    return _decoded(_checked(payload)[0])


def _decoded(message: samples_pb2.SampleBatch) -> SampleBatch:
    values, times_ns, flags = message.values, message.times_ns, message.flags
    return checked_batch(
        unit=message.unit, signal=message.signal, run=message.run, epoch=epoch_of(message.epoch), seq=message.seq,
        t0_ns=message.t0_ns, dt_ns=message.dt_ns, unit_of_measure=message.unit_of_measure, counts=_counts(message),
        values=np.frombuffer(values, "<f8") if values else None,
        times_ns=np.frombuffer(times_ns, "<i8") if times_ns else None, irregular=message.irregular,
        scale=message.scale, offset=message.offset, flags=np.frombuffer(flags, "u1") if flags else None,
    )  # fmt: skip


@functools.lru_cache(65_536)
def epoch_of(raw: bytes) -> UUID:
    """The epoch of 16 bytes; cached, since making a UUID takes longer than reading the rest of a batch."""
    return UUID(bytes=raw)


def _counts(message: samples_pb2.SampleBatch) -> CountArray | None:
    if residuals := message.count_residuals:
        return join_counts(residuals, message.samples)
    if planes := message.count_planes:
        return join_planes(planes, message.samples)
    return np.frombuffer(message.counts, "<i4") if message.counts else None


def _checked(payload: bytes, *, bounded: bool = True) -> tuple[samples_pb2.SampleBatch, int]:
    """The message, and the time of its last sample."""
    try:
        message = samples_pb2.SampleBatch.FromString(payload)
    except DecodeError as error:
        raise WireError(f"not a sample batch ({len(payload)} bytes): {error}") from error
    schema = message.schema
    if schema > SAMPLE_SCHEMA:
        raise NewerSchema(
            f"sample batch of schema {schema}, this gyrofleet reads up to {SAMPLE_SCHEMA}: upgrade this side"
        )
    n = message.samples
    if schema < 1 or not 1 <= n <= MAX_SAMPLES_PER_BATCH or len(message.epoch) != 16:
        raise WireError(f"not a sample batch: schema {schema}, {n} samples, epoch {len(message.epoch)} bytes")
    residuals, values, times_ns = len(message.count_residuals), len(message.values), message.times_ns
    # nearly every batch has nothing but residuals, or nothing but values
    is_plain = residuals - MEAN_BYTES in (n, 2 * n, 3 * n, 4 * n) if not values else values == 8 * n and not residuals
    if not is_plain or times_ns or message.counts or message.count_planes or message.flags:
        _check_lengths(message)
    t0_ns, dt_ns = message.t0_ns, message.dt_ns
    last_ns = int.from_bytes(times_ns[-8:], "little", signed=True) if times_ns else t0_ns + (n - 1) * dt_ns
    if not (isfinite(message.scale) and isfinite(message.offset)):
        raise _wrong(message, f"scale {message.scale} or offset {message.offset} is not a finite number")
    if dt_ns < 1 or not 0 <= message.seq <= INT64_MAX - n:
        raise _wrong(message, f"dt_ns {dt_ns} or seq {message.seq} is outside its range")
    if t0_ns < -INT64_MAX or not -INT64_MAX <= last_ns <= INT64_MAX:
        raise _wrong(message, f"times from {t0_ns} ns do not fit 64 bits")
    if bounded:
        _check_bounds(message, message.seq, t0_ns, dt_ns, last_ns, times_ns)
    return message, last_ns


def _check_bounds(
    message: samples_pb2.SampleBatch, seq: int, t0_ns: int, dt_ns: int, last_ns: int, times_ns: bytes
) -> None:
    if dt_ns > MAX_INTERVAL_NS or seq > MAX_SEQ - message.samples:
        raise _wrong(message, f"dt_ns {dt_ns} or seq {seq} is beyond its bounds")
    if not (MIN_MOMENT_NS <= t0_ns <= MAX_MOMENT_NS and MIN_MOMENT_NS <= last_ns <= MAX_MOMENT_NS):
        raise _wrong(message, f"times from {t0_ns} ns on are not between 1897 and 2116")
    # unit and signal are those of the key expression, whose length is bounded
    if len(message.run) > MAX_NAME_CHARS or len(message.unit_of_measure) > MAX_NAME_CHARS:
        raise _wrong(message, f"run or unit of measure has more than {MAX_NAME_CHARS} characters")
    if times_ns and not are_moments(np.frombuffer(times_ns, "<i8")):
        raise _wrong(message, "one of its times is not between 1897 and 2116")


def _check_lengths(message: samples_pb2.SampleBatch) -> None:
    n = message.samples
    for name, item_bytes in _ITEM_BYTES.items():
        length = len(getattr(message, name))
        if length and length not in {n * each for each in item_bytes}:
            raise WireError(f"not a whole sample batch: {length} bytes of {name} for {n} samples")
    length = len(message.count_residuals)
    if length and length - MEAN_BYTES not in {n, 2 * n, 3 * n, 4 * n}:
        raise WireError(f"not a whole sample batch: {length} bytes of count_residuals for {n} samples")
    if sum(map(bool, (message.counts, message.count_planes, message.count_residuals, message.values))) != 1:
        raise _wrong(message, "a batch holds either counts or values, exactly one of them")


def _wrong(message: samples_pb2.SampleBatch, what: str) -> WireError:
    names = [_shown(each) for each in (message.run, message.unit, message.signal)]
    return WireError("not a sample batch: run {}, unit {}, signal {}: {}".format(*names, what))


def _shown(name: str) -> str:
    """A name for a message: not too long, and without characters that nobody sees."""
    return name[:MAX_NAME_CHARS] if name.isprintable() else ascii(name[:MAX_NAME_CHARS])


def encode_preview(payload: bytes) -> bytes:
    """The first sample of a whole batch in the form that plotting tools read.

    Only its own bytes are read: a recorder needs no machine code.
    """
    message = samples_pb2.SampleBatch.FromString(payload)
    n = message.samples
    if values := message.values:
        (value,) = struct.unpack_from("<d", values)
    else:
        if residuals := message.count_residuals:
            count = first_count(residuals, n)
        elif planes := message.count_planes:
            count = int(join_planes(planes[::n], 1)[0])
        else:
            (count,) = struct.unpack_from("<i", message.counts)
        value = count * message.scale + message.offset
    return bytes(samples_pb2.Preview(value=value, unit_of_measure=message.unit_of_measure).SerializeToString())


def sample_descriptors() -> bytes:
    """The serialised FileDescriptorSet that makes a recording readable for other tools."""
    file = descriptor_pb2.FileDescriptorProto()
    samples_pb2.DESCRIPTOR.CopyToProto(file)
    return bytes(descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString())


def _bytes(array: npt.NDArray[np.generic] | None, dtype: str) -> bytes:
    return b"" if array is None else array.astype(dtype, copy=False).tobytes()
