"""Signals out of the bytes of many CAN frames at once: shifts and masks on columns instead of a call per frame."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ingest.can.frames import MOST_BYTES
from stream.batch import BoolArray, CountArray, FloatArray

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
    """The bytes of n frames of one message, and the 64-bit words that signals are cut from, made once each.

    Parameters
    ----------
    data: shape (n, width); bytes beyond a frame's length are 0; the width is at least 8.
    length: shape (n,); bytes that each frame has.
    """

    def __init__(self, data: npt.NDArray[np.uint8], length: npt.NDArray[np.uint8]) -> None:
        self.data = data
        self.length = length
        self.width = data.shape[1]
        self.least = int(length.min(initial=self.width))
        self._words: dict[tuple[int, str], npt.NDArray[np.uint64]] = {}

    def __len__(self) -> int:
        return len(self.data)

    def word(self, first: int, order: str) -> npt.NDArray[np.uint64]:
        """Bytes `first` to `first` + 7 as one number; `order` is ``<`` or ``>``."""
        found = self._words.get((first, order))
        if found is None:
            octets = np.ascontiguousarray(self.data[:, first : first + _WORD_BYTES])
            found = octets.view(f"{order}u8").reshape(-1).astype(np.uint64, copy=False)
            self._words[first, order] = found
        return found

    def octet(self, index: int) -> npt.NDArray[np.uint64]:
        """Byte `index` of every frame."""
        return self.data[:, index].astype(np.uint64)


@dataclass(frozen=True)
class BitField:
    """Where a signal lies in a frame and what its bits mean.

    Parameters
    ----------
    order: ``<`` (Intel) or ``>`` (Motorola).
    first_bit: Intel: its least significant bit, counted from bit 0 of byte 0. Motorola: its most significant bit,
        counted from bit 7 of byte 0 downwards and on.
    bits: How many, 1 to 64.
    is_signed, is_float: Two's complement; IEEE 754 of 16, 32 or 64 bits.

    Examples
    --------
    >>> data = np.array([[0x34, 0x12, 0, 0, 0, 0, 0, 0]], np.uint8)
    >>> frames = FrameBytes(data, np.array([8], np.uint8))
    >>> hex(BitField("<", 0, 16).raw(frames)[0]), hex(BitField(">", 0, 16).raw(frames)[0])
    ('0x1234', '0x3412')
    """

    order: str
    first_bit: int
    bits: int
    is_signed: bool = False
    is_float: bool = False

    @property
    def needs_bytes(self) -> int:
        """Bytes that a frame must have to hold all of it."""
        return (self.first_bit + self.bits + 7) // 8

    @property
    def fits_counts(self) -> bool:
        """Whether each of its values is an integer of 32 bits with sign."""
        return not self.is_float and self.bits <= _COUNT_BITS - (not self.is_signed)

    def raw(self, frames: FrameBytes) -> RawArray:
        """Its value in every frame, without scale: int64, uint64 (64 bits without sign) or float64."""
        word = self._bits(frames)
        if self.is_float:
            unsigned, floating = _FLOATS[self.bits]
            # a NaN that signals is quieted on the way to float64, which the processor remarks on
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
    """Where cantools says that a signal lies."""
    is_little = signal.byte_order == "little_endian"
    first = signal.start if is_little else 8 * (signal.start // 8) + 7 - signal.start % 8
    return BitField("<" if is_little else ">", first, signal.length, bool(signal.is_signed), bool(signal.is_float))


@dataclass(frozen=True)
class Switch:
    """A signal is present only where the multiplexer `name` is, and has one of these raw values."""

    name: str
    values: tuple[int, ...]


@dataclass(frozen=True)
class SignalLayout:
    """One signal of a message: its bits, how they become a value, and when it is there.

    Parameters
    ----------
    name: As the database calls it.
    field: Its bits.
    scale, offset: value = raw * scale + offset.
    switch: The multiplexer it hangs on.
    unit_of_measure: As the database writes it.
    """

    name: str
    field: BitField
    scale: float = 1.0
    offset: float = 0.0
    switch: Switch | None = None
    unit_of_measure: str = ""


@dataclass(frozen=True)
class Decoded:
    """One signal in the frames that carry it.

    Parameters
    ----------
    rows: shape (n,); which frames those are; None for all.
    raw: Its values there, without scale.
    short: Frames that should carry it and are too short.
    """

    rows: BoolArray | None
    raw: RawArray
    short: int

    def counts(self) -> CountArray:
        """The raw values as 32-bit integers; only where the field fits them."""
        return self.raw.astype(np.int32)

    def values(self, scale: float, offset: float) -> FloatArray:
        """The values: raw * scale + offset."""
        if (scale, offset) == (1.0, 0.0):
            return np.asarray(self.raw, np.float64)
        # an IEEE float off the bus may be anything; whoever uses it looks whether it is finite
        with np.errstate(invalid="ignore", over="ignore"):
            return np.asarray(self.raw * scale + offset, np.float64)


class MessageLayout:
    """A message of a database, ready to decode many of its frames at once.

    Parameters
    ----------
    name: As the database calls it.
    signals: Its signals by name.

    Attributes
    ----------
    unusable: Signals of the database that cannot be decoded, and why.

    Examples
    --------
    >>> layout = MessageLayout("IMU", {"rate": SignalLayout("rate", BitField("<", 0, 16, is_signed=True), 0.25)})
    >>> frames = FrameBytes(np.array([[0xFE, 0xFF, 0, 0, 0, 0, 0, 0]], np.uint8), np.array([2], np.uint8))
    >>> layout.decode(frames, ["rate"])["rate"].values(0.25, 0.0).tolist()
    [-0.5]
    """

    def __init__(self, name: str, signals: Mapping[str, SignalLayout]) -> None:
        self.name = name
        self.signals = dict(signals)
        self.unusable: dict[str, str] = {}

    @classmethod
    def of(cls, message: "Message") -> "MessageLayout":
        """The layout of a message as cantools has read it, without signals that cannot be decoded."""
        unusable = {signal.name: why for signal in message.signals if (why := why_unusable(signal)) is not None}
        signals = {signal.name: _signal_layout(signal) for signal in message.signals if signal.name not in unusable}
        for name, layout in list(signals.items()):
            if layout.switch is not None and layout.switch.name not in signals:
                unusable[name] = f"its multiplexer {layout.switch.name} is not there"
                del signals[name]
        found = cls(message.name, signals)
        found.unusable = unusable
        return found

    def decode(self, frames: FrameBytes, names: "list[str] | tuple[str, ...]") -> dict[str, Decoded]:
        """Decode the signals `names` of n frames of the message."""
        known: dict[str, tuple[BoolArray | None, RawArray, int]] = {}
        decoded: dict[str, Decoded] = {}
        for name in names:
            rows, raw, short = self._full(name, frames, known)
            decoded[name] = Decoded(rows, raw if rows is None else raw[rows], short)
        return decoded

    def _full(
        self, name: str, frames: FrameBytes, known: dict[str, tuple[BoolArray | None, RawArray, int]]
    ) -> tuple[BoolArray | None, RawArray, int]:
        """Where a signal is present, its raw value in all frames (meaningless in others), and the short ones."""
        if name in known:
            return known[name]
        layout = self.signals[name]
        needs = layout.field.needs_bytes
        rows = None
        if layout.switch is not None:
            rows, selector, _ = self._full(layout.switch.name, frames, known)
            chosen = np.isin(selector, np.array(layout.switch.values, selector.dtype))
            rows = chosen if rows is None else rows & chosen
        short = 0
        if needs > frames.least:
            long_enough = frames.length >= needs
            short = int((~long_enough if rows is None else rows & ~long_enough).sum())
            if short:
                rows = long_enough if rows is None else rows & long_enough
        if needs > frames.width:
            raw: RawArray = np.zeros(len(frames), np.float64 if layout.field.is_float else np.int64)
        else:
            raw = layout.field.raw(frames)
        known[name] = rows, raw, short
        return known[name]


def why_unusable(signal: "Signal") -> str | None:
    """Why a signal of a database cannot be decoded; None if it can."""
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
    return None


def _signal_layout(signal: "Signal") -> SignalLayout:
    switch = None
    if signal.multiplexer_signal is not None:
        switch = Switch(signal.multiplexer_signal, tuple(signal.multiplexer_ids or ()))
    return SignalLayout(
        signal.name,
        bit_field(signal),
        float(signal.conversion.scale),
        float(signal.conversion.offset),
        switch,
        signal.unit or "",
    )
