"""A run, one unit of it, or a check by hand is excluded from evaluation with a reason, and included again."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.free_ports import free_endpoint

LIMITS = """
name = "S"
revision = "A"
valid_from = 2026-01-01
[[limit]]
metric = "bias"
parameters = { earth_rate = "none" }
lower = -10.0
upper = 10.0
unit_of_measure = "deg/h"
"""
STEP = ("--procedure", "static_bias", "--position", "IRA_up", "--store", "s")
Run = Callable[..., Any]


def _store(run_command: Run, folder: Path, biases: dict[tuple[str, str], float]) -> None:
    """A run of a day for each bias, of the unit and run that are its key."""
    rng = np.random.default_rng(5)
    (folder / "limits.toml").write_text(LIMITS)
    assert run_command("limits", "add", "limits.toml", "--store", "s", cwd=folder).code == 0
    for day, ((unit, run), bias) in enumerate(biases.items(), start=1):
        rows = "\n".join(f"{at},{bias + 0.5 * rng.standard_normal():.5f}" for at in range(3700))
        (folder / f"{day}.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
        given = ("--unit", unit, "--run", run, "--start", f"2026-03-{day:02d}T12:00:00Z")
        assert run_command("import", f"{day}.csv", *given, *STEP, cwd=folder).code == 0


def _verdicts(run_command: Run, folder: Path) -> dict[str, tuple[str, str]]:
    found = run_command("verdicts", "--store", "s", "--json", cwd=folder).json
    return {row["unit"]: (row["verdict"], row["latest_verdict"]) for row in found["units"]}


def test_an_excluded_run_is_out_of_every_evaluation_until_it_is_included(run_command: Run, tmp_path: Path) -> None:
    _store(run_command, tmp_path, {("U", "good"): 5.0, ("U", "kicked"): 40.0})
    assert _verdicts(run_command, tmp_path) == {"U": ("FAIL", "FAIL")}

    why = ("--reason", "the table was kicked", "--by", "Li Wei", "--store", "s")
    done = run_command("runs", "exclude", "kicked", *why, "--json", cwd=tmp_path).json
    assert (done["units"], done["by"], done["in_lake"]) == (["U"], "Li Wei", True)
    assert _verdicts(run_command, tmp_path) == {"U": ("PASS", "PASS")}
    text = run_command("verdicts", "--store", "s", cwd=tmp_path)
    assert "1 of its 2 runs excluded from evaluation: kicked (the table was kicked; Li Wei)" in text.err + text.out
    chinese = run_command("verdicts", "--store", "s", "--lang", "zh", cwd=tmp_path)
    assert "2 次试验中有 1 次已排除，不参与评定：kicked" in chinese.err + chinese.out
    # where no run is named the longest that counts is taken; a named one can still be looked at
    longest = run_command("allan", "--unit", "U", "--signal", "rate", "--store", "s", "--json", cwd=tmp_path).json
    assert longest["run"] == "good"
    named = ("--run", "kicked", "--store", "s", "--json")
    assert run_command("allan", "--unit", "U", "--signal", "rate", *named, cwd=tmp_path).json["run"] == "kicked"
    # each door names what it leaves out
    trend = run_command("trend", "bias", "--store", "s", "--json", cwd=tmp_path).json
    assert (trend["excluded"], trend["values"]) == (["kicked (U: the table was kicked)"], 1)
    asked = run_command("metrics", "--run", "kicked", "--store", "s", cwd=tmp_path)
    assert "run 'kicked' is excluded from evaluation: kicked (the table was kicked; Li Wei)" in asked.err
    assert "run kicked is excluded from evaluation" in run_command("metrics", "--store", "s", cwd=tmp_path).err
    # the record stays, and who excluded it, when and why
    asked = ("sql", "select run, unit, reason, by_whom from exclusions", "--store", "s", "--json")
    rows = run_command(*asked, cwd=tmp_path)
    assert rows.json == [{"run": "kicked", "unit": "U", "reason": "the table was kicked", "by_whom": "Li Wei"}]
    acts = run_command("audit", "--unit", "U", "--store", "s", "--json", cwd=tmp_path).json
    (act,) = [row for row in acts if row["kind"] == "ExclusionEntered"]
    assert (act["by"], act["run"]) == ("Li Wei", "kicked")
    assert act["what"] == "excluded from evaluation, the table was kicked"

    # twice changes nothing; the way back does
    again = run_command("runs", "exclude", "kicked", *why, "--json", cwd=tmp_path).json
    assert (again["units"], again["already"], again["uids"]) == ([], ["U"], [])
    assert run_command("runs", "include", "kicked", *why, cwd=tmp_path).code == 0
    assert _verdicts(run_command, tmp_path) == {"U": ("FAIL", "FAIL")}


@pytest.mark.long
def test_a_mistyped_serial_is_no_unit_once_its_runs_are_excluded(run_command: Run, tmp_path: Path) -> None:
    _store(run_command, tmp_path, {("U", "a"): 5.0, ("X", "b"): 40.0})
    unknown = run_command("runs", "exclude", "b", "--unit", "U", "--reason", "x", "--store", "s", cwd=tmp_path)
    assert (unknown.code, "it tested X" in unknown.err) == (1, True)
    lacking = run_command("runs", "exclude", "nix", "--reason", "x", "--store", "s", cwd=tmp_path)
    assert (lacking.code, "the last runs are b, a" in lacking.err) == (1, True)
    excluded = ("runs", "exclude", "b", "--unit", "X", "--reason", "the serial was U", "--store", "s")
    assert run_command(*excluded, cwd=tmp_path).code == 0
    found = run_command("verdicts", "--store", "s", "--json", cwd=tmp_path).json
    assert [row["unit"] for row in found["units"]] == ["U"]
    (warning,) = [row for row in found["warnings"] if row["unit"] == "X"]
    assert "1 of its 1 run excluded from evaluation: b (the serial was U;" in warning["reason"]
    listed = run_command("runs", "list", "--store", "s", "--json", cwd=tmp_path).json
    assert {row["run"]: [each["unit"] for each in row["excluded"]] for row in listed} == {"a": [], "b": ["X"]}


@pytest.mark.long
def test_a_check_of_another_unit_is_excluded_alone(run_command: Run, tmp_path: Path) -> None:
    _store(run_command, tmp_path, {("U", "a"): 5.0})
    entered = ("check", "--unit", "U", "--item", "visual", "--verdict", "FAIL", "--by", "Li Wei", "--store", "s")
    uid = run_command(*entered, "--json", cwd=tmp_path).json["uid"]
    assert _verdicts(run_command, tmp_path)["U"][0] == "FAIL"
    both = run_command("runs", "exclude", "a", "--check", uid, "--reason", "x", "--store", "s", cwd=tmp_path)
    assert (both.code, "name a run, of which units" in both.err) == (1, True)
    excluded = ("--check", uid, "--reason", "it was of U2", "--store", "s")
    assert run_command("runs", "exclude", *excluded, cwd=tmp_path).code == 0
    assert _verdicts(run_command, tmp_path)["U"] == ("PASS", "PASS")
    assert run_command("runs", "include", *excluded, cwd=tmp_path).code == 0
    assert _verdicts(run_command, tmp_path)["U"][0] == "FAIL"


@pytest.mark.long
def test_a_diagnosis_names_what_it_leaves_out(run_command: Run, tmp_path: Path) -> None:
    names = {("U", f"r{number}"): 5.0 for number in range(5)}
    _store(run_command, tmp_path, names | {("U", "kicked"): 40.0})
    excluded = ("runs", "exclude", "kicked", "--reason", "kicked", "--store", "s")
    assert run_command(*excluded, cwd=tmp_path).code == 0
    asked = ("diagnose", "--unit", "U", "--model", "rate = bias", "--store", "s", "--json")
    found = run_command(*asked, cwd=tmp_path).json
    text = json.dumps(found)
    assert "they are excluded from evaluation: kicked (kicked)" in text
    assert "r4" in text
    assert '"kicked"' not in text


@pytest.mark.long
def test_a_whole_run_is_excluded_for_units_that_come_later_whatever_was_before(
    run_command: Run, tmp_path: Path
) -> None:
    _store(run_command, tmp_path, {("U", "r"): 5.0, ("V", "r"): 5.0})
    rows = "\n".join(f"{at},{50 + at % 7 / 10}" for at in range(3700))
    (tmp_path / "late.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
    why = ("--reason", "kicked", "--store", "s")
    for words in (("exclude", "r", "--unit", "U"), ("exclude", "r")):
        assert run_command("runs", *words, *why, cwd=tmp_path).code == 0
    given = ("--unit", "W", "--run", "r", "--start", "2026-03-05T12:00:00Z")
    assert run_command("import", "late.csv", *given, *STEP, cwd=tmp_path).code == 0
    assert _verdicts(run_command, tmp_path) == {}
    nothing = run_command("trend", "bias", "--store", "s", cwd=tmp_path)
    assert (nothing.code, "excluded from evaluation are r (kicked)" in nothing.err) == (1, True)
    for words in (("include", "r", "--unit", "U"), ("include", "r")):
        assert run_command("runs", *words, *why, cwd=tmp_path).code == 0
    assert set(_verdicts(run_command, tmp_path)) == {"U", "V", "W"}


def test_a_record_without_a_step_is_excluded_as_well(run_command: Run, tmp_path: Path) -> None:
    rows = "\n".join(f"{at},{at % 7 / 10}" for at in range(300))
    (tmp_path / "a.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
    given = ("--unit", "U", "--run", "r", "--start", "2026-03-05T12:00:00Z", "--store", "s")
    assert run_command("import", "a.csv", *given, cwd=tmp_path).code == 0
    why = ("--reason", "kicked", "--store", "s", "--json")
    assert run_command("runs", "exclude", "r", *why, cwd=tmp_path).json["units"] == ["U"]
    assert run_command("runs", "exclude", "r", *why, cwd=tmp_path).json["already"] == ["U"]
    done = run_command("allan", "--unit", "U", "--signal", "rate", "--store", "s", cwd=tmp_path)
    assert (done.code, "every run of unit U, signal rate is excluded" in done.err) == (1, True)


def test_evaluations_follow_an_exclusion_beside_a_recorder_at_once(
    run_command: Run, spawn: Run, tmp_path: Path
) -> None:
    """The recorder seals its segment, which would stay open for five minutes."""
    _store(run_command, tmp_path, {("U", "good"): 5.0, ("U", "kicked"): 40.0})
    recorder = spawn("record", "--listen", free_endpoint(), "--store", str(tmp_path / "s"), "--json")
    assert json.loads(recorder.stdout.readline())["event"] == "recording"
    words = ("runs", "exclude", "kicked", "--reason", "x", "--store", "s", "--json")
    done = run_command(*words, cwd=tmp_path)
    assert done.json["in_lake"], done.err
    assert _verdicts(run_command, tmp_path) == {"U": ("PASS", "PASS")}
    # a check by hand comes to the lake as well, once no more of them are entered
    check = ("check", "--unit", "U", "--item", "visual", "--verdict", "FAIL", "--by", "Li", "--store", "s")
    assert run_command(*check, cwd=tmp_path).code == 0
    until = time.monotonic() + 20.0
    while _verdicts(run_command, tmp_path)["U"][0] != "FAIL":
        assert time.monotonic() < until, "the check stays in an open segment"
        time.sleep(0.2)


def test_runs_that_begin_within_a_microsecond_are_listed(run_command: Run, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("time[s],rate[deg/s]\n1796000000.123456789,0.01\n1796000001.123456789,0.02\n")
    assert run_command("import", "x.csv", "--unit", "U", "--store", "s", cwd=tmp_path).code == 0
    listed = run_command("runs", "list", "--store", "s", cwd=tmp_path)
    assert (listed.code, "2026-11-30 00:53:20Z" in listed.out) == (0, True), listed.err


def test_a_unit_whose_only_run_is_excluded_leaves_what_is_kept(run_command: Run, tmp_path: Path) -> None:
    """Its serial number is between two others, whose values are kept."""
    _store(run_command, tmp_path, {("U1", "r1"): 2.0, ("U2", "r2"): 40.0, ("U3", "r3"): 3.0})
    assert _verdicts(run_command, tmp_path)["U2"] == ("FAIL", "FAIL")
    assert run_command("runs", "exclude", "r2", "--reason", "x", "--store", "s", cwd=tmp_path).code == 0
    assert _verdicts(run_command, tmp_path) == {"U1": ("PASS", "PASS"), "U3": ("PASS", "PASS")}
    asked = ("sql", "select distinct unit from unit_metrics order by unit", "--store", "s", "--json")
    assert run_command(*asked, cwd=tmp_path).json == [{"unit": "U1"}, {"unit": "U3"}]
    trend = run_command("trend", "bias", "--store", "s", "--json", cwd=tmp_path).json
    assert trend["values"] == 2
