"""The floor: what the documents and samples of runs make of it, and the rows that tell its changes."""

from typing import Any

import pytest

from analytics.floor import SILENT_AFTER_NS, Floor
from analytics.serve.live.floor_rows import STATE_COLUMNS, VERDICTS, FloorRows, runs_of
from stream.events import (
    Check,
    EarlyDecision,
    EstimatePoint,
    EstimatePublished,
    Limit,
    LimitsApplied,
    PowerOn,
    RunEnded,
    RunResumed,
    RunStarted,
    StepEnded,
    StepStarted,
    StepWords,
    UnitMounted,
    UnitReleased,
    Verdict,
    VerdictGiven,
)
from stream.identity import Place

PLACE = Place("plant", "bench-1")
S = 10**9
LIMIT = Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=1.0, unit_of_measure="deg/h")


def floor_of(*documents: Any) -> Floor:
    floor = Floor()
    for at, document in enumerate(documents):
        floor.take(PLACE, document, at * S)
    return floor


def started(run: str = "r1", *units: str) -> RunStarted:
    return RunStarted(run=run, t_ns=0, units=units or ("U1", "U2"), procedure="static_bias", operator="Li")


LIMITED = LimitsApplied(run="r1", t_ns=0, revision="FOG-A", limits=(LIMIT,), planned_s=3600.0)


def decided(outcome: str, unit: str = "U1", forecast_s: float | None = None) -> EarlyDecision:
    return EarlyDecision(
        run="r1", t_ns=S, unit=unit, signal="rate", limit=LIMIT, outcome=outcome, rule="curtailment",
        error_probability=0.0, looked_at_fraction=0.5, reason="so", reason_zh="如此", forecast_s=forecast_s,
    )  # fmt: skip


def estimated(value: float) -> EstimatePublished:
    point = EstimatePoint(tau_s=10.0, value=value, lo=0.9 * value, hi=1.1 * value, edf=20, n=30)
    return EstimatePublished(
        run="r1", t_ns=60 * S, unit="U1", signal="rate", estimator="bias_stability_10s", unit_of_measure="deg/h",
        confidence=0.95, samples=600, missing=0, sample_interval_s=0.1, points=(point,),
    )  # fmt: skip


def state(rows: FloorRows, floor: Floor, unit: str) -> dict[str, Any]:
    document = rows.document(floor)
    number = next(row[0] for row in document["units"] if row[1] == unit)
    found = next(row for row in document["states"] if row[0] == number)
    return dict(zip(STATE_COLUMNS, found, strict=True)) | {"steps": document["steps"]}


def test_units_stand_in_their_slots_with_their_step() -> None:
    words = StepWords(step="rate", rate_command_deg_per_s=10.0)
    floor = floor_of(
        started(),
        UnitMounted(run="r1", t_ns=0, unit="U1", slot="A3", product="FOG-70"),
        step := StepStarted(run="r1", t_ns=0, unit="U1", words=words),
    )
    assert (floor.units["U1"].slot, floor.units["U1"].product) == ("A3", "FOG-70")
    rows = FloorRows()
    found = state(rows, floor, "U1")
    assert found["steps"][found["step"]] == "rate 10 deg/s"
    floor.take(PLACE, StepEnded(run="r1", t_ns=S, unit="U1", step_uid=step.uid), S)
    found = state(rows, floor, "U1")
    assert found["steps"][found["step"]] == ""


def test_a_verdict_is_that_of_the_run_or_of_early_decisions_never_of_an_estimate() -> None:
    floor = floor_of(started(), LIMITED, estimated(5.0))
    unit = floor.units["U1"]
    assert unit.so_far == ""  # an interval looked at in mid-run decides nothing
    assert unit.worst is not None
    assert unit.worst.value == 5.0
    floor.take(PLACE, decided("UNDECIDED"), S)
    assert unit.so_far == ""
    floor.take(PLACE, decided("FAIL"), S)
    assert (unit.so_far, unit.verdict) == ("FAIL", "")
    check = Check(limit=LIMIT, verdict=Verdict.MARGINAL, value=1.0, lo=0.9, hi=1.1)
    floor.take(PLACE, VerdictGiven(run="r1", t_ns=S, unit="U1", verdict=Verdict.MARGINAL, checks=(check,)), S)
    assert unit.so_far == "MARGINAL"


