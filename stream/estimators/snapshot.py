"""The state of what follows a signal as bytes: versioned, compact, checked, and nothing of Python's own in it."""

import struct
import zlib
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import zstandard

from stream.errors import EstimatorError

if TYPE_CHECKING:
    from stream.estimators.base import Follower

SNAPSHOT_VERSION = 3

_HEAD = struct.Struct("<4sII")  # mark, version, CRC-32 of version and content
_MARK = b"GFES"


class _Array(msgspec.Struct, frozen=True, array_like=True):
    dtype: str
    shape: tuple[int, ...]
    data: bytes


class _Content(msgspec.Struct, frozen=True):
    estimator: str
    arguments: dict[str, int | float]
    signal: tuple[str, str, str]
    tracker: dict[str, int]
    reference: float
    arrays: tuple[_Array, ...]


_decoder = msgspec.msgpack.Decoder(_Content)


def take_snapshot(follower: "Follower") -> bytes:
    """State of `follower`, to be brought back by `restore`; it goes on from there as if nothing had happened.

    Examples
    --------
    >>> from stream.estimators.bias_stability import BiasStability
    >>> restore(take_snapshot(BiasStability(10.0))).key
    'bias_stability_10s'
    """
    state = follower.export_state()
    content = _Content(
        estimator=type(follower).__name__,
        arguments=dict(follower.arguments),
        signal=state.signal,
        tracker=state.tracker,
        reference=state.reference,
        arrays=tuple(_Array(a.dtype.str, a.shape, np.ascontiguousarray(a).tobytes()) for a in state.arrays),
    )
    packed = zstandard.ZstdCompressor(level=1).compress(msgspec.msgpack.encode(content))
    return _HEAD.pack(_MARK, SNAPSHOT_VERSION, _checksum(SNAPSHOT_VERSION, packed)) + packed


def restore(snapshot: bytes) -> "Follower":
    """The estimator, or whatever follows a signal, that a snapshot was taken of.

    Raises
    ------
    EstimatorError: If the bytes are no snapshot, are damaged, or were written by a newer gyrofleet.
    """
    from stream.estimators.base import EstimatorState, follower_classes

    if len(snapshot) < _HEAD.size:
        raise EstimatorError(f"{len(snapshot)} bytes are no snapshot of an estimator")
    mark, version, checksum = _HEAD.unpack_from(snapshot)
    packed = snapshot[_HEAD.size :]
    if mark != _MARK or checksum != _checksum(version, packed):
        raise EstimatorError("the snapshot of an estimator is damaged; estimate anew from the record")
    if version > SNAPSHOT_VERSION:
        raise EstimatorError(
            f"snapshot of version {version}, this gyrofleet reads up to {SNAPSHOT_VERSION}: upgrade this side"
        )
    if version < SNAPSHOT_VERSION:
        raise EstimatorError(
            f"snapshot of version {version}, of an older gyrofleet; this one keeps version {SNAPSHOT_VERSION}: "
            "estimate anew from the record"
        )
    content = _decoder.decode(zstandard.ZstdDecompressor().decompress(packed))
    classes = {cls.__name__: cls for cls in follower_classes()}
    if content.estimator not in classes:
        raise EstimatorError(
            f"snapshot of an estimator {content.estimator!r}, which this gyrofleet does not have; it has "
            f"{', '.join(classes)}"
        )
    follower = classes[content.estimator](**content.arguments)
    arrays = tuple(np.frombuffer(a.data, np.dtype(a.dtype)).reshape(a.shape) for a in content.arrays)
    follower.import_state(EstimatorState(content.signal, content.tracker, content.reference, arrays))
    return follower


def _checksum(version: int, packed: bytes) -> int:
    return zlib.crc32(packed, version)
