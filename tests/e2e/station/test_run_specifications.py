"""A procedure's run applies the specification of each unit's product: early decisions, and verdicts that agree."""

import json
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.e2e.conftest import finish

Bench = Any
Kept = Any
Gyrofleet = Callable[..., Any]
Spawn = Callable[..., subprocess.Popen[str]]

SHORT = ("--set", "warm_up_s=30", "--set", "bias_record_s=600", "--every", 20)
PRODUCTS = {"SIM-0001": "FOG-A", "SIM-0002": "FOG-B", "SIM-0003": "FOG-C", "SIM-0004": "FOG-A"}
# planted: 0.02 deg/sqrt(h), that is 1.2 deg/h in averages of 1 s, 0.38 deg/h in averages of 10 s
SPECIFICATION = """
name = "fog"
revision = "A"
[[limit]]
metric = "bias_stability_averaged"
parameters = { average_s = 1 }
product = "FOG-A"
upper = 6.0
unit_of_measure = "deg/h"
[[limit]]
metric = "allan_deviation"
parameters = { tau_s = 10 }
product = "FOG-A"
upper = 2.0
unit_of_measure = "deg/h"
[[limit]]
metric = "bias_stability_averaged"
parameters = { average_s = 1 }
product = "FOG-B"
upper = 0.6
unit_of_measure = "deg/h"
[[limit]]
metric = "bias"
product = "FOG-B"
parameters = { earth_rate = "none" }
upper = 100.0
unit_of_measure = "deg/h"
"""


@pytest.fixture(scope="module")
def products(tmp_path_factory: pytest.TempPathFactory, simulated: Callable[..., Bench]) -> Iterator[Bench]:
    """A station with units of three products, a hundred times real time."""
    folder = tmp_path_factory.mktemp("products") / "sim"
    folder.mkdir()
    rows = [f"{unit},S{i},{product}\n" for i, (unit, product) in enumerate(PRODUCTS.items(), 1)]
    (folder / "units.csv").write_text("serial,slot,product\n" + "".join(rows))
    found = simulated(folder, "--units", 4, "--speed", 100, "--rate-hz", 10)
    yield found
    finish(found)


@pytest.fixture
def specify(gyrofleet: Gyrofleet, tmp_path: Path) -> Callable[..., None]:
    """Enter a specification into the store of this test."""

    def enter(text: str = SPECIFICATION) -> None:
        (tmp_path / "fog.toml").write_text(text)
        done = gyrofleet("limits", "add", "fog.toml", "--store", "S")
        assert done.code == 0, done.err

    return enter


def documents(kept: Kept, kind: str) -> list[dict[str, Any]]:
    rows = kept.rows(f"select document from events where kind = '{kind}' order by t_ns")
    return [json.loads(row["document"]) for row in rows]


def check_documents(kept: Kept, gyrofleet: Gyrofleet) -> None:
    """Each unit has the limits of its product, the bad one fails early, and both kinds of verdicts agree."""
    applied = {each["unit"]: each for each in documents(kept, "LimitsApplied")}
    assert {unit: len(each["limits"]) for unit, each in applied.items()} == {
        "SIM-0001": 2,
        "SIM-0002": 1,
        "SIM-0004": 2,
    }
    assert {each["revision"] for each in applied.values()} == {"fog-A"}
    assert {each["planned_s"] for each in applied.values()} == {600.0}
    (step,) = kept.rows("select t_start_ns from steps where unit = 'SIM-0001'")
    assert all(step["t_start_ns"] <= each["since_ns"] for each in applied.values())

    decided = [each for each in documents(kept, "EarlyDecision") if each["outcome"] != "UNDECIDED"]
    early = {(each["unit"], each["outcome"]) for each in decided if each["looked_at_fraction"] < 0.9}
    assert ("SIM-0002", "FAIL") in early
    assert {unit for unit, outcome in early if outcome == "FAIL"} == {"SIM-0002"}
    assert {("SIM-0001", "PASS"), ("SIM-0004", "PASS")} <= early  # the Allan deviation is far below its limit
    assert all(each["t_ns"] >= applied[each["unit"]]["since_ns"] for each in decided)

    live = {each["unit"]: each for each in documents(kept, "VerdictGiven")}
    assert {unit: each["verdict"] for unit, each in live.items()} == {
        "SIM-0001": "PASS", "SIM-0002": "FAIL", "SIM-0004": "PASS",
    }  # fmt: skip
    reported = json.loads(gyrofleet("verdicts", "--store", "S", "--json").out)
    assert {row["unit"]: row["verdict"] for row in reported["units"]} == {
        "SIM-0001": "PASS", "SIM-0002": "FAIL", "SIM-0003": "NO_DATA", "SIM-0004": "PASS",
    }  # fmt: skip
    values = {(row["unit"], row["metric"]): row for row in reported["verdicts"] if row["value"] is not None}
    metrics = {"bias_stability": "bias_stability_averaged", "allan_deviation": "allan_deviation"}
    checks = [(unit, each) for unit, verdict in live.items() for each in verdict["checks"]]
    assert len(checks) == 5
    for unit, check in checks:
        characteristic = check["limit"]["characteristic"]
        value = values[unit, metrics[characteristic]]
        assert value["verdict"] == check["verdict"]
        # of the same samples; averages begin with the record in the one, with the second of the clock in the other
        tolerance = 0.15 if characteristic == "bias_stability" else 1e-9
        assert value["value"] == pytest.approx(check["value"], rel=tolerance)


