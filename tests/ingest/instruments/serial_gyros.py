"""Two serial gyros, with frames of a fixed and of a variable length."""

import struct
from functools import reduce
from uuid import UUID

import numpy as np

from ingest.serial.frame_layout import decode_layout
from stream.batch import SampleBatch

EPOCH = UUID(int=3)
SECOND = 10**9
FIXED = decode_layout(
    b"""
sync = "AA 55"
length = 12
interval_s = 0.005
byte_order = "little"
counter = {at = 2, type = "u8"}
checksum = {kind = "crc16-modbus", at = -2, start = 2}
[[fields]]
signal = "rate"
at = 3
type = "i32"
scale = 1e-6
unit = "deg/s"
[[fields]]
signal = "temperature"
at = 7
type = "i24"
scale = 0.01
offset = -40.0
unit = "degC"
byte_order = "big"
""",
    "fixed.toml",
)
VARIABLE = decode_layout(
    b"""
sync = "EB 90"
interval_s = 0.01
longest = 40
length_field = {at = 2, type = "u8", add = 4}
counter = {at = 3, type = "u16"}
checksum = {kind = "xor", start = 2}
fields = [{signal = "rate", at = 5, type = "float32", unit = "deg/s"}]
""",
    "variable.toml",
)


def bit_by_bit(data: bytes, state: int, polynomial: int, top: int) -> int:
    """A CRC as its definition has it; reflected where `top` is 1."""
    for byte in data:
        state ^= byte
        for _ in range(8):
            out = state & top
            state = (state >> 1 if top == 1 else (state << 1) & 0xFF) ^ (polynomial if out else 0)
    return state


def modbus(data: bytes) -> int:
    return bit_by_bit(data, 0xFFFF, 0xA001, 1)


def fixed(number: int, rate: int, temperature: int = 6500) -> bytes:
    body = struct.pack("<Bi", number % 256, rate) + temperature.to_bytes(3, "big", signed=True)
    return b"\xaa\x55" + body + struct.pack("<H", modbus(body))


def variable(number: int, rate: float, padding: bytes = b"") -> bytes:
    body = struct.pack(">Hf", number % 65536, rate) + padding
    body = bytes([len(body)]) + body
    return b"\xeb\x90" + body + bytes([reduce(lambda a, b: a ^ b, body)])


def rates(batches: list[SampleBatch]) -> list[float]:
    mine = [batch for batch in batches if batch.signal == "rate"]
    return [] if not mine else np.concatenate([batch.value_array for batch in mine]).tolist()
