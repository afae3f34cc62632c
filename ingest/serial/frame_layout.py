"""Layout of the frames of a serial gyro, from a TOML file."""

import math
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from ingest.checksums import SERIAL_CHECKSUM_BYTES, ByteArray, SerialChecksum
from stream.batch import FloatArray, IntArray
from stream.errors import BadInput
from stream.files.toml_text import decode_toml
from stream.identity import check_name

FieldType = Literal["u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "float32", "float64"]
ByteOrder = Literal["little", "big"]
Index = Annotated[int, msgspec.Meta(ge=0)]

SIZES: dict[str, int] = {
    "u8": 1, "i8": 1, "u16": 2, "i16": 2, "u24": 3, "i24": 3, "u32": 4, "i32": 4, "float32": 4, "float64": 8,
}  # fmt: skip
_LONGEST = 4096


class FrameField(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A quantity in a frame: `at` is its first byte, counted from the frame's first; value = raw * scale + offset."""

    signal: str  # name of the quantity
    at: Index  # its first byte, from 0
    type: FieldType  # of the raw number
    scale: float = 1.0  # value of one count
    offset: float = 0.0  # value of count 0
    unit: str = "1"  # unit of measure of the value; 1 is none
    byte_order: ByteOrder | None = None  # ``big`` or ``little``; by default that of the frame


class FrameNumber(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The counter or the length in a frame.

    A counter wraps at `modulus`, by default at the range of its type. A length plus `add` is that of the whole frame.
    """

    at: Index  # its first byte, from 0
    type: Literal["u8", "u16", "u24", "u32"]  # of the number
    modulus: Annotated[int, msgspec.Meta(ge=2)] | None = None  # at which a counter begins again
    add: int = 0  # bytes of a frame that its length field leaves out
    byte_order: ByteOrder | None = None  # ``big`` or ``little``; by default that of the frame


class FrameChecksum(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A checksum over the bytes from `start` up to, not including, `stop`; negative ones count from the frame's end."""

    kind: SerialChecksum  # how it is computed
    at: int = -1  # its first byte; -1 is the frame's last
    start: int = 0  # first byte it is over
    stop: int | None = None  # the byte after the last of these; by default the checksum's own first
    initial: int | None = None  # value that it begins with; by default that of its kind
    byte_order: ByteOrder | None = None  # ``big`` or ``little``; by default that of the frame


class FrameLayout(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Layout of a frame.

    >>> layout = decode_layout(b'''
    ... sync = "AA 55"
    ... length = 7
    ... interval_s = 0.005
    ... counter = {at = 2, type = "u8"}
    ... checksum = {kind = "xor", at = -1, start = 2}
    ... [[fields]]
    ... signal = "rate"
    ... at = 3
    ... type = "i24"
    ... scale = 1e-5
    ... unit = "deg/s"
    ... ''', "layout.toml")
    >>> layout.shortest
    7
    """

    sync: str  # bytes with which each frame begins, in hexadecimal: ``"AA 55"``
    interval_s: float  # nominal time between frames, seconds
    length: int | None = None  # bytes of a frame including sync
    length_field: FrameNumber | None = None  # the field that holds it, instead
    longest: int = 256  # bytes of the longest frame with a length field: a length beyond it is garbage
    byte_order: ByteOrder = "big"  # ``big`` or ``little``, unless a field has its own
    fields: tuple[FrameField, ...]  # the quantities in the frame
    counter: FrameNumber | None = None  # tells lost frames
    checksum: FrameChecksum | None = None  # by default none is checked
    data_bits: Literal[7, 8] = 8  # of the line
    parity: Literal["N", "E", "O"] = "N"  # none, even or odd
    stop_bits: Literal[1, 2] = 1  # of the line

    @property
    def sync_bytes(self) -> bytes:
        """The sync bytes."""
        return bytes.fromhex(self.sync)

    @property
    def shortest(self) -> int:
        """Bytes of the shortest frame that holds everything."""
        ends = [len(self.sync_bytes)]
        ends += [field.at + SIZES[field.type] for field in self.fields]
        ends += [number.at + SIZES[number.type] for number in (self.counter, self.length_field) if number is not None]
        if (checksum := self.checksum) is not None:
            size = SERIAL_CHECKSUM_BYTES[checksum.kind]
            ends.append(checksum.at + size if checksum.at >= 0 else max(ends) - checksum.at)
        return max(ends)

    def check(self, where: str) -> None:
        """Raise BadInput, with `where` before it, if the layout contradicts itself."""
        try:
            is_there = bool(self.sync_bytes)
        except ValueError:
            is_there = False
        shortest = self.shortest if is_there else 0
        checksum, counter = self.checksum, self.counter
        scales = [each.scale and math.isfinite(each.scale) and math.isfinite(each.offset) for each in self.fields]
        is_counted = counter is None or (counter.modulus or 2) <= 256 ** SIZES[counter.type]
        is_inside = checksum is None or checksum.at >= 0 or -checksum.at >= SERIAL_CHECKSUM_BYTES[checksum.kind]
        parts = f"but its parts need {shortest} bytes, and {_LONGEST} are allowed"
        rules = (
            (is_there, f'sync is {self.sync!r}, hexadecimal bytes are needed, for example "AA 55"'),
            (0.0 < self.interval_s < 1e6, f"interval_s is {self.interval_s}, more than 0 is needed"),
            ((self.length is None) != (self.length_field is None), "either length or length_field is needed"),
            (self.length is None or shortest <= self.length <= _LONGEST, f"length is {self.length}, {parts}"),
            (self.length is not None or shortest <= self.longest <= _LONGEST, f"longest is {self.longest}, {parts}"),
            (bool(self.fields), "it has no fields: it would give no samples"),
            (len({each.signal for each in self.fields}) == len(self.fields), "two fields have the same signal"),
            (all(scales), "a scale is 0, or a scale or offset is not finite"),
            (is_counted, "the counter's modulus is more than its type holds"),
            (is_inside, "the checksum reaches beyond the frame"),
        )
        for is_kept, complaint in rules:
            if not is_kept:
                raise BadInput(f"{where}: {complaint}")
        for each in self.fields:
            try:
                check_name("signal", each.signal)
            except BadInput as error:
                raise BadInput(f"{where}: {error}") from error

    def order(self, part: FrameField | FrameNumber | FrameChecksum) -> ByteOrder:
        """Byte order of a part."""
        return part.byte_order or self.byte_order


def decode_layout(text: bytes, where: str) -> FrameLayout:
    """Read a layout from TOML; raises BadInput, with `where` before it."""
    try:
        layout = decode_toml(text, FrameLayout)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(f"{where}: {error}") from None
    layout.check(where)
    return layout


def load_layout(path: Path) -> FrameLayout:
    """Read a layout from a TOML file; raises BadInput if it cannot be read or is no layout."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise BadInput(f"{path}: the layout of the frames cannot be read: {error.strerror}") from error
    return decode_layout(text, str(path))


def integers(data: ByteArray, at: int, kind: str, order: ByteOrder) -> IntArray:
    """Whole numbers of one place in many frames, shape (n,)."""
    part = data[:, at : at + SIZES[kind]].astype(np.int64)
    columns = part.T if order == "big" else part.T[::-1]
    value = np.zeros(len(data), np.int64)
    for column in columns:
        value = (value << 8) | column
    bits = 8 * SIZES[kind]
    return value - ((value >> (bits - 1)) << bits) if kind.startswith("i") else value


def floats(data: ByteArray, at: int, kind: str, order: ByteOrder) -> FloatArray:
    """Floating-point numbers of one place in many frames, shape (n,)."""
    size = SIZES[kind]
    part = np.ascontiguousarray(data[:, at : at + size])
    with np.errstate(invalid="ignore"):  # a signalling NaN becomes a NaN
        return np.asarray(part.view(f"{'>' if order == 'big' else '<'}f{size}").ravel(), np.float64)
