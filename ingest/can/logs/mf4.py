"""MF4 logs by asammdf, whose machine code reads wherever a damaged file says: it is asked for what is there only."""

import logging
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import can
import numpy as np
import numpy.typing as npt
from can.io.generic import MessageReader

Offsets = npt.NDArray[np.uint64]
_SIZE_BYTES = 4  # before each value of variable length


def mf4_reader(path: Path) -> MessageReader:
    """Open an MF4 file; whatever asammdf raises of a damaged one."""
    from asammdf.blocks import mdf_v4

    names = vars(mdf_v4)
    if "print" not in names:
        # it prints some errors among our results; logged, they are reported as damage
        names["print"] = lambda *texts, **_: logging.getLogger("asammdf").warning(
            " ".join(map(str, texts)).strip().split("\n")[-1]
        )
        # its destructor fails, and Python prints that, where the constructor did not come to its end
        kind: Any = mdf_v4.MDF4
        kind.__del__ = lambda mdf: _closed(mdf.close)
        names["validate_blocks"] = lambda *_: False  # a second way to read, all in machine code that checks nothing
        for name, guard in _GUARDS.items():
            names[name] = guard(names[name])
    return can.MF4Reader(str(path))


def _closed(close: Callable[[], None]) -> None:
    with suppress(AttributeError):
        close()


def _raw_bytes(read: Callable[..., Any]) -> Callable[..., Any]:
    """Bytes of a channel in each record."""

    def guarded(data: bytes, record_bytes: int, offset_bytes: int, count: int) -> Any:
        if record_bytes < 0 or not 0 <= offset_bytes <= record_bytes or count < 0:
            raise ValueError(f"a channel lies beyond its records: byte {offset_bytes:,} of {record_bytes:,}")
        return read(data, record_bytes, offset_bytes, count)

    return guarded


def _invalidation(read: Callable[..., Any]) -> Callable[..., Any]:
    """A bit of each record's invalidation bytes."""

    def guarded(data: bytes, size_bytes: int, bit: int, *others: Any) -> Any:
        if size_bytes > 0 and not 0 <= bit < 8 * size_bytes:
            raise ValueError(f"a channel's invalidation bit lies beyond its records: bit {bit:,} of {8 * size_bytes:,}")
        return read(data, size_bytes, bit, *others)

    return guarded


def _values(read: Callable[..., Any]) -> Callable[..., Any]:
    """Values of variable length, up to the first that lies beyond the data."""

    def guarded(data: bytes, is_bytes: bool, offsets: Offsets | None) -> Any:
        return read(data, is_bytes, None if offsets is None else _within(offsets, data))

    return guarded


def _largest(read: Callable[..., Any]) -> Callable[..., Any]:
    """Size of the largest value of variable length."""

    def guarded(data: bytes, offsets: Offsets, count: int) -> Any:
        inside = np.ascontiguousarray(_within(offsets[:count], data), np.uint64)
        return read(data, inside, len(inside)) if len(inside) else 0

    return guarded


def _within(offsets: Offsets, data: bytes) -> Offsets:
    beyond = np.flatnonzero((offsets > max(0, len(data) - _SIZE_BYTES)) | (offsets < 0))
    return offsets[: beyond[0]] if len(beyond) else offsets


_GUARDS = {
    "get_channel_raw_bytes": _raw_bytes, "get_invalidation_bits_array": _invalidation, "extract": _values,
    "get_vlsd_max_sample_size": _largest,
}  # fmt: skip
