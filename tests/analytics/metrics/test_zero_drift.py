"""The fitted zero of a test through which the zero drifts: its limits hold the truth, and are no wider than need be."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from analytics.methods.zero_drift import Sequence, zero_uncertainty
from storage.store import Store
from tests.bench.metric_coverage import CHECKS, covered
from tests.bench.metric_steps import flicker_noise

RATES = np.array([way * rate for rate in np.geomspace(1, 100, 11) for way in (1.0, -1.0)])
NOISE = 0.26  # of the mean of a step, deg/h
FREEDOM = 40.0


def sequence(rng: np.random.Generator, drift: np.ndarray, nonlinearity: float = 0.0) -> Sequence:
    """A rest, 22 rates and a rest; the zero is 0 but for the drift."""
    rate = np.r_[0.0, RATES, 0.0]
    output = 3600 * rate + nonlinearity * (rate / 100) ** 3 + drift + rng.normal(0, NOISE, rate.size)
    u = NOISE * np.sqrt(rng.chisquare(FREEDOM, rate.size) / FREEDOM)
    turning = rate != 0
    weights = np.zeros(rate.size)
    design = np.column_stack([np.ones(RATES.size), RATES])
    weights[turning] = np.linalg.solve(design.T @ design, design.T)[0]
    return Sequence(output, rate, u, np.full(rate.size, FREEDOM), weights)


def share_held(rng: np.random.Generator, bias_instability: float, trials: int) -> tuple[float, float]:
    """How often the interval holds the zero, and its median half width."""
    held, halves = 0, []
    for _ in range(trials):
        wander = flicker_noise(24 * 12, bias_instability, rng) if bias_instability else np.zeros(24 * 12)
        steps = sequence(rng, wander.reshape(24, 12)[:, :6].mean(axis=1))
        found = zero_uncertainty(steps)
        assert found is not None
        half = stats.t.isf(0.025, found.freedom) * found.value
        held += abs(float(steps.weights @ steps.output)) <= half
        halves.append(half)
    return held / trials, float(np.median(halves))


@pytest.mark.long
@pytest.mark.parametrize("bias_instability", [0.0, 0.1, 0.5, 2.0])
def test_the_zero_is_held_whatever_it_drifts(bias_instability: float) -> None:
    trials = 200
    share, half = share_held(np.random.default_rng(21), bias_instability, trials)
    assert share * trials >= stats.binom.ppf(0.001 / 4, trials, 0.93)
    if not bias_instability:  # what a drift that cannot be seen costs
        assert half < 1.6 * 1.96 * NOISE / math.sqrt(22)


@pytest.mark.long
def test_records_of_the_bench_that_drift(tmp_path: Path) -> None:
    checks = [each for each in CHECKS if each.metric == "fitted_zero"]
    found = list(covered(Store.create(tmp_path / "store"), 40, 7, checks, flicker=0.5))
    assert [each for each in found if each.outside] == []
    assert {each.rows for each in found} == {40}


def test_a_nonlinearity_is_scatter_and_a_steady_drift_is_held() -> None:
    rng = np.random.default_rng(22)
    plain = zero_uncertainty(sequence(rng, np.zeros(24)))
    bent = zero_uncertainty(sequence(rng, np.zeros(24), nonlinearity=20.0))
    steady = zero_uncertainty(sequence(rng, np.linspace(-2.5, 2.5, 24)))
    assert plain is not None
    assert bent is not None
    assert steady is not None
    assert plain.value < bent.value < 20.0 / 5
    assert 5.0 / math.sqrt(24) / 3 < steady.value < 5.0


def test_numbers_of_any_size_and_steps_without_noise() -> None:
    steps = sequence(np.random.default_rng(23), np.zeros(24))
    found = zero_uncertainty(steps)
    scaled = zero_uncertainty(steps._replace(output=steps.output * 1e-9, u=steps.u * 1e-9))
    assert found is not None
    assert scaled is not None
    assert scaled.value == pytest.approx(found.value * 1e-9, rel=1e-6)
    assert zero_uncertainty(steps._replace(u=np.full(24, np.nan))) is None
    exact = zero_uncertainty(steps._replace(output=3600 * steps.rate, u=np.zeros(24)))
    assert exact is not None
    assert exact.value < 1e-6
