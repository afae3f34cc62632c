"""The verdict of a diagnosis in one sentence."""

import re
from collections.abc import Sequence
from typing import Any

import msgspec

from analytics.loop.bilingual import Bilingual
from analytics.loop.report.finding_sentences import alternative
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Language, Wording
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.tracing.result.holdout import ErrorGain, ExpectedGain, HeldOutAnswer, Holdout, HoldoutSlope
from analytics.loop.tracing.verdict.caveats import hidden_delay_caveat, no_size_caveat
from analytics.loop.tracing.verdict.held_out_caveats import holdout_caveats
from tests.diagnosed_units import NOISE, SHUPE, a_finding, diagnosed


def test_a_clock_is_asked_for_an_offset_that_a_reader_can_judge() -> None:
    """40 deg/h/(degC/s) over 0.012 deg/h/degC: no clock is off by most of an hour."""
    found = diagnosed()
    others = {each.name: each for each in found.diagnosis.effects[0].confounded}
    late = others["temperature_time_offset"]
    assert late.implied is not None
    # the least that the declared coefficient allows, which is known to about a tenth
    assert 0.5 * SHUPE / 0.012 < late.implied < SHUPE / 0.012
    assert not late.is_plausible
    reported = alternative(late, Wording("en"))
    assert "but clocks are off by 120 s at most: unlikely" in reported
    assert "时钟偏差至多120 s" in alternative(late, Wording("zh"))
    document = found.diagnosis.document()["confounded"]
    assert [each["implied"]["plausible"] for each in document if each["name"] == "temperature_time_offset"] == [False]
    late = msgspec.structs.replace(late, implied=80.0)
    assert "it would need at least 80 s" in alternative(late, Wording("en"))


NINE_BLOCKS = Bilingual("9 blocks", "9个数据块")


def verdicts() -> Sequence[Diagnosis]:
    confounded = diagnosed().diagnosis.effects[0].confounded
    head: dict[str, Any] = {"units": ("FOG-1",), "signal": "rate", "runs": ("a", "b", "c")}
    jump = msgspec.structs.replace(a_finding(), name="jump", parameters={"run": "a", "at_s": 60.0}, replicates=False)
    return [
        Diagnosis(verdict=ModelVerdict.NOTHING_MISSING, declared_noise=NOISE, **head),
        Diagnosis(verdict=ModelVerdict.NOTHING_MISSING, **head),
        Diagnosis(verdict=ModelVerdict.NOTHING_MISSING, declared_noise=NOISE, scatter=NINE_BLOCKS, **head),
        Diagnosis(verdict=ModelVerdict.EFFECT_FOUND, effects=(a_finding(),), **head),
        Diagnosis(verdict=ModelVerdict.EFFECT_FOUND, effects=(a_finding(), a_finding(name="warm_up")), **head),
        Diagnosis(verdict=ModelVerdict.CONFOUNDED, effects=(a_finding(confounded=confounded), jump), **head),
        Diagnosis(
            verdict=ModelVerdict.CONFOUNDED,
            effects=(a_finding(confounded=confounded),),
            replication="within_run",
            **head,
        ),
        Diagnosis(
            verdict=ModelVerdict.UNKNOWN_FUNCTION, effects=(a_finding(unknown_function_of=("temperature",)),), **head
        ),
        Diagnosis(verdict=ModelVerdict.UNREPLICATED, effects=(a_finding(),), replication="within_run", **head),
        Diagnosis(verdict=ModelVerdict.UNREPLICATED, unreplicated=(a_finding(confirmed=False),), **head),
        Diagnosis(verdict=ModelVerdict.UNREPLICATED, unreplicated=(a_finding(largest_share=0.99),), **head),
        Diagnosis(
            verdict=ModelVerdict.UNREPLICATED, unreplicated=(a_finding(largest_share=0.99, replicates=False),), **head
        ),
        Diagnosis(
            verdict=ModelVerdict.UNREPLICATED, unreplicated=(a_finding(largest_share=0.34, replicates=False),), **head
        ),
        Diagnosis(verdict=ModelVerdict.UNREPLICATED, effects=(jump,), **head),
        Diagnosis(verdict=ModelVerdict.UNEXPLAINED, noise_excess=2.5, **head),
        Diagnosis(verdict=ModelVerdict.UNEXPLAINED, noise_excess=2.5, effects=(jump,), **head),
        Diagnosis(
            verdict=ModelVerdict.UNEXPLAINED, noise_excess=2.5, unreplicated=(a_finding(confirmed=False),), **head
        ),
        Diagnosis(verdict=ModelVerdict.UNEXPLAINED, effects=(jump, jump), **head),
        Diagnosis(verdict=ModelVerdict.NOT_ENOUGH_DATA, missing=(NINE_BLOCKS,), **head),
    ]  # fmt: skip


def test_every_verdict_is_a_sentence_of_its_own_in_both_languages() -> None:
    assert {each.verdict for each in verdicts()} == set(ModelVerdict)
    stops: dict[Language, str] = {"en": ".", "zh": "。"}
    for language, stop in stops.items():
        reported = [verdict_sentence(each, Wording(language)) for each in verdicts()]
        assert len(set(reported)) == len(reported)
        for text in reported:
            assert text.endswith(stop)
            assert text.count(stop + " ") == 0
            assert not re.search(r"[{}]|None|nan|_", text), text
            assert bool(re.search("[\u4e00-\u9fff]", text)) is (language == "zh")