def test_it_passes_early_only_by_all_limits() -> None:
    other = Limit(characteristic="allan_deviation", signal="rate", tau_s=1.0, upper=1.0, unit_of_measure="deg/h")
    both = LimitsApplied(run="r1", t_ns=0, revision="FOG-A", limits=(LIMIT, other))
    floor = floor_of(started(), both, decided("PASS"))
    assert floor.units["U1"].early == ""
    floor.take(PLACE, LIMITED, S)
    assert floor.units["U1"].early == "PASS"


def test_time_left_is_until_the_end_or_the_forecast_of_the_decision() -> None:
    floor, rows = floor_of(started(), LIMITED), FloorRows()
    assert state(rows, floor, "U1")["left_s"] is None  # no sample yet
    floor.sampled(PLACE, "U1", "r1", 600 * S, S)
    assert state(rows, floor, "U1")["left_s"] == 3000
    floor.take(PLACE, decided("UNDECIDED", forecast_s=1600.0), S)
    assert state(rows, floor, "U1")["left_s"] == 1000
    floor.take(PLACE, decided("FAIL"), S)
    assert state(rows, floor, "U1")["left_s"] == 0


def test_a_unit_falls_silent_and_comes_back_once_each() -> None:
    floor = floor_of(started())
    floor.sampled(PLACE, "U1", "r1", S, 100 * S)
    floor.forget_changes()
    floor.listen(100 * S + SILENT_AFTER_NS)
    assert floor.changed == set()
    floor.listen(101 * S + SILENT_AFTER_NS)
    floor.listen(102 * S + SILENT_AFTER_NS)
    assert floor.changed == {"U1"}
    assert state(FloorRows(), floor, "U1")["silent"] == 1
    floor.forget_changes()
    floor.sampled(PLACE, "U1", "r1", 2 * S, 200 * S)
    assert floor.changed == {"U1"}
    assert state(FloorRows(), floor, "U1")["silent"] == 0


def test_an_ended_run_is_not_silent_and_leaves_when_the_next_begins() -> None:
    floor = floor_of(started("r1", "U1", "U2"))
    floor.sampled(PLACE, "U1", "r1", S, S)
    floor.take(PLACE, RunEnded(run="r1", t_ns=S), S)
    floor.listen(10**6 * S)
    assert state(FloorRows(), floor, "U1")["silent"] == 0
    gone = floor.units["U1"].number
    floor.take(PLACE, started("r2", "U2", "U3"), 2 * S)
    assert set(floor.units) == {"U2", "U3"}
    assert gone in floor.gone
    assert set(floor.runs) == {"r2"}


def test_what_comes_late_of_a_run_that_has_left_does_not_bring_it_back() -> None:
    floor = floor_of(started("r1", "U1"), RunEnded(run="r1", t_ns=9), started("r2", "U1"))
    verdict = VerdictGiven(run="r1", t_ns=9, unit="U1", verdict=Verdict.FAIL)
    for late in (estimated(2.0), verdict, RunEnded(run="r1", t_ns=9)):
        floor.take(PLACE, late, 20 * S)
    floor.sampled(PLACE, "U1", "r1", 9, 20 * S)
    assert [row["run"] for row in runs_of(floor)] == ["r2"]
    assert (floor.units["U1"].run.run, floor.units["U1"].verdict) == ("r2", "")
    floor.take(PLACE, RunResumed(run="r1", t_ns=30, gap_ns=9), 30 * S)
    assert {row["run"] for row in runs_of(floor)} == {"r1", "r2"}


def test_instruments_of_the_station_are_no_units_of_the_floor() -> None:
    floor = floor_of(started("r1", "U1"))
    rows = FloorRows()
    for name in ("U1", "chamber"):
        floor.sampled(PLACE, name, "r1", S, S)
    floor.listen(S + 2 * SILENT_AFTER_NS)
    changes, document = rows.changes(floor), rows.document(floor)
    assert changes is not None
    for told in (changes, document):
        assert [row[1] for row in told["units"]] == ["U1"]
        assert len(told["states"]) == 1
        assert [(row["units"], row["silent"]) for row in told["runs"]] == [(1, 1)]
    assert floor.units["chamber"].is_silent  # rules of alerts hear of it


def test_another_station_keeps_its_run() -> None:
    floor = floor_of(started("r1", "U1"))
    floor.take(PLACE, RunEnded(run="r1", t_ns=S), S)
    floor.take(Place("plant", "bench-2"), started("r2", "U9"), 2 * S)
    assert set(floor.runs) == {"r1", "r2"}


