"""White noise that grows with a temperature is not the noise declared everywhere."""

import numpy as np
import pytest

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.tracing.verdict.noise_over_channels import noise_trend
from analytics.loop.tracing.whitening.stack import stacked
from tests.analytics.loop.block_runs import BLOCK_S, WHITE, run_of, warming

MODEL = ErrorModel.parse("rate = bias + temperature")
NOISE = ModelNoise(N=WHITE * float(np.sqrt(BLOCK_S / 3600.0)), B=0.003, K=0.003, turn_on=0.01)


def runs(seed: int, growth: float, only: tuple[int, ...] = (0, 1, 2, 3, 4, 5)) -> list[RunBlocks]:
    """Six runs; above 25 degC the noise grows by this share of its size every 10 degC, in some of them."""
    rng = np.random.default_rng(seed)
    made = []
    for number in range(6):
        warm = warming(number)
        sigma = WHITE * (1.0 + growth * (number in only) * np.clip(warm - 25.0, 0.0, None) / 10.0)
        made.append(run_of(rng, number, 0.02 * (warm - 25.0), {"temperature": warm}, sigma=sigma))
    return made


def found(growth: float) -> Diagnosis:
    return diagnose(runs(3, growth), MODEL, declared_noise=NOISE)


def test_noise_that_grows_is_not_that_declared() -> None:
    assert found(0.0).verdict is ModelVerdict.NOTHING_MISSING
    growing = found(1.0)
    assert growing.verdict is ModelVerdict.UNEXPLAINED
    sentence = verdict_sentence(growing, Wording("en"))
    assert (
        "its white part N grows with gyro temperature, from 0.009" in sentence
    )  # 0.1 deg/h of 30 s: 0.0091 deg/sqrt(h)
    assert "白噪声N随陀螺温度增大" in verdict_sentence(growing, Wording("zh"))
    assert growing.limits[-1] == growing.unexplained


def test_one_run_alone_shows_no_trend() -> None:
    stack, _ = stacked(runs(4, 1.0, only=(2,)), MODEL)
    assert noise_trend(stack) is None


@pytest.mark.long
def test_steady_noise_has_no_trend() -> None:
    trends = [noise_trend(stacked(runs(100 + seed, 0.0), MODEL)[0]) for seed in range(60)]
    assert sum(each is not None for each in trends) < 2  # each by chance in 1 of 1000: two of 60 in 1 of 600
