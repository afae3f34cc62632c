"""Checksums that messages carry: whether the bytes of a frame are those that were sent."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Octets = npt.NDArray[np.uint8]


def _crc8_table(polynomial: int) -> Octets:
    table: npt.NDArray[Any] = np.arange(256)
    for _ in range(8):
        table = np.where(table & 0x80, (table << 1) ^ polynomial, table << 1) & 0xFF
    return table.astype(np.uint8)


def _crc8(data: Octets, polynomial: int, initial: int, final: int) -> Octets:
    table = _crc8_table(polynomial)
    crc = np.full(len(data), initial, np.uint8)
    for column in data.T:
        crc = table[crc ^ column]
    return crc ^ np.uint8(final)


def crc8_sae_j1850(data: Octets) -> Octets:
    """CRC-8 SAE J1850 (AUTOSAR Crc_CalculateCRC8): 0x1D, begun with 0xFF, inverted.

    Examples
    --------
    >>> hex(crc8_sae_j1850(np.frombuffer(b"123456789", np.uint8).reshape(1, -1))[0])
    '0x4b'
    """
    return _crc8(data, 0x1D, 0xFF, 0xFF)


def crc8_autosar(data: Octets) -> Octets:
    """CRC-8 of AUTOSAR (Crc_CalculateCRC8H2F): 0x2F, begun with 0xFF, inverted.

    Examples
    --------
    >>> hex(crc8_autosar(np.frombuffer(b"123456789", np.uint8).reshape(1, -1))[0])
    '0xdf'
    """
    return _crc8(data, 0x2F, 0xFF, 0xFF)


def crc8_sae_j1850_zero(data: Octets) -> Octets:
    """CRC-8 of polynomial 0x1D, begun with 0, not inverted.

    Examples
    --------
    >>> hex(crc8_sae_j1850_zero(np.frombuffer(b"123456789", np.uint8).reshape(1, -1))[0])
    '0x37'
    """
    return _crc8(data, 0x1D, 0x00, 0x00)


def sum8(data: Octets) -> Octets:
    """Sum of the bytes, modulo 256."""
    return np.asarray(data.sum(axis=1, dtype=np.uint64), np.uint8)


def xor8(data: Octets) -> Octets:
    """Exclusive or of the bytes."""
    return np.asarray(np.bitwise_xor.reduce(data, axis=1), np.uint8)


CHECKSUMS: dict[str, Callable[[Octets], Octets]] = {
    "xor": xor8,
    "sum8": sum8,
    "crc8_sae_j1850": crc8_sae_j1850,
    "crc8_sae_j1850_zero": crc8_sae_j1850_zero,
    "crc8_autosar": crc8_autosar,
}
