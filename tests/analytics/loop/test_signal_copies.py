"""A channel that copies the signal is distinguished from a cause, and left out."""

from dataclasses import replace

import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.channel_coherence import copies_of_signal
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.residuals import residuals_of
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.unit_diagnosis import trace_units
from analytics.loop.unit_reduction import Question, ReducedUnit, ReducedUnits
from tests.bench.loop_campaign import Campaign, Planted
from tests.bench.tracing_cases import DECLARED, MODEL


def leaking(run: RunBlocks) -> RunBlocks:
    leak = Channel(0.3 * run.value + 5.0, 0.0 * run.value, "V")
    return replace(run, channels={**run.channels, "monitor": leak})


def test_a_copy_is_left_out_with_a_caveat_and_the_effect_behind_it_is_found() -> None:
    campaign = Campaign(5, runs=6, types=("temperature",), duration_s=14400.0)
    model = ErrorModel.parse("bias + scale_factor*input_rate + temperature")
    planted = Planted("temperature_squared", campaign.coefficients_for("temperature_squared", {}, 20.0))
    runs = tuple(leaking(run) for run in campaign.runs([planted]))
    assert diagnose(runs, model, declared_noise=DECLARED).names == ("channel:monitor",)
    data = ReducedUnit(runs, (), DECLARED, "", turn_on_is_declared=True)
    read = ReducedUnits({"FOG-0231": data}, {"FOG-0231": model}, {})
    whole = trace_units(read, Question(str(model), signal="rate")).units["FOG-0231"].diagnosis
    assert "channel:monitor" not in whole.names
    assert "temperature_squared" in {*whole.names, *(other.name for each in whole.effects for other in each.confounded)}
    (caveat,) = [each for each in whole.limits if "copy" in each]
    assert "monitor" in caveat
    assert "it is left out" in caveat
    assert "monitor" in caveat.zh


@pytest.mark.long
@pytest.mark.parametrize("z", [20.0, 100.0])
def test_a_cause_is_no_copy(z: float) -> None:
    campaign = Campaign(5, runs=4, types=("environment",), duration_s=7200.0)
    runs = campaign.runs([Planted("vibration", campaign.coefficients_for("vibration", {}, z))])
    residuals = residuals_of(runs, diagnose(runs, MODEL, declared_noise=DECLARED))
    assert residuals is not None
    assert copies_of_signal(residuals, sorted(residuals.channels)) == ()
