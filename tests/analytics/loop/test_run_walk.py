"""An effect that shifts whole runs, beside a bias that walks from run to run."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from analytics.loop.report.finding_sentences import evidence
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Language, Wording
from analytics.loop.tracing.held_out.run_walk import log_odds
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.tracing.result.holdout import WALK_LOG_ODDS, HeldOutAnswer, Holdout, HoldoutSlope
from tests.bench.tracing_cases import Case
from tests.bench.tracing_outcomes import RIGHT, traced
from tests.diagnosed_units import a_finding

_DAY = np.arange(15.0)
_LANGUAGES: tuple[Language, ...] = ("en", "zh")


@pytest.mark.parametrize("seed", [1014, 1015])
@pytest.mark.in_gate("1015")
def test_a_bias_that_walks_from_run_to_run_is_not_called_ageing(seed: int) -> None:
    line = traced(Case("null", "correlated_turn_on", 0.0, seed))
    assert line["verdict"] not in ("effect_found", "confounded"), line


@pytest.mark.long
def test_ageing_is_named() -> None:
    line = traced(Case("planted", "ageing", 10.0, 2000))
    assert line["outcome"] in RIGHT, line


def test_many_runs_decide_between_a_trend_and_a_walk() -> None:
    """In 60 runs the true one of the two has odds over 20 more often than not (of 100, by chance 1 in 1000)."""
    rng = np.random.default_rng(7)
    day = np.arange(60.0)
    walks = [np.cumsum(rng.standard_normal(60)) for _ in range(100)]
    trends = [0.1 * day + rng.standard_normal(60) for _ in range(100)]
    for_walk = sum((log_odds(each, day, day) or 0.0) < -WALK_LOG_ODDS for each in walks)
    for_trend = sum((log_odds(each, day, day) or 0.0) > WALK_LOG_ODDS for each in trends)
    assert for_walk > binom.ppf(0.999, 100, 0.5)
    assert for_trend > binom.ppf(0.999, 100, 0.5)


@given(
    seed=st.integers(0, 10_000),
    scale=st.floats(1e-3, 1e3),
    offset=st.floats(-1e3, 1e3),
    size=st.floats(1e-3, 1e3),
    days=st.floats(0.1, 100.0),
)
def test_neither_units_nor_offsets_change_the_odds(
    seed: int, scale: float, offset: float, size: float, days: float
) -> None:
    bias = np.random.default_rng(seed).standard_normal(15) + 0.2 * _DAY
    expected = log_odds(bias, _DAY, _DAY)
    assert expected is not None
    got = log_odds(scale * (bias + offset), -size * (_DAY + offset), days * _DAY + offset)
    assert got == pytest.approx(expected, abs=1e-5)


def test_too_few_runs_and_an_effect_alike_in_all_are_not_compared() -> None:
    assert log_odds(_DAY[:2], _DAY[:2], _DAY[:2]) is None
    assert log_odds(_DAY, np.ones(15), _DAY) is None


def test_runs_without_a_date_walk_by_their_number() -> None:
    bias = 2.0 * _DAY + np.random.default_rng(1).standard_normal(15)
    assert log_odds(bias, _DAY, np.zeros(15)) == log_odds(bias, _DAY, _DAY)


def test_an_exact_fit_has_finite_odds() -> None:
    odds = log_odds(_DAY, _DAY, _DAY)
    assert odds is not None
    assert np.isfinite(odds)
    assert odds > WALK_LOG_ODDS


@pytest.mark.parametrize(
    ("log_odds_of_effect", "answer"),
    [(3.5, HeldOutAnswer.CONFIRMED), (1.0, HeldOutAnswer.NO_POWER), (-3.5, HeldOutAnswer.REFUSED)],
)
def test_the_odds_decide_what_the_slope_confirmed(log_odds_of_effect: float, answer: HeldOutAnswer) -> None:
    slope = HoldoutSlope("ageing", 1.0, 0.1, 0.1, accepted=True, answer=HeldOutAnswer.CONFIRMED)
    other = HoldoutSlope("warm_up", 1.0, 0.1, 0.1, accepted=True, answer=HeldOutAnswer.CONFIRMED)
    one = Holdout(("r1",), slope, (slope,)).beside_walk("ageing", log_odds_of_effect)
    assert one.overall is answer
    total = HoldoutSlope("all", 1.0, 0.1, 0.1, accepted=True, answer=HeldOutAnswer.CONFIRMED)
    two = Holdout(("r1",), total, (slope, other)).beside_walk("ageing", log_odds_of_effect)
    assert (two.answer("ageing"), two.answer("warm_up")) == (answer, HeldOutAnswer.CONFIRMED)


def test_what_the_slope_refuses_stays_refused() -> None:
    slope = HoldoutSlope("ageing", 0.1, 0.1, 0.1, accepted=False)
    assert Holdout(("r1",), slope, (slope,)).beside_walk("ageing", 9.0).confirms("ageing") is False


@pytest.mark.parametrize(("log_odds_of_effect", "words"), [(1.0, ("as well", "同样好")), (-5.0, ("better", "更好"))])
def test_the_sentences_name_the_walk_and_no_lack_of_excitation(
    log_odds_of_effect: float, words: tuple[str, str]
) -> None:
    found = a_finding(name="ageing")
    slope = HoldoutSlope("ageing", 0.9, 0.1, 0.1, accepted=True, answer=HeldOutAnswer.CONFIRMED)
    holdout = Holdout(("r1",), slope, (slope,)).beside_walk("ageing", log_odds_of_effect)
    found = msgspec.structs.replace(found, confirmed=holdout.confirms("ageing"))
    is_refused = found.confirmed is False
    diagnosis = Diagnosis(
        verdict=ModelVerdict.UNREPLICATED, units=("FOG-1",), signal="rate", runs=("a", "b", "c"), holdout=holdout,
        effects=() if is_refused else (found,), unreplicated=(found,) if is_refused else (),
    )  # fmt: skip
    for language, word in zip(_LANGUAGES, words, strict=True):
        wording = Wording(language)
        text = verdict_sentence(diagnosis, wording)
        assert word in text
        text += " ".join(evidence(found, diagnosis, wording))
        assert text.count({"en": "walks from run to run", "zh": "随机游走"}[language]) == 2
        assert "excite" not in text
        assert "激励不足" not in text
