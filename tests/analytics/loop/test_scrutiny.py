"""Collinearity, leverage, coherence, recovery and provenance of a diagnosis."""

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from scipy import stats

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.channel_coherence import channel_coherence
from analytics.loop.provenance import provenance
from analytics.loop.recovery import recovered
from analytics.loop.regressor_diagnostics import regressor_diagnostics
from analytics.loop.residuals import Residuals, residuals_of
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from tests.bench.loop_campaign import Campaign, Planted
from tests.bench.tracing_cases import DECLARED, MODEL


@cache
def traced(size: float = 10.0, *, known: bool = True) -> tuple[list[RunBlocks], Diagnosis, Residuals]:
    """Nine runs with vibration at work, which three of them excite; `known` with the library."""
    campaign = Campaign(3, runs=9, types=("temperature", "static", "environment"), duration_s=7200.0)
    planted = Planted("vibration", campaign.coefficients_for("vibration", {}, size))
    runs = campaign.runs([planted])
    found = diagnose(runs, MODEL, declared_noise=DECLARED, effects=None if known else {})
    residuals = residuals_of(runs, found)
    assert residuals is not None
    return runs, found, residuals


def test_regressors_are_as_ordinary_regression_has_them() -> None:
    _, found, residuals = traced()
    assert found.model is not None
    diagnostics = regressor_diagnostics(residuals, found.model)
    assert diagnostics is not None
    assert [each.name for each in diagnostics.regressors] == list(found.model.labels())
    whitened = residuals.record.whitener(residuals.noise)(residuals.record.stack.column(found.model.columns))
    whitened = whitened[~residuals.held_out]
    inverse = np.linalg.inv(whitened.T @ whitened)
    for at, each in enumerate(diagnostics.regressors):
        # variance of the coefficient over that with this column alone
        assert each.vif == pytest.approx(inverse[at, at] * float(whitened[:, at] @ whitened[:, at]), rel=1e-6)
        assert sum(each.leverage.values()) == pytest.approx(1.0)
    of_vibration = diagnostics.regressors[-1].leverage
    excited = [run for run, share in of_vibration.items() if share > 0.1]
    assert excited
    assert all("environment" in run for run in excited)
    scaled = whitened / np.linalg.norm(whitened, axis=0)
    assert diagnostics.condition == pytest.approx(float(np.linalg.cond(scaled)), rel=1e-6)


def test_the_channel_at_work_is_coherent_with_the_residual_until_it_is_in_the_model() -> None:
    first = channel_coherence(traced(known=False)[2])[0]
    assert (first.channel, first.lag_s) == ("vibration", 0.0)
    assert first.p_value < 1e-4
    left = {each.channel: each for each in channel_coherence(traced()[2])}
    assert left["vibration"].p_value > 0.01


@pytest.mark.long
@pytest.mark.parametrize("campaigns", [15, pytest.param(60, marks=pytest.mark.long)])
def test_coherence_by_chance_is_as_likely_as_stated(campaigns: int) -> None:
    """P-values of noise alone: the smallest of a campaign is not below 0.1 too often (binomial, 99.9 %)."""
    campaign = Campaign(4, runs=4, types=("environment",), duration_s=7200.0)
    stack = case_of(campaign.runs(), MODEL, DECLARED, ()).stack
    assert len(stack.runs) == 4
    least: list[float] = []
    for seed in range(campaigns):
        runs = campaign.runs(noise_seed=seed)
        found = diagnose(runs, MODEL, declared_noise=DECLARED, effects={}) if not least else None
        base = traced_residuals(runs) if found is None else residuals_of(runs, found)
        assert base is not None
        least.append(channel_coherence(base)[0].p_value)
    assert np.count_nonzero(np.array(least) < 0.1) <= stats.binom.ppf(0.999, campaigns, 0.1)


def traced_residuals(runs: list[RunBlocks]) -> Residuals:
    case = case_of(runs, MODEL, DECLARED, ())
    record = case.training
    fit = np.linalg.lstsq(record.whitener(DECLARED)(record.design), record.whitener(DECLARED)(record.value[:, None]))[0]
    after = record.value - record.design @ fit[:, 0]
    return Residuals(record, DECLARED, after, after, np.zeros(len(record), dtype=bool))


def test_noise_of_the_model_is_what_the_whitening_inverts() -> None:
    _, _, residuals = traced()
    whitener = residuals.record.whitener(residuals.noise)
    white = np.random.default_rng(1).standard_normal((len(residuals.record), 3))
    assert np.allclose(whitener(whitener.colour(white)), white, atol=1e-9)


@pytest.mark.long
def test_what_was_found_is_found_again_when_it_is_planted() -> None:
    _, found, residuals = traced()
    again = recovered(found, residuals, MODEL, 3, declared_noise=DECLARED)
    assert list(again) == list(found.names)
    assert again["vibration"].share == 1.0
    assert again["vibration"].lo == pytest.approx(stats.beta.ppf(0.025, 3, 1), rel=1e-6)


def test_a_false_alarm_is_as_likely_as_the_search_has_tests() -> None:
    _, found, _ = traced()
    each = found.false_alarm(msgspec.structs.replace(found.effects[0], significance=3.0))
    p_value = 2 * stats.norm.sf(3.0)
    assert found.tests > 5
    assert each == pytest.approx(1 - (1 - p_value) ** found.tests, rel=1e-9)


def test_provenance_changes_with_the_data_alone() -> None:
    runs, _, _ = traced()
    first = provenance(runs)
    assert provenance(runs).sha256 == first.sha256
    changed = [replace(runs[0], value=np.nextafter(runs[0].value, np.inf)), *runs[1:]]
    other = provenance(changed).sha256
    assert [run for run in first.sha256 if first.sha256[run] != other[run]] == [runs[0].run]
