"""Causes that the biases of all runs follow: their size in each sentence, and when they are not tested."""

import msgspec
import numpy as np
import pytest

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.report.finding_sentences import evidence
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from stream.batch import FloatArray
from tests.analytics.loop.test_effects_between_runs import MODEL, SCATTER, WITHIN, noise_of, runs_at, undated


def drifting(seed: int, per_day: float, count: int = 9) -> tuple[list[RunBlocks], FloatArray]:
    """Runs a day apart whose bias grows, and their biases."""
    rng = np.random.default_rng(seed)
    biases = SCATTER * rng.standard_normal(count) + per_day * np.arange(count)
    return runs_at(np.full(count, 25.0), biases, rng), biases


def said(found: Diagnosis, words: Wording) -> str:
    """All sentences about the first effect."""
    effect = found.effects[0]
    return " ".join([verdict_sentence(found, words), words.coefficient(effect), *evidence(effect, found, words)])


@pytest.mark.parametrize("per_day", [0.06, 0.045])
def test_two_sizes_of_one_cause_are_named_by_the_runs_that_give_them(per_day: float) -> None:
    runs, biases = drifting(4, per_day)
    found = diagnose(runs, MODEL, declared_noise=noise_of(biases), turn_on_is_declared=False)
    (effect,) = found.effects
    test, own = effect.of_biases, effect.coefficients[0]
    assert test is not None
    assert test.value != own.value
    for words, of_training, of_all in (
        (Wording("en"), "{} deg/h/day in the training runs", "{} deg/h/day over all of them"),
        (Wording("zh"), "{} deg/h/day（训练试验）", "全部试验的系数为{} deg/h/day"),
    ):
        text = said(found, words)
        for size, wanted in ((own, of_training), (test, of_all)):
            bounds = words.size(size, "deg/h/day").removesuffix(" deg/h/day")
            assert text.count(bounds) == text.count(wanted.format(bounds)) > 0
    assert "for biases that are independent from run to run" in said(found, Wording("en"))
    assert "设各次试验的零偏相互独立" in said(found, Wording("zh"))


def test_with_no_run_held_out_a_cause_has_one_size() -> None:
    runs, biases = drifting(3, 0.04)
    found = diagnose(runs, MODEL, declared_noise=noise_of(biases), turn_on_is_declared=False, holdout=[])
    test, own = found.effects[0].of_biases, found.effects[0].coefficients[0]
    assert test is not None
    assert (test.value, test.lo, test.hi) == (own.value, own.lo, own.hi)
    assert found.model is not None
    assert own.value == found.model.coefficients[-1]
    assert "in the training runs" not in said(found, Wording("en"))


@pytest.mark.parametrize(
    ("count", "is_dated", "why", "zh"),
    [(4, True, "not enough runs, 4 of the 5 needed", "试验次数不足，有4次，需要5次"),
     (6, False, "6 of 6 runs have no date", "6次试验中有6次没有日期"), (6, True, None, None)],
)  # fmt: skip
def test_runs_that_cannot_be_compared_say_why(count: int, is_dated: bool, why: str | None, zh: str | None) -> None:
    runs, biases = drifting(6, 0.0, count)
    if not is_dated:
        runs = undated(runs, [run.run for run in runs])
    noise = WITHIN if count < 5 else noise_of(biases)
    found = diagnose(runs, MODEL, declared_noise=noise, turn_on_is_declared=False)
    assert found.verdict is ModelVerdict.NOTHING_MISSING
    caveats = [each for each in found.limits if "not compared with" in each]
    assert len(caveats) == (why is not None)
    for each in caveats:
        assert str(why) in each
        assert isinstance(each, Bilingual)
        assert str(zh) in each.zh


@pytest.mark.parametrize("far", [0, 2])
def test_one_far_run_confirms_nothing(far: int) -> None:
    """A run at another temperature, whose bias differs: held-out runs are right with it as soon as their bias is."""
    rng = np.random.default_rng(1)
    levels, biases = 25.0 + 0.5 * rng.standard_normal(9), SCATTER * rng.standard_normal(9)
    levels[far], biases[far] = 60.0, biases[far] + 0.6
    found = diagnose(runs_at(levels, biases, rng), MODEL, declared_noise=noise_of(biases), turn_on_is_declared=False)
    assert (found.verdict, found.names, found.effects[0].confirmed) == (
        ModelVerdict.UNREPLICATED,
        ("temperature",),
        None,
    )
    assert found.effects[0].sole_run == f"r0{far}"
    assert f"run r0{far} alone shows it" in verdict_sentence(found, Wording("en"))
    assert f"仅由试验r0{far}显示" in said(found, Wording("zh"))
    assert any(each.startswith(f"temperature: run r0{far} alone shows it") for each in found.limits)


