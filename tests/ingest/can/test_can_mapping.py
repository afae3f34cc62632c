"""A mapping says whose frame is whose; counters, checksums and grids do what they promise."""

from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from ingest.can.frames import CanFrame, frame_block
from ingest.can.mapping import CanMapping
from ingest.can.plan import CanPlan
from ingest.can.stream import CanDecoder
from ingest.can.summary import LogFrameCounts, remarks
from ingest.checksums import checksums
from stream.batch import SampleBatch
from stream.errors import BadInput
from stream.quantities import check_unit

DBC = Path(__file__).with_name("can_bench.dbc")
MS = 1_000_000


def imu(t_ns: int, i: int, *, identifier: int = 0x101, channel: int = 0, index: int = 0) -> CanFrame:
    body = (i & 0xFFFF).to_bytes(2, "little") + bytes([0, index << 4]) + b"\1\0" + bytes([i % 16])
    crc = int(checksums("crc8_sae_j1850", np.frombuffer(body, np.uint8).reshape(1, -1))[0])
    return CanFrame(t_ns, channel, identifier, body + bytes([crc]))


def mapped(tmp_path: Path, text: str, unit: str | None = None) -> CanPlan:
    path = tmp_path / "mapping.toml"
    path.write_text(text)
    return CanMapping([DBC], path, unit=unit).plan()


def decoded(plan: CanPlan, frames: list[CanFrame], size: int = 10_000) -> tuple[list[SampleBatch], CanDecoder]:
    decoder = CanDecoder(plan, run="r1", epoch_of=lambda unit: UUID(int=len(unit)))
    batches = [b for i in range(0, len(frames), size) for b in decoder.take(frame_block(frames[i : i + size]))]
    return batches + decoder.finish(), decoder


def joined(batches: list[SampleBatch]) -> dict[tuple[str, str], tuple[list[int], list[float]]]:
    found: dict[tuple[str, str], tuple[list[int], list[float]]] = {}
    for batch in batches:
        times, values = found.setdefault((batch.unit, batch.signal), ([], []))
        assert batch.seq == len(times)
        times.extend(batch.time_array.tolist())
        values.extend(batch.value_array.tolist())
    return found


def test_every_signal_under_its_own_name() -> None:
    plan = CanMapping([DBC], unit="U1").plan()
    assert [(signal, measure) for _, signal, measure in plan.signals] == [
        ("yawrate", "deg/s"),
        ("imu.temp", "degC"),
        ("index", "1"),
        ("wide", "smoots"),
        ("counter", "1"),
        ("crc", "1"),
        ("other.temp", "degC"),
        ("accx", "g_0"),
    ]
    (remark,) = plan.remarks
    assert remark.startswith("message IMU, signal Wide: unit of measure 'smoots' is not known; it is kept as it is")
    assert all(check_unit(measure) for _, _, measure in plan.signals if measure != "smoots")


IDS = """[[message]]
message = "IMU"
ids = { "FOG-1" = 0x101, "FOG-2" = 0x18FF0102 }
signals = { YawRate = "rate" }
"""


def test_units_by_id(tmp_path: Path) -> None:
    frames = [
        each
        for i in range(100)
        for each in (
            imu(i * MS, i),
            imu(i * MS + 5, 2 * i, identifier=0x98FF0102),
            imu(i * MS + 7, 0, identifier=0x103),
        )
    ]
    batches, decoder = decoded(mapped(tmp_path, IDS), frames)
    found = joined(batches)
    assert found["FOG-1", "rate"][1] == [i * 0.01 for i in range(100)]
    assert found["FOG-2", "rate"] == ([i * MS + 5 for i in range(100)], [2 * i * 0.01 for i in range(100)])
    assert decoder.counts.unknown == {0x103: 100}
    assert [batch.counts is not None and batch.scale == 0.01 for batch in batches] == [True] * len(batches)


def test_units_by_channel_and_by_multiplexer(tmp_path: Path) -> None:
    frames = [imu(i * MS, i, channel=i % 3, index=i % 4) for i in range(120)]
    by_channel = '[[message]]\nmessage = "IMU"\nchannels = { A = 0, B = 2 }\nsignals = { YawRate = "rate" }\n'
    batches, decoder = decoded(mapped(tmp_path, by_channel), frames)
    assert joined(batches)["B", "rate"][0] == [i * MS for i in range(2, 120, 3)]
    assert decoder.counts.unrouted == {0x101: 40}
    by_index = by_channel.replace(
        "channels = { A = 0, B = 2 }", 'multiplexer = "Index"\nunits = { A = 1, B = 3 }\nchannel = 0'
    )
    batches, decoder = decoded(mapped(tmp_path, by_index), frames)
    assert joined(batches)["B", "rate"][0] == [i * MS for i in range(3, 120, 12)]
    assert decoder.counts.unrouted == {0x101: 100}


GRID = (
    IDS.replace("ids", "# ids").replace('message = "IMU"', 'message = "IMU"\nunit = "FOG-1"')
    + """
counter = { signal = "Counter", modulus = 16 }
checksum = { signal = "Crc", algorithm = "crc8_sae_j1850", last_byte = 6 }
interval_s = 0.001
"""
)


