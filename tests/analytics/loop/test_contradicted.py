"""No effect is confirmed where the held-out error is larger with it, and none has a size that the rates do not give."""

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import ModelVerdict
from tests.analytics.loop.block_runs import BLOCK_S, BLOCKS, WHITE, run_of

N = WHITE * float(np.sqrt(BLOCK_S / 3600.0))


def test_a_confirmed_slope_does_not_outweigh_a_larger_error() -> None:
    """Only what changes within a run acts; the held-out runs are at other temperatures, and scatter is declared."""
    rng = np.random.default_rng(21)
    runs = []
    for number in range(9):
        swing = 2.0 * np.sin(np.arange(BLOCKS) / (2.0 + 0.2 * number))
        offset = (0.0, 20.0, -20.0)[number % 3] if number >= 6 else 0.0
        runs.append(run_of(rng, number, 0.1 * swing, {"temperature": 25.0 + offset + swing}))
    noise = ModelNoise(N=N, B=0.003, K=0.003, turn_on=2.0)
    found = diagnose(runs, ErrorModel.parse("rate = bias"), declared_noise=noise)
    assert found.verdict is ModelVerdict.UNREPLICATED
    assert found.effects[0].name == "temperature"
    assert found.effects[0].confirmed is None
    assert found.holdout is not None
    assert found.holdout.effects[0].raises_error
    assert not found.holdout.accepted  # so that it does not go live
    sentence = verdict_sentence(found, Wording("en"))
    assert "the held-out runs contradict it: with it their RMS error over" in sentence
    assert "confirm it" not in sentence
    assert "留出试验与之相矛盾" in verdict_sentence(found, Wording("zh"))


def turning(number: int, half_width: float, rng: np.random.Generator) -> RunBlocks:
    """A run of rates from 0.02 to 100 deg/s, each held for six blocks; below the half width the output is dead."""
    levels = [0, 0.02, -0.02, 0.04, -0.04, 0.1, -0.1, 0.3, -0.3, 1, -1, 3, -3, 10, -10, 100, -100, 0]
    rate = np.repeat(rng.permutation(np.array(levels, np.float64)), 6)
    return run_of(rng, number, 3600.0 * np.where(np.abs(rate) < half_width, 0.0, rate), {"input_rate": rate})


@pytest.mark.parametrize(("half_width", "between"), [(0.05, (0.04, 0.1)), (0.2, (0.1, 0.3))])
@pytest.mark.long
def test_a_dead_zone_far_below_the_largest_rate_has_its_size(half_width: float, between: tuple[float, float]) -> None:
    rng = np.random.default_rng(22)
    runs = [turning(number, half_width, rng) for number in range(6)]
    noise = ModelNoise(N=N, B=0.003, K=0.003, turn_on=0.02)
    found = diagnose(runs, ErrorModel.parse("rate = bias + scale_factor*input_rate"), declared_noise=noise)
    (effect,) = found.effects
    assert (effect.name, effect.confirmed) == ("dead_zone", True)
    assert effect.coefficients[0].value == pytest.approx(-3600.0, rel=1e-3)
    low, high = effect.parameter_bounds["half_width"]
    assert between[0] * 0.99 < low < effect.parameters["half_width"] < high < between[1] * 1.01


@pytest.mark.long
def test_a_shape_at_the_end_of_what_was_tried_is_stated() -> None:
    rng = np.random.default_rng(23)
    runs = []
    for number in range(6):
        start = 3000.0 * number
        since = np.asarray(start + (np.arange(BLOCKS) + 0.5) * BLOCK_S, np.float64)
        runs.append(run_of(rng, number, 3.0 * np.exp(-since / 1e5), {"time_since_power_on": since}))
    noise = ModelNoise(N=N, B=0.003, K=0.003, turn_on=0.02)
    found = diagnose(runs, ErrorModel.parse("rate = bias"), declared_noise=noise)
    assert found.effects[0].parameters == {"time_constant": 10_000.0}  # of 100,000
    assert [each for each in found.limits if "10000 is the largest value tried; it may be larger" in each]
