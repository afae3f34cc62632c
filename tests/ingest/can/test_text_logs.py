"""CAN logs in text as tools write them: times without a zone, differences, broken lines, headers that end early."""

import time
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import pytest

from ingest.can.logs.can_log import CanLog
from ingest.can.logs.log_file import CanLogFile
from ingest.can.mapping import CanMapping
from ingest.tables.sample_file import TableSummary
from stream.batch import SampleBatch
from stream.errors import BadInput

START_NS = 1_795_255_200 * 10**9  # 2026-11-21 10:00 UTC, 18:00 in Shanghai
HEAD = "date Sat Nov 21 06:00:00.000 pm 2026\nbase hex  timestamps {}\n{}"
EVENTS = "internal events logged\n"
DBC = """VERSION ""
BU_: A
BO_ 256 IMU: 8 A
 SG_ Rate : 0|16@1- (0.01,0) [-300|300] "deg/s" A
 SG_ Count : 16|8@1+ (1,0) [0|255] "" A
"""


def asc(stamps: list[str], form: str = "absolute", events: str = EVENTS) -> str:
    lines = [
        f" {stamp} 1  100             Rx   d 8 {at:02X} 00 {at:02X} 00 00 00 00 00" for at, stamp in enumerate(stamps)
    ]
    return HEAD.format(form, events) + "\n".join(lines) + "\n"


def times_ns(path: Path, zone: str | None = None) -> list[int]:
    return [t for block in CanLog(path, zone).blocks() for t in block.t_ns.tolist()]


def checked(tmp_path: Path, name: str, text: str, dbc: str = DBC) -> TableSummary:
    (tmp_path / name).write_text(text)
    (tmp_path / "a.dbc").write_text(dbc)
    return CanLogFile(tmp_path / name, CanMapping([tmp_path / "a.dbc"], None, unit="U", variants={})).check()