@pytest.mark.long
@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_lost_repeated_and_damaged_frames_leave_gaps_in_the_grid(tmp_path: Path, size: int) -> None:
    random = np.random.default_rng(5)
    lost = set(random.choice(np.arange(1, 1999), 60, replace=False).tolist())
    kept = [i for i in range(2000) if i not in lost]
    frames = [imu(10**15 + i * MS + int(random.integers(0, 300_000)), i) for i in kept]
    first_ns = frames[0].t_ns
    damaged = kept[100]
    frames[100] = frames[100]._replace(data=b"\xff" + frames[100].data[1:])
    frames.insert(500, frames[499]._replace(t_ns=frames[499].t_ns + 10))
    batches, decoder = decoded(mapped(tmp_path, GRID), frames, size)
    good = [i for i in kept if i != damaged]
    times, values = joined(batches)["FOG-1", "rate"]
    assert times == [first_ns + i * MS for i in good]
    assert values == [i * 0.01 for i in good]
    assert {batch.irregular for batch in batches} == {False}
    assert all(batch.times_ns is None for batch in batches)
    (count,) = decoder.counts.messages
    assert (count.lost, count.repeated, count.checksum_failures) == (61, 1, 1)
    assert (count.frames, count.decoded) == (1941, 1939)
    assert 0 < count.off_grid_s < 0.0003


@pytest.mark.parametrize(("moved_s", "remarked"), [(0, 0), (0.5, 1), (3600, 2)])
def test_a_clock_that_was_set_back_is_named(tmp_path: Path, moved_s: float, remarked: int) -> None:
    """Counter and interval go on; the times of reception do not."""
    plan = mapped(tmp_path, GRID)
    frames = [imu(10**15 + i * MS - (round(moved_s * 10**9) if i >= 500 else 0), i) for i in range(1000)]
    batches, decoder = decoded(plan, frames, 500)  # the next block begins with it
    assert joined(batches)["FOG-1", "rate"][0] == [10**15 + i * MS for i in range(1000)]
    found = list(remarks(decoder.counts, LogFrameCounts(data=1000)))
    assert len(found) == remarked
    if found:
        assert f"the log's clock goes back at 1 place, by up to {moved_s:,} s; the samples have" in found[0]
    assert [f"frames came up to {moved_s:,} s before or after" in each for each in found[1:]] == [True] * (moved_s > 1)


def test_receive_times_settle_the_interval_and_say_when_it_is_none(tmp_path: Path) -> None:
    plan = mapped(tmp_path, IDS)
    regular = [imu(i * 10 * MS + (i % 3) * 100_000, i) for i in range(1000)]
    batches, _ = decoded(plan, regular, 50)
    assert {(batch.dt_ns, batch.irregular) for batch in batches} == {(10 * MS, False)}
    assert joined(batches)["FOG-1", "rate"][0] == [frame.t_ns for frame in regular]
    random = np.random.default_rng(1)
    wild = [imu(i * 10 * MS + int(random.integers(0, 8 * MS)), i) for i in range(1000)]
    batches, _ = decoded(plan, wild, 500)
    assert {batch.irregular for batch in batches} == {True}


def test_short_frames_and_a_second_channel_are_counted(tmp_path: Path) -> None:
    short = [imu(i * MS, i)._replace(data=b"\1") for i in range(10, 13)]
    frames = [imu(i * MS, i) for i in range(10)] + short + [imu(20 * MS, 3, channel=1)]
    batches, decoder = decoded(mapped(tmp_path, IDS), frames)
    assert len(joined(batches)["FOG-1", "rate"][0]) == 10
    assert [(count.short, count.other_channel) for count in decoder.counts.messages] == [(3, 1)]


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ('"IMU"', '"IMV"', "message IMV: not in the CAN database, which has IMU, OTHER"),
        ("YawRate", "YawRat", "has no signal YawRat in the CAN database; it has YawRate"),
        ("0x18FF0102", "0x3FFFFFFF", "is no id of 11 or 29 bits"),
        ("FOG-1", "FOG 1", "unit 'FOG 1' cannot be used as a name"),
        ("ids = {", "idz = {", r"unknown field `idz` - at `\$.message\[0\]`"),
        ("ids = {", 'unit = "A"\nids = {', "in one way"),
        ('"rate" }', '"rate", Temp = "rate" }', "makes signal rate twice"),
        ('"FOG-2" = 0x18FF0102', "", "never"),
    ],
)
def test_what_a_mapping_gets_wrong(tmp_path: Path, old: str, new: str, reported: str) -> None:
    if reported == "never":
        assert mapped(tmp_path, IDS.replace(f", {old}", new)).units == ("FOG-1",)
        return
    with pytest.raises(BadInput, match=reported):
        mapped(tmp_path, IDS.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("crc8_sae_j1850", "crc9", "checksum 'crc9' is not known; known are xor"),
        ("last_byte = 6", "last_byte = 9", "the message has bytes 0 to 7"),
        ("modulus = 16", "modulus = 17", "cannot count modulo 17"),
        ("interval_s = 0.001", "interval_s = 0", "expected 1e-6 to 1e6 seconds"),
    ],
)
def test_what_a_mapping_gets_wrong_in_its_checks(tmp_path: Path, old: str, new: str, reported: str) -> None:
    with pytest.raises(BadInput, match=reported):
        mapped(tmp_path, GRID.replace(old, new))


def test_the_unit_of_the_command_is_whose_the_rest_is(tmp_path: Path) -> None:
    text = '[[message]]\nmessage = "IMU"\n'
    assert mapped(tmp_path, text, "U7").units == ("U7",)
    with pytest.raises(BadInput, match="or give --unit"):
        mapped(tmp_path, text)
