"""What fails at a station in the middle of a procedure, and files that are wrong from its start."""

import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from storage.log.event_log import EventLog
from storage.recording.recorder import Recorder
from storage.segments.disk import Disk, Space
from storage.store import Store
from stream.transport.zenoh_bus import ZenohBus
from tests.small_disk import small_disk_at

Bench = Any
Kept = Any
Spawn = Callable[..., subprocess.Popen[str]]
Gyrofleet = Callable[..., Any]


@pytest.mark.long
def test_a_chamber_that_never_settles_is_given_up_and_gone_on_with(
    gyrofleet: Gyrofleet, kept: Kept, spawn: Spawn, fast: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    command = fast.run(
        "bias_temperature_sensitivity", "--settle-timeout-h", "0.5", "--set", "least_temperature_deg_c=15",
        "--set", "most_temperature_deg_c=40", "--set", "warm_up_s=0", "--set", "bias_record_s=2000",
    )  # fmt: skip
    fast.tell("chamber", "SIM:FAULT UNSETTLED")
    try:
        reported, _ = fast.ended(spawn(*command), code=1)
    finally:
        fast.tell("chamber", "SIM:FAULT NONE")
    assert reported["event"] == "interrupted"
    assert re.search(r"step 3 \(soak\): temperature settles is not done after [1-9],\d{3} s", reported["remark"])
    assert "the station was made safe" in reported["remark"]
    assert fast.is_safe()
    (done,) = kept.rows("select count(*) as n from steps where outcome = 'completed'")
    assert done["n"] == 2
    # made safe, the chamber goes to room temperature: the record may not begin while it comes back
    process = spawn(*command)
    state(lambda run: run["step"] == 3 and run["open_steps"])
    process.send_signal(signal.SIGINT)
    fast.ended(process, code=130)
    time.sleep(0.5)
    last, _ = fast.ended(spawn(*command))
    assert last["outcome"] == "completed"
    kept.sound()
    (found,) = kept.rows(
        "select max(abs(s.value - 40)) as off, count(*) as n from steps p join samples s on s.signal = "
        "'chamber_temperature' and s.t_ns between p.t_start_ns and p.t_end_ns "
        "where p.temperature_command = 40 and p.outcome = 'completed'"
    )
    assert found["n"] > 0
    assert found["off"] < 0.5
    reasons = "select document->>'$.reason' as reason from events where kind = 'RunResumed' order by t_ns"
    assert [row["reason"] for row in kept.rows(reasons)] == [
        "resumed at step 3; no step was cut",
        "resumed at step 3; step 4 is begun again, from step 3 on",
    ]


@pytest.mark.long
def test_a_run_that_gives_up_a_silent_table_does_not_call_the_station_safe(
    spawn: Spawn, slow: Bench, state: Callable[..., dict[str, Any]], gyrofleet: Gyrofleet
) -> None:
    words = ("--settle-timeout-h", "0.01", "--set", "startup_s=4", "--set", "rate_record_s=40")
    process = spawn(*slow.run("scale_factor", *words))
    state(lambda run: run["step"] >= 2 and run["open_steps"])
    slow.tell("table", "SIM:FAULT SILENT")
    reported, err = slow.ended(process, code=1)
    assert reported["event"] == "interrupted"
    assert "is not done after" in reported["remark"]
    assert "; table could not be made safe: rate table table at TCPIP" in reported["remark"]
    assert "make it safe by hand; give the same command to resume" in reported["remark"]
    assert "was made safe" not in reported["remark"] + err
    status = gyrofleet("status", "--store", "S", "--json").out
    assert "table could not be made safe" in status
    assert "was made safe" not in status


@pytest.mark.long
def test_an_instrument_that_falls_silent_is_reported_once_and_the_run_goes_on(
    gyrofleet: Gyrofleet, kept: Kept, spawn: Spawn, slow: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    process = spawn(*slow.run("static_bias", "--set", "bias_record_s=200", "--set", "warm_up_s=0"))
    state(lambda run: bool(run["open_steps"]))
    slow.tell("supply", "SIM:FAULT DROP")
    slow.tell("chamber", "SIM:FAULT SILENT")
    time.sleep(5.0)
    for name in ("supply", "chamber"):
        slow.tell(name, "SIM:FAULT NONE")
    last, err = slow.ended(process)
    assert last["outcome"] == "completed"
    notes = [
        row["text"] for row in kept.rows("select document->>'$.text' as text from events where kind = 'NoteAdded'")
    ]
    assert len([text for text in notes if "chamber" in text and "tried again until it answers" in text]) == 1
    assert len([text for text in notes if "chamber" in text and "answers again" in text]) == 1
    assert err.count("tried again until it answers") == 1
    assert last["short_records"] == 0, err
    kept.completed(steps=1)
    kept.sound()


@pytest.mark.long
def test_units_that_deliver_nothing_do_not_pass_silently(
    gyrofleet: Gyrofleet, kept: Kept, spawn: Spawn, bench: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    gyros = bench.role("gyros")
    process = spawn(*bench.run("static_bias", "--set", "bias_record_s=300", "--set", "warm_up_s=0"))
    state(lambda run: bool(run["open_steps"]))
    time.sleep(0.5)
    os.kill(gyros, signal.SIGSTOP)
    try:
        last, err = bench.ended(process)
    finally:
        os.kill(gyros, signal.SIGCONT)
    assert last["outcome"] == "completed"
    assert last["short_records"] == 2
    assert "lack samples" in last["remark"]
    for unit in ("SIM-0001", "SIM-0002"):
        assert f"unit {unit}: signal rate has " in err
    found = kept.rows("select document->>'$.unit' as unit from events where kind = 'NoteAdded' order by unit")
    assert {row["unit"] for row in found} == {"SIM-0001", "SIM-0002"}


class FullDisk(Disk):
    """A disk that can be filled and emptied."""

    free = 10 << 30

    def space(self, folder: Path) -> Space:
        return Space(self.free, 100 << 30)


@pytest.mark.long
def test_a_recorder_that_pauses_is_told_while_the_procedure_goes_on(
    store: Path, kept: Kept, spawn: Spawn, bench: Bench, endpoint: str
) -> None:
    disk = FullDisk()
    recorded = Store.create(store)
    with (
        ZenohBus(listen=[endpoint]) as bus,
        Recorder(recorded, bus, EventLog(recorded, disk=disk), sync_interval_s=0.05, disk=disk) as recorder,
    ):
        process = spawn(
            *bench.run("static_bias", "--set", "bias_record_s=600", "--set", "warm_up_s=0", "--connect", endpoint)
        )
        assert process.stdout is not None
        assert process.stderr is not None
        assert f"to the recorder at {endpoint}" in process.stdout.readline()
        disk.free = 1 << 20
        reported = next(line for line in process.stderr if "warning: the recorder pauses" in line)
        assert "kept in reserve" in reported
        (progress,) = (store / "spool").glob("*/procedure.json")
        assert json.loads(progress.read_bytes())["phase"] == "running", "it was to be reported while it measures"
        disk.free = 10 << 30
        last, err = bench.ended(process)
        assert err.count("recording goes on") == 1
    assert (last["outcome"], last["short_records"]) == ("completed", 0)
    assert recorder.paused is None
    kept.completed(steps=1)
    kept.sound()


def test_what_is_wrong_in_files_is_said_with_its_place_and_nothing_is_started(
    gyrofleet: Gyrofleet, store: Path, bench: Bench, tmp_path: Path
) -> None:
    text = (bench.folder / "station.toml").read_text()
    for name in ("gyros.dbc", "gyros.toml"):
        (tmp_path / name).write_bytes((bench.folder / name).read_bytes())
    units = "serial,slot\nSIM-0001,S1\nSIM-0002,S2\n"
    bench.tell("table", "RATE:SETP 0")
    chamber = text[text.index("[instruments.chamber]") : text.index("[instruments.table]")]
    table = text[text.index("[instruments.table]") : text.index("[instruments.supply]")]
    supply = text[text.index("[instruments.supply]") : text.index("[buses.can]")]
    cases: list[tuple[str, str, str]] = [
        (text, "serial\nSIM-0001\nSIM-0001\n", "units.csv: line 3: unit SIM-0001 is on line 2 already"),
        (text, "serial,slot\nSIM-0001,S9\n", "units.csv: line 2: slot 'S9' is none of the station's: S1, S2"),
        (text, "serial\nFOG-7\n", "has unit FOG-7: add it to a mapping file"),
        (text.replace('"rate_table"', '"rate_tabel"'), units, "instruments.table.kind is 'rate_tabel'"),
        (text.replace("gyros.dbc", "nowhere.dbc"), units, "nowhere.dbc"),
        (text.replace('mapping = "gyros.toml"', 'mapping = "units.csv"'), units, "units.csv"),
        (text.replace(table, ""), units, "has no instrument for rate from -300 to 300 deg/s"),
        (
            text.replace("max_rate_deg_per_s = 400", "max_rate_deg_per_s = 200"),
            units,
            "may be set to -200 to 200 deg/s",
        ),
        (text.replace(supply, "").replace('power = "supply"', ""), units, "no instrument that does: add its supply"),
        (text.replace('power = "supply"', 'power = "table"'), units, "slots.S1.power is 'table', a rate_table"),
        (
            text.replace('power = "supply"', 'power = "suply"'),
            units,
            "slots.S1.power is 'suply', which is no instrument",
        ),
        (text.replace("[instruments.chamber]", "[instrument.chamber]"), units, "unknown field `instrument`"),
        (text.replace("sample_interval_s = 10.0", "sample_intervall_s = 10.0"), units, "instruments.chamber"),
        (text.replace("sample_interval_s = 10.0", "sample_interval_s = 0"), units, "sample_interval_s is 0"),
        (text.replace('"UTC"', '"Mars/Olympus"'), units, "station.time_zone is 'Mars/Olympus', which is not known"),
        (text.replace("speed = 100.0", "speed = 0"), units, "clock.speed is 0"),
        (text.replace("start_ns", "# start_ns"), units, "without clock.start_ns and clock.origin_s"),
        (
            text.replace(chamber, chamber + "calibration_due = 31\n"),
            units,
            "instruments.chamber (a temperature_chamber)",
        ),
        (text.replace("TCPIP::", "TCPI::", 1), units, "station.toml: instruments.chamber.resource is 'TCPI::"),
        (text.replace("[station]", "[station"), units, "line 1"),
        (text, "", "it is empty"),
    ]
    station, listed = tmp_path / "station.toml", tmp_path / "units.csv"
    for station_text, unit_text, said in cases:
        station.write_text(station_text)
        listed.write_text(unit_text)
        words = ("run", "scale_factor", "--station", station, "--units", listed, "--yes", "--json")
        assert said in (message := bench.refused(words, store)), (said, message)
        assert not list((tmp_path / "S" / "spool").glob("*/procedure.json")), said
    assert "there is nothing to end: no run of scale_factor" in bench.refused(bench.run("scale_factor", "--end"), store)
    assert bench.ask("table", "RATE:ACT?") == "0.000000"
    missing = gyrofleet("run", "scale_factor", "--units", listed, "--yes")
    assert missing.code == 1
    assert "say at which station: --station FILE" in missing.err


@pytest.fixture
def small_store(store: Path) -> Iterator[Path]:
    """The store of this test's runs, on a disk of 24 MB."""
    with small_disk_at(store, 24) as folder:
        yield folder


@pytest.mark.long  # in the gate: `test_state_file.py`, `test_spooled_delivery.py`
def test_a_disk_without_any_room_costs_nothing_as_long_as_the_run_is_at_work(
    spawn: Spawn, slow: Bench, state: Callable[..., Any], kept: Kept, small_store: Path
) -> None:
    """Neither spool nor the state of the run can be written: both go on in memory, and catch up."""
    process = spawn(*slow.run("static_bias", "--set", "warm_up_s=5", "--set", "bias_record_s=500"))
    state(lambda run: run["open_steps"])
    time.sleep(1.0)
    ballast = small_store / "ballast"
    with ballast.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    assert shutil.disk_usage(small_store).free == 0
    time.sleep(10.0)
    assert process.poll() is None
    ballast.unlink()
    done, err = slow.ended(process, timeout_s=120.0)
    assert "cannot be written: [Errno 28]" in err
    assert "every sample is recorded" in done["remark"]
    kept.sound()
    gaps = "select t_ns - lag(t_ns) over (partition by unit order by t_ns) as gap_ns from samples where signal = 'rate'"
    (row,) = kept.rows(f"select max(gap_ns) / 1e9 as longest_s from ({gaps})")
    assert row["longest_s"] < 0.15
