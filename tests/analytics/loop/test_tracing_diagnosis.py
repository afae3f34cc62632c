"""From runs to a verdict: planted effects come back, nothing is invented, and what the data cannot show is named."""

import json
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.fleet import benjamini_hochberg, diagnose_fleet
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from stream.errors import BadInput
from tests.bench.loop_campaign import Campaign, Planted

DECLARED = ModelNoise(N=0.005, B=0.01, K=0.006, turn_on=0.05)
MODEL = ErrorModel.parse("rate = bias + scale_factor*input_rate + temperature")


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return Campaign(seed=11)


def planted(campaign: Campaign, name: str, z: float, **shape: object) -> list[RunBlocks]:
    return campaign.runs([Planted(name, campaign.coefficients_for(name, shape, z), shape)])


def reported(runs: Sequence[RunBlocks], model: ErrorModel = MODEL) -> Diagnosis:
    return diagnose(runs, model, declared_noise=DECLARED)


def test_nothing_is_missing_where_nothing_is(campaign: Campaign) -> None:
    found = reported(campaign.runs())
    assert found.verdict is ModelVerdict.NOTHING_MISSING
    assert not found.effects
    assert found.noise is not None
    assert pytest.approx(0.005, rel=0.05) == found.noise.N
    assert found.error is not None
    assert found.error.is_held_out
    assert [row.averaging_s for row in found.error.rows] == [30.0, 300.0, 1800.0, 3600.0]
    assert all(row.before == row.after for row in found.error.rows)
    assert "gravity_o" in found.detection_limits


@pytest.mark.long
@pytest.mark.parametrize("name", ["gravity_o", "supply_voltage_squared", "scale_factor_cubic"])
def test_a_planted_effect_comes_back(campaign: Campaign, name: str) -> None:
    """Sign and size within 4 standard errors; the held-out runs confirm it and the error falls to the floor."""
    shape = {"supply_voltage_nominal": 12.0} if name == "supply_voltage_squared" else {}
    size = campaign.coefficients_for(name, shape, 14.0)[0]
    found = reported(campaign.runs([Planted(name, [size], shape)]))
    assert name in (*found.names, *(each.name for each in found.confounded))
    assert found.verdict in (ModelVerdict.EFFECT_FOUND, ModelVerdict.CONFOUNDED)
    if found.names == (name,):
        coefficient = found.effects[0].coefficients[0]
        assert abs(coefficient.value - size) < 4 * (coefficient.hi - coefficient.lo) / (2 * 1.96)
    assert found.holdout is not None
    assert found.holdout.accepted
    assert found.holdout.runs == found.runs[10:]
    assert found.error is not None
    assert found.error.achievable_fraction_excited is None or found.error.achievable_fraction_excited > 0.8


@pytest.mark.long
def test_detection_limits_are_where_effects_are_found(campaign: Campaign) -> None:
    """An effect at its limit times 1.5 is found."""
    limit = reported(campaign.runs()).detection_limits["magnetic_o"]
    assert limit.unit_of_measure.startswith("deg/h/")
    found = reported(campaign.runs([Planted("magnetic_o", [1.5 * limit.coefficient])]))
    assert found.names == ("magnetic_o",)


@pytest.mark.long
def test_a_line_is_found_and_confirmed(campaign: Campaign) -> None:
    found = reported(planted(campaign, "periodic_line", 14.0, frequency_hz=1 / 400))
    assert found.names == ("periodic_line",)
    assert found.effects[0].parameters["frequency_hz"] == pytest.approx(1 / 400, abs=1e-5)
    assert found.effects[0].confirmed
    assert found.holdout is not None
    assert abs(found.holdout.total.slope - 1) < 3.3 * np.hypot(
        found.holdout.total.slope_se, found.holdout.total.training_se
    )
    assert any("folded" in each for each in found.limits)
    assert any("no model predicts it" in each for each in found.limits)


def test_no_average_is_told_that_is_longer_than_the_runs() -> None:
    """Runs of half an hour have no averages of an hour."""
    short = Campaign(seed=12, runs=9, duration_s=1800.0, types=("temperature", "static"))
    found = reported(short.runs(channels=("input_rate", "temperature")))
    assert found.error is not None
    assert [row.averaging_s for row in found.error.rows] == [30.0, 300.0, 1800.0]


@pytest.mark.long
def test_a_jump_is_told_but_cannot_be_confirmed(campaign: Campaign) -> None:
    found = reported(planted(campaign, "jump", 14.0, run=campaign.names[3], at_s=9000.0))
    assert found.names == ("jump",)
    assert found.verdict is ModelVerdict.UNREPLICATED
    assert found.effects[0].parameters == {"run": campaign.names[3], "at_s": pytest.approx(9000.0, abs=120.0)}
    assert any("a jump happens once" in each for each in found.limits)


