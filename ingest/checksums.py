"""Checksums of many frames at once, of CAN and of serial lines."""

from functools import cache
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from stream.batch import IntArray

ByteArray = npt.NDArray[np.uint8]


class _Crc(NamedTuple):
    bits: int
    polynomial: int
    initial: int
    final: int = 0
    is_reflected: bool = False


_CRCS = {
    "crc8": _Crc(8, 0x07, 0),
    "crc8_sae_j1850": _Crc(8, 0x1D, 0xFF, 0xFF),
    "crc8_sae_j1850_zero": _Crc(8, 0x1D, 0),
    "crc8_autosar": _Crc(8, 0x2F, 0xFF, 0xFF),
    "crc16-ccitt": _Crc(16, 0x1021, 0xFFFF),
    "crc16-modbus": _Crc(16, 0xA001, 0xFFFF, is_reflected=True),
}
CAN_CHECKSUMS = ("xor", "sum8", "crc8_sae_j1850", "crc8_sae_j1850_zero", "crc8_autosar")
SerialChecksum = Literal["sum8", "xor", "crc8", "crc16-ccitt", "crc16-modbus"]
SERIAL_CHECKSUM_BYTES: dict[str, int] = {"sum8": 1, "xor": 1, "crc8": 1, "crc16-ccitt": 2, "crc16-modbus": 2}


def checksums(kind: str, data: ByteArray, initial: int | None = None) -> IntArray:
    """Checksum of each row of bytes, shape (n,).

    `kind`: ``sum8`` and ``xor``: of the bytes. ``crc8``: polynomial 0x07, from 0. ``crc8_sae_j1850`` (AUTOSAR
    Crc_CalculateCRC8): 0x1D, from 0xFF, inverted; ``..._zero``: from 0, not inverted. ``crc8_autosar``
    (Crc_CalculateCRC8H2F): 0x2F, from 0xFF, inverted. ``crc16-ccitt``: 0x1021, from 0xFFFF ("CCITT-FALSE").
    ``crc16-modbus``: 0x8005 reflected, from 0xFFFF.

    >>> text = np.frombuffer(b"123456789", np.uint8)[None]
    >>> [hex(checksums(kind, text)[0]) for kind in ("crc8", "crc16-ccitt", "crc16-modbus")]
    ['0xf4', '0x29b1', '0x4b37']
    >>> [hex(checksums(kind, text)[0]) for kind in ("crc8_sae_j1850", "crc8_sae_j1850_zero", "crc8_autosar")]
    ['0x4b', '0x37', '0xdf']
    """
    if kind == "sum8":
        return np.asarray((data.sum(axis=1, dtype=np.int64) + (initial or 0)) & 0xFF)
    if kind == "xor":
        return np.asarray(np.bitwise_xor.reduce(data, axis=1).astype(np.int64) ^ (initial or 0))
    crc = _CRCS[kind]
    table = _table(crc)
    state = np.full(len(data), crc.initial if initial is None else initial, np.int64)
    for column in data.T.astype(np.int64):
        if crc.is_reflected:
            state = (state >> 8) ^ table[(state ^ column) & 0xFF]
        else:
            state = ((state << 8) & (1 << crc.bits) - 1) ^ table[(state >> crc.bits - 8) ^ column]
    return state ^ crc.final


@cache
def _table(crc: _Crc) -> IntArray:
    table = np.arange(256, dtype=np.int64)
    if crc.is_reflected:
        for _ in range(8):
            table = np.where(table & 1, (table >> 1) ^ crc.polynomial, table >> 1)
        return table
    top, mask = 1 << crc.bits - 1, (1 << crc.bits) - 1
    table <<= crc.bits - 8
    for _ in range(8):
        table = np.where(table & top, (table << 1) ^ crc.polynomial, table << 1) & mask
    return table
