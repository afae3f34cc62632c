"""Procedures at a simulated station, in processes of their own: its data, crashes, faults, operators and mistakes."""

import json
import math
import os
import random
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from ingest.run_cli import run
from storage.catalog import Catalog
from storage.store import Store
from storage.verify import verify

Spawn = Callable[..., subprocess.Popen[str]]
Gyrofleet = Callable[..., Any]

EARTH_DEG_PER_H = 15.041067
SHORT = ("--set", "startup_s=4", "--set", "rate_record_s=4", "--set", "off_between_rates_s=1")
CYCLES = ("--set", "repeats=4", "--set", "cool_down_s=5", "--set", "warm_up_s=0", "--set")
ROOM_DEG_C = 25.0


class Bench:
    """A simulated station, and what a test asks of its instruments behind the back of the run."""

    def __init__(self, folder: Path, process: subprocess.Popen[str]) -> None:
        self.folder = folder
        self.process = process
        self.simulation = json.loads((folder / "simulation.json").read_bytes())

    @property
    def files(self) -> tuple[object, ...]:
        return ("--station", self.folder / "station.toml", "--units", self.folder / "units.csv")

    def run(self, procedure: str, *more: object) -> tuple[object, ...]:
        return ("run", procedure, *self.files, "--yes", "--store", "S", "--json", *more)

    def ask(self, instrument: str, query: str) -> str:
        return self.tell(instrument, query)

    def tell(self, instrument: str, command: str) -> str:
        """Have a line done; what was answered by the time the instrument closed the connection."""
        with socket.create_connection(("127.0.0.1", self.simulation["ports"][instrument]), timeout=10) as line:
            line.sendall(f"{command}\n".encode())
            line.shutdown(socket.SHUT_WR)
            return line.makefile("r").read().strip()

    def is_safe(self) -> bool:
        time.sleep(3.0 / self.simulation["speed"] + 0.05)  # the table brakes with 100 deg/s2
        return (
            float(self.ask("table", "RATE:ACT?")) == 0.0
            and float(self.ask("chamber", "TEMP:SETP?")) == ROOM_DEG_C
            and self.ask("supply", "OUTP?") == "0"
        )

    def role(self, name: str) -> int:
        """Process of the instruments, or of the gyros."""
        for entry in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                words = entry.read_bytes().split(b"\0")
            except OSError:
                continue
            if words[-3:-1] == [name.encode(), str(self.folder).encode()]:
                return int(entry.parent.name)
        raise AssertionError(f"no process plays the {name} of {self.folder}")


