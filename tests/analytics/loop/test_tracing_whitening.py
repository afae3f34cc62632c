"""The filter against dense algebra, the noise fit against known noise, the screening against white noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.base import EffectKind
from analytics.loop.effects.registry import effects_for
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.search.event_scans import jump_column, scan_jumps
from analytics.loop.tracing.search.evidence import leave_one_out, noise_inflation
from analytics.loop.tracing.search.screening import candidates_for, family_p_value, screen
from analytics.loop.tracing.whitening.joint_fit import fit_jointly, nothing_more
from analytics.loop.tracing.whitening.least_squares import solve
from analytics.loop.tracing.whitening.noise_variance import averages_of, expected_variance
from analytics.loop.tracing.whitening.stack import UnitRecord, stacked
from analytics.loop.tracing.whitening.white_variance import record_of
from analytics.loop.tracing.whitening.whitened_fit import fit_noise
from analytics.loop.tracing.whitening.whitener import NoiseModel, Whitener
from stream.batch import FloatArray, IntArray

NOISE = ModelNoise(N=0.005, B=0.01, K=0.02, turn_on=0.05)
MODEL = ErrorModel.parse("bias + temperature")


def slots(rng: np.random.Generator, blocks: int) -> IntArray:
    return np.cumsum(rng.choice([1, 1, 1, 2, 40], blocks))


def exact_run(rng: np.random.Generator, name: str, slot: IntArray, noise: ModelNoise = NOISE) -> RunBlocks:
    """A run whose noise has exactly the covariance of the model."""
    model = NoiseModel(30.0, 21600.0)
    covariance = model.covariance(noise, slot.astype(float), np.ones(slot.size))
    value = np.linalg.cholesky(covariance) @ rng.standard_normal(slot.size)
    temperature = 25 + 10 * np.sin(slot / 100 + rng.uniform(0, 6))
    channels = {
        name: Channel(mean, np.zeros(slot.size), unit)
        for name, mean, unit in (
            ("temperature", temperature, "degC"),
            ("supply_voltage", 12 + rng.standard_normal(slot.size), "V"),
            ("gravity_i", np.cos(slot / 37.0), "g_0"),
        )
    }
    white = np.full(slot.size, model.space(noise).white)
    return RunBlocks("FOG-1", name, "rate", slot, 30.0, 0, value, np.full(slot.size, 3000), white, "deg/h", channels)


def record(seed: int, runs: int = 6, blocks: int = 300, *, gaps: bool = False) -> UnitRecord:
    rng = np.random.default_rng(seed)
    made = [exact_run(rng, f"r{k}", slots(rng, blocks) if gaps else np.arange(blocks)) for k in range(runs)]
    stack, _ = stacked(made, MODEL)
    return replace(record_of(stack, NOISE), white=np.ones(len(stack)))


def dense(of: UnitRecord, noise: ModelNoise) -> FloatArray:
    """Covariance of all blocks of a record."""
    slot, number = of.stack.slot.astype(float), of.stack.run_number
    total = np.zeros((len(of), len(of)))
    for run in range(len(of.stack.runs)):
        own = np.flatnonzero(number == run)
        total[np.ix_(own, own)] = of.noise_model.covariance(noise, slot[own], of.white[own])
    return total


@pytest.mark.parametrize("noise", [NOISE, ModelNoise(N=0.01, B=0.0, K=0.0, turn_on=0.0)])
def test_whitening_is_the_inverse_of_the_cholesky_factor(noise: ModelNoise) -> None:
    of = record(1, runs=3, blocks=120, gaps=True)
    rng = np.random.default_rng(2)
    of = replace(of, white=rng.uniform(0.3, 50.0, len(of)))
    columns = rng.standard_normal((len(of), 4))
    covariance = dense(of, noise)
    factor = np.linalg.cholesky(covariance)
    whitener = of.whitener(noise)
    expected = np.linalg.solve(factor, columns)
    np.testing.assert_allclose(whitener(columns), expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert whitener.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], abs=1e-8)


def test_adjoint_is_the_transpose() -> None:
    of = record(3, runs=2, blocks=90, gaps=True)
    rng = np.random.default_rng(4)
    x, u = rng.standard_normal((2, len(of), 2))
    whitener = of.whitener(NOISE)
    assert np.sum(whitener(x) * u) == pytest.approx(np.sum(x * whitener.adjoint(u)), rel=1e-9)


def test_flicker_has_the_spectrum_that_its_coefficient_says() -> None:
    """Within 1 dB from one period in a run to one in 13 blocks: sum of the states against B**2/(2*pi*f)."""
    for longest_s in (3600.0, 21600.0, 864_000.0):
        model = NoiseModel(30.0, longest_s)
        space = model.space(ModelNoise(N=1.0, B=0.01, K=0.0, turn_on=0.0))
        frequency = np.geomspace(1 / longest_s, 1 / 400.0, 30)
        tau = model.correlation_s[:, None]
        density = np.sum(space.variance[:, None] * 2 * tau / (1 + (2 * np.pi * frequency * tau) ** 2), axis=0)
        ratio = density / (0.01**2 / (2 * np.pi * frequency))
        assert np.all(np.abs(10 * np.log10(ratio)) < 1.0), longest_s


@pytest.mark.long
def test_noise_fit_finds_the_noise() -> None:
    """Twelve runs of 6 h: N to 1 % (sqrt(1/2n) = 0.8 %), the others to a factor that their information allows."""
    of = record(5, runs=12, blocks=720)
    away = replace(of, prior=replace(of.prior, center=ModelNoise(N=0.0055, B=0.015, K=0.012, turn_on=0.03)))
    fitted = fit_noise(away, away.design).noise
    assert pytest.approx(0.005, rel=0.03) == fitted.N
    assert 0.6 < fitted.B / 0.01 < 1.6
    assert 0.6 < fitted.K / 0.02 < 1.6
    assert 0.5 < fitted.turn_on / 0.05 < 2.0


def test_coefficients_agree_with_dense_least_squares() -> None:
    of = record(6, runs=3, blocks=150, gaps=True)
    inverse = np.linalg.inv(dense(of, NOISE))
    expected = np.linalg.solve(of.design.T @ inverse @ of.design, of.design.T @ inverse @ of.value)
    whitened = of.whitener(NOISE)(np.column_stack([of.value, of.design]))
    found = solve(whitened[:, 1:].T @ whitened[:, 1:], whitened[:, 1:].T @ whitened[:, 0]).coefficients
    np.testing.assert_allclose(found, expected, rtol=1e-7)


@pytest.mark.parametrize("records", [40, pytest.param(100, marks=pytest.mark.long)])
def test_screening_is_calibrated_on_its_own_noise(records: int) -> None:
    """p-values of one candidate over all records are uniform; the family-wise 5 % test errs in 5 % of them."""
    p_values, smallest = [], []
    for seed in range(records):
        of = record(1000 + seed, runs=3, blocks=100)
        names = {name: each for name, each in effects_for(of.stack.runs).items() if each.kind is EffectKind.LIBRARY}
        candidates = candidates_for([of], names, MODEL, (EffectKind.LIBRARY,), {})
        found = screen(candidates, [of.design], [NOISE], np.random.default_rng(seed))
        by_name = {group[0].candidate.effect.name: group[0].p_value for group in found.by_effect()}
        p_values.append(by_name["supply_voltage"])
        smallest.append(family_p_value(min(by_name.values()), found.tests))
    assert stats.kstest(p_values, "uniform").pvalue > 1e-3
    wrong = sum(each < 0.05 for each in smallest)
    assert stats.binom.sf(wrong - 1, records, 0.05) > 1e-3
    assert stats.binom.cdf(wrong, records, 0.05) > 1e-3


def test_jump_scan_is_the_ratio_of_a_fit() -> None:
    """The scan's z at its best block is that of a regression with the step added, at the same noise."""
    of = record(7, runs=4, blocks=250, gaps=True)
    value = of.value + 0.3 * jump_column(of, 600)[:, 0]
    joint = fit_jointly([replace(of, value=value)], nothing_more([of]))
    found = scan_jumps([replace(of, value=value)], joint)
    assert found is not None
    assert abs(found.row - 600) <= 2
    step = jump_column(of, found.row)
    whitened = of.whitener(joint.noises[0])(np.column_stack([value, of.design, step]))
    solution = solve(whitened[:, 1:].T @ whitened[:, 1:], whitened[:, 1:].T @ whitened[:, 0])
    z = solution.coefficients[-1] / np.sqrt(solution.covariance[-1, -1])
    assert found.z == pytest.approx(z, rel=0.02)


