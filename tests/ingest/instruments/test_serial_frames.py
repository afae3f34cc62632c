"""Frames of serial gyros: found in garbage, decoded, placed in time, and read from a real (pseudo) terminal."""

import binascii
import os
import random
import struct
import time
import tty
from collections.abc import Callable
from functools import reduce
from itertools import pairwise
from pathlib import Path
from uuid import UUID

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.checksums import checksums
from ingest.serial.frame_layout import FrameLayout, decode_layout, load_layout
from ingest.serial.serial_frames import SerialFrames
from ingest.serial.serial_line import SerialLine
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.errors import BadInput, InstrumentError

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


def read(frames: SerialFrames, data: bytes, t_ns: int = 0, cuts: list[int] | None = None) -> list[SampleBatch]:
    cuts = sorted({min(cut, len(data)) for cut in cuts or []} | {0, len(data)})
    batches = [b for i, j in pairwise(cuts) for b in frames.feed(data[i:j], t_ns)]
    return batches + frames.finish(t_ns)


def rates(batches: list[SampleBatch]) -> list[float]:
    mine = [batch for batch in batches if batch.signal == "rate"]
    return [] if not mine else np.concatenate([batch.value_array for batch in mine]).tolist()


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
def test_every_type_in_both_orders(order: str) -> None:
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
            whole = int.from_bytes(raw, order, signed=kind == "i24")  # type: ignore[arg-type]
            expected = struct.unpack(sign + code, raw)[0] if code else whole
            [batch] = SerialFrames(layout, "U", "r", EPOCH).feed(b"\x7e" + raw, 0)
            assert np.array_equal(batch.value_array, [expected], equal_nan=True)
            assert (batch.counts is None) == (kind in {"u32", "float32", "float64"})


garbage = st.lists(st.binary(max_size=40), min_size=1, max_size=12)
cuts = st.lists(st.integers(0, 600), max_size=10)


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


def test_lost_frames_are_gaps_in_the_times_and_numbers_go_on() -> None:
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    kept = [i for i in range(600) if i not in {5, 6, 7, 300}]
    batches = []
    for start in range(0, 600, 50):
        part = [i for i in kept if start <= i < start + 50]
        batches += frames.feed(b"".join(fixed(i, i) for i in part), SECOND + part[-1] * 5_000_000)
    mine = [batch for batch in batches if batch.signal == "rate"]
    times = np.concatenate([batch.time_array for batch in mine])
    assert times.tolist() == [SECOND + i * 5_000_000 for i in kept]
    assert frames.counts.lost == 4
    assert [batch.seq for batch in mine] == np.cumsum([0, *(len(batch) for batch in mine[:-1])]).tolist()
    assert [batch.times_ns is None for batch in mine].count(False) == 1  # a gap between two batches needs none


def test_a_frame_that_comes_twice_is_one() -> None:
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    assert rates(frames.feed(fixed(1, 1) + fixed(1, 1) + fixed(2, 2), 0)) == pytest.approx([1e-6, 2e-6])
    assert frames.counts.repeated == 1
    assert frames.feed(fixed(2, 2), 1) == []


def test_the_jitter_of_the_line_is_not_in_the_times() -> None:
    rng = np.random.default_rng(7)
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    batches = []
    for k in range(400):
        late_ns = 0 if k == 0 else int(rng.exponential(3e6))
        batches += frames.feed(fixed(2 * k, 0) + fixed(2 * k + 1, 0), SECOND + (2 * k + 1) * 5_000_000 + late_ns)
    times = np.concatenate([batch.time_array for batch in batches if batch.signal == "rate"])
    assert np.abs(times - SECOND - np.arange(800) * 5_000_000).max() < 100_000
    assert frames.counts.lost == 0


@pytest.mark.parametrize("error", [80e-6, -80e-6])
def test_a_clock_that_runs_otherwise_is_followed(error: float) -> None:
    """At 80e-6 a free grid is 96 ms off after 20 min; steered by half of each 10 s it is twice 0.8 ms behind, and one
    window more of drift between two steerings."""
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    worst = 0.0
    made = [fixed(i, 0) for i in range(256)] * 2
    for k in range(0, 240_000, 50):
        true = SECOND + round((k + 49) * 5_000_000 * (1 + error))
        [batch, _] = frames.feed(b"".join(made[k % 256 : k % 256 + 50]), true)
        worst = max(worst, abs(batch.last_ns - true) / 1e9)
    assert worst < 80e-6 * 10 * 3 + 0.001
    assert frames.times.steering == pytest.approx(error, rel=0.1)
    assert frames.counts.lost == 0


def test_a_whole_turn_of_the_counter_that_was_lost_is_counted() -> None:
    frames = SerialFrames(FIXED, "U", "r", EPOCH)
    frames.feed(b"".join(fixed(i, 0) for i in range(10)), SECOND)
    [batch, _] = frames.feed(b"".join(fixed(i, 0) for i in range(10 + 512, 20 + 512)), SECOND + 522 * 5_000_000)
    assert frames.counts.lost == 512
    assert batch.last_ns == SECOND + 522 * 5_000_000