def test_evidence_of_many_runs_is_not_said_to_come_from_one() -> None:
    texts = [verdict_sentence(each, Wording("en")) for each in verdicts()]
    assert [each for each in texts if "99% of its evidence comes from one run" in each]
    assert not [each for each in texts if "34%" in each]


def test_a_sentence_names_what_was_found_its_alternatives_and_what_it_wins() -> None:
    found = diagnosed()
    text = verdict_sentence(found.diagnosis, Wording("en", found.data.runs[0]))
    assert found.diagnosis.verdict is ModelVerdict.CONFOUNDED
    assert text.startswith(
        "The declared model lacks one of several effects, which these data cannot separate: temperature rate"
    )
    assert re.search(r"or time offset of the temperature sensor \(unlikely: it would need [1-9],\d{3} s\)", text)
    assert "3 held-out runs confirm it" in text
    assert re.search(r"RMS error over \d+ s there falls from", text)


def test_of_several_effects_the_one_that_explains_most_comes_first() -> None:
    """By its share of the held-out error, not by its evidence, whatever the verdict; the others come after it."""
    other = diagnosed().diagnosis.effects[0].confounded[:1]
    small = a_finding(confirmed=True, error_share=0.05)
    large = a_finding(name="warm_up", evidence=50.0, confirmed=True, error_share=0.62)
    jump = msgspec.structs.replace(a_finding(), name="jump", parameters={"run": "a", "at_s": 60.0}, replicates=False)
    for verdict, first in (
        (ModelVerdict.EFFECT_FOUND, small),
        (ModelVerdict.CONFOUNDED, msgspec.structs.replace(small, confounded=other)),
        (ModelVerdict.UNKNOWN_FUNCTION, msgspec.structs.replace(small, unknown_function_of=("temperature",))),
    ):
        found = Diagnosis(verdict=verdict, units=("FOG-1",), signal="rate", effects=(jump, first, large))
        text = verdict_sentence(found, Wording("en"))
        assert text.startswith("The declared model lacks 2 effects, the largest first: warm-up")
        assert "62% of the squared error; and temperature rate" in text
        assert text.index("temperature rate") < text.index("also, a bias jump")
        assert "按大小排列" in verdict_sentence(found, Wording("zh"))


def test_caveats_name_effects_in_the_words_of_the_field() -> None:
    found = a_finding(name="function_of_input_rate")
    held_out = [
        HoldoutSlope(found.name, 0.4, 0.1, 0.1, accepted=False, answer=HeldOutAnswer.NO_POWER),
        HoldoutSlope(found.name, 0.4, 0.1, 0.1, accepted=True, answer=HeldOutAnswer.CONFIRMED),
        HoldoutSlope(found.name, 1.0, 0.1, 0.1, accepted=False, walk_log_odds=0.0),
        HoldoutSlope(found.name, 1.0, 0.1, 0.1, accepted=False, is_independent=False),
        HoldoutSlope(found.name, 1.0, 0.1, 0.1, accepted=False, answer=HeldOutAnswer.NO_POWER, raises_error=True),
    ]
    texts = [each for one in held_out for each in holdout_caveats(Holdout(("r",), one, (one,)), [found])]
    assert len(texts) == len(held_out)
    for each in (*texts, hidden_delay_caveat(found), no_size_caveat(found)):
        assert each.startswith("function of input rate")
        assert each.zh.startswith("输入角速率的未知函数")
        assert found.name not in each + each.zh


def test_shares_are_without_the_noise_of_rounding() -> None:
    diagnosis = diagnosed().diagnosis
    error = diagnosis.error
    assert error is not None
    rows = tuple(msgspec.structs.replace(each, gain_within=ErrorGain(0.9, -0.1, 1.0, 3)) for each in error.rows)
    gain = ExpectedGain(0.998, 6.6e-18, 1.0, 3, averaging_s=1800.0)
    text = verdict_sentence(
        msgspec.structs.replace(diagnosis, error=msgspec.structs.replace(error, rows=rows, gain=gain)), Wording("en")
    )
    assert "is expected to fall by 100 % (0 % to 100 %)" in text


def test_a_gain_about_the_mean_is_not_stated_of_an_effect_on_means() -> None:
    diagnosis = diagnosed().diagnosis
    error = diagnosis.error
    assert error is not None
    rows = tuple(
        msgspec.structs.replace(
            each, before=0.308, after=0.0175, before_within=0.00727, after_within=0.00717,
            gain_within=ErrorGain(0.001, -0.1, 0.1, 3),
        )
        for each in error.rows
    )  # fmt: skip
    gain = ExpectedGain(0.0011, 0.001, 0.0012, 3, averaging_s=1800.0)
    text = verdict_sentence(
        msgspec.structs.replace(diagnosis, error=msgspec.structs.replace(error, rows=rows, gain=gain)), Wording("en")
    )
    assert "from 0.308 to 0.0175" in text
    assert "expected to fall" not in text
