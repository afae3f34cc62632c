"""Signals from the bytes of many CAN frames at once: shifts and masks on columns instead of a call per frame."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ingest.can.frames import MOST_BYTES
from stream.batch import BoolArray, FloatArray

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

_WORD_BYTES = 8
_WORD_BITS = 64
_COUNT_BITS = 32
_FLOATS: dict[int, tuple[type[np.unsignedinteger[Any]], type[np.floating[Any]]]] = {
    16: (np.uint16, np.float16),
    32: (np.uint32, np.float32),
    64: (np.uint64, np.float64),
}

RawArray = npt.NDArray[Any]


class FrameBytes:
    """The bytes of n frames of one message, shape (n, at least 8), and their lengths; words are made once each."""

    def __init__(self, data: npt.NDArray[np.uint8], length: npt.NDArray[np.uint8]) -> None:
        self.data, self.length = data, length
        self.width = data.shape[1]
        self.least = int(length.min(initial=self.width))
        self._words: dict[tuple[int, str], npt.NDArray[np.uint64]] = {}

    def word(self, first: int, order: str) -> npt.NDArray[np.uint64]:
        """Bytes `first` to `first` + 7 as one number; `order` is ``<`` or ``>``."""
        if (first, order) not in self._words:
            octets = np.ascontiguousarray(self.data[:, first : first + _WORD_BYTES])
            self._words[first, order] = octets.view(f"{order}u8").reshape(-1).astype(np.uint64, copy=False)
        return self._words[first, order]

    def octet(self, index: int) -> npt.NDArray[np.uint64]:
        """Byte `index` of every frame."""
        return self.data[:, index].astype(np.uint64)


@dataclass(frozen=True)
class BitField:
    """Place and type of a signal in a frame.

    `first_bit`: Intel: its least significant bit, counted from bit 0 of byte 0. Motorola: its most significant bit,
    counted from bit 7 of byte 0 downwards and on.
    `is_signed`, `is_float`: two's complement; IEEE 754 of 16, 32 or 64 bits.

    >>> data = np.array([[0x34, 0x12, 0, 0, 0, 0, 0, 0]], np.uint8)
    >>> frames = FrameBytes(data, np.array([8], np.uint8))
    >>> hex(BitField("<", 0, 16).raw(frames)[0]), hex(BitField(">", 0, 16).raw(frames)[0])
    ('0x1234', '0x3412')
    """

    order: str  # ``<`` (Intel) or ``>`` (Motorola)
    first_bit: int
    bits: int  # how many, 1 to 64
    is_signed: bool = False
    is_float: bool = False

    @property
    def needs_bytes(self) -> int:
        """Bytes that a frame must have to hold all of it."""
        return (self.first_bit + self.bits + 7) // 8

    @property
    def fits_counts(self) -> bool:
        """Whether all its values are signed integers of 32 bits."""
        return not self.is_float and self.bits <= _COUNT_BITS - (not self.is_signed)

    def raw(self, frames: FrameBytes) -> RawArray:
        """Its value in every frame, without scale: int64, uint64 (64 bits without sign) or float64."""
        word = self._bits(frames)
        if self.is_float:
            unsigned, floating = _FLOATS[self.bits]
            # a signalling NaN becomes a quiet one on the way to float64, which sets a flag of the processor
            with np.errstate(invalid="ignore"):
                return word.astype(unsigned).view(floating).astype(np.float64)
        if self.is_signed:
            unused = np.uint64(_WORD_BITS - self.bits)
            return (word << unused).view(np.int64) >> unused.astype(np.int64)
        return word.view(np.int64) if self.bits < _WORD_BITS else word

    def _bits(self, frames: FrameBytes) -> npt.NDArray[np.uint64]:
        first = min(self.first_bit // 8, frames.width - _WORD_BYTES)
        skipped = self.first_bit - 8 * first
        beyond = skipped + self.bits - _WORD_BITS  # bits of the ninth byte
        word = frames.word(first, self.order)
        if self.order == "<":
            value = word >> np.uint64(skipped)
            if beyond > 0:
                value |= frames.octet(first + _WORD_BYTES) << np.uint64(_WORD_BITS - skipped)
        elif beyond > 0:
            value = (word << np.uint64(beyond)) | (frames.octet(first + _WORD_BYTES) >> np.uint64(8 - beyond))
        else:
            value = word >> np.uint64(-beyond)
        return value if self.bits == _WORD_BITS else value & np.uint64((1 << self.bits) - 1)


def bit_field(signal: "Signal") -> BitField:
    """Place and type of a signal of cantools."""
    is_little = signal.byte_order == "little_endian"
    first = signal.start if is_little else 8 * (signal.start // 8) + 7 - signal.start % 8
    return BitField("<" if is_little else ">", first, signal.length, bool(signal.is_signed), bool(signal.is_float))


@dataclass(frozen=True)
class SignalLayout:
    """One signal of a message as in the database: value = raw * scale + offset, within `span` if that is stated.

    With a `switch` it is present only in frames whose multiplexer of that name has one of the raw values.
    """

    name: str
    field: BitField
    scale: float = 1.0
    offset: float = 0.0
    switch: tuple[str, tuple[int, ...]] | None = None
    unit_of_measure: str = ""
    span: tuple[float, float] | None = None


@dataclass(frozen=True)
class Decoded:
    """One signal in the frames of a message."""

    all_raw: RawArray  # shape (n,); raw value of every frame, without meaning in frames that lack the signal
    rows: BoolArray | None  # shape (n,); frames that carry the signal; None for all
    short_rows: BoolArray | None  # shape (n,); frames that should carry it and are too short; None for none

    @property
    def raw(self) -> RawArray:
        """Raw values of the frames that carry it."""
        return self.all_raw if self.rows is None else self.all_raw[self.rows]


def scaled(raw: RawArray, scale: float, offset: float) -> FloatArray:
    """Values of raw ones; a floating-point number off the bus may be anything, also not finite."""
    if (scale, offset) == (1.0, 0.0):
        return np.asarray(raw, np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(raw * scale + offset, np.float64)


class MessageLayout:
    """A message of a database, ready to decode many of its frames at once; `unusable` signals with the reasons.

    >>> layout = MessageLayout("IMU", {"rate": SignalLayout("rate", BitField("<", 0, 16, is_signed=True), 0.25)})
    >>> frames = FrameBytes(np.array([[0xFE, 0xFF, 0, 0, 0, 0, 0, 0]], np.uint8), np.array([2], np.uint8))
    >>> scaled(layout.decode(frames, ["rate"])["rate"].raw, 0.25, 0.0).tolist()
    [-0.5]
    """

    def __init__(self, name: str, signals: Mapping[str, SignalLayout]) -> None:
        self.name = name
        self.signals = dict(signals)
        self.unusable: dict[str, str] = {}

    @classmethod
    def of(cls, message: "Message") -> "MessageLayout":
        """Layout of a message of cantools, without signals that cannot be decoded."""
        signals: dict[str, SignalLayout] = {}
        unusable: dict[str, str] = {}
        names = [signal.name for signal in message.signals]
        for signal in message.signals:
            why = "it is there twice" if names.count(signal.name) > 1 else why_unusable(signal, message.length)
            if why is not None:
                unusable[signal.name] = why
                continue
            scale, offset = float(signal.conversion.scale), float(signal.conversion.offset)
            selector = signal.multiplexer_signal
            switch = None if selector is None else (selector, tuple(signal.multiplexer_ids or ()))
            span = _span(signal)
            layout = SignalLayout(signal.name, bit_field(signal), scale, offset, switch, signal.unit or "", span)
            signals[signal.name] = layout
        for name, layout in list(signals.items()):
            if layout.switch is not None and layout.switch[0] not in signals:
                unusable[name] = f"its multiplexer {layout.switch[0]} is not there"
                del signals[name]
        found = cls(message.name, signals)
        found.unusable = unusable
        return found

    def decode(self, frames: FrameBytes, names: Iterable[str]) -> dict[str, Decoded]:
        """Decode the signals `names` of n frames of the message."""
        known: dict[str, Decoded] = {}
        return {name: self._decoded(name, frames, known) for name in names}

    def _decoded(self, name: str, frames: FrameBytes, known: dict[str, Decoded]) -> Decoded:
        if name in known:
            return known[name]
        layout = self.signals[name]
        needs = layout.field.needs_bytes
        rows = short = None
        if layout.switch is not None:
            multiplexer, values = layout.switch
            selector = self._decoded(multiplexer, frames, known)
            rows = np.isin(selector.all_raw, np.array(values, selector.all_raw.dtype))
            if selector.rows is not None:
                rows &= selector.rows
        if needs > frames.least:
            is_short = frames.length < needs
            short = is_short if rows is None else rows & is_short
            rows = ~is_short if rows is None else rows & ~is_short
        if needs > frames.width:
            raw: RawArray = np.zeros(len(frames.data), np.float64 if layout.field.is_float else np.int64)
        else:
            raw = layout.field.raw(frames)
        known[name] = Decoded(raw, rows, short)
        return known[name]


def _span(signal: "Signal") -> tuple[float, float] | None:
    """Least and greatest value that a database states; both 0 is none, and so are numbers beyond all that is sent."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return None
    try:
        return float(signal.minimum), float(signal.maximum)
    except OverflowError:
        return None


def why_unusable(signal: "Signal", message_bytes: int = 0) -> str | None:
    """Reason why a signal of a database cannot be decoded; None if it can."""
    try:
        conversion = (float(signal.conversion.scale), float(signal.conversion.offset))
    except OverflowError:
        conversion = (math.inf, math.inf)
    if not all(map(math.isfinite, conversion)):
        return "its factor or offset is too large for a number"
    if not 1 <= signal.length <= _WORD_BITS or (signal.is_float and signal.length not in _FLOATS):
        return f"it has {signal.length} bits"
    if bit_field(signal).needs_bytes > MOST_BYTES:
        return f"it ends beyond the {MOST_BYTES} bytes of a frame"
    if 0 < message_bytes < bit_field(signal).needs_bytes:
        return f"it ends beyond the {message_bytes} bytes of its message"
    return None
