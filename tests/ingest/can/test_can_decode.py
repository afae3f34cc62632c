"""Decoding many frames at once gives what cantools gives for each of them."""

import math
from typing import Any

import numpy as np
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.can.decode import BitField, FrameBytes, MessageLayout, scaled

EXACT_BITS = 53
FRAMES = 24


def frames_of(data: list[bytes]) -> FrameBytes:
    width = 8 if max(len(each) for each in data) <= 8 else 64
    rows = np.frombuffer(b"".join(each.ljust(width, b"\0") for each in data), np.uint8).reshape(len(data), width)
    return FrameBytes(rows, np.array([len(each) for each in data], np.uint8))


@st.composite
def signal(draw: Any, /, name: str, first_byte: int, octets: int, **multiplexing: Any) -> Signal:
    """A signal somewhere within some bytes of a frame."""
    floats = [bits for bits in (16, 32, 64) if bits <= 8 * octets]
    is_float = bool(floats) and draw(st.booleans())
    bits = draw(st.sampled_from(floats)) if is_float else draw(st.integers(1, min(64, 8 * octets)))
    position = 8 * first_byte + draw(st.integers(0, 8 * octets - bits))
    order = draw(st.sampled_from(["little_endian", "big_endian"]))
    start = position if order == "little_endian" else 8 * (position // 8) + 7 - position % 8
    scale = draw(st.sampled_from([1, 2, 0.25, 0.1, -0.5, 3.6e3]))
    offset = draw(st.sampled_from([0, -40, 0.5]))
    conversion = BaseConversion.factory(scale=scale, offset=offset, is_float=is_float)
    is_signed = not is_float and draw(st.booleans())
    return Signal(name, start, bits, order, is_signed, conversion=conversion, **multiplexing)


@st.composite
def message(draw: Any, /) -> Message:
    """A message of classic or FD length; one half of them with a multiplexer, and one nested in it."""
    length = draw(st.sampled_from([8, 8, 12, 24, 64]))
    signals: list[Signal] = []
    place = 0
    if draw(st.booleans()):
        signals = [
            Signal("outer", 0, 2, is_multiplexer=True),
            Signal("inner", 8, 2, is_multiplexer=True, multiplexer_ids=[0, 2], multiplexer_signal="outer"),
            draw(signal("of_outer", 1, 3, multiplexer_ids=[1], multiplexer_signal="outer")),
            Signal("rest_outer", 8, 5, multiplexer_ids=[3], multiplexer_signal="outer"),
            draw(signal("of_inner", 2, 3, multiplexer_ids=[0, 3], multiplexer_signal="inner")),
            Signal("rest_inner", 16, 7, is_signed=True, multiplexer_ids=[1, 2], multiplexer_signal="inner"),
        ]
        place = 5
    while place < length:
        octets = draw(st.integers(1, min(9, length - place)))
        signals.append(draw(signal(f"s{place}", place, octets)))
        place += octets
    return Message(0x101, "M", length, signals, strict=True)


def same(mine: float, theirs: float, bits: int) -> bool:
    if math.isnan(theirs):
        return math.isnan(mine)
    # beyond 53 bits cantools calculates with whole numbers of any length, and rounds once less
    return mine == theirs if bits <= EXACT_BITS else math.isclose(mine, theirs, rel_tol=4e-16)


def rows_of(length: int, seed: int) -> list[bytes]:
    """Frames of random bytes, and some at the ends of every range."""
    random = np.random.default_rng(seed)
    ends = [bytes(length), b"\xff" * length, b"\x80" + bytes(length - 1), b"\x7f" + b"\xff" * (length - 1)]
    return ends + [random.bytes(length) for _ in range(FRAMES)]


@settings(max_examples=80, deadline=None, derandomize=True)
@given(message(), st.integers(0, 2**32 - 1))
def test_equal_to_cantools_on_every_kind_of_signal(of: Message, seed: int) -> None:
    rows = rows_of(of.length, seed)
    layout = MessageLayout.of(of)
    decoded = layout.decode(frames_of(rows), list(layout.signals))
    for scaling in (False, True):
        found: list[dict[str, float]] = [{} for _ in rows]
        for name, each in decoded.items():
            scale, offset = (layout.signals[name].scale, layout.signals[name].offset) if scaling else (1.0, 0.0)
            where = range(len(rows)) if each.rows is None else np.flatnonzero(each.rows).tolist()
            for row, value in zip(where, scaled(each.raw, scale, offset).tolist(), strict=True):
                found[row][name] = value
        for octets, mine in zip(rows, found, strict=True):
            theirs: Any = of.decode(octets, decode_choices=False, scaling=scaling)
            assert set(mine) == set(theirs)
            for name, value in theirs.items():
                assert same(mine[name], float(value), layout.signals[name].field.bits), (name, mine[name], value)


@pytest.mark.long
@settings(max_examples=30, deadline=None, derandomize=True)
@given(message(), st.integers(0, 2**32 - 1))
def test_counts_are_the_raw_integers_where_they_fit(of: Message, seed: int) -> None:
    rows = rows_of(of.length, seed)
    layout = MessageLayout.of(of)
    for name, each in layout.decode(frames_of(rows), list(layout.signals)).items():
        field = layout.signals[name].field
        assert field.fits_counts == (not field.is_float and field.bits <= (32 if field.is_signed else 31))
        if field.fits_counts:
            assert each.raw.astype(np.int32).tolist() == each.raw.tolist()


def test_a_frame_that_is_short_lacks_what_it_does_not_hold() -> None:
    of = Message(0x1, "M", 8, [Signal("a", 0, 16), Signal("b", 16, 24), Signal("c", 47, 16, "big_endian")])
    rows = [bytes(range(1, n + 1)) for n in (8, 7, 6, 5, 4, 2, 1, 0)]
    decoded = MessageLayout.of(of).decode(frames_of(rows), ["a", "b", "c"])
    kept = {name: 8 if each.rows is None else int(each.rows.sum()) for name, each in decoded.items()}
    assert kept == {"a": 6, "b": 4, "c": 2}
    short = {name: int(each.short_rows.sum()) for name, each in decoded.items() if each.short_rows is not None}
    assert short == {"a": 2, "b": 4, "c": 6}
    theirs: Any = of.decode(rows[3], allow_truncated=True)
    assert decoded["b"].raw[3] == theirs["b"]


@pytest.mark.parametrize(
    ("field", "octets", "value"),
    [
        (BitField("<", 4, 12), "f0 de 00", 0xDEF),
        (BitField(">", 4, 12), "0d ef 00", 0xDEF),
        (BitField("<", 0, 16, is_signed=True), "ff 7f", 32767),
        (BitField(">", 0, 16, is_signed=True), "80 00", -32768),
        (BitField("<", 4, 64), "f0 ff ff ff ff ff ff ff 0f", 2**64 - 1),
        (BitField(">", 4, 64, is_signed=True), "0f ff ff ff ff ff ff ff e0", -2),
        (BitField("<", 0, 16, is_float=True), "00 3c", 1.0),
        (BitField(">", 8, 32, is_float=True), "00 40 49 0f db", 3.1415927410125732),
        (BitField("<", 448, 64, is_float=True), "00 " * 56 + "00 00 00 00 00 00 f8 3f", 1.5),
    ],
)
def test_bits_by_hand(field: BitField, octets: str, value: float) -> None:
    data = bytes.fromhex(octets)
    assert field.raw(frames_of([data.ljust(8 if len(data) <= 8 else 64, b"\0")])).tolist() == [value]