@pytest.mark.long
def test_units_of_two_products_are_judged_by_their_own_limits(
    gyrofleet: Gyrofleet, kept: Kept, products: Bench, specify: Callable[..., None]
) -> None:
    specify()
    done = gyrofleet(*products.run("static_bias", *SHORT))
    assert done.code == 0, done.err
    last = json.loads(done.out.splitlines()[-1])
    assert (last["event"], last["outcome"]) == ("ended", "completed")
    assert last["verdicts"] == {"SIM-0001": "PASS", "SIM-0002": "FAIL", "SIM-0004": "PASS"}
    assert "no specification has limits for product FOG-C: units SIM-0003 are not judged" in done.err
    assert "judged after the run (units SIM-0002): bias (earth_rate = none)" in done.err
    assert "unit SIM-0002: early FAIL, bias_stability of rate, 1 s <= 0.6 deg/h: the sum of squares is" in done.err
    check_documents(kept, gyrofleet)


@pytest.mark.long
def test_recorder_and_estimators_in_processes_of_their_own_decide_alike(
    gyrofleet: Gyrofleet, kept: Kept, products: Bench, specify: Callable[..., None], spawn: Spawn, endpoint: str
) -> None:
    specify()
    record = spawn("record", "--listen", endpoint, "--store", "S", "--json")
    assert record.stdout is not None
    assert record.stdout.readline()
    estimate = spawn("estimate", "--store", "S", "--every", "20", "--json")
    assert estimate.stderr is not None
    assert "estimating" in estimate.stderr.readline()
    done = gyrofleet(*products.run("static_bias", *SHORT[:-2]))
    assert done.code == 0, done.err
    for process in (estimate, record):
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
    check_documents(kept, gyrofleet)


def test_a_specification_that_is_not_there_is_refused_with_those_that_are(
    products: Bench, store: Path, specify: Callable[..., None]
) -> None:
    def refused(name: str) -> str:
        return str(products.refused(products.run("static_bias", *SHORT, "--specification", name), store))

    assert f"there is no store in {store}" in refused("fog")
    specify(SPECIFICATION.replace('revision = "A"', 'revision = "A"\nvalid_until = 2020-12-31'))
    assert "there is no specification 'fgo'" in refused("fgo")
    assert "there are fog" in refused("fgo")
    known = "fog@A (from ever until 2021-01-01 (not included))"
    assert f"no revision 'B' of specification fog; there are {known}" in refused("fog@B")
    assert f"no revision valid now of specification fog; there are {known}" in refused("fog")
    assert not (store / "spool").exists()


@pytest.mark.long
def test_what_a_run_will_be_judged_by_is_known_before_it_begins(
    gyrofleet: Gyrofleet, products: Bench, specify: Callable[..., None]
) -> None:
    def remarks(*words: object) -> list[str]:
        done = gyrofleet(*products.run(*words, "--check"))
        assert done.code == 0, done.err
        found: list[str] = json.loads(done.out)["limits"]
        return found

    assert remarks("static_bias") == ["no limits: there is no store in S yet; `gyrofleet limits add FILE` adds one"]
    specify(SPECIFICATION.replace('revision = "A"', 'revision = "A"\nvalid_until = 2020-12-31'))
    assert remarks("static_bias") == ["no limits: S has no specification that is valid now"]
    applied = remarks("static_bias", "--specification", "fog@A")
    assert "fog@A is applied; `gyrofleet verdicts` judges by the revisions valid now: none" in applied
    turning = remarks("scale_factor", "--specification", "fog@A")
    assert any("bias_stability, allan_deviation" in each and "judged after the run" in each for each in turning)
