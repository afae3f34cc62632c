"""`gyrofleet import` of CAN logs keeps the promises that it makes for tables; `gyrofleet can scan` leads there."""

import json
import tomllib
from pathlib import Path
from typing import Any

import can
import pytest
from click.testing import CliRunner

from gyrofleet import main

DBC = Path(__file__).with_name("can_bench.dbc")
START_S = 1_700_000_000.0


def write(path: Path, first: int, last: int) -> Path:
    with can.Logger(path) as logger:
        for i in range(first, last):
            body = (i & 0x7FFF).to_bytes(2, "little") + bytes([i * i & 0xFF, 0, 1, 0, i % 16, 0])
            logger.on_message_received(
                can.Message(timestamp=START_S + i * 0.01, arbitration_id=0x101, is_extended_id=False, data=body)
            )
            if i % 10 == 0:
                logger.on_message_received(
                    can.Message(timestamp=START_S + i * 0.01, arbitration_id=0x7FF, is_extended_id=False, data=body)
                )
    return path


def run(*words: object, exit_code: int = 0) -> Any:
    result = CliRunner().invoke(main, [*map(str, words), "--json"])
    assert result.exit_code == exit_code, result.output
    return json.loads(result.stdout.splitlines()[-1])


def test_a_log_comes_in_once_and_a_cut_one_is_completed(tmp_path: Path) -> None:
    store = tmp_path / "store"
    whole = write(tmp_path / "bench.blf", 0, 8000)
    content = whole.read_bytes()
    whole.write_bytes(content[: len(content) * 2 // 3])
    words = ("import", whole, "--dbc", DBC, "--unit", "FOG-1", "--store", store)
    cut = run(*words, exit_code=1)["files"][0]
    assert "cut short" in cut["damage"]
    assert 0 < cut["signals"][0]["added"] == cut["signals"][0]["in_lake"] < 8000
    whole.write_bytes(content)
    full = run(*words)["files"][0]
    assert full["damage"] == ""
    assert {each["in_lake"] for each in full["signals"]} == {8000}
    assert full["signals"][0]["added"] == 8000 - cut["signals"][0]["in_lake"]
    assert full["frames"]["unknown"] == {str(0x7FF): 800}
    assert {each["added"] for each in run(*words)["files"][0]["signals"]} == {0}
    query = "select min(value) least, max(value) most, count(distinct t_ns) times from samples where signal = 'yawrate'"
    assert run("sql", query, "--store", store) == [{"least": 0.0, "most": 79.99, "times": 8000}]


@pytest.mark.long
def test_scan_proposes_a_mapping_that_import_takes(tmp_path: Path) -> None:
    store, mapping = tmp_path / "store", tmp_path / "mapping.toml"
    logs = [write(tmp_path / f"{i}.log", i * 2000, (i + 1) * 2000) for i in range(2)]
    scan = run("can", "scan", logs[0], "--dbc", DBC, "--write", mapping, "--unit", "FOG-1")
    (imu, other) = scan["scan"]["ids"]
    assert (imu["message"], imu["frames"], round(imu["rate_hz"])) == ("IMU", 2000, 100)
    assert [each["name"] for each in imu["signals"] if each["looks_like_counter"]] == ["Counter"]
    assert [each["name"] for each in imu["signals"] if each["varies"]] == ["YawRate", "Temp", "Counter"]
    assert (other["message"], scan["unknown"]) == (None, 1)
    assert "modulus = 16" in mapping.read_text()
    run("can", "scan", logs[0], "--dbc", DBC, "--write", mapping, exit_code=1)  # not over one's work
    found = run("import", *logs, "--dbc", DBC, "--mapping", mapping, "--run", "r1", "--store", store)["files"]
    assert [{s["signal"]: (s["added"], s["in_lake"]) for s in each["signals"]}["yawrate"] for each in found] == [
        (2000, 2000),
        (2000, 4000),
    ]
    assert run("allan", "--unit", "FOG-1", "--signal", "yawrate", "--run", "r1", "--store", store)


@pytest.mark.long
def test_a_log_without_a_date_counts_from_its_start(tmp_path: Path) -> None:
    log = tmp_path / "bench.log"
    log.write_text("".join(f"({i * 0.01:.6f}) can0 101#{i:02x}00000000000000\n" for i in range(100)))
    words = ("import", log, "--dbc", DBC, "--unit", "FOG-1")
    assert run(*words, "--store", tmp_path / "a")["files"][0]["date_known"] is False
    dated = run(*words, "--store", tmp_path / "b", "--start", "2026-11-21T18:00:00+08:00")["files"][0]
    assert dated["date_known"] is True
    query = "select min(t_ns) t_ns from samples where signal = 'yawrate'"
    assert run("sql", query, "--store", tmp_path / "b") == [{"t_ns": 1795255200 * 10**9}]


@pytest.mark.parametrize(
    ("more", "reported"),
    [
        ([], "a CAN log needs its database"),
        (["--dbc", DBC], "nothing says whose samples these are"),
        (["--dbc", "none.dbc", "--unit", "U"], "no such file"),
        (["--dbc", __file__, "--unit", "U"], "cannot be read as a CAN database"),
    ],
)
def test_what_is_lacking_is_said(tmp_path: Path, more: list[object], reported: str) -> None:
    log = write(tmp_path / "a.log", 0, 10)
    answer = run("import", log, *more, "--store", tmp_path / "store", exit_code=1)
    assert reported in answer["error"]["message"]
    assert not (tmp_path / "store").exists()


_PAGES = """VERSION ""
BU_: GYRO
BO_ 274 Slow: 8 GYRO
 SG_ Page M : 0|8@1+ (1,0) [0|255] "" GYRO
 SG_ TempF m0 : 8|16@1- (0.05,32) [-100|300] "degF" GYRO
 SG_ AccX m1 : 8|16@1- (0.5,0) [-16000|16000] "mg" GYRO
 SG_ Load m2 : 8|16@1+ (1,0) [0|9000] "g" GYRO
 SG_ Rate m2 : 24|16@1+ (1,0) [0|9000] "furlong" GYRO
 SG_ Turn m2 : 40|8@1+ (1,0) [0|200] "grad/s" GYRO
 SG_ Wide m2 : 48|8@1+ (1,0) [0|200] "smoots" GYRO
"""


def test_pages_in_turn_are_no_counter_and_units_of_a_database_are_those_of_gyros(tmp_path: Path) -> None:
    """Pages 0, 0, 1, 2: with the page as a counter every second frame of page 0 would be a repeated one."""
    dbc, log, mapping, store = (tmp_path / name for name in ("own.dbc", "own.log", "map.toml", "store"))
    dbc.write_text(_PAGES)
    log.write_text(
        "".join(
            f"({1_700_000_000 + i * 0.05:.6f}) can0 112#{(0, 0, 1, 2)[i % 4]:02x}{i % 100:02x}0000000000{i % 50:02x}\n"
            for i in range(800)
        )
    )
    turns = log.with_name("turns.log")  # pages 0, 1, 2, 0: what looks like a counter most
    turns.write_text(log.read_text())
    turns.write_text(
        "".join(f"({1_700_000_000 + i * 0.05:.6f}) can0 112#{i % 3:02x}{i % 100:02x}000000000000\n" for i in range(300))
    )
    for each in (log, turns):
        (slow,) = run("can", "scan", each, "--dbc", dbc)["scan"]["ids"]
        (page,) = [signal for signal in slow["signals"] if signal["name"] == "Page"]
        assert (page["looks_like_counter"], page["selects_page"]) == (False, True)
    run("can", "scan", turns, "--dbc", dbc, "--write", mapping, "--unit", "P1")
    (message,) = tomllib.loads(mapping.read_text())["message"]
    assert "counter" not in message
    assert "Page" not in message["signals"]
    words = ("import", log, "--dbc", dbc, "--mapping", mapping, "--run", "r1", "--store", store)
    (found,) = run(*words)["files"]
    assert {each["signal"]: each["in_lake"] for each in found["signals"]} == {
        "tempf": 400, "accx": 200, "load": 200,
    }  # fmt: skip
    every = run("import", log, "--dbc", dbc, "--unit", "P2", "--run", "r2", "--store", store)
    remarks = " ".join(every["files"][0]["remarks"])
    assert "'g' is taken as a mass" in remarks
    assert "'rate' is expected to be an angular rate" in remarks
    assert "signal Turn: 'grad/s' is taken as deg/s (German Grad, a degree)" in remarks
    assert "signal Wide: unit of measure 'smoots' is not known; it is kept as it is" in remarks
    query = "select distinct unit_of_measure as of from signals where signal in ('accx', 'turn', 'wide') order by of"
    assert run("sql", query, "--store", store) == [{"of": "deg/s"}, {"of": "mg_0"}, {"of": "smoots"}]
    plain = CliRunner().invoke(
        main, ["import", str(log), "--dbc", str(dbc), "--unit", "P2", "--run", "r2", "--store", str(store)]
    )
    assert plain.exit_code == 0, plain.output  # with a unit that nobody knows
    assert run("allan", "--unit", "P2", "--run", "r2", "--signal", "wide", "--store", store)


_SAWTEETH = """VERSION ""
BU_: GYRO
BO_ 257 IMU: 8 GYRO
 SG_ Rate : 0|16@1- (0.01,0) [-300|300] "deg/s" GYRO
 SG_ TableAngle : 16|16@1+ (1,0) [0|720] "deg" GYRO
 SG_ Counter : 32|8@1+ (1,0) [0|255] "" GYRO
 SG_ Saw : 40|8@1+ (1,0) [0|255] "" GYRO
 SG_ Idle : 48|8@1+ (1,0) [0|255] "" GYRO
"""


def test_what_a_proposed_mapping_leaves_out_is_named_and_can_be_taken(tmp_path: Path) -> None:
    """An angle is no counter; what may be one stands in the mapping as a comment that can be taken."""
    dbc, log, mapping = (tmp_path / name for name in ("own.dbc", "own.log", "map.toml"))
    dbc.write_text(_SAWTEETH)
    bodies = [(i * i % 997).to_bytes(2, "little") + (i % 360).to_bytes(2, "little") for i in range(800)]
    log.write_text(
        "".join(
            f"({1_700_000_000 + i * 0.01:.6f}) can0 101#{body.hex()}{i % 16:02x}{i % 100:02x}0000\n"
            for i, body in enumerate(bodies)
        )
    )
    remarks = run("can", "scan", log, "--dbc", dbc, "--write", mapping, "--unit", "P1")["remarks"]
    assert ["signal Counter: is taken as the counter" in remarks[0], "signal Saw: is left out" in remarks[1]] == [
        True
    ] * 2
    assert all("it rises by one from frame to frame" in each and "remove the #" in each for each in remarks)
    lines = mapping.read_text().splitlines()
    assert '# "Idle" = "idle"  # left out: it never changes here' in lines
    mapping.write_text("\n".join(each.removeprefix("# ") if "Saw" in each else each for each in lines))
    (message,) = tomllib.loads(mapping.read_text())["message"]
    assert message["signals"] == {"Rate": "rate", "TableAngle": "tableangle", "Saw": "saw"}
    assert message["counter"] == {"signal": "Counter", "modulus": 16}


def test_a_log_with_every_frame_sent_and_received(tmp_path: Path) -> None:
    logs = {}
    for name in ("echoes", "copies", "sent"):
        logs[name] = tmp_path / f"{name}.log"
        with can.Logger(logs[name]) as logger:
            for i in range(300):
                body = (i * i & 0x7FFF).to_bytes(2, "little") + bytes(6)
                frame = can.Message(START_S + i * 0.01, 0x101, is_extended_id=False, data=body, is_rx=name != "sent")
                logger.on_message_received(frame)
                if name != "sent":
                    frame.timestamp, frame.is_rx = frame.timestamp + 0.0001, name == "copies"
                    logger.on_message_received(frame)
    words = ("--dbc", DBC, "--unit", "FOG-1", "--store", tmp_path / "store")
    echoes, copies, sent = run("import", *logs.values(), *words)["files"]
    for each in (echoes, sent):
        assert {(s["sample_interval_s"], s["irregular"], s["in_lake"]) for s in each["signals"]} == {(0.01, False, 300)}
    assert not [each for each in sent["remarks"] if "left out" in each or "repeat" in each]
    assert echoes["remarks"][-1].startswith("300 frames left out: each repeats a frame of the other direction (Rx, Tx)")
    assert {each["in_lake"] for each in copies["signals"]} == {600}
    assert (
        "299 of 600 frames repeat the data of the frame before, 0.0001 s after it, where the" in copies["remarks"][-1]
    )
    assert run("can", "scan", logs["echoes"], "--dbc", DBC)["scan"]["echoes"] == 300
