"""A second effect that one training run alone excites, beside an effect that all show, is not lost in the noise."""

import numpy as np
import pytest

from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from tests.analytics.loop.block_runs import BLOCK_S, BLOCKS, WHITE, run_of, warming

MODEL = ErrorModel.parse("rate = bias")
NOISE = ModelNoise(N=WHITE * float(np.sqrt(BLOCK_S / 3600.0)), B=0.003, K=0.003, turn_on=0.01)
PER_V = 0.3


def found(stepping: tuple[int, ...], acting: tuple[int, ...]) -> Diagnosis:
    """Nine runs over temperature, the last three held out; in some the supply steps, and in some of them it acts."""
    rng = np.random.default_rng(11)
    runs = []
    for number in range(9):
        warm, supply = warming(number), 5.0 + 1e-4 * rng.standard_normal(BLOCKS)
        if number in stepping:
            supply = supply + np.repeat([0.0, -0.5, 0.0, 0.5, 0.0, -0.25, 0.25, 0.0], BLOCKS // 8)
        error = 0.02 * (warm - 25.0) + PER_V * (supply - 5.0) * (number in acting)
        runs.append(run_of(rng, number, error, {"temperature": warm, "supply_voltage": supply}))
    return diagnose(runs, MODEL, declared_noise=NOISE)


def test_held_out_runs_are_asked_of_it() -> None:
    both = found(stepping=(2, 7), acting=(2, 7))
    assert set(both.names) == {"temperature", "supply_voltage"}
    (supply,) = (each for each in both.effects if each.name == "supply_voltage")
    assert supply.confirmed
    (size,) = supply.coefficients
    assert abs(size.value - PER_V) < 3.0 * (size.hi - size.lo) / (2 * 1.96)


@pytest.mark.long
@pytest.mark.parametrize(("stepping", "is_refused"), [((2,), False), ((2, 7), True)])
def test_it_was_seen_once(stepping: tuple[int, ...], is_refused: bool) -> None:
    once = found(stepping=stepping, acting=(2,))
    assert once.names == ("temperature",)
    assert once.verdict in (ModelVerdict.EFFECT_FOUND, ModelVerdict.CONFOUNDED)
    (seen,) = once.unreplicated
    assert seen.name == "supply_voltage"
    assert seen.confirmed is (False if is_refused else None)
    assert "supply_voltage" not in once.detection_limits
    sentence = verdict_sentence(once, Wording("en"))
    assert "; also, supply voltage" in sentence
    assert any("the noise stands for it" in each for each in once.limits)


@pytest.mark.long
def test_nothing_more_is_seen_where_nothing_more_is() -> None:
    one = found(stepping=(2, 7), acting=())
    assert (one.names, one.unreplicated) == (("temperature",), ())