def test_changes_make_the_same_floor_as_all_of_it() -> None:
    floor, rows = floor_of(started(), LIMITED), FloorRows()
    first = rows.document(floor)
    units = {row[0]: row for row in first["units"]}
    states = {row[0]: row for row in first["states"]}
    floor.forget_changes()
    steps = dict(enumerate(first["steps"]))
    for document in (
        StepStarted(run="r1", t_ns=0, unit="U2", words=StepWords(step="cold")),
        estimated(0.5),
        decided("PASS"),
        RunEnded(run="r1", t_ns=S),
        started("r2", "U7"),
        VerdictGiven(run="r2", t_ns=S, unit="U7", verdict=Verdict.PASS),
    ):
        floor.take(PLACE, document, S)
        changes = rows.changes(floor)
        floor.forget_changes()
        assert changes is not None
        units |= {row[0]: row for row in changes["units"]}
        states |= {row[0]: row for row in changes["states"]}
        steps |= changes["steps"]
        for number in changes["gone"]:
            del units[number], states[number]
    last = rows.document(floor)
    assert sorted(units.values()) == sorted(last["units"])
    assert sorted(states.values()) == sorted(last["states"])
    assert list(steps.values()) == last["steps"]
    assert rows.changes(floor) is None


def test_a_thousand_changes_a_second_among_ten_thousand_units_are_cheap() -> None:
    import time

    floor, rows = Floor(), FloorRows()
    names = tuple(f"U{i:05d}" for i in range(10_000))
    floor.take(PLACE, started("r1", *names), 0)
    floor.take(PLACE, LIMITED, 0)
    for name in names:
        floor.sampled(PLACE, name, "r1", S, S)
    floor.forget_changes()
    began = time.process_time()
    for name in names[:1000]:
        floor.take(PLACE, decided("UNDECIDED", unit=name, forecast_s=1600.0), 2 * S)
    changes = rows.changes(floor)
    assert time.process_time() - began < 0.25
    assert changes is not None
    assert len(changes["states"]) == 1000


@pytest.mark.parametrize("verdict", list(Verdict))
def test_every_verdict_has_a_code(verdict: Verdict) -> None:
    floor = floor_of(started(), VerdictGiven(run="r1", t_ns=S, unit="U1", verdict=verdict))
    assert VERDICTS[state(FloorRows(), floor, "U1")["verdict"]] == verdict


def test_a_released_unit_has_its_decision_and_is_not_silent() -> None:
    released = UnitReleased(run="r1", t_ns=9 * S, unit="U1", verdict=Verdict.FAIL, planned_s=3600.0, recorded_s=900.0)
    floor = floor_of(started(), LIMITED)
    for unit in ("U1", "U2"):
        floor.sampled(PLACE, unit, "r1", S, S)
    floor.take(PLACE, released, 9 * S)
    floor.take(PLACE, PowerOn(run="r1", t_ns=10 * S, unit="U1", epoch="e"), 10 * S)  # the run was resumed
    floor.listen(60 * S + SILENT_AFTER_NS)
    rows = {row["number"]: row for row in rows_of(floor)}
    one, two = (rows[floor.units[name].number] for name in ("U1", "U2"))
    assert (VERDICTS[one["verdict"]], one["released"], one["silent"], one["left_s"]) == ("FAIL", 1, 0, 0)
    assert (VERDICTS[two["verdict"]], two["released"], two["silent"]) == ("", 0, 1)
    (run,) = FloorRows().document(floor)["runs"]
    assert (run["released"], run["saved_s"], run["verdicts"]) == (1, 2700, {"": 1, "FAIL": 1})


def rows_of(floor: Floor) -> list[dict[str, Any]]:
    return [dict(zip(STATE_COLUMNS, state, strict=True)) for state in FloorRows().document(floor)["states"]]


def test_between_steps_no_temperature_is_commanded() -> None:
    """The chamber moves to that of the next step, whose document comes once it has settled."""
    floor = floor_of(
        started(), StepStarted(run="r1", t_ns=0, unit="U1", words=StepWords(temperature_command_deg_c=-20.0))
    )
    assert floor.units["U1"].run.temperature_command_deg_c == -20.0
    floor.take(PLACE, StepEnded(run="r1", t_ns=S, unit="U1", step_uid="x", outcome="completed"), 3 * S)
    assert floor.units["U1"].run.temperature_command_deg_c is None
