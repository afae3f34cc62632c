"""What an effect may be called: how far it has to lead, what it keeps beside it, and what held-out runs accept."""

from typing import Any, cast

import numpy as np
import pytest

from analytics.loop.effects.base import Role
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.held_out.held_out_set import HeldOutSet, _slope
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from analytics.loop.tracing.search.effect_search import Selected, _as_before
from analytics.loop.tracing.search.fitted_candidates import FittedCandidate
from analytics.loop.tracing.verdict.conclusion import _of_open_form
from analytics.loop.tracing.whitening.least_squares import fit_of_clusters
from analytics.loop.tracing.whitening.stack import stacked
from analytics.loop.tracing.whitening.white_variance import record_of
from tests.bench.loop_campaign import Campaign

MODEL = ErrorModel.parse("rate = bias + scale_factor*input_rate + temperature")


def fitted_candidate(name: str, evidence: float, *, at_most: float | None = None) -> FittedCandidate:
    """A fitted candidate of so much evidence; its fit plays no part in its name."""
    return FittedCandidate(
        effect=effect(name),
        parameters={},
        columns=(),
        joint=cast("Any", None),
        likelihood_ratio=evidence,
        degrees=1,
        evidence=evidence,
        at_most=at_most,
    )


@pytest.mark.parametrize(
    ("best", "other", "is_near"),
    [
        (40.0, 28.1, True),  # within 12
        (40.0, 27.9, False),
        (1000.0, 971.0, True),  # within 3 %
        (1000.0, 969.0, False),
    ],
)
def test_an_effect_leads_by_twelve_or_three_per_cent(best: float, other: float, is_near: bool) -> None:
    assert fitted_candidate("humidity", other).is_near(fitted_candidate("gravity_o", best)) is is_near


def test_causes_that_look_alike_have_to_lead_by_a_quarter() -> None:
    rate = fitted_candidate("temperature_rate", 1000.0)
    assert "temperature_gradient" in effect("temperature_rate").aliases
    assert fitted_candidate("temperature_gradient", 751.0).is_near(rate)
    assert not fitted_candidate("temperature_gradient", 749.0).is_near(rate)
    # it holds whichever of the two names the other
    assert fitted_candidate("drift_in_run", 751.0).is_near(fitted_candidate("ageing", 1000.0))
    assert fitted_candidate("ageing", 751.0).is_near(fitted_candidate("drift_in_run", 1000.0))
    # a clock that follows a cause is not another cause
    assert effect("temperature_time_offset").role is Role.ALIAS
    assert not fitted_candidate("temperature_time_offset", 751.0).is_near(rate)


def test_noise_at_its_pace_is_no_argument_against_another_form() -> None:
    best = fitted_candidate("gravity_o", 100.0)
    assert fitted_candidate("humidity", 20.0, at_most=95.0).is_near(best)
    assert not fitted_candidate("humidity", 20.0).is_near(best)


def test_an_effect_chosen_anew_keeps_what_it_was_not_told_from() -> None:
    other = fitted_candidate("temperature_gradient", 95.0)
    old = Selected(fitted_candidate("temperature_rate", 100.0), (other,), ())
    again = Selected(fitted_candidate("temperature_rate", 300.0), (), ())
    kept = _as_before(old, again)
    assert [(each.name, each.evidence) for each in kept.confounded] == [("temperature_gradient", 295.0)]
    # the place may be taken by what was beside it, but by no more than that
    swapped = _as_before(old, Selected(fitted_candidate("temperature_gradient", 300.0), (), ()))
    assert [(each.name, each.evidence) for each in swapped.confounded] == [("temperature_rate", 300.0)]
    new = Selected(fitted_candidate("humidity", 300.0), (), ())
    assert _as_before(old, new) is new


@pytest.mark.parametrize(
    ("slope", "slope_se", "accepted"),
    [
        (0.9, 0.02, True),  # five standard errors off, and it wins 99 % of what it could
        (0.75, 0.02, False),  # it would make a third of the effect again
        (1.5, 0.02, False),
        (1.5, 0.3, True),  # chance may be that large
        (0.4, 0.3, False),  # not seen at all
        (-1.0, 0.02, False),
    ],
)
def test_the_held_out_set_accepts_a_size_by_chance_or_by_what_it_wins(
    slope: float, slope_se: float, accepted: bool
) -> None:
    assert _slope("gravity_o", slope, slope_se, 0.01).accepted is accepted


def test_an_effect_beside_a_refused_function_of_its_channel_is_of_open_form() -> None:
    roles = {"temperature": "cause", "input_rate": "cause"}
    found = FoundEffect("scale_factor_temperature", {}, (), 9.0, 60.0, roles)
    refused = FoundEffect("function_of_temperature", {}, (), 6.0, 20.0, {"temperature": "cause"}, confirmed=False)
    assert _of_open_form(found, [refused]).unknown_function_of == ("temperature",)
    assert _of_open_form(found, []) is found
    elsewhere = FoundEffect("function_of_humidity", {}, (), 6.0, 20.0, {"humidity": "cause"}, confirmed=False)
    assert _of_open_form(found, [elsewhere]) is found
    named = FoundEffect("temperature_squared", {}, (), 6.0, 20.0, {"temperature": "cause"}, confirmed=False)
    assert _of_open_form(found, [named]) is found


def test_clusters_alike_in_size_tell_the_standard_error_of_their_means() -> None:
    rng = np.random.default_rng(5)
    value = rng.standard_normal((8, 50)).cumsum(axis=1)
    found = fit_of_clusters(np.ones((400, 1)), value.ravel(), np.repeat(np.arange(8), 50))
    assert found is not None
    assert found.coefficients[0] == pytest.approx(value.mean())
    assert found.covariance[0, 0] == pytest.approx(value.mean(axis=1).var(ddof=1) / 8)
    assert fit_of_clusters(np.ones((50, 1)), value[0], np.zeros(50, dtype=int)) is None


@pytest.mark.long
@pytest.mark.parametrize("weighted_is_better", [True, False])
def test_before_is_the_better_of_two_fits_with_its_own_uncertainty(weighted_is_better: bool) -> None:
    campaign = Campaign(seed=3)
    stack, _ = stacked(campaign.runs(), MODEL)
    record = record_of(stack, ModelNoise(N=0.005, B=0.01, K=0.006, turn_on=0.05))
    held_out = stack.of_replicates(stack.replicates[10:])
    best = np.linalg.lstsq(record.design[held_out], record.value[held_out])[0]
    declared = np.asarray(best + np.array([0.0 if weighted_is_better else 5.0, 0.0, 0.0]), dtype=np.float64)
    box = HeldOutSet(
        record=record,
        held_out=held_out,
        declared=declared,
        before=record.value - record.design @ declared,
        predictions=np.ones((len(record), 1)),
        covariance=1e-6 * np.eye(3),
        whitened=np.empty((0, 5)),
    )
    alone = box.declared_alone
    plain = fit_of_clusters(record.design[~held_out], record.value[~held_out], stack.replicate[~held_out])
    assert plain is not None
    expected = (declared, box.covariance) if weighted_is_better else plain
    np.testing.assert_array_equal(alone.coefficients, expected[0])
    np.testing.assert_array_equal(alone.covariance, expected[1])
    np.testing.assert_allclose(box.before_alone, record.value - record.design @ alone.coefficients)
