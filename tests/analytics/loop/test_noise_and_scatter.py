"""Noise that was declared against noise that was measured, and what differs from run to run."""

from dataclasses import replace

import numpy as np
import pytest

from analytics.commands.closed_loop.diagnose import noise_of
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.model.declared_noise import with_turn_on
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from tests.bench.loop_campaign import Campaign

TRUE = ModelNoise(N=0.005, B=0.01, K=0.006, turn_on=0.05)
MODEL = ErrorModel.parse("rate = bias + scale_factor*input_rate + temperature")
BIAS = ErrorModel.parse("rate = bias")
DAY_NS = 86_400 * 10**9
BLOCKS = 120


@pytest.fixture(scope="module")
def quiet_runs() -> list[RunBlocks]:
    return Campaign(seed=11, runs=9, duration_s=10_800.0).runs()


def declared(factor: float) -> ModelNoise:
    return ModelNoise(N=TRUE.N * factor, B=TRUE.B, K=TRUE.K, turn_on=TRUE.turn_on)


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 10.0])
def test_white_noise_declared_wrongly_is_measured_and_said(quiet_runs: list[RunBlocks], factor: float) -> None:
    found = diagnose(quiet_runs, MODEL, declared_noise=declared(factor))
    assert found.noise is not None
    # 9 runs of 360 blocks tell N to 1.3 %; rate tests are noisier by a part of that
    assert pytest.approx(TRUE.N, rel=0.15) == found.noise.N
    assert any(each.startswith("the white noise N declared, or else") for each in found.limits)


def test_noise_declared_rightly_raises_no_word(quiet_runs: list[RunBlocks]) -> None:
    found = diagnose(quiet_runs, MODEL, declared_noise=TRUE)
    assert found.verdict is ModelVerdict.NOTHING_MISSING
    assert not any(
        "white noise N" in each or "turn-on scatter" in each or "less noise" in each for each in found.limits
    )


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.05, 20.0])
def test_slow_noise_declared_too_large_and_turn_on_scatter_declared_wrongly_are_said(
    quiet_runs: list[RunBlocks], factor: float
) -> None:
    slow = ModelNoise(N=TRUE.N, B=max(1.0, factor) * TRUE.B, K=max(1.0, factor) * TRUE.K, turn_on=0.05 * factor)
    found = diagnose(quiet_runs, MODEL, declared_noise=slow)
    assert any(each.startswith("the declared turn-on scatter is") for each in found.limits)
    assert any(each.startswith("less noise at averages of 300 to 3600 s than") for each in found.limits) == (factor > 1)


def run_at(number: int, mean: float, warm: float, *, rng: np.random.Generator) -> RunBlocks:
    """One hour of 30 s at one temperature; noise 0.05 deg/h a block."""
    ones = np.ones(BLOCKS)
    temperature = warm + 0.1 * np.sin(np.arange(BLOCKS) / 9.0)
    return RunBlocks(
        "U1", f"r{number}", "rate", np.arange(BLOCKS), 30.0, number * DAY_NS, mean + 0.05 * rng.standard_normal(BLOCKS),
        30 * ones.astype(int), 0.0025 * ones, "deg/h", {"temperature": Channel(temperature, 0.01 * ones, "degC")},
        is_date_known=False,
    )  # fmt: skip


def two_runs() -> list[RunBlocks]:
    rng = np.random.default_rng(270)
    return [run_at(0, 0.0, 13.0, rng=rng), run_at(1, 65.0, 47.0, rng=rng)]


def test_two_runs_that_differ_by_far_more_than_their_noise_are_a_finding_that_two_runs_cannot_tell() -> None:
    runs = two_runs()
    found = diagnose(runs, BIAS)
    assert found.verdict is ModelVerdict.CONFOUNDED
    assert found.names == ("turn_on",)
    names = {each.name: each.recorded for each in found.confounded}
    assert names["temperature"]
    assert names["gravity_i"] is False
    assert "temperature" not in found.detection_limits
    (size,) = found.effects[0].coefficients
    assert size.value == pytest.approx(65.0 / np.sqrt(2), rel=0.01)
    english, chinese = (verdict_sentence(found, Wording(word, runs[0])) for word in ("en", "zh"))
    assert english.startswith("The runs differ by 46")
    assert "2 runs cannot separate these causes" in english
    assert "2次试验无法区分" in chinese
    # noise alone, with turn-on scatter and without
    assert found.error is not None
    row = found.error.rows[0]
    assert row.floor > 30
    assert row.floor_within < 0.2
    # no model predicts it
    assert str(found.model) == str(found.declared)


def test_turn_on_scatter_that_was_declared_is_no_finding() -> None:
    found = diagnose(two_runs(), BIAS, declared_noise=ModelNoise(N=0.0046, B=0.01, K=0.01, turn_on=50.0))
    assert "turn_on" not in found.names
    estimated = diagnose(
        two_runs(), BIAS, declared_noise=ModelNoise(N=0.0046, B=0.01, K=0.01, turn_on=50.0),
        turn_on_is_declared=False,
    )  # fmt: skip
    assert estimated.names == ("turn_on",)


def test_what_does_not_differ_between_the_runs_is_not_meant() -> None:
    rng = np.random.default_rng(271)
    level = Channel(np.zeros(BLOCKS), np.zeros(BLOCKS), "g_0")
    runs = [run_at(number, mean, 25.0, rng=rng) for number, mean in enumerate((0.0, 40.0, -20.0))]
    runs = [replace(run, channels={**run.channels, "gravity_i": level}) for run in runs]
    found = diagnose(runs, BIAS)
    assert "temperature" not in {each.name for each in found.confounded}
    assert found.effects == ()
    assert any("this is attributed to turn-on scatter, which was not declared" in each for each in found.limits)


def test_noise_without_turn_on_scatter_has_it_estimated() -> None:
    runs = two_runs()
    given = noise_of("N=0.0046, B=0.01, K=0.01")
    assert given.turn_on is None
    estimated = with_turn_on(given, runs, BIAS)
    assert estimated.turn_on == pytest.approx(65.0 / 2 * 1.4826, rel=0.01)
    assert with_turn_on(given._replace(turn_on=0.3), runs, BIAS).turn_on == 0.3


@pytest.mark.parametrize("own_fits", [True, False])
def test_a_walk_that_no_allan_fit_shows_is_no_excess_of_what_the_fits_allow(*, own_fits: bool) -> None:
    """A third of its upper bound is declared for it; that nothing explains the rest had been the verdict."""
    rng = np.random.default_rng(6)
    ones = np.ones(BLOCKS)
    white, walk = 0.05 / np.sqrt(30.0 / 3600.0), 0.9 * np.sqrt(30.0 / 3600.0)
    runs = [
        RunBlocks(
            "U1", f"r{at}", "rate", np.arange(BLOCKS), 30.0, at * DAY_NS,
            rng.normal(0.0, 0.15) + white * rng.standard_normal(BLOCKS) + walk * np.cumsum(rng.standard_normal(BLOCKS)),
            30 * ones.astype(int), white**2 * ones, "deg/h",
        )
        for at in range(9)
    ]  # fmt: skip
    noise = ModelNoise(N=0.05, B=0.05, K=0.36, turn_on=0.15, most=(0.06, 0.15, 1.1) if own_fits else None)
    found = diagnose(runs, BIAS, declared_noise=noise, turn_on_is_declared=False)
    assert found.verdict is (ModelVerdict.NOTHING_MISSING if own_fits else ModelVerdict.UNEXPLAINED)
    assert any("which do not bound slow noise to less" in each for each in found.limits) is own_fits
