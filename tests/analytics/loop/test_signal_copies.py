"""A channel that is a copy of the signal is told from a cause."""

from dataclasses import replace

import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.channel_coherence import copies_of_signal
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.residuals import residuals_of
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.unit_diagnosis import UnitDiagnosis, with_copies_named
from analytics.loop.unit_reduction import ReducedUnit
from tests.bench.loop_campaign import Campaign, Planted
from tests.bench.tracing_cases import DECLARED, MODEL


def leaking(run: RunBlocks) -> RunBlocks:
    leak = Channel(0.3 * run.value + 5.0, 0.0 * run.value, "V")
    return replace(run, channels={**run.channels, "monitor": leak})


def test_a_copy_is_named_with_a_caveat() -> None:
    runs = [leaking(run) for run in Campaign(5, runs=4, types=("temperature",), duration_s=7200.0).runs()]
    model = ErrorModel.parse("bias + temperature")
    found = diagnose(runs, model, declared_noise=DECLARED)
    assert found.names == ("channel:monitor",)
    whole = with_copies_named(UnitDiagnosis(ReducedUnit(tuple(runs), (), DECLARED, ""), found))
    (caveat,) = [each for each in whole.diagnosis.limits if "copy" in each]
    assert "monitor" in caveat
    assert "monitor" in caveat.zh


@pytest.mark.parametrize("z", [20.0, 100.0])
def test_a_cause_is_no_copy(z: float) -> None:
    campaign = Campaign(5, runs=4, types=("environment",), duration_s=7200.0)
    runs = campaign.runs([Planted("vibration", campaign.coefficients_for("vibration", {}, z))])
    residuals = residuals_of(runs, diagnose(runs, MODEL, declared_noise=DECLARED))
    assert residuals is not None
    assert copies_of_signal(residuals, sorted(residuals.channels)) == ()
