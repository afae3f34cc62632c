"""The state of an estimator as bytes: versioned, compact, checked, without Python's own serialisation."""

import re
import struct
import zlib
from typing import Any

import msgspec
import numpy as np
import zstandard

from stream.decoding import msgpack_decoder
from stream.errors import EstimatorError
from stream.estimators.base import Estimator, EstimatorState, estimator_classes

SNAPSHOT_VERSION = 3

_HEAD = struct.Struct("<4sII")  # mark, version, CRC-32 of version and content
_MARK = b"GFES"
_DTYPE = re.compile(r"[<|][biuf][1248]")


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


_decoder = msgpack_decoder(_Content)


def take_snapshot(estimator: Estimator[Any]) -> bytes:
    """State of an estimator; the one that `restore` makes of it continues as if there had been no interruption."""
    state = estimator.export_state()
    content = _Content(
        estimator=type(estimator).__name__, arguments=dict(estimator.arguments), signal=state.signal,
        tracker=state.tracker, reference=state.reference,
        arrays=tuple(_Array(a.dtype.str, a.shape, np.ascontiguousarray(a).tobytes()) for a in state.arrays),
    )  # fmt: skip
    packed = zstandard.ZstdCompressor(level=1).compress(msgspec.msgpack.encode(content))
    return _HEAD.pack(_MARK, SNAPSHOT_VERSION, zlib.crc32(packed, SNAPSHOT_VERSION)) + packed


def restore(snapshot: bytes) -> Estimator[Any]:
    """The estimator of a snapshot; EstimatorError if it is none, is damaged, or of another version."""
    if len(snapshot) < _HEAD.size:
        raise EstimatorError(f"{len(snapshot)} bytes are no snapshot of an estimator")
    mark, version, checksum = _HEAD.unpack_from(snapshot)
    packed = snapshot[_HEAD.size :]
    if mark != _MARK or checksum != zlib.crc32(packed, version):
        raise EstimatorError("the snapshot of an estimator is damaged; estimate again from the record")
    if version > SNAPSHOT_VERSION:
        raise EstimatorError(
            f"snapshot of version {version}, this gyrofleet reads up to {SNAPSHOT_VERSION}: upgrade this side"
        )
    if version < SNAPSHOT_VERSION:
        raise EstimatorError(
            f"snapshot of version {version}, of an older gyrofleet; this one keeps version {SNAPSHOT_VERSION}: "
            "estimate again from the record"
        )
    try:
        return _restored(packed)
    except (
        msgspec.MsgspecError, zstandard.ZstdError, ArithmeticError, AttributeError, LookupError, MemoryError,
        RecursionError, TypeError, ValueError,
    ) as error:  # fmt: skip
        # its checksum is right: another program, or somebody, has written it
        raise EstimatorError(
            f"the snapshot of an estimator cannot be read ({type(error).__name__}: {error}); estimate again from the "
            "record"
        ) from error


def _restored(packed: bytes) -> Estimator[Any]:
    content = _decoder.decode(zstandard.ZstdDecompressor().decompress(packed))
    classes = {cls.__name__: cls for cls in estimator_classes()}
    if content.estimator not in classes:
        raise EstimatorError(
            f"snapshot of an estimator {content.estimator!r}, which this gyrofleet does not have; it has "
            f"{', '.join(classes)}"
        )
    estimator = classes[content.estimator](**content.arguments)
    if wrong := [a.dtype for a in content.arrays if _DTYPE.fullmatch(a.dtype) is None]:
        raise ValueError(f"no numbers are of the type {wrong[0]!r}")
    arrays = tuple(np.frombuffer(a.data, np.dtype(a.dtype)).reshape(a.shape) for a in content.arrays)
    estimator.import_state(EstimatorState(content.signal, content.tracker, content.reference, arrays))
    return estimator