@pytest.mark.long
def test_what_one_run_shows_is_not_an_effect(campaign: Campaign) -> None:
    """A gravity effect at work in a single run: never a finding."""
    size = campaign.coefficients_for("gravity_o", {}, 12.0, only_runs=(3,))
    found = reported(campaign.runs([Planted("gravity_o", size, only_runs=(3,))]))
    assert found.verdict in (ModelVerdict.UNREPLICATED, ModelVerdict.UNKNOWN_FUNCTION, ModelVerdict.UNEXPLAINED)


@pytest.mark.long
def test_a_single_run_never_gives_a_bare_effect(campaign: Campaign) -> None:
    runs = planted(campaign, "gravity_o", 25.0)
    found = reported([runs[3]])
    assert found.replication == "within_run"
    assert found.verdict is not ModelVerdict.EFFECT_FOUND
    assert any("one run only" in each for each in found.limits)
    assert all("#" in name for name in found.runs)


def test_one_ramp_cannot_tell_what_moves_with_it() -> None:
    """Temperature squared in single ramps: the truth is named or in the confounded set."""
    ramps = Campaign(seed=12, types=("temperature",), runs=9)
    runs = planted(ramps, "thermal_lag", 14.0, time_constant=2000.0)
    found = reported(runs)
    names = {*found.names, *(each.name for each in found.confounded)}
    assert "thermal_lag" in names
    assert all(each.separating_test for each in found.confounded)


@pytest.mark.long
def test_a_copied_and_a_constant_channel_are_told(campaign: Campaign) -> None:
    runs = [
        replace(
            run,
            channels={
                **run.channels,
                "copied": replace(run.channels["gravity_o"], mean=3 * run.mean("gravity_o") + 1),
                "still": Channel(np.ones(len(run)), np.zeros(len(run)), "1"),
            },
        )
        for run in planted(campaign, "gravity_o", 14.0)
    ]
    found = reported(runs)
    assert found.verdict is ModelVerdict.CONFOUNDED
    assert {*found.names, *(each.name for each in found.confounded)} >= {"gravity_o", "channel:copied"}
    assert any("still is constant" in each for each in found.limits)
    assert any("copied and gravity_o are copies" in each for each in found.limits)


@pytest.mark.long
def test_stretches_of_nan_are_left_out_or_the_channel_is(campaign: Campaign) -> None:
    def holed(run: RunBlocks, name: str, part: float) -> RunBlocks:
        mean = run.mean(name).copy()
        mean[: int(part * mean.size)] = np.nan
        return replace(run, channels={**run.channels, name: replace(run.channels[name], mean=mean)})

    runs = planted(campaign, "gravity_o", 14.0)
    few = reported([holed(run, "humidity", 0.1) for run in runs])
    assert "gravity_o" in few.names
    assert any("blocks left out: a channel has no value" in each for each in few.limits)
    many = reported([holed(run, "humidity", 0.6) for run in runs])
    assert "gravity_o" in many.names
    assert "humidity" in many.detection_limits  # by the blocks in which it is there
    assert "humidity" not in many.not_tested
    assert [each.what for each in many.left_out] == ["the blocks of channel humidity"]


def test_too_little_data_is_a_result(campaign: Campaign) -> None:
    run = campaign.runs()[0]
    short = replace(
        run,
        slot=run.slot[:12],
        value=run.value[:12],
        n=run.n[:12],
        white_variance=run.white_variance[:12],
        channels={
            name: Channel(each.mean[:12], each.spread[:12], each.unit_of_measure) for name, each in run.channels.items()
        },
    )
    found = reported([short])
    assert found.verdict is ModelVerdict.NOT_ENOUGH_DATA
    assert "12 blocks" in found.missing[0]


def test_runs_must_belong_together(campaign: Campaign) -> None:
    runs = campaign.runs()
    with pytest.raises(BadInput, match="several values of unit"):
        reported([runs[0], replace(runs[1], unit="other")])
    with pytest.raises(BadInput, match="run to hold out is not there: nine"):
        diagnose(runs, MODEL, holdout=["nine"])


@pytest.mark.long
def test_two_runs_have_no_held_out_set(campaign: Campaign) -> None:
    found = reported(campaign.runs()[:2])
    assert found.holdout is None
    assert any("no held-out set" in each for each in found.limits)


