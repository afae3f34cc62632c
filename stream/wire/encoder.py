"""Encoder of the successive sample batches of one stream."""

import functools

from stream.batch import SampleBatch
from stream.wire import samples_pb2
from stream.wire.batches import schema_of
from stream.wire.count_residuals import split_counts


class BatchEncoder:
    """Encodes the batches of one stream; for one thread.

    Fields that are the same in all batches of a stream are encoded once. Fields encoded separately and joined in the
    order of their numbers give the same bytes as `encode_batch`.
    """

    def __init__(self) -> None:
        self._like: SampleBatch | None = None
        self._position = samples_pb2.SampleBatch()
        self._head = self._interval = self._measure = self._scale = b""

    def encode(self, batch: SampleBatch) -> bytes:
        """The wire form of a batch."""
        if self._like is None or not _is_like(batch, self._like):
            self._encode_common(batch)
        position = self._position
        position.seq, position.samples, position.t0_ns = batch.seq, len(batch), batch.t0_ns
        parts = [self._head, position.SerializeToString(), self._interval]
        if batch.times_ns is not None:
            parts += _field(11, batch.times_ns.astype("<i8", copy=False).tobytes())
        parts += (self._measure, self._scale)
        if batch.values is not None:
            parts += _field(16, batch.values.astype("<f8", copy=False).tobytes())
        if batch.flags is not None:
            parts += _field(17, batch.flags.tobytes())
        if batch.counts is not None:
            parts += _field(20, split_counts(batch.counts))
        return b"".join(parts)

    def _encode_common(self, batch: SampleBatch) -> None:
        head = samples_pb2.SampleBatch(
            schema=schema_of(batch), unit=batch.unit, signal=batch.signal, run=batch.run, epoch=batch.epoch.bytes
        )
        interval = samples_pb2.SampleBatch(dt_ns=batch.dt_ns, irregular=batch.irregular)
        measure = samples_pb2.SampleBatch(unit_of_measure=batch.unit_of_measure)
        scale = samples_pb2.SampleBatch(scale=batch.scale, offset=batch.offset)
        self._head, self._interval, self._measure, self._scale = (
            bytes(part.SerializeToString()) for part in (head, interval, measure, scale)
        )
        self._like = batch


def _is_like(a: SampleBatch, b: SampleBatch) -> bool:
    # floats by identity: 0.0 and -0.0 are equal, and differ on the wire
    return (
        (a.epoch is b.epoch or a.epoch == b.epoch) and a.scale is b.scale and a.offset is b.offset
        and (a.counts is None) == (b.counts is None) and a.dt_ns == b.dt_ns and a.irregular == b.irregular
        and a.run == b.run and a.unit == b.unit and a.signal == b.signal and a.unit_of_measure == b.unit_of_measure
    )  # fmt: skip


def _field(number: int, data: bytes) -> tuple[bytes, bytes]:
    return _field_head(number, len(data)), data


@functools.lru_cache(maxsize=4096)
def _field_head(number: int, length: int) -> bytes:
    """Number and length of a field, before its bytes."""
    return varint(number << 3 | 2) + varint(length)


def varint(number: int) -> bytes:
    r"""The wire form of a number.

    >>> varint(300)
    b'\xac\x02'
    """
    found = b""
    while number > 127:
        found += _CONTINUED[number & 127]
        number >>= 7
    return found + _LAST[number]


_CONTINUED = [bytes([each | 128]) for each in range(128)]
_LAST = [bytes([each]) for each in range(128)]