def simulate(command_line: Callable[..., list[str]], folder: Path, *more: object) -> Bench:
    process = subprocess.Popen(
        command_line("simulate", folder, "--units", 2, "--json", *more),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line, process.communicate()[1]
    assert json.loads(line)["event"] == "ready"
    return Bench(folder, process)


def ended(process: subprocess.Popen[str], code: int = 0, timeout_s: float = 60.0) -> tuple[dict[str, Any], str]:
    out, err = process.communicate(timeout=timeout_s)
    assert process.returncode == code, (out, err)
    assert "Traceback" not in err, err
    told: dict[str, Any] = json.loads(out.splitlines()[-1])
    return told, err


def is_running(pid: int) -> bool:
    """Whether a process is at work; one that has ended may wait for long to be taken note of."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def finish(bench: Bench) -> None:
    bench.process.send_signal(signal.SIGINT)
    try:
        bench.process.communicate(timeout=20)
    finally:
        bench.process.kill()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory, command_line: Callable[..., list[str]]) -> Iterator[Bench]:
    """A hundred times real time."""
    found = simulate(command_line, tmp_path_factory.mktemp("bench") / "sim", "--speed", 100, "--rate-hz", 10)
    yield found
    finish(found)


@pytest.fixture(scope="module")
def fast(tmp_path_factory: pytest.TempPathFactory, command_line: Callable[..., list[str]]) -> Iterator[Bench]:
    """A thousand times real time: for what takes hours."""
    found = simulate(command_line, tmp_path_factory.mktemp("fast") / "sim", "--speed", 1000, "--rate-hz", 1)
    yield found
    finish(found)


@pytest.fixture
def state(tmp_path: Path) -> Callable[[Callable[[dict[str, Any]], bool]], dict[str, Any]]:
    """Wait until the run of this test's store has come so far, by the file in which it is remembered."""

    def wait(has_come: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        until = time.monotonic() + 40
        while time.monotonic() < until:
            for path in sorted((tmp_path / "S" / "spool").glob("*/procedure.json")):
                found: dict[str, Any] = json.loads(path.read_bytes())
                if found["phase"] != "ended" and has_come(found):
                    return found
            time.sleep(0.005)
        raise AssertionError("the run did not come so far")

    return wait


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """The store of this test's runs."""
    return tmp_path / "S"


def refused(words: tuple[object, ...], store: Path) -> str:
    """Why a command is refused; in this process, since starting one takes longer than what is tested."""
    done = CliRunner().invoke(run, [*(str(word) for word in words[1:]), "--store", str(store)])
    assert done.exit_code == 1, done.output
    message: str = json.loads(done.output.splitlines()[-1])["error"]["message"]
    return message


def rows(store: Path, sql: str) -> list[dict[str, Any]]:
    with Catalog(Store.open(store)) as catalog:
        return [row for batch in catalog.batches(sql) for row in batch.to_pylist()]


def sound(store: Path) -> None:
    """Nothing is there twice, every step that was begun has an end, and the store is whole."""
    (row,) = rows(store, "select count(*) as n, count(distinct (unit, signal, epoch, seq)) as once from samples")
    assert row["n"] == row["once"] > 0
    found, _ = verify(Store.open(store))
    assert found.is_sound, found.findings
    (open_,) = rows(store, "select count(*) as n from steps where outcome = 'open'")
    assert open_["n"] == 0
    # what the last document of a run promises is what is there, whichever process sent it
    (ended,) = rows(store, "select document from events where kind = 'RunEnded'")
    totals = json.loads(ended["document"])["totals"]
    promised = {(each["unit"], each["signal"], each["epoch"]): each["samples"] for each in totals}
    kept = rows(store, "select unit, signal, epoch, count(*) as n from samples group by all")
    assert promised == {(row["unit"], row["signal"], str(row["epoch"])): row["n"] for row in kept}


def completed(store: Path, steps: int = 24) -> None:
    """Every recorded step of each unit was completed once."""
    found = rows(
        store,
        "select unit, step, rate_command, repeat, count(*) as n from steps where outcome = 'completed' group by all",
    )
    by_unit = {unit: sum(r["n"] for r in found if r["unit"] == unit) for unit in ("SIM-0001", "SIM-0002")}
    assert by_unit == {"SIM-0001": steps, "SIM-0002": steps}
    assert all(r["n"] == 1 for r in found)


def test_a_scale_factor_is_measured_as_it_was_planted(
    gyrofleet: Gyrofleet, store: Path, bench: Bench, tmp_path: Path
) -> None:
    record_s, rate_hz = 10.0, 10.0
    done = gyrofleet(*bench.run("scale_factor"))
    assert done.code == 0, done.err
    last = json.loads(done.out.splitlines()[-1])
    assert (last["event"], last["outcome"], last["steps_done"], last["short_records"]) == ("ended", "completed", 25, 0)
    sound(store)
    completed(store)
    found = rows(
        store,
        "select p.unit, p.rate_command, p.t_start_ns, s.epoch, list(s.value order by s.t_ns) as v, "
        "list(s.t_ns order by s.t_ns) as t from steps p join samples s on s.unit = p.unit and s.signal = 'rate' "
        "and s.t_ns >= p.t_start_ns + (p.settle * 1e9)::bigint and s.t_ns <= p.t_end_ns group by all order by all",
    )
    assert len(found) == 48  # of each step one epoch, of each epoch one step
    assert len({row["epoch"] for row in found}) == 48
    truths = [json.loads(line) for line in (bench.folder / "truth.jsonl").read_text().splitlines()]
    for unit in ("SIM-0001", "SIM-0002"):
        planted = next(each["parameters"] for each in truths if each["unit"] == unit)
        mine = [row for row in found if row["unit"] == unit]
        white = planted["noise"]["angle_random_walk_deg_per_sqrt_h"] / 60.0  # deg/sqrt(s)
        for row in mine:
            times = np.array(row["t"], np.int64)
            assert len(times) == record_s * rate_hz
            assert (np.diff(times) == round(1e9 / rate_hz)).all()
            # white noise, the table's ripple of 2e-4 deg/s, counts of 5e-5 deg/s; a ramp of 100 deg/s2 would show
            expected = math.sqrt(white**2 * rate_hz + 2e-4**2 / 2 + 5e-5**2 / 12)
            assert np.std(row["v"], ddof=1) == pytest.approx(expected, rel=5 / math.sqrt(2 * (len(times) - 1)))
        rate = np.array([row["rate_command"] for row in mine])
        mean = np.array([np.mean(row["v"]) for row in mine])
        earth = EARTH_DEG_PER_H / 3600.0 * math.sin(math.radians(bench.simulation["latitude_deg"]))
        x = rate + earth
        full = planted["scale"]["full_range_deg_per_s"]
        design = np.column_stack([np.ones_like(x), x, x**2 / full, x**3 / full**2, np.abs(x) / 2]) * [1, *[1e-6] * 4]
        fitted = np.linalg.lstsq(design, mean - x, rcond=None)[0]
        flicker = planted["noise"]["bias_instability_deg_per_h"] / 3600.0
        turn_on = planted["bias"]["turn_on_deg_per_h"] / 3600.0
        variance = white**2 / record_s + flicker**2 + turn_on**2
        bound = 5 * np.sqrt(variance * np.diag(np.linalg.inv(design.T @ design)))
        scale = planted["scale"]
        warm_up_deg_per_h = 0.3 * math.exp(-15.0 / 300.0)  # in the middle of a record, 10 s to 40 s after power-on
        bias = (planted["bias"]["constant_deg_per_h"] + warm_up_deg_per_h) / 3600.0
        bound[0] += 0.3 * (25.0 / 300.0) / 3600.0
        expected_terms = [bias, scale["error_ppm"], *scale["nonlinearity_ppm"], scale["asymmetry_ppm"]]
        assert (np.abs(fitted - expected_terms) < bound).all(), (fitted, expected_terms, bound)
        assert bound[1] < 10.0, "the bound is to tell a scale factor error of 500 ppm from none"
    kinds = "select unit, document->>'$.epoch' as epoch from events where kind = 'PowerOn'"
    powered = rows(store, kinds)
    assert len({(row["unit"], row["epoch"]) for row in powered}) == len(powered) == 50
    assert {row["epoch"] for row in found} < {row["epoch"] for row in powered}
    turned = rows(
        store,
        "select p.rate_command as r, max(abs(s.value - p.rate_command)) as off, count(*) as n from steps p "
        "join samples s on s.unit = 'table' and s.signal = 'table_rate' and s.t_ns between p.t_start_ns and p.t_end_ns "
        "where p.unit = 'SIM-0001' group by all",
    )
    assert len(turned) == 23  # at rest before and after
    assert all(row["off"] <= 2.1e-4 and row["n"] >= 1 for row in turned), turned  # ripple, and rounding to 1e-6


def test_killed_at_any_moment_nothing_is_there_twice_and_nothing_is_forgotten(
    gyrofleet: Gyrofleet, store: Path, spawn: Spawn, bench: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    command = bench.run("bias_repeatability", *CYCLES, "bias_record_s=100")
    rng = random.Random(11)
    moments: list[Callable[[dict[str, Any]], bool]] = [
        lambda run: True,  # right at the start
        lambda run: run["step"] >= 1 and not run["is_powered"],  # off between two records
        lambda run: run["step"] >= 2 and run["open_steps"],  # a second before the step's end
    ]
    for moment in moments:
        process = spawn(*command)
        state(moment)
        time.sleep(rng.uniform(0.0, 0.1))
        process.kill()
        process.wait()
    last = spawn(*command)
    assert last.stdout is not None
    told = json.loads(last.stdout.readline())
    assert told["resumed"]
    assert told["gap_s"] > 0.0
    done, _ = ended(last)
    assert done["run"].endswith("-bias_repeatability-A")
    completed(store, steps=4)
    sound(store)
    cut = rows(
        store,
        "select repeat, outcome, count(distinct unit) as units from steps where outcome <> 'completed' "
        "group by all order by repeat desc",
    )
    assert {row["outcome"] for row in cut} == {"interrupted"}
    assert cut[0]["repeat"] >= told["steps_done"] >= 2, "it goes on at the step that was cut"
    assert cut[0]["units"] == 2
    resumed = [
        json.loads(row["document"]) for row in rows(store, "select document from events where kind = 'RunResumed'")
    ]
    assert len(resumed) in {2, 3}, "killed before it was said that it began, it begins once again"
    assert all(each["gap_ns"] > 0 for each in resumed)
    assert told["gap_s"] in [each["gap_ns"] / 1e9 for each in resumed]
    (row,) = rows(store, "select count(*) as n from events where kind = 'RunStarted'")
    assert row["n"] == 1
    again = gyrofleet(*command, "--run", done["run"])
    assert again.code == 0
    assert "nothing to do" in again.json["remark"]


def test_stopped_by_ctrl_c_the_station_is_safe_and_the_run_goes_on_later(
    gyrofleet: Gyrofleet, store: Path, spawn: Spawn, bench: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    command = bench.run("scale_factor", *SHORT)
    bench.tell("chamber", "TEMP:SETP 40")
    process = spawn(*command)
    state(lambda run: run["step"] >= 4)
    assert abs(float(bench.ask("table", "RATE:ACT?"))) > 1.0
    process.send_signal(signal.SIGINT)
    told, _ = ended(process, code=130)
    assert told["event"] == "interrupted"
    assert "same command" in told["remark"]
    assert bench.is_safe()
    bench.tell("chamber", f"TEMP:SETP {ROOM_DEG_C}")
    assert "other steps of scale_factor" in refused(bench.run("scale_factor", "--set", "startup_s=3"), store)
    one = bench.folder / "one.csv"
    one.write_text("serial\nSIM-0001\n")
    other = refused(bench.run("scale_factor", *SHORT, "--run", told["run"], "--units", one), store)
    assert "other units (new now: none; gone: SIM-0002)" in other
    turned = bench.folder / "turned.csv"
    turned.write_text("serial\nSIM-0002\nSIM-0001\n")  # the order of scanning means nothing
    last, _ = ended(spawn(*bench.run("scale_factor", *SHORT, "--units", turned)))
    assert last["run"] == told["run"]
    completed(store)
    sound(store)
    assert bench.is_safe()


def test_an_operator_confirms_pauses_and_aborts(
    bench: Bench, tmp_path: Path, command_line: Callable[..., list[str]]
) -> None:
    words = [str(word) for word in bench.run("scale_factor", *SHORT) if word not in {"--yes", "--json"}]
    process = subprocess.Popen(
        command_line(*words), cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, bufsize=1,
    )  # fmt: skip
    try:
        assert process.stdin is not None
        assert process.stderr is not None

        def until(part: str) -> None:
            for line in process.stderr or ():
                if part in line:
                    return
            raise AssertionError(f"{part!r} was not said")

        until("then press Enter")
        time.sleep(0.5)
        assert bench.ask("table", "RATE:ACT?") == "0.000000"
        run = next((tmp_path / "S" / "spool").glob("*/procedure.json"))
        assert json.loads(run.read_bytes())["step"] == 0, "it was to wait"
        process.stdin.write("what\n")
        until("Ctrl-C stops")
        process.stdin.write("\n")
        deadline = time.monotonic() + 20
        while json.loads(run.read_bytes())["step"] < 3 and time.monotonic() < deadline:
            time.sleep(0.02)
        process.stdin.write("p\n")
        until("is paused")
        step = json.loads(run.read_bytes())["step"]
        time.sleep(1.0)
        assert json.loads(run.read_bytes())["step"] == step
        process.stdin.write("c\n")
        until("goes on")
        while json.loads(run.read_bytes())["step"] <= step and time.monotonic() < deadline:
            time.sleep(0.02)
        process.stdin.write("a\n")
        out, err = process.communicate(timeout=30)
        assert process.returncode == 1, err
        assert "(aborted)" in out
        assert bench.is_safe()
    finally:
        process.kill()
        process.communicate()


def test_without_an_operator_a_prompt_ends_the_run_instead_of_waiting_for_ever(
    gyrofleet: Gyrofleet, bench: Bench
) -> None:
    words = [word for word in bench.run("static_bias") if word != "--yes"]
    refused = gyrofleet(*words)  # its standard input is empty
    assert refused.code == 1
    assert "nobody can confirm" in refused.out + refused.err
    assert bench.is_safe()
    aborted = gyrofleet(*bench.run("static_bias", "--end"))
    assert aborted.code == 0
    assert json.loads(aborted.out.splitlines()[-1])["outcome"] == "stopped"


def test_a_chamber_that_never_settles_is_given_up_and_gone_on_with(
    gyrofleet: Gyrofleet, store: Path, spawn: Spawn, fast: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    command = fast.run(
        "bias_temperature_sensitivity", "--settle-timeout-h", "0.5", "--set", "least_temperature_deg_c=15",
        "--set", "most_temperature_deg_c=40", "--set", "warm_up_s=0", "--set", "bias_record_s=2000",
    )  # fmt: skip
    fast.tell("chamber", "SIM:FAULT UNSETTLED")
    try:
        told, _ = ended(spawn(*command), code=1)
    finally:
        fast.tell("chamber", "SIM:FAULT NONE")
    assert told["event"] == "interrupted"
    assert "step 3 (soak): temperature settles is not done after 1,8" in told["remark"]
    assert "the station was made safe" in told["remark"]
    assert fast.is_safe()
    (kept,) = rows(store, "select count(*) as n from steps where outcome = 'completed'")
    assert kept["n"] == 2
    # made safe, the chamber goes to room temperature: the record may not begin while it comes back
    process = spawn(*command)
    state(lambda run: run["step"] == 3 and run["open_steps"])
    process.send_signal(signal.SIGINT)
    ended(process, code=130)
    time.sleep(0.5)
    last, _ = ended(spawn(*command))
    assert last["outcome"] == "completed"
    sound(store)
    (found,) = rows(
        store,
        "select max(abs(s.value - 40)) as off, count(*) as n from steps p join samples s on s.signal = "
        "'chamber_temperature' and s.t_ns between p.t_start_ns and p.t_end_ns "
        "where p.temperature_command = 40 and p.outcome = 'completed'",
    )
    assert found["n"] > 0
    assert found["off"] < 0.5
    reasons = "select document->>'$.reason' as reason from events where kind = 'RunResumed' order by t_ns"
    assert [row["reason"] for row in rows(store, reasons)] == [
        "taken up again at step 3; no step was cut",
        "taken up again at step 3; step 4 is begun again, from step 3 on",
    ]


def test_an_instrument_that_falls_silent_is_reported_once_and_the_run_goes_on(
    gyrofleet: Gyrofleet, store: Path, spawn: Spawn, bench: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    process = spawn(*bench.run("static_bias", "--set", "bias_record_s=900", "--set", "warm_up_s=0"))
    state(lambda run: bool(run["open_steps"]))
    bench.tell("supply", "SIM:FAULT DROP")
    bench.tell("chamber", "SIM:FAULT SILENT")
    time.sleep(5.0)
    for name in ("supply", "chamber"):
        bench.tell(name, "SIM:FAULT NONE")
    last, err = ended(process)
    assert last["outcome"] == "completed"
    notes = [
        row["text"] for row in rows(store, "select document->>'$.text' as text from events where kind = 'NoteAdded'")
    ]
    assert len([text for text in notes if "chamber" in text and "tried again until it answers" in text]) == 1
    assert len([text for text in notes if "chamber" in text and "answers again" in text]) == 1
    assert err.count("tried again until it answers") == 1
    assert last["short_records"] == 0
    completed(store, steps=1)
    sound(store)


def test_units_that_deliver_nothing_do_not_pass_silently(
    gyrofleet: Gyrofleet, store: Path, spawn: Spawn, bench: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    gyros = bench.role("gyros")
    process = spawn(*bench.run("static_bias", "--set", "bias_record_s=300", "--set", "warm_up_s=0"))
    state(lambda run: bool(run["open_steps"]))
    time.sleep(0.5)
    os.kill(gyros, signal.SIGSTOP)
    try:
        last, err = ended(process)
    finally:
        os.kill(gyros, signal.SIGCONT)
    assert last["outcome"] == "completed"
    assert last["short_records"] == 2
    assert "lack samples" in last["remark"]
    for unit in ("SIM-0001", "SIM-0002"):
        assert f"unit {unit}: signal rate has " in err
    found = rows(store, "select document->>'$.unit' as unit from events where kind = 'NoteAdded' order by unit")
    assert {row["unit"] for row in found} == {"SIM-0001", "SIM-0002"}


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
        (text.replace("[station]", "[station"), units, "line 1"),
        (text, "", "it is empty"),
    ]
    station, listed = tmp_path / "station.toml", tmp_path / "units.csv"
    for station_text, unit_text, said in cases:
        station.write_text(station_text)
        listed.write_text(unit_text)
        words = ("run", "scale_factor", "--station", station, "--units", listed, "--yes", "--json")
        assert said in (message := refused(words, store)), (said, message)
        assert not list((tmp_path / "S" / "spool").glob("*/procedure.json")), said
    assert "there is nothing to end: no run of scale_factor" in refused(bench.run("scale_factor", "--end"), store)
    assert bench.ask("table", "RATE:ACT?") == "0.000000"
    missing = gyrofleet("run", "scale_factor", "--units", listed, "--yes")
    assert missing.code == 1
    assert "say at which station: --station FILE" in missing.err


def test_a_recorder_elsewhere_may_be_killed_in_the_middle(
    gyrofleet: Gyrofleet, store: Path, spawn: Spawn, bench: Bench, endpoint: str, state: Callable[..., dict[str, Any]]
) -> None:
    def record() -> subprocess.Popen[str]:
        process = spawn("record", "--listen", endpoint, "--store", "S", "--json")
        assert process.stdout is not None
        process.stdout.readline()
        return process

    recorder = record()
    process = spawn(*bench.run("static_bias", "--set", "bias_record_s=600", "--set", "warm_up_s=0"))
    assert process.stdout is not None
    assert f"to the recorder at {endpoint}" in process.stdout.readline()
    state(lambda run: bool(run["open_steps"]))
    time.sleep(1.5)
    recorder.kill()
    recorder.wait()
    time.sleep(1.5)
    recorder = record()
    last, _ = ended(process)
    assert (last["outcome"], last["short_records"]) == ("completed", 0)
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=30)
    (row,) = rows(store, "select count(*) as n from samples")
    assert row["n"] == last["samples"]
    sound(store)


def test_runs_of_a_day_have_letters_and_an_overdue_calibration_is_said_and_a_station_has_one_run_at_a_time(
    gyrofleet: Gyrofleet, store: Path, spawn: Spawn, bench: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    quick = ("--set", "bias_record_s=10", "--set", "warm_up_s=0")
    overdue = bench.folder / "overdue.toml"
    overdue.write_text(
        (bench.folder / "station.toml")
        .read_text()
        .replace('kind = "rate_table"', 'kind = "rate_table"\nserial = "T-7"\ncalibration_due = 2020-03-31')
    )
    first = gyrofleet(*bench.run("static_bias", *quick, "--station", overdue))
    assert first.code == 0, first.err
    assert json.loads(first.out.splitlines()[-1])["run"].endswith("-static_bias-A")
    warning = "warning: the rate_table table, serial T-7 was due for calibration on 2020-03-31"
    assert warning in first.err
    assert {"text": warning} in rows(store, "select document->>'$.text' as text from events where kind = 'NoteAdded'")
    process = spawn(*bench.run("static_bias", "--set", "bias_record_s=100000"))
    state(lambda run: True)
    other = gyrofleet(*bench.run("static_bias", *quick, "--store", "other"))
    assert other.code == 1
    assert "another gyrofleet run is at work at station bench" in other.json["error"]["message"]
    process.send_signal(signal.SIGINT)
    told, _ = ended(process, code=130)
    assert told["run"].endswith("-B")
    one = bench.folder / "only.csv"
    one.write_text("serial\nSIM-0001\n")
    done = gyrofleet(*bench.run("static_bias", *quick, "--units", one))
    assert json.loads(done.out.splitlines()[-1])["run"].endswith("-C")
    assert f"run {told['run']} of SIM-0001, SIM-0002 was left unfinished" in done.err


def test_a_simulated_station_ends_as_a_whole_and_goes_on_with_its_clock(
    tmp_path: Path, command_line: Callable[..., list[str]]
) -> None:
    folder = tmp_path / "sim"
    found = simulate(command_line, folder, "--speed", 1000, "--rate-hz", 1)
    second = subprocess.run(command_line("simulate", folder), capture_output=True, text=True, timeout=30)
    assert second.returncode == 1
    assert "another gyrofleet simulate plays the station in" in second.stderr
    roles = [found.role("instruments"), found.role("gyros")]
    clock = (folder / "station.toml").read_bytes()
    found.process.kill()  # not asked: those that it started see it themselves
    found.process.communicate()
    again = simulate(command_line, folder)
    try:
        assert not any(map(is_running, roles))
        assert (folder / "station.toml").read_bytes() == clock
        deadline = time.monotonic() + 10
        told: list[dict[str, Any]] = []
        while time.monotonic() < deadline and len(told) < 4:
            lines = (folder / "truth.jsonl").read_bytes().splitlines()
            told = [each for each in map(msgspec.json.decode, lines) if each["duration_s"] == 0.0]
            time.sleep(0.05)
        # a power-on more of each, not the first one once again
        assert sorted((each["unit"], each["power_on"]) for each in told) == [
            ("SIM-0001", 1), ("SIM-0001", 2), ("SIM-0002", 1), ("SIM-0002", 2),
        ]  # fmt: skip
        roles = [again.role("instruments"), again.role("gyros")]
        again.process.send_signal(signal.SIGINT)
        _, err = again.process.communicate(timeout=20)
        assert again.process.returncode == 0, err
        assert "station ended" in err
        assert not any(map(is_running, roles))
    finally:
        again.process.kill()
