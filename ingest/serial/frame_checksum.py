"""Checksums of serial frames, of many frames at once."""

from functools import cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from stream.batch import IntArray

ByteArray = npt.NDArray[np.uint8]
ChecksumKind = Literal["sum8", "xor", "crc8", "crc16-ccitt", "crc16-modbus"]

CHECKSUM_BYTES: dict[str, int] = {"sum8": 1, "xor": 1, "crc8": 1, "crc16-ccitt": 2, "crc16-modbus": 2}
_INITIAL = {"sum8": 0, "xor": 0, "crc8": 0, "crc16-ccitt": 0xFFFF, "crc16-modbus": 0xFFFF}


def checksums(kind: ChecksumKind, data: ByteArray, initial: int | None = None) -> IntArray:
    """Checksum of each row.

    Parameters
    ----------
    kind: ``sum8`` and ``xor``: of the bytes. ``crc8``: polynomial 0x07, from 0. ``crc16-ccitt``: 0x1021, from 0xFFFF
        ("CCITT-FALSE"). ``crc16-modbus``: 0x8005 reflected, from 0xFFFF.
    data: shape (n, m); the bytes of n frames.
    initial: Where it starts, if elsewhere.

    Returns
    -------
    ndarray of int64, shape (n,)

    Examples
    --------
    >>> text = np.frombuffer(b"123456789", np.uint8)[None]
    >>> [hex(checksums(kind, text)[0]) for kind in ("crc8", "crc16-ccitt", "crc16-modbus")]
    ['0xf4', '0x29b1', '0x4b37']
    """
    start = _INITIAL[kind] if initial is None else initial
    if kind == "sum8":
        return np.asarray((data.sum(axis=1, dtype=np.int64) + start) & 0xFF)
    state = np.full(len(data), start, np.int64)
    for column in data.T.astype(np.int64):
        if kind == "xor":
            state ^= column
        elif kind == "crc8":
            state = _table(kind)[state ^ column]
        elif kind == "crc16-ccitt":
            state = ((state << 8) & 0xFFFF) ^ _table(kind)[(state >> 8) ^ column]
        else:
            state = (state >> 8) ^ _table(kind)[(state ^ column) & 0xFF]
    return state


@cache
def _table(kind: str) -> IntArray:
    table = np.arange(256, dtype=np.int64)
    if kind == "crc16-ccitt":
        table <<= 8
    for _ in range(8):
        if kind == "crc8":
            table = np.where(table & 0x80, (table << 1) ^ 0x07, table << 1) & 0xFF
        elif kind == "crc16-ccitt":
            table = np.where(table & 0x8000, (table << 1) ^ 0x1021, table << 1) & 0xFFFF
        else:
            table = np.where(table & 1, (table >> 1) ^ 0xA001, table >> 1)
    return table
