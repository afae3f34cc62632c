"""What the next test is asked for: twins, look-alikes that stood still, curves, unexplained noise, and no plan."""

from dataclasses import replace

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.next_test.candidates import candidate_tests
from analytics.loop.next_test.open_question import held_still
from analytics.loop.next_test.plans import timed_tests
from analytics.loop.next_test.recommendation import comparable, fleet_next_test, next_test
from analytics.loop.next_test.separation import inseparable
from analytics.loop.next_test.station_bounds import StationBounds
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.fleet import diagnose_fleet
from tests.bench.loop_campaign import Campaign, Noise
from tests.bench.next_test import DESIGNS, tried
from tests.bench.tracing_cases import DECLARED, MODEL, planted_in

BIAS = ErrorModel.parse("bias + temperature")


def of(kind: str, runs: int = 4) -> list[RunBlocks]:
    return Campaign(4000, types=(kind,), runs=runs, duration_s=7200.0).runs()


def test_alike_so_far_is_not_alike_in_every_test() -> None:
    """Three positions give gravity and its square one column; the opposite positions do not."""
    names, runs = ("gravity_i", "gravity_i_squared"), of("three_positions")
    assert inseparable(names, runs) == {names[0]: (names[1],)}
    bounds = StationBounds.of_runs(runs)
    timed = timed_tests(candidate_tests(["gravity_i"], bounds, runs), runs, bounds)
    assert inseparable(names, [*runs, *(run for each in timed for run in each.runs)]) == {names[0]: (), names[1]: ()}


def test_a_look_alike_whose_channel_stood_still_is_a_rival() -> None:
    """With the input axis horizontal throughout, a heading error is a harmonic of the table angle."""
    assert "heading" in held_still(("table_angle_harmonic_1",), of("two_headings"))
    assert held_still(("humidity",), of("static")) == ()


def test_each_power_on_of_a_test_is_a_run_of_its_own() -> None:
    runs = of("power_on")
    bounds = StationBounds.of_runs(runs, None, least_deg_c=-10.0, most_deg_c=60.0)
    cycles = [each for each in candidate_tests(["time_since_power_on"], bounds, runs) if "2_temperatures" in each.name]
    (first, *_) = timed_tests(cycles, runs, bounds)
    assert len(first.runs) == 2
    # the first block is whole
    assert [float(run.mean("time_since_power_on")[0]) for run in first.runs] == pytest.approx([15.0, 15.0], abs=30.0)
    assert np.ptp(np.concatenate([run.mean("chamber_setpoint") for run in first.runs])) == 70.0


def test_runs_are_planned_with_that_have_the_channels_of_all_effects_found() -> None:
    """An effect of a channel that only some runs have stays in their error: the others are planned with."""
    with_rate, *others = of("ramp", 4)
    runs = [with_rate, *(replace(run, channels={"temperature": run.channels["temperature"]}) for run in others)]
    kept, beside = comparable(runs, ("temperature_rate",), {"scale_factor": {}, "temperature_squared": {}})
    assert [run.run for run in kept] == [run.run for run in others]
    assert list(beside) == ["temperature_squared"]
    kept, beside = comparable(runs, ("scale_factor_cubic",), {"scale_factor": {}})
    assert ([run.run for run in kept], list(beside)) == ([with_rate.run], ["scale_factor"])


@pytest.mark.long
def test_unexplained_noise_is_looked_for_at_rest() -> None:
    runs = Campaign(1, runs=5, types=("static",), duration_s=7200.0, noise=Noise(b=0.03)).runs()
    found = diagnose(runs, BIAS, declared_noise=DECLARED)
    assert found.verdict == "unexplained"
    asked = next_test(found, runs, BIAS, declared_noise=DECLARED)
    assert asked is not None
    assert asked.question == "excess"
    assert asked.plans[0].is_enough
    hours = asked.plans[0].test.repeats * float(asked.plans[0].test.steps[0]["record_s"]) / 3600.0
    new = Campaign(101, runs=1, types=("static",), duration_s=hours * 3600.0, noise=Noise(b=0.03)).runs()
    assert diagnose(new, BIAS, declared_noise=DECLARED, holdout=()).verdict == "unexplained"


def test_too_little_data_says_what_to_record() -> None:
    runs = [run.part(slice(0, 5)) for run in of("static", 3)]
    asked = next_test(diagnose(runs, BIAS, declared_noise=DECLARED), runs, BIAS, declared_noise=DECLARED)
    assert asked is not None
    assert (asked.question, asked.plans) == ("none", ())
    assert asked.why_not is not None
    assert "blocks" in asked.why_not
    assert asked.why_not.zh


@pytest.mark.long
def test_a_fleet_is_given_one_test_for_all_units() -> None:
    units, design = {}, DESIGNS["positions"]
    for number in range(2):
        unit = f"FOG-{number}"
        campaign = Campaign(4000 + number, types=design.types, runs=4, duration_s=7200.0, unit=unit)
        planted = planted_in(campaign, "gravity_i", 14.0, np.random.default_rng(3))
        units[unit] = campaign.runs([planted])
    fleet = diagnose_fleet(units, MODEL, declared_noise=dict.fromkeys(units, DECLARED))
    asked = fleet_next_test(fleet, units, MODEL, declared_noise=dict.fromkeys(units, DECLARED))
    assert asked is not None
    assert asked.units == tuple(units)
    assert set(asked.rivals) == {"gravity_i", "gravity_i_squared"}
    assert asked.plans[0].is_enough


@pytest.mark.long
@pytest.mark.parametrize(
    ("design", "name"), [("positions", "gravity_i"), ("one_way", "scale_factor_quadratic"), ("heading", "heading")]
)
def test_the_recommended_test_closes_cases_of_other_families(design: str, name: str) -> None:
    line = tried(design, name, 0)
    assert name in line["rivals"]
    assert line["decided"], line