def test_expected_variance_of_averages_is_that_of_the_covariance() -> None:
    of = record(8, runs=2, blocks=100, gaps=True)
    averages = averages_of(of, 20, np.arange(len(of)))
    covariance = dense(of, NOISE)
    expected = [covariance[np.ix_(rows, rows)].mean() for rows in averages.rows]
    np.testing.assert_allclose(expected_variance(of, NOISE, averages), expected, rtol=1e-9)
    np.testing.assert_allclose(averages.of(of.value), [of.value[rows].mean() for rows in averages.rows], atol=1e-12)


def test_whitener_of_white_noise_only_scales() -> None:
    white = ModelNoise(N=0.02, B=0.0, K=0.0, turn_on=0.0)
    whitener = Whitener.of(NoiseModel(30.0, 3000.0), white, np.array([0, 1, 1, 5, 0, 1]), np.ones(6))
    np.testing.assert_allclose(whitener(np.ones((6, 1)))[:, 0], np.sqrt(30 / 3600) / 0.02)


def test_noise_that_is_not_modelled_takes_significance_back() -> None:
    """A slow wave of its own in every run disagrees with any common one; white noise leaves the test alone."""
    of = record(9, runs=6, blocks=300)
    slow = np.sin(2 * np.pi * of.stack.slot / 150)[:, None]
    rng = np.random.default_rng(10)
    size = 0.05 * rng.standard_normal(6)[of.stack.run_number]
    numbers = [of.stack.run_number]
    inflations = []
    for value in (of.value, of.value + size * slow[:, 0]):
        hypothesis = nothing_more([of]).with_common([slow])
        joint = fit_jointly([replace(of, value=value)], hypothesis)
        inflations.append(noise_inflation(joint, numbers, numbers, 1))
    assert inflations[0] == 1.0
    assert inflations[1] > 2.0


def test_leaving_one_out_counts_only_what_others_tell() -> None:
    """An effect in two runs replicates; the same column at work in one of them does not."""
    of = record(11, runs=6, blocks=300)
    number = of.stack.run_number
    column = np.where(number < 2, np.cos(of.stack.slot / 20.0), 0.0)[:, None]
    outcomes = []
    for at_work in (number < 2, number < 1):
        value = of.value + 0.03 * column[:, 0] * at_work
        joint = fit_jointly([replace(of, value=value)], nothing_more([of]).with_common([column]))
        outcomes.append(leave_one_out(joint, [number], 1))
    assert outcomes[0].replicates
    assert outcomes[0].largest_share < 0.8
    assert not outcomes[1].replicates
