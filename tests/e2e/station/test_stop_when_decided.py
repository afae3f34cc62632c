"""Units are released once their limits are decided: power off, slot free, and a verdict that rests on the decision."""

import json
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.e2e.conftest import finish

Bench = Any
Kept = Any
Gyrofleet = Callable[..., Any]
Spawn = Callable[..., subprocess.Popen[str]]

SHORT = ("--set", "warm_up_s=30", "--set", "bias_record_s=900", "--every", 20, "--stop-when-decided")
PRODUCTS = {"SIM-0001": "GOOD", "SIM-0002": "BAD", "SIM-0003": "GOOD", "SIM-0004": "BAD"}
# planted: 0.02 deg/sqrt(h), that is 1.2 deg/h in averages of 1 s, 0.38 deg/h in averages of 10 s
SPECIFICATION = """
name = "fog"
revision = "A"
[[limit]]
metric = "allan_deviation"
parameters = { tau_s = 10 }
product = "GOOD"
upper = 2.0
unit_of_measure = "deg/h"
[[limit]]
metric = "allan_deviation"
parameters = { tau_s = 10 }
product = "BAD"
upper = 0.1
unit_of_measure = "deg/h"
"""
AFTER = """
[[limit]]
metric = "bias"
product = "GOOD"
parameters = { earth_rate = "none" }
upper = 100.0
unit_of_measure = "deg/h"
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory, simulated: Callable[..., Bench]) -> Iterator[Bench]:
    """A station with two good and two bad units, a hundred times real time."""
    folder = tmp_path_factory.mktemp("decided") / "sim"
    folder.mkdir()
    rows = [f"{unit},S{i},{product}\n" for i, (unit, product) in enumerate(PRODUCTS.items(), 1)]
    (folder / "units.csv").write_text("serial,slot,product\n" + "".join(rows))
    found = simulated(folder, "--units", 4, "--speed", 100, "--rate-hz", 10)
    yield found
    finish(found)


def specify(gyrofleet: Gyrofleet, folder: Path, text: str) -> None:
    (folder / "fog.toml").write_text(text)
    done = gyrofleet("limits", "add", "fog.toml", "--store", "S")
    assert done.code == 0, done.err


def documents(kept: Kept, kind: str) -> dict[str, dict[str, Any]]:
    rows = kept.rows(f"select document from events where kind = '{kind}' order by t_ns")
    return {each["unit"]: each for each in (json.loads(row["document"]) for row in rows)}


def verdicts(gyrofleet: Gyrofleet) -> dict[str, dict[str, Any]]:
    reported = json.loads(gyrofleet("verdicts", "--store", "S", "--json").out)
    return {row["unit"]: row for row in reported["verdicts"] if row["metric"] == "allan_deviation"}


@pytest.mark.long
def test_all_are_decided_and_the_run_ends_early(gyrofleet: Gyrofleet, kept: Kept, bench: Bench, tmp_path: Path) -> None:
    specify(gyrofleet, tmp_path, SPECIFICATION)
    done = gyrofleet(*bench.run("static_bias", *SHORT))
    assert done.code == 0, done.err
    last = json.loads(done.out.splitlines()[-1])
    assert (last["event"], last["outcome"]) == ("ended", "completed")
    assert last["verdicts"] == {unit: "PASS" if what == "GOOD" else "FAIL" for unit, what in PRODUCTS.items()}
    assert set(last["released"]) == set(PRODUCTS)
    assert "every unit is decided: the record ends early" in done.err
    assert "4 of 4 units were decided early" in done.err
    assert "supply is switched off; slots S1, S2, S3, S4 are free" in done.err
    released = documents(kept, "UnitReleased")
    for unit, each in released.items():
        assert each["verdict"] == last["verdicts"][unit]
        assert each["recorded_s"] < 0.95 * each["planned_s"] == 0.95 * 900.0
        assert last["released"][unit]["saved_s"] == pytest.approx(each["planned_s"] - each["recorded_s"])
    off = documents(kept, "PowerOff")
    assert set(off) == set(PRODUCTS)
    steps = kept.rows("select unit, t_start_ns, t_end_ns, outcome from steps")
    assert {row["outcome"] for row in steps} == {"completed"}
    for row in steps:
        assert row["t_end_ns"] == released[row["unit"]]["t_ns"]
    for unit, row in verdicts(gyrofleet).items():
        assert row["verdict"] == last["verdicts"][unit]
        assert row["reason"].startswith("decided early, after 0."), row["reason"]
    saved_s = sum(each["saved_s"] for each in last["released"].values())
    (ended,) = (json.loads(row["document"]) for row in kept.rows("select document from events where kind = 'RunEnded'"))
    assert (ended["released"], ended["saved_s"]) == (4, pytest.approx(saved_s))
    (run,) = kept.rows("select released, saved_s, time_zone from runs")
    assert (run["released"], run["saved_s"]) == (4, pytest.approx(saved_s))
    roles = [each["status"] for each in gyrofleet("status", "--store", "S", "--json").json["roles"]]
    (role,) = (each for each in roles if each["run"] is not None)
    assert role["run"]["released"] == last["verdicts"]
    assert role["run"]["saved_s"] == pytest.approx(saved_s)
    shown = gyrofleet("status", "--store", "S").out
    assert "SIM-0001 PASS 合格, SIM-0002 FAIL 不合格" in shown
    assert f"{saved_s / 3600:,.1f} unit hours saved" in shown


@pytest.mark.long
def test_a_unit_with_limits_after_the_run_is_released_only_as_a_failure(
    gyrofleet: Gyrofleet, kept: Kept, bench: Bench, tmp_path: Path
) -> None:
    specify(gyrofleet, tmp_path, SPECIFICATION + AFTER)
    done = gyrofleet(*bench.run("static_bias", *SHORT))
    assert done.code == 0, done.err
    last = json.loads(done.out.splitlines()[-1])
    assert set(last["released"]) == {"SIM-0002", "SIM-0004"}
    assert "released early only as FAIL: SIM-0001, SIM-0003; the whole record is needed for bias" in done.err
    assert last["verdicts"] == {unit: "PASS" if what == "GOOD" else "FAIL" for unit, what in PRODUCTS.items()}
    assert last["short_records"] == 0  # what was released lacks nothing
    spans = {row["unit"]: row["t_end_ns"] - row["t_start_ns"] for row in kept.rows("select * from steps")}
    assert spans["SIM-0002"] < 0.95 * spans["SIM-0001"]
    assert spans["SIM-0001"] >= 900 * 10**9 - 2 * 10**8


def test_decisions_of_estimators_in_other_processes_release_units(
    gyrofleet: Gyrofleet, kept: Kept, bench: Bench, spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    specify(gyrofleet, tmp_path, SPECIFICATION)
    record = spawn("record", "--listen", endpoint, "--store", "S", "--json")
    assert record.stdout is not None
    assert record.stdout.readline()
    estimate = spawn("estimate", "--store", "S", "--every", "20", "--json")
    assert estimate.stderr is not None
    assert estimate.stdout is not None
    assert "estimating" in estimate.stderr.readline()
    # it waits where nobody reads its estimates
    reader = threading.Thread(target=estimate.stdout.read)
    reader.start()
    done = gyrofleet(*bench.run("static_bias", *SHORT[:4], "--stop-when-decided"))
    assert done.code == 0, done.err
    assert set(json.loads(done.out.splitlines()[-1])["released"]) == set(PRODUCTS)
    for process in (estimate, record):
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    reader.join(10)
    assert {unit: each["verdict"] for unit, each in documents(kept, "VerdictGiven").items()} == {
        unit: "PASS" if what == "GOOD" else "FAIL" for unit, what in PRODUCTS.items()
    }


@pytest.mark.long
def test_a_run_that_is_killed_after_a_release_goes_on_with_the_others(
    gyrofleet: Gyrofleet, kept: Kept, bench: Bench, spawn: Spawn, tmp_path: Path
) -> None:
    specify(gyrofleet, tmp_path, SPECIFICATION + AFTER)
    command = bench.run("static_bias", *SHORT)
    process = spawn(*command)
    assert process.stderr is not None
    lines = iter(process.stderr.readline, "")
    assert any("is decided after" in line for line in lines)
    process.kill()
    process.wait(30)
    done = gyrofleet(*command)
    assert done.code == 0, done.err
    last = json.loads(done.out.splitlines()[-1])
    assert last["resumed"]
    assert set(last["released"]) == {"SIM-0002", "SIM-0004"}
    released = kept.rows("select unit, count(*) as n from events where kind = 'UnitReleased' group by unit")
    assert {row["unit"]: row["n"] for row in released} == {"SIM-0002": 1, "SIM-0004": 1}
    completed = kept.rows("select unit, count(*) as n from steps where outcome = 'completed' group by unit")
    assert {row["unit"]: row["n"] for row in completed} == dict.fromkeys(PRODUCTS, 1)
    found = {unit: row["verdict"] for unit, row in verdicts(gyrofleet).items()}
    assert found == {unit: "PASS" if what == "GOOD" else "FAIL" for unit, what in PRODUCTS.items()}
