"""An effect that one training run shows, and held-out runs show as well."""

from dataclasses import replace

import pytest

from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from tests.bench.tracing_cases import DECLARED, MODEL, Built, Case, built


@pytest.fixture(scope="module")
def shown_by_one() -> Built:
    """A scale factor that warms up: of the ten training runs one at high rate begins cold."""
    return built(Case("planted", "scale_factor_warm_up", 8.0, 2004))


@pytest.mark.long
def test_held_out_runs_replicate_what_one_training_run_shows(shown_by_one: Built) -> None:
    found = diagnose(shown_by_one.runs, MODEL, declared_noise=DECLARED)
    assert (found.verdict, found.names) == (ModelVerdict.EFFECT_FOUND, ("scale_factor_warm_up",))
    assert found.effects[0].largest_share > 0.95
    assert found.effects[0].confirmed
    assert found.holdout is not None
    assert found.holdout.total.slope > 3.29 * found.holdout.total.slope_se


@pytest.mark.long
def test_without_it_in_the_held_out_runs_it_was_seen_once(shown_by_one: Built) -> None:
    campaign = shown_by_one.campaign
    training = tuple(campaign.training)
    planted = [replace(each, only_runs=training) for each in shown_by_one.planted]
    seed = Case("planted", "scale_factor_warm_up", 8.0, 2004).noise_seed
    found = diagnose(campaign.runs(planted, noise_seed=seed), MODEL, declared_noise=DECLARED)
    assert found.verdict is ModelVerdict.UNREPLICATED
    assert "scale_factor_warm_up" in [each.name for each in found.unreplicated]


@pytest.mark.long
def test_without_held_out_runs_it_was_seen_once(shown_by_one: Built) -> None:
    found = diagnose(shown_by_one.runs[:10], MODEL, declared_noise=DECLARED, holdout=())
    assert found.verdict is ModelVerdict.UNREPLICATED
    assert not found.effects