@pytest.mark.parametrize("of_machine", ["UTC", "Asia/Shanghai", "America/New_York"])
def test_the_time_of_day_is_of_the_zone_that_is_given(
    tmp_path: Path, of_machine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not of the computer that reads the log."""
    monkeypatch.setenv("TZ", of_machine)
    time.tzset()
    try:
        path = tmp_path / "v.asc"
        path.write_text(asc(["0.000000", "0.010000"]))
        assert times_ns(path, "Asia/Shanghai") == [START_NS, START_NS + 10**7]
        assert times_ns(path) == [START_NS + 8 * 3600 * 10**9, START_NS + 8 * 3600 * 10**9 + 10**7]
    finally:
        monkeypatch.undo()
        time.tzset()


def test_what_is_taken_for_granted_of_a_time_of_day_is_said(tmp_path: Path) -> None:
    path = tmp_path / "v.asc"
    path.write_text(asc(["0.000000"]))
    for zone, said in ((None, "taken as of UTC; give --time-zone"), ("Asia/Shanghai", "taken as of Asia/Shanghai")):
        log = CanLog(path, zone)
        assert len(list(log.blocks())) == 1
        assert said in log.note


def test_times_that_are_differences_are_added_up(tmp_path: Path) -> None:
    steps_us = [8000, 12_000, 9_500, 10_250, 10_000]
    path = tmp_path / "r.asc"
    path.write_text(asc([f"{each / 1e6:.6f}" for each in steps_us], "relative"))
    expected = [START_NS + 1000 * sum(steps_us[: at + 1]) for at in range(5)]
    assert times_ns(path, "Asia/Shanghai") == expected


@pytest.mark.parametrize("events", [EVENTS, "no internal events logged\n", ""])
def test_no_frame_is_lost_with_the_header(tmp_path: Path, events: str) -> None:
    path = tmp_path / "n.asc"
    path.write_text(asc([f"{at / 100:.6f}" for at in range(20)], events=events))
    assert len(times_ns(path)) == 20


def test_a_line_that_cannot_be_read_costs_itself(tmp_path: Path) -> None:
    good = [f"(1795255200.{10 * at:06}) can0 100#{at:02X}00" for at in range(50)]
    lines = [*good[:10], "candump: interface went down", *good[10:30], "(1795255200.1) can0 100#GG", *good[30:]]
    (tmp_path / "x.log").write_text("\n".join(lines) + "\n")
    log = CanLog(tmp_path / "x.log")
    assert sum(len(block) for block in log.blocks()) == 50
    assert log.damage.startswith(
        "2 of 52 lines cannot be read and are left out, the first is line 11, 'candump: interface"
    )
    text = asc([f"{at / 100:.6f}" for at in range(20)]).replace(" 05 00 05 ", " GG 00 05 ")
    (tmp_path / "x.asc").write_text(text)
    log = CanLog(tmp_path / "x.asc")
    assert sum(len(block) for block in log.blocks()) == 19
    assert log.damage.startswith("1 of 23 lines cannot be read and are left out, the first is line 9, '0.05")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("d 8 05 00", "d 8 0 5 00"),  # a byte in two
        ("d 8 05 00 05 00 00 00 00 00", "d 8 05 00 05 00 00 00 00 00 01"),
        ("d 8 05 00 05 00 00 00 00 00", "d 8 05 00 05 00 00 00 00"),
        ("d 8 05 00 05 00 00 00 00 00", "d 8 05 00 05 00 00 00 00 0"),
        (" 0.050000 1", " 0.05x000 1"), (" 0.050000 1", " 0,050000 1"),
        ("Rx   d 8 05", "R#   d 8 05"),
    ],
)  # fmt: skip
def test_a_damaged_frame_of_an_asc_is_no_other_frame(tmp_path: Path, old: str, new: str) -> None:
    text = asc([f"{at / 100:.6f}" for at in range(20)])
    assert old in text
    (tmp_path / "x.asc").write_text(text.replace(old, new))
    log = CanLog(tmp_path / "x.asc")
    assert sum(len(block) for block in log.blocks()) == 19
    assert log.damage.startswith("1 of 23 lines cannot be read and are left out, the first is line 9, '0")


def test_other_lines_of_an_asc_are_no_damage(tmp_path: Path) -> None:
    others = [
        "0.051 1  Statistic: D 12 R 0 XD 0 XR 0 E 0 O 0 B 0.98%",
        "0.052 J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1 40",
        "0.053 1  100x            Rx   r",
        "0.054 1  ErrorFrame",
        "// 0.05 d 8 01 02",
        "0.055 SV: 2 0 1 ::Sys::x = d 5 1 2 3",
        " 0.056 1  101             Rx   d 2 01 02  Length = 100000 BitCount = 64 ID = 257",
    ]
    (tmp_path / "x.asc").write_text(asc([f"{at / 100:.6f}" for at in range(5)]) + "\n".join(others) + "\n")
    log = CanLog(tmp_path / "x.asc")
    assert sum(len(block) for block in log.blocks()) >= 6
    assert log.damage == ""


def test_what_candump_shows_on_a_screen_is_named(tmp_path: Path) -> None:
    (tmp_path / "s.log").write_text(" (1795255200.0) can0 100 [2] 01 02\n" * 3 + "(1795255200.0) can0 100#0102\n")
    log = CanLog(tmp_path / "s.log")
    assert len(list(log.blocks())) == 1
    assert "write the log with `candump -l`" in log.damage


def frames(stamps_s: list[float], payload: Callable[[int], str]) -> str:
    return "".join(f"({1795255200 + stamp:.6f}) can0 {payload(at)}\n" for at, stamp in enumerate(stamps_s))


def test_a_clock_that_is_a_year_ahead_once_does_not_drop_the_rest_in_silence(tmp_path: Path) -> None:
    stamps = [3e7, *(at / 100 for at in range(300))]
    with pytest.raises(BadInput, match="of 301 frames 300 lie before one that came earlier"):
        checked(tmp_path, "g.log", frames(stamps, lambda at: f"100#0100{at % 256:02X}0000000000"))
    some = [at / 100 - (at > 200) for at in range(300)]
    found = checked(tmp_path, "j.log", frames(some, lambda at: f"100#0100{at % 256:02X}0000000000"))
    assert any("99 of 300 before one that came earlier left out" in each for each in found.remarks)


@pytest.mark.parametrize("lost", [44, 256, 300, 1000])
def test_frames_lost_over_whole_turns_of_a_counter_are_counted_by_the_clock(tmp_path: Path, lost: int) -> None:
    kept = [at for at in range(3000) if not 1000 <= at < 1000 + lost]
    text = "".join(f"({1795255200 + at / 100:.6f}) can0 100#0100{at % 256:02X}0000000000\n" for at in kept)
    (tmp_path / "map.toml").write_text(
        '[[message]]\nmessage = "IMU"\nunit = "U"\n[message.signals]\nRate = "rate"\n'
        '[message.counter]\nsignal = "Count"\nmodulus = 256\n'
    )
    (tmp_path / "c.log").write_text(text)
    (tmp_path / "a.dbc").write_text(DBC)
    mapping = CanMapping([tmp_path / "a.dbc"], tmp_path / "map.toml", unit=None, variants={})
    found = CanLogFile(tmp_path / "c.log", mapping).check()
    assert any(f"{lost} lost" in each for each in found.remarks)


def test_values_of_j1939_that_say_error_or_not_available_are_no_measurements(tmp_path: Path) -> None:
    dbc = """VERSION ""
BU_: A
BO_ 2566844926 ARI: 8 A
 SG_ Yaw : 0|16@1+ (0.000122,-3.92) [-3.92|4] "rad/s" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_DEF_ "ProtocolType" STRING;
BA_DEF_DEF_ "ProtocolType" "J1939";
BA_ "VFrameFormat" BO_ 2566844926 3;
"""
    raw = [0x7D7D, 0xFFFF, 0x7D7E, 0xFE00, 0x7D7F, 0xFB00]
    text = frames(
        [at / 100 for at in range(6)], lambda at: f"18FF01FE#{raw[at] & 0xFF:02X}{raw[at] >> 8:02X}000000000000"
    )
    dbc = dbc.replace("2566844926", str(0x98FF01FE))
    (tmp_path / "j.log").write_text(text)
    (tmp_path / "j.dbc").write_text(dbc)
    log = CanLogFile(tmp_path / "j.log", CanMapping([tmp_path / "j.dbc"], None, unit="U", variants={}))
    found = log.check()
    assert any("3 values that say error or not available (J1939-71) left out" in each for each in found.remarks)
    assert [signal.sampling.samples for signal in found.signals] == [3]


def test_doubtful_databases_are_named(tmp_path: Path) -> None:
    log = frames([at / 100 for at in range(20)], lambda at: f"100#0100{at:02X}0000000000")
    more = {
        ' SG_ Rate : 32|16@1- (1,0) [0|0] "degC" A\n': "signal Rate: left out, it is there twice",
        ' SG_ State : 62|6@1+ (1,0) [0|0] "" A\n': "State: left out, it ends beyond the 8 bytes of its message",
        '\nBO_ 256 IMU2: 8 A\n SG_ Other : 0|16@1- (1,0) [0|0] "" A\n': "messages IMU and IMU2 have one identifier",
    }
    cases = {DBC + text: said for text, said in more.items()}
    narrow = DBC.replace("[-300|300]", "[-0.001|0.001]")
    cases[narrow] = "20 values outside the range that the database states"
    for dbc, said in cases.items():
        found = checked(tmp_path, "d.log", log, dbc)
        assert any(said in each for each in found.remarks), (said, found.remarks)


def test_the_samples_are_those_of_the_frames(tmp_path: Path) -> None:
    (tmp_path / "a.dbc").write_text(DBC)
    (tmp_path / "v.asc").write_text(asc([f"{at / 100:.6f}" for at in range(20)], events=""))
    mapping = CanMapping([tmp_path / "a.dbc"], None, unit="U", variants={})
    log = CanLogFile(tmp_path / "v.asc", mapping, time_zone="Asia/Shanghai")
    batches = [each for each in log.batches(lambda unit, run: UUID(int=1)) if isinstance(each, SampleBatch)]
    rates = [each for each in batches if each.signal == "rate"]
    assert rates[0].t0_ns == START_NS
    assert [value for batch in rates for value in batch.value_array.tolist()] == [at * 0.01 for at in range(20)]


def blocks_of(*blocks: tuple[str, float]) -> str:
    """An ASC of one trigger block for each time of day and first stamp, of three frames."""
    lines = []
    for clock, first_s in blocks:
        lines.append(f"Begin Triggerblock Sat Nov 21 {clock} pm 2026")
        lines.append(f"   {first_s:.6f} Start of measurement")
        lines += [f"   {first_s + at / 100:.6f} 1  100             Rx   d 2 01 00" for at in range(3)]
        lines.append("End TriggerBlock")
    return HEAD.format("absolute", EVENTS) + "\n".join(lines) + "\n"


@pytest.mark.parametrize("first_s", [0.0, 600.0])
def test_blocks_of_triggers_are_where_their_frames_were(tmp_path: Path, first_s: float) -> None:
    """Stamps of the second block, 600 s later, begin again or go on from the start of the measurement."""
    (tmp_path / "v.asc").write_text(blocks_of(("06:00:00.000", 0.0), ("06:10:00.000", first_s)))
    expected = [START_NS + begin * 10**9 + at * 10**7 for begin in (0, 600) for at in range(3)]
    assert times_ns(tmp_path / "v.asc", "Asia/Shanghai") == expected


def test_a_trigger_long_after_the_start_of_the_measurement(tmp_path: Path) -> None:
    (tmp_path / "v.asc").write_text(blocks_of(("06:10:00.000", 599.5)))
    assert times_ns(tmp_path / "v.asc", "Asia/Shanghai")[0] == START_NS + 599_500_000_000


TRC = ";$FILEVERSION=2.1\n;$STARTTIME=46347.4166666667\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
DAMAGED = {
    "time": "   3   0,0x5 DT 1 0100 Rx - 2 03 00",
    "id": "   3   30.0 DT 1 0x#0 Rx - 2 03 00",
    "byte": "   3   30.0 DT 1 0100 Rx - 2 0 3 00",
    "length": "   3   30.0 DT 1 0100 Rx - 2 03",
    "kind": "   3   30.0 D? 1 0100 Rx - 2 03 00",
    "end": "   3   30.0 DT 1",
}


def test_buses_of_a_trc_count_from_0_as_the_channels_of_all_other_formats(tmp_path: Path) -> None:
    """Mappings would give the data of one unit to another."""
    rows = [f"   {at}   {at}0.0 DT {bus} 0100 Rx - 2 0{at} 00" for at, bus in enumerate((1, 2, 1))]
    (tmp_path / "v.trc").write_text(TRC + "\n".join(rows) + "\n")
    log = CanLog(tmp_path / "v.trc", "Asia/Shanghai")
    assert [channel for block in log.blocks() for channel in block.channel.tolist()] == [0, 1, 0]


@pytest.mark.parametrize("line", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_line_of_a_trc_costs_that_line(tmp_path: Path, line: str) -> None:
    lines = [f"   {at}   {at}0.0 DT 1 0100 Rx - 2 0{at} 00" for at in (1, 2, 4, 5)]
    lines[2:2] = [line, "   3   35.0 ST 1 Rx - 4 00 00 00 00"]
    (tmp_path / "v.trc").write_text(TRC + "\n".join(lines) + "\n")
    log = CanLog(tmp_path / "v.trc", "Asia/Shanghai")
    frames = [t for block in log.blocks() for t in block.t_ns.tolist()]
    assert len(frames) == 4
    assert "1 of 9 lines cannot be read and are left out" in log.damage
    assert line.split()[1] in log.damage
