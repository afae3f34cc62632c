"""The watch of models in use: a right one stays, one whose effect has gone is refused, and it is said once."""

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.live.residual_watch import STRETCH_S, THRESHOLD, cusum, gains, stretches
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.model.model_registry import ModelVersion
from stream.batch import FloatArray
from stream.errors import BadInput

BLOCK_S = 30.0
BLOCKS = 360
WHITE_DEG_PER_H = 1.0
TURN_ON_DEG_PER_H = 2.0
RUNS = 5


def version(coefficient: float) -> ModelVersion:
    model = ErrorModel.parse("rate = bias + temperature").fitted([10.0, coefficient], unit_of_measure="deg/h")
    before = ErrorModel.parse("rate = bias").fitted([10.0], unit_of_measure="deg/h")
    n = WHITE_DEG_PER_H * (BLOCK_S / 3600.0) ** 0.5
    return ModelVersion(
        unit="U1", signal="rate", version=1, parent=None, text=str(model), model=model, before=before,
        noise=ModelNoise(N=n, B=0.0, K=0.0, turn_on=TURN_ON_DEG_PER_H), block_s=BLOCK_S,
        longest_s=BLOCKS * BLOCK_S, runs={}, training_runs=(), verdict="effect_found", added=("temperature",),
        holdout={"accepted": True}, made_ns=1, by="Li",
    )  # fmt: skip


def run_of(rng: np.random.Generator, coefficient: float, blocks: int = BLOCKS) -> RunBlocks:
    slot = np.arange(blocks)
    deg_c: FloatArray = 25.0 + 10.0 * np.sin(2.0 * np.pi * slot / 120.0)
    value = (
        10.0
        + rng.normal(0.0, TURN_ON_DEG_PER_H)
        + rng.normal(0.0, WHITE_DEG_PER_H, blocks)
        + coefficient * (deg_c - 25.0)
    )
    return RunBlocks(
        "U1", "r1", "rate", slot, BLOCK_S, 0, value, np.full(blocks, 600), np.full(blocks, WHITE_DEG_PER_H**2),
        "deg/h", {"temperature": Channel(deg_c, np.zeros(blocks), "degC")},
    )  # fmt: skip


# in one run the effect is worth z = 4: sum((0.03 * 10 sin)**2) = 360 * 0.09 / 2 = 4.0**2
COEFFICIENT = 4.0 / (10.0 * (BLOCKS / 2.0) ** 0.5)


def refused_after(rng: np.random.Generator, coefficient: float) -> int | None:
    """The first of the runs behind which the model is refused."""
    lost = 0.0
    for number in range(RUNS):
        (found,) = stretches(version(COEFFICIENT), run_of(rng, coefficient), is_ended=True)
        lost = cusum(lost, found.gain)
        if lost > THRESHOLD:
            return number + 1
    return None


def test_a_right_model_is_seldom_refused() -> None:
    rng = np.random.default_rng(11)
    refused = sum(refused_after(rng, COEFFICIENT) is not None for _ in range(40))
    # exp(-gain) of a right model has mean 1, so that any sum of losses passes ln 200 with odds of at most 1 in 200 a
    # run: 0.025 in five; more than 5 of 40 have a probability of 5e-4
    assert refused <= 5


def test_a_model_whose_effect_has_gone_is_refused() -> None:
    rng = np.random.default_rng(12)
    found = [refused_after(rng, 0.0) for _ in range(40)]
    # the sum of the losses of three runs is 24 with a standard deviation of 6.9: 0.35 % stay below 5.3
    assert sum(each is not None and each <= 3 for each in found) >= 38


def test_the_gain_is_that_of_the_likelihood() -> None:
    rng = np.random.default_rng(13)
    found = np.array([float(gains(version(COEFFICIENT), run_of(rng, COEFFICIENT)).sum()) for _ in range(200)])
    # normal with mean z**2/2 and standard deviation z, z = 4; whitening for the turn-on scatter takes a whole number of
    # periods as good as unchanged
    assert abs(found.mean() - 8.0) < 4.0 * 4.0 / 200**0.5
    assert 3.3 < found.std() < 4.7


def test_long_runs_are_judged_by_stretches_and_only_complete_ones_while_they_go_on() -> None:
    blocks = round(2.5 * STRETCH_S / BLOCK_S)
    run = run_of(np.random.default_rng(14), COEFFICIENT, blocks)
    ended = stretches(version(COEFFICIENT), run, is_ended=True)
    going_on = stretches(version(COEFFICIENT), run, is_ended=False)
    assert [each.number for each in ended] == [0, 1, 2]
    assert ended[:2] == going_on
    assert [each.blocks for each in ended] == [720, 720, 360]
    assert sum(each.gain for each in ended) == pytest.approx(float(gains(version(COEFFICIENT), run).sum()))


def test_a_run_without_the_channel_says_so() -> None:
    run = run_of(np.random.default_rng(15), 0.0)
    bare = RunBlocks(
        run.unit, run.run, run.signal, run.slot, run.block_s, 0, run.value, run.n, run.white_variance, "deg/h"
    )
    with pytest.raises(BadInput, match="needs channel temperature"):
        gains(version(COEFFICIENT), bare)