@pytest.mark.long
def test_noise_that_is_not_declared_is_guessed(campaign: Campaign) -> None:
    found = diagnose(planted(campaign, "gravity_o", 14.0), MODEL)
    assert "gravity_o" in found.names
    assert found.noise is not None
    assert pytest.approx(0.005, rel=0.1) == found.noise.N
    assert any("no noise was declared" in each for each in found.limits)


@pytest.mark.long
def test_json_has_the_agreed_form(campaign: Campaign) -> None:
    document = json.loads(msgspec.json.encode(reported(planted(campaign, "gravity_o", 14.0)).document()))
    assert {"verdict", "effects", "confounded", "holdout", "error", "noise", "detection_limits", "model"} <= set(
        document
    )
    (effect,) = document["effects"]
    wanted = {"name", "parameters", "coefficient", "unit_of_measure", "lo", "hi", "significance", "roles"}
    assert wanted <= set(effect)
    assert effect["lo"] < effect["coefficient"] < effect["hi"]
    assert effect["roles"] == {"gravity_o": "cause"}
    assert {"runs", "slope", "slope_se", "accepted"} <= set(document["holdout"])
    assert {"before", "after", "floor", "achievable_fraction"} <= set(document["error"])
    assert set(document["error"]["before"]) == {"rms_30s", "rms_300s", "rms_1800s", "rms_3600s"}
    assert {"N", "B", "K", "turn_on"} <= set(document["noise"])
    assert "gravity_o" in document["model"]["text"]


@pytest.mark.long
def test_the_model_found_predicts_the_held_out_runs(campaign: Campaign) -> None:
    runs = planted(campaign, "gravity_o", 20.0)
    found = reported(runs)
    assert found.model is not None
    assert found.declared is not None
    position_run = runs[13]
    before = np.std(found.declared.residual(position_run))
    assert np.std(found.model.residual(position_run)) < before


@pytest.mark.long
def test_a_fleet_finds_what_one_unit_cannot(campaign: Campaign) -> None:
    """Six units with an effect of z = 3.5 each."""
    units = {}
    for number in range(6):
        of_unit = Campaign(seed=60 + number, unit=f"FOG-{number}", runs=10)
        size = of_unit.coefficients_for("magnetic_i", {}, 3.5)
        units[of_unit.unit] = of_unit.runs([Planted("magnetic_i", size)])
    found = diagnose_fleet(units, MODEL, declared_noise=dict.fromkeys(units, DECLARED))
    assert "magnetic_i" in [each.name for each in found.effects]
    assert len(found.by_unit["magnetic_i"]) == 6
    over = found.over_units["magnetic_i"]
    (pooled,) = next(each for each in found.effects if each.name == "magnetic_i").coefficients
    assert over.lo < pooled.value < over.hi
    assert over.spread_lo <= over.spread <= over.spread_hi
    assert msgspec.json.decode(msgspec.json.encode(found.document()))["verdict"] == found.verdict.value


@pytest.mark.long
def test_what_one_unit_has_alone_is_not_common_to_all() -> None:
    """A jump is of one run of one unit; a line is reported with its amplitude in each."""
    units = {}
    for number in range(3):
        of_unit = Campaign(seed=80 + number, unit=f"FOG-{number}", runs=10)
        event = {"run": of_unit.names[1], "at_s": 9000.0}
        line = {"frequency_hz": 1 / 400}
        plants = {
            1: [Planted("jump", of_unit.coefficients_for("jump", event, 14.0), event)],
            2: [Planted("periodic_line", of_unit.coefficients_for("periodic_line", line, 20.0), line)],
        }
        units[of_unit.unit] = of_unit.runs(plants.get(number, []))
    found = diagnose_fleet(units, MODEL, declared_noise=dict.fromkeys(units, DECLARED))
    assert [each.name for each in found.effects] == ["periodic_line"]
    assert [(each.name, each.confirmed) for each in found.unreplicated] == [("jump", None)]
    own = {each.unit: each for each in found.by_unit["periodic_line"]}
    (amplitude,) = found.units["FOG-2"].effects[0].coefficients
    assert own["FOG-2"].coefficient == pytest.approx(amplitude.value, rel=0.05)
    assert own["FOG-0"].coefficient < 0.2 * amplitude.value
    (pooled,) = found.effects[0].coefficients
    assert pooled.value == pytest.approx(amplitude.value / 3**0.5, rel=0.1)


def test_false_discoveries_are_bounded() -> None:
    assert benjamini_hochberg({}) == []
    assert benjamini_hochberg({"a": 0.2, "b": 0.04}) == []
    assert benjamini_hochberg({"a": 0.02, "b": 0.04}) == ["a", "b"]
