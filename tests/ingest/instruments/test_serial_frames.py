"""Frames of serial gyros: decoded, and found in garbage however it is cut."""

import binascii
import random
import struct
from collections.abc import Callable
from functools import reduce
from itertools import pairwise
from typing import Literal

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.checksums import checksums
from ingest.serial.frame_layout import FrameLayout
from ingest.serial.serial_frames import SerialFrames
from stream.batch import SampleBatch
from tests.ingest.instruments.serial_gyros import EPOCH, FIXED, VARIABLE, bit_by_bit, fixed, modbus, rates, variable


def read(frames: SerialFrames, data: bytes, t_ns: int = 0, cuts: list[int] | None = None) -> list[SampleBatch]:
    cuts = sorted({min(cut, len(data)) for cut in cuts or []} | {0, len(data)})
    batches = [b for i, j in pairwise(cuts) for b in frames.feed(data[i:j], t_ns)]
    return batches + frames.finish(t_ns)


def test_checksums_are_those_of_their_definitions() -> None:
    assert bit_by_bit(b"123456789", 0, 0x07, 0x80) == 0xF4  # the check values of the catalogue of CRCs
    assert modbus(b"123456789") == 0x4B37
    data = np.random.default_rng(1).integers(0, 256, (50, 17), np.uint8)
    others: dict[str, Callable[[bytes], int]] = {
        "crc8": lambda row: bit_by_bit(row, 0, 0x07, 0x80),
        "crc16-ccitt": lambda row: binascii.crc_hqx(row, 0xFFFF),
        "crc16-modbus": modbus,
        "sum8": lambda row: sum(row) % 256,
        "xor": lambda row: reduce(lambda a, b: a ^ b, row),
    }
    for kind, other in others.items():
        assert checksums(kind, data).tolist() == [other(row.tobytes()) for row in data]
    assert checksums("crc16-ccitt", data, 0).tolist() == [binascii.crc_hqx(row.tobytes(), 0) for row in data]


def test_a_frame_by_hand() -> None:
    frames = SerialFrames(FIXED, "FOG-1", "r1", EPOCH)
    rate, temperature = frames.feed(fixed(9, -2_000_000, -100), 77)
    assert rate.counts is not None
    assert (rate.counts.tolist(), rate.scale, rate.unit_of_measure, rate.t0_ns) == ([-2_000_000], 1e-6, "deg/s", 77)
    assert temperature.value_array.tolist() == [-41.0]
    assert (temperature.seq, temperature.dt_ns, temperature.unit) == (0, 5_000_000, "FOG-1")


@pytest.mark.parametrize("order", ["little", "big"])
def test_every_type_in_both_orders(order: Literal["little", "big"]) -> None:
    kinds = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "float32": "f", "float64": "d"}
    sign = "<" if order == "little" else ">"
    rng = np.random.default_rng(2)
    for kind, code in {**kinds, "i24": "", "u24": ""}.items():
        size = int(kind[1:]) // 8 if not kind.startswith("float") else int(kind[5:]) // 8
        layout = msgspec.convert(
            {
                "sync": "7E",
                "length": 1 + size,
                "interval_s": 1.0,
                "byte_order": order,
                "fields": [{"signal": "x", "at": 1, "type": kind}],
            },
            FrameLayout,
        )
        for _ in range(20):
            raw = rng.bytes(size)
            whole = int.from_bytes(raw, order, signed=kind == "i24")
            expected = struct.unpack(sign + code, raw)[0] if code else whole
            [batch] = SerialFrames(layout, "U", "r", EPOCH).feed(b"\x7e" + raw, 0)
            assert np.array_equal(batch.value_array, [expected], equal_nan=True)
            assert (batch.counts is None) == (kind in {"u32", "float32", "float64"})


garbage = st.lists(st.binary(max_size=40), min_size=1, max_size=12)
cuts = st.lists(st.integers(0, 600), max_size=10)


@pytest.mark.long
@settings(deadline=None, max_examples=150)
@given(garbage, cuts, st.booleans())
def test_with_garbage_that_holds_no_sync_every_frame_is_found(
    between: list[bytes], where: list[int], is_fixed: bool
) -> None:
    first = b"\xaa" if is_fixed else b"\xeb"
    between = [part.replace(first, b"\x00") for part in between]
    frames = SerialFrames(FIXED if is_fixed else VARIABLE, "U", "r", EPOCH)
    made = [fixed(i, i * 1000) if is_fixed else variable(i, i / 4, b"\x01" * (i % 7)) for i in range(len(between))]
    data = b"".join(part + frame for part, frame in zip(between, made, strict=True))
    found = rates(read(frames, data, cuts=where))
    assert found == pytest.approx([i * 1e-3 if is_fixed else i / 4 for i in range(len(made))])
    assert frames.counts.dropped_bytes == sum(map(len, between))
    assert frames.counts.lost == frames.counts.bad_checksums == 0


def one_by_one(data: bytes) -> list[tuple[int, int]]:
    """Where the frames of VARIABLE are by its rule: from left to right, a byte dropped where there is none."""
    found, at = [], 0
    while at < len(data):
        length = data[at + 2] + 4 if at + 2 < len(data) else 0
        frame = data[at : at + length]
        is_frame = frame[:2] == b"\xeb\x90" and 10 <= length <= 40 and len(frame) == length
        if is_frame and reduce(lambda a, b: a ^ b, frame[2:-1]) == frame[-1]:
            found.append((at, length))
            at += length
        else:
            at += 1
    return found


looks_alike = st.one_of(
    st.binary(max_size=6),
    st.just(b"\xeb"),
    st.just(b"\xeb\x90"),
    st.binary(max_size=3).map(lambda tail: b"\xeb\x90" + tail),
    st.integers(0, 60_000).map(lambda i: variable(i, 1.0)[:-3]),
    st.tuples(st.integers(0, 60_000), st.binary(max_size=9)).map(lambda p: variable(p[0], 2.0, p[1])),
    st.integers(0, 60_000).map(lambda i: variable(i, 3.0, variable(i, 4.0))),  # a frame within a frame
)


@pytest.mark.long
@settings(deadline=None, max_examples=300)
@given(st.lists(looks_alike, max_size=25), cuts)
def test_whatever_comes_is_read_by_the_rule_however_it_is_cut(parts: list[bytes], where: list[int]) -> None:
    data = b"".join(parts)
    frames = SerialFrames(VARIABLE, "U", "r", EPOCH)
    read(frames, data, cuts=where)
    expected = one_by_one(data)
    assert frames.counts.frames == len(expected)
    assert frames.counts.dropped_bytes == len(data) - sum(length for _, length in expected)


def test_a_flipped_bit_costs_one_frame() -> None:
    rng = random.Random(4)
    data = bytearray(b"".join(fixed(i, i) for i in range(200)))
    hit = sorted(rng.sample(range(1, 199), 20))
    for number in hit:
        data[number * 12 + rng.randrange(12)] ^= 1 << rng.randrange(8)
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    found = rates(read(frames, bytes(data)))
    assert [round(rate * 1e6) for rate in found] == [i for i in range(200) if i not in hit]
    assert frames.counts.lost == 20
    assert frames.counts.dropped_bytes == 240
