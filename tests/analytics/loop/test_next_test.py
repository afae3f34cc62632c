"""The next test: what a station can run, what it would record, and how surely it decides."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effect
from analytics.loop.next_test.candidate import CandidateTest
from analytics.loop.next_test.candidates import candidate_tests
from analytics.loop.next_test.plans import TestPlan
from analytics.loop.next_test.predicted_run import ThermalChain, predicted_runs
from analytics.loop.next_test.recommendation import next_test
from analytics.loop.next_test.separation import DRAWS, FittedRecord, Rival, RivalFit, inseparable
from analytics.loop.next_test.station_bounds import THERMAL, StationBounds
from analytics.loop.next_test.timeline import STEP_S, timeline
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.diagnosis import diagnose
from ingest.procedures.procedure import load_procedure
from tests.bench.loop_campaign import Campaign, DenseWhitener, Planted
from tests.bench.next_test import planned_runs, tried
from tests.bench.tracing_cases import DECLARED, MODEL, planted_in

BOUNDS = StationBounds(
    least_deg_c=-20.0, most_deg_c=55.0, rate_deg_per_s=50.0, least_angle_deg=0.0, most_angle_deg=360.0, least_v=10.0,
    most_v=13.0,
)  # fmt: skip
EVERYTHING = ("temperature", "input_rate", "table_angle", "gravity_o", "supply_voltage", "time_since_power_on")


@cache
def campaign() -> Campaign:
    return Campaign(3, runs=6, types=("temperature", "static", "environment"), duration_s=7200.0)


@cache
def runs() -> list[RunBlocks]:
    return campaign().runs()


def plans_for(*channels: str) -> list[CandidateTest]:
    return [each for each in candidate_tests(channels or EVERYTHING, BOUNDS, runs()) if not each.like]


def planned(test: CandidateTest) -> RunBlocks:
    (run,) = predicted_runs(timeline(test, BOUNDS), runs(), ThermalChain.of_runs(runs()), "next", {})
    return run


@pytest.mark.long
@pytest.mark.parametrize("test", plans_for(), ids=lambda test: test.name)
def test_every_plan_is_a_procedure_that_a_station_runs(test: CandidateTest, tmp_path: Path) -> None:
    path = tmp_path / "next.toml"
    path.write_bytes(msgspec.toml.encode(test.document))
    procedure = load_procedure(path)
    assert procedure.steps() == test.planned()
    assert procedure.names.zh
    played = timeline(test, BOUNDS)
    known = np.isfinite(played.setpoint_deg_c)
    assert np.all((played.setpoint_deg_c[known] >= -20.0) & (played.setpoint_deg_c[known] <= 55.0))
    assert np.abs(np.diff(played.air_deg_c[known])).max(initial=0.0) <= 2.0 / 60.0 * STEP_S + 1e-9
    assert np.abs(played.rate_deg_per_s).max() <= 50.0


def test_plans_move_only_what_rivals_depend_on() -> None:
    assert {each.name.partition("_")[0] for each in plans_for("temperature")} == {"temperature", "rest"}
    assert {each.name.partition("_")[0] for each in plans_for("input_rate")} == {"rate", "rates", "rest"}
    assert {each.name.partition("_")[0] for each in plans_for("gravity_s")} == {"tumble", "rest"}
    assert {each.name.partition("_")[0] for each in plans_for("table_angle")} == {"headings", "rest"}
    assert {each.name.partition("_")[0] for each in plans_for("humidity")} == {"rest"}
    repeated = [each.like for each in candidate_tests(["humidity"], BOUNDS, runs()) if each.like]
    assert repeated == [run.run for run in runs()]


def test_a_station_may_do_what_the_unit_has_been_through_unless_told_otherwise() -> None:
    own = StationBounds.of_runs(runs(), most_deg_c=30.0)
    assert own.most_deg_c == 30.0
    assert own.least_deg_c is not None
    setpoints = np.concatenate([run.mean("chamber_setpoint") for run in runs()])
    assert own.least_deg_c == pytest.approx(setpoints.min(), abs=0.6)
    assert own.rate_deg_per_s is None
    assert own.least_v is not None
    assert 10.0 <= own.least_v < 11.0


def test_a_temperature_in_counts_bounds_no_chamber() -> None:
    counted = [
        replace(
            run,
            channels={
                **run.channels,
                **{name: replace(run.channels[name], unit_of_measure="count") for name in THERMAL},
            },
        )
        for run in runs()
    ]
    assert StationBounds.of_runs(counted).least_deg_c is None
    assert StationBounds.of_runs(counted).least_v is not None


def test_lags_between_temperatures_come_from_the_units_own_runs() -> None:
    chain = ThermalChain.of_runs(runs())
    # as `loop_drives` simulates them, on a grid of 17 %
    assert chain.lag_s["case_temperature"] == pytest.approx(900.0, rel=0.2)
    assert chain.lag_s["temperature"] == pytest.approx(1100.0, rel=0.35)


def test_the_predicted_temperature_is_that_of_the_physics() -> None:
    (test,) = [each for each in plans_for("temperature") if each.name == "temperature_triangle_20_deg_c_1_per_min_4_h"]
    predicted = planned(test)
    plan = TestPlan(test=test, hours=4.0, power=1.0, separation=0.0, by_truth={})
    (done,) = planned_runs(campaign(), plan, Planted("temperature_squared", [0.0]), BOUNDS, 1)
    both = np.intersect1d(predicted.slot, done.slot)[200:]  # the run may begin at another temperature
    ahead = predicted.mean("temperature")[np.isin(predicted.slot, both)]
    real = done.mean("temperature")[np.isin(done.slot, both)]
    assert np.corrcoef(ahead, real)[0, 1] > 0.97
    assert np.ptp(ahead[-160:]) == pytest.approx(np.ptp(real[-160:]), rel=0.2)


def rival_fit(*names: str) -> RivalFit:
    case = case_of(runs(), MODEL, DECLARED, ())
    rivals = [Rival(effect(name), ({},)) for name in names]
    return RivalFit([FittedRecord(case.training.stack, DECLARED, np.ones(len(case.training)))], MODEL, rivals)


def test_the_power_is_that_of_simulated_tests() -> None:
    """Data of the test drawn with the dense covariance of the noise, fitted by ordinary linear algebra."""
    names = ("supply_voltage_squared", "vibration")
    fit = rival_fit(*names)
    (test,) = [each for each in plans_for("supply_voltage") if each.name == "supply_steps_5_min"]
    run = planned(test)
    white = fit.whitened([run])
    assert white is not None
    found = fit.separation(white, 1)
    every = [*runs(), run]
    whiten = DenseWhitener([each.slot for each in every], 30.0, campaign().noise)
    known = np.concatenate([MODEL.columns(each) for each in every])
    columns = [np.concatenate([effect(name).regressors(each, {}) for each in every]) for name in names]
    white = whiten(np.column_stack([np.concatenate([each.value for each in every]), known, *columns]))
    white[:, 1:] /= np.linalg.norm(white[:, 1:], axis=0)
    old = sum(map(len, runs()))
    rng = np.random.default_rng(5)
    for number, name in enumerate(names):
        own = white[:, [1, 2, 3, 4 + number]]
        inverse = np.linalg.inv(own[:old].T @ own[:old])
        mean = inverse @ own[:old].T @ white[:old, 0]
        wins = 0
        for _ in range(200):
            theta = rng.multivariate_normal(mean, inverse)
            value = np.concatenate([white[:old, 0], own[old:] @ theta + rng.standard_normal(len(run))])
            left = [_left(value, white[:, [1, 2, 3, 4 + k]]) for k in range(2)]
            without = _left(value, white[:, [1, 2, 3]])
            evidence = without - np.array(left) - 9.0
            lead = max(12.0, 0.03 * evidence[number])
            wins += bool(evidence[number] > 0 and evidence[number] - evidence[1 - number] >= lead)
        spread = np.sqrt(0.25 / 200 + 0.25 / DRAWS)
        assert found.by_truth[name] == pytest.approx(wins / 200, abs=4.0 * spread + 0.02)


def _left(value: np.ndarray, columns: np.ndarray) -> float:
    solution = np.linalg.lstsq(columns, value, rcond=None)[0]
    return float(np.sum((value - columns @ solution) ** 2))


def test_what_has_the_same_columns_is_never_separated() -> None:
    fit = rival_fit("temperature_rate", "temperature_time_offset")
    for test in plans_for("temperature")[:3]:
        run = planned(test)
        white = fit.whitened([run])
        assert white is not None
        assert fit.separation(white, 1).power == 0.0


def test_a_clock_and_a_slope_are_inseparable() -> None:
    names = ("temperature_rate", "temperature_time_offset", "temperature_gradient")
    assert inseparable(names, runs()) == {names[0]: (names[1],), names[2]: ()}


@pytest.mark.long
def test_causes_that_look_alike_have_no_test_but_say_so() -> None:
    ramps = Campaign(4000, types=("ramp",), runs=9)
    planted = planted_in(ramps, "temperature_rate", 14.0, np.random.default_rng((0, 3)))
    some = ramps.runs([planted], noise_seed=7000)
    asked = next_test(diagnose(some, MODEL, declared_noise=DECLARED), some, MODEL, declared_noise=DECLARED)
    assert asked is not None
    assert {"temperature_rate", "temperature_gradient"} <= set(asked.rivals)
    assert (asked.plans, asked.why_not is not None) == ((), True)


def test_nothing_is_planned_where_nothing_is_open() -> None:
    found = diagnose(runs(), MODEL, declared_noise=DECLARED)
    assert found.verdict == "nothing_missing"
    assert next_test(found, runs(), MODEL, declared_noise=DECLARED) is None


@pytest.mark.long
def test_the_power_of_a_repetition_is_that_of_the_held_out_answer() -> None:
    """An effect of one training run: planned is what confirms it in a held-out run."""
    size = campaign().coefficients_for("vibration", {}, 12.0, only_runs=(2,))
    some = campaign().runs([Planted("vibration", size, only_runs=(2,))])
    found = diagnose(some, MODEL, declared_noise=DECLARED)
    asked = next_test(found, some, MODEL, declared_noise=DECLARED, bounds=BOUNDS)
    assert asked is not None
    assert asked.question == "again"
    assert asked.plans
    assert all(0.0 <= each.power <= 1.0 for each in asked.plans)
    assert asked.document()["plans"][0]["hours"] > 0.0


@pytest.mark.long
@pytest.mark.parametrize("name", ["thermal_hysteresis", "thermal_lag"])
def test_the_recommended_test_closes_the_case(name: str) -> None:
    line = tried("ramp", name, 0)
    assert name in line["rivals"]
    assert line["decided"], line