def test_a_counter_that_starts_anew_is_no_loss_of_a_million_frames() -> None:
    frames = SerialFrames(VARIABLE, "U", "r", EPOCH)
    frames.feed(b"".join(variable(i, 0.0) for i in range(30_000, 30_010)), SECOND)
    [batch] = frames.feed(b"".join(variable(i, 0.0) for i in range(10)), 4 * SECOND)
    assert (frames.counts.restarts, frames.counts.lost) == (1, 0)
    assert batch.t0_ns == 4 * SECOND - 90_000_000
    assert batch.last_ns == 4 * SECOND


def test_without_a_counter_time_tells_of_lost_frames() -> None:
    layout = msgspec.structs.replace(FIXED, counter=None)
    frames = SerialFrames(layout, "U", "r", EPOCH)
    frames.feed(fixed(0, 0) * 10, SECOND)
    [batch, _] = frames.feed(fixed(0, 0) * 10, 3 * SECOND)
    assert frames.counts.lost == 390
    assert batch.last_ns == 3 * SECOND


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ('sync = "AA 5"', "sync is 'AA 5'"),
        ('sync = ""', "sync is ''"),
        ("length = 11", "length is 11, but its parts need 12"),
        ("interval_s = 0.0", "interval_s is 0"),
        ('byte_order = "middle"', r"\$\.byte_order"),
        ('counter = {at = 2, type = "u8", modulus = 300}', "modulus is more"),
        ('checksum = {kind = "crc16-modbus", at = -1}', "reaches beyond"),
        ('checksum = {kind = "md5"}', r"\$\.checksum\.kind"),
        ("lenght = 12", "lenght"),
    ],
)
def test_a_layout_that_makes_no_sense_names_its_file_and_place(tmp_path: Path, change: str, complaint: str) -> None:
    parts = {
        "sync": 'sync = "AA 55"',
        "length": "length = 12",
        "interval_s": "interval_s = 0.005",
        "byte_order": 'byte_order = "little"',
        "counter": 'counter = {at = 2, type = "u8"}',
        "checksum": 'checksum = {kind = "crc16-modbus", at = -2, start = 2}',
        "fields": 'fields = [{signal = "rate", at = 3, type = "i32"}, {signal = "t", at = 7, type = "i24"}]',
    }
    path = tmp_path / "gyro.toml"
    path.write_text("\n".join(parts.values()))
    assert load_layout(path).length == 12
    parts[change.split(" ")[0]] = change
    path.write_text("\n".join(parts.values()))
    with pytest.raises(BadInput, match=rf"gyro\.toml: .*{complaint}"):
        load_layout(path)
    with pytest.raises(BadInput, match=r"none\.toml"):
        load_layout(tmp_path / "none.toml")


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_a_port_is_read_lost_and_found_again(tmp_path: Path) -> None:
    path = tmp_path / "tty"
    batches: list[SampleBatch] = []
    said: list[str] = []

    def plug() -> int:
        master, slave = os.openpty()
        tty.setraw(slave)
        path.unlink(missing_ok=True)
        path.symlink_to(os.ttyname(slave))
        os.close(slave)
        return master

    master = plug()
    line = SerialLine(
        str(path), 460_800, FIXED, "FOG-1", "r1", EPOCH, StationClock(), batches.append, said.append, batch_s=0.05
    )
    line.start()
    until(lambda: line._port is not None)
    for i in range(100):
        os.write(master, fixed(i, i) + (b"\x00noise" if i == 50 else b""))
        time.sleep(0.002)
    until(lambda: line.frames.counts.frames == 100)
    os.close(master)
    until(lambda: len(said) >= 1)
    master = plug()
    until(lambda: any("is there again" in text for text in said))
    for i in range(100, 150):
        os.write(master, fixed(i, i))
    until(lambda: line.frames.counts.frames == 150)
    line.stop()
    line.stop()
    os.close(master)
    assert [round(rate * 1e6) for rate in rates(batches)] == list(range(150))
    assert f"unit FOG-1 at {path}" in said[0]
    assert sum("tried again" in text for text in said) == 1
    assert any("6 bytes that belong to no frame" in text for text in said)
    times = np.concatenate([batch.time_array for batch in batches if batch.signal == "rate"])
    assert np.diff(times).min() > 0


def test_a_port_that_is_not_there_is_said(tmp_path: Path) -> None:
    said: list[str] = []
    line = SerialLine(
        str(tmp_path / "none"), 9600, FIXED, "FOG-1", "r1", EPOCH, StationClock(), lambda batch: None, said.append
    )
    with pytest.raises(InstrumentError, match=r"unit FOG-1 at .*none: the port cannot be opened"):
        line.open()
    line.start()
    until(lambda: len(said) == 1)
    line.stop()