def last_run_far(seed: int, count: int) -> Diagnosis:
    """Runs at one temperature and a last, held-out one at another, whose bias differs: the training tells no size."""
    rng = np.random.default_rng(seed)
    levels, biases = np.full(count, 25.0), 0.02 * rng.standard_normal(count)
    levels[-1], biases[-1] = 60.0, biases[-1] + 0.5
    return diagnose(runs_at(levels, biases, rng), MODEL, declared_noise=noise_of(biases), turn_on_is_declared=False)


@pytest.mark.parametrize(("seed", "count"), [(1, 9), (4, 9), (2, 5)])
def test_one_far_run_is_named_where_the_held_out_runs_refuse(seed: int, count: int) -> None:
    found, far = last_run_far(seed, count), f"r0{count - 1}"
    (effect,) = found.unreplicated
    assert (found.verdict, found.effects, effect.confirmed) == (ModelVerdict.UNREPLICATED, (), False)
    assert effect.sole_run == far
    assert verdict_sentence(found, Wording("en")).endswith(
        f"; run {far} alone shows it: without it the biases of the other runs do not."
    )
    assert f"；仅由试验{far}显示" in verdict_sentence(found, Wording("zh"))
    assert any(f"since run {far} alone shows it" in each for each in evidence(effect, found, Wording("en")))
    (caveat,) = [each for each in found.limits if f"run {far} alone shows it" in each]
    assert "slope" not in caveat
    assert all("0.000 ± 0.000" not in each for each in evidence(effect, found, Wording("en")))
    (told,) = msgspec.structs.replace(found, declared_noise=None).document()["unreplicated"]
    assert told["sole_run"] == far
    assert [each["name"] for each in told["confounded"]] == [other.name for other in effect.confounded] != []


def test_no_slope_is_given_where_the_training_gives_no_size_or_the_held_out_runs_tell_nothing() -> None:
    found = last_run_far(1, 9)
    (effect,), holdout = found.unreplicated, found.holdout
    assert holdout is not None
    assert effect.coefficients[0].lo < 0 < effect.coefficients[0].hi
    effect = msgspec.structs.replace(effect, sole_run=None)
    unsized = msgspec.structs.replace(found, unreplicated=(effect,))
    assert verdict_sentence(unsized, Wording("en")).endswith(
        "; the training runs alone give no size of it that the held-out runs could confirm."
    )
    slope = msgspec.structs.replace(holdout.effects[0], slope=0.0, slope_se=1e-150, sole_run=None)
    hidden = msgspec.structs.replace(unsized, holdout=msgspec.structs.replace(holdout, effects=(slope,)))
    for each in (effect, msgspec.structs.replace(effect, of_biases=None)):
        said = msgspec.structs.replace(hidden, unreplicated=(each,))
        assert verdict_sentence(said, Wording("en")).endswith("the held-out runs have nothing that tells of it.")
        assert "The held-out runs have nothing that tells of it." in list(evidence(each, said, Wording("en")))


def second_far_run() -> Diagnosis:
    """Two runs at another temperature agree in their biases."""
    rng = np.random.default_rng(1)
    levels, biases = 25.0 + 0.5 * rng.standard_normal(9), SCATTER * rng.standard_normal(9)
    levels[[2, 7]] = 60.0
    biases[[2, 7]] += 0.6
    return diagnose(runs_at(levels, biases, rng), MODEL, declared_noise=noise_of(biases), turn_on_is_declared=False)


def test_a_second_far_run_that_agrees_confirms() -> None:
    found = second_far_run()
    assert found.verdict in (ModelVerdict.EFFECT_FOUND, ModelVerdict.CONFOUNDED)
    assert found.effects[0].confirmed
    assert found.effects[0].sole_run is None


def test_an_effect_whose_bounds_contain_zero_is_not_confirmed_by_its_slope() -> None:
    found = second_far_run()
    effect, holdout = found.effects[0], found.holdout
    assert holdout is not None
    assert effect.confirmed
    assert not effect.has_no_size
    none = msgspec.structs.replace(effect.coefficients[0], value=0.0, lo=0.0)
    unsized = msgspec.structs.replace(effect, coefficients=(none,), of_biases=None)
    assert unsized.has_no_size
    sentences = list(evidence(unsized, found, Wording("en")))
    assert any(each.endswith("no confirmation, since its bounds contain zero.") for each in sentences)
    assert not any(each.endswith(": confirmed.") for each in sentences)
