"""The report of a diagnosis: what its tables say against what was planted, its words, and the file that it makes."""

import base64
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from matplotlib.figure import Figure

from analytics.commands.diagnose_output import print_unit
from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.checks import Note
from analytics.loop.blocks.left_out import LeftOut
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.report.diagnosis_html import report_html, write_report
from analytics.loop.report.diagnosis_plots import figures_of, write_figures
from analytics.loop.report.effect_driver import drawn
from analytics.loop.report.error_by_driver import bias_over_temperature, scale_factor_over_rate
from analytics.loop.report.finding_sentences import alternative
from analytics.loop.report.residual_curves import residual_allan, whitened_spectrum
from analytics.loop.report.residuals import Residuals, residuals_of
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Language, Wording
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.fleet import diagnose_fleet, significant_findings
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.tracing.result.finding import EffectCoefficient, FoundEffect
from analytics.loop.tracing.whitening.stack import NO_CHANNEL_VALUE
from analytics.loop.unit_diagnosis import UnitDiagnosis, UnitsDiagnosis, held_out_runs
from analytics.loop.unit_reduction import ReducedUnit
from stream.errors import BadInput
from tests.bench.loop_campaign import DECLARED_MODEL, Campaign, Planted

SHUPE = 40.0  # deg/h per degC/s
SQUARE = 2e-3  # deg/h/degC^2
NOISE = NoiseCoefficients(N=0.005, B=0.02, K=0.01, turn_on=0.3)


@cache
def diagnosed(name: str = "temperature_rate", size: float = SHUPE) -> UnitDiagnosis:
    """Nine runs of two hours with one effect that was not declared."""
    campaign = Campaign(3, runs=9, types=("temperature", "rate", "static"), duration_s=7200.0, step_s=5.0)
    runs = tuple(campaign.runs([Planted(name, [size])] if size else [], channels=("input_rate", "temperature")))
    found = diagnose(runs, ErrorModel.parse(DECLARED_MODEL), declared_noise=NOISE)
    notes = (Note("counts", "a <remark>", "temperature"), Note("output", "a limit", None, (), is_limit=True))
    return UnitDiagnosis(ReducedUnit(runs, notes, NOISE, "as given"), found)


def left(found: UnitDiagnosis) -> Residuals:
    residuals = residuals_of(found.data.runs, found.diagnosis)
    assert residuals is not None
    return residuals


def as_units(*found: UnitDiagnosis) -> UnitsDiagnosis:
    units = {each.unit: each for each in found}
    return UnitsDiagnosis(units, {}, significant_findings({unit: each.diagnosis for unit, each in units.items()}))


def test_residuals_are_those_of_the_models_and_the_held_out_set_is_the_last_third() -> None:
    found = diagnosed()
    residuals = left(found)
    names = [run.run for run in found.data.runs]
    stack = residuals.record.stack
    told = {names[number] for number in np.unique(stack.run_number[residuals.held_out])}
    assert told == set(names[6:])
    assert found.diagnosis.model is not None
    expected = np.concatenate([found.diagnosis.model.residual(run) for run in stack.runs])
    np.testing.assert_allclose(residuals.after, expected, rtol=0, atol=1e-12)
    assert found.diagnosis.error is not None
    told_error = found.diagnosis.error.rows[0]  # of one block
    rms = [np.sqrt(np.mean(each[residuals.judged] ** 2)) for each in (residuals.before, residuals.after)]
    np.testing.assert_allclose(rms, [told_error.before, told_error.after], rtol=1e-9)


def test_noise_variance_is_that_of_the_dense_covariance_over_gaps_and_runs() -> None:
    residuals = left(diagnosed())
    record = residuals.record
    keep = np.ones(len(record), dtype=bool)
    keep[30:70] = keep[100:101] = False
    part = record.stack.part(keep)
    thinned = replace(residuals, record=replace(record, stack=part, steps=part.steps, white=record.white[keep]))
    weights = np.random.default_rng(1).standard_normal(len(part))
    dense = 0.0
    for run in np.unique(part.run_number):
        own = part.run_number == run
        covariance = record.noise_model.covariance(
            residuals.noise, part.slot[own].astype(float), thinned.record.white[own]
        )
        dense += weights[own] @ covariance @ weights[own]
    assert thinned.noise_variance(weights) == pytest.approx(dense, rel=1e-9)


def test_allan_deviation_of_the_residual_is_the_definition_and_leaves_out_gaps() -> None:
    residuals = left(diagnosed())
    record = residuals.record
    chosen = np.flatnonzero(residuals.held_out)
    gap = chosen[20:25]
    keep = np.ones(len(record), dtype=bool)
    keep[gap] = False
    part = record.stack.part(keep)
    thinned = Residuals(
        replace(record, stack=part), residuals.noise, residuals.before[keep], residuals.after[keep],
        residuals.held_out[keep],
    )  # fmt: skip
    at = {each.tau_s: each for each in residual_allan(thinned)}
    squares = []
    for run in np.unique(part.run_number[thinned.held_out]):
        rows = np.flatnonzero(part.run_number == run)
        by_slot = dict(zip(part.slot[rows].tolist(), thinned.after[rows].tolist(), strict=True))
        for start in range(max(by_slot) + 1):
            values = [by_slot.get(start + step) for step in range(8)]
            if None not in values:
                numbers = np.array(values, dtype=float)
                squares.append((numbers[4:].mean() - numbers[:4].mean()) ** 2)
    assert at[120.0].differences == len(squares)
    assert at[120.0].after == pytest.approx(np.sqrt(np.mean(squares) / 2), rel=1e-9)
    assert at[120.0].lo < at[120.0].after < at[120.0].hi


def test_long_allan_deviation_falls_to_the_noise_with_the_effect() -> None:
    deviations = [each for each in residual_allan(left(diagnosed())) if each.tau_s >= 240]
    assert max(each.before / each.after for each in deviations) > 2
    assert all(each.lo < each.floor * 1.5 for each in deviations)  # the floor is within reach of the limits


def test_bias_over_temperature_shows_what_was_planted_and_then_only_noise() -> None:
    found = diagnosed("temperature_squared", SQUARE)
    residuals = left(found)
    table = bias_over_temperature(residuals)
    assert table is not None
    assert table.channel == "temperature"
    errors = np.array([[each.before, each.after, each.floor] for each in table.classes])
    before, after, floor = errors.T
    # 5 standard deviations: one in 10^6 in each of 8 classes, the error of the fitted coefficients is far less
    assert np.all(np.abs(after) < 5 * floor)
    assert np.ptp(before - after) > 3 * np.ptp(after)
    assert sum(each.blocks for each in table.classes) <= np.count_nonzero(residuals.held_out)


def test_scale_factor_over_rate_finds_a_planted_error_in_ppm() -> None:
    residuals = left(diagnosed())
    rate = residuals.channel("input_rate")
    wrong = replace(residuals, before=residuals.after + 25e-6 * 3600.0 * rate)
    table = scale_factor_over_rate(wrong)
    assert table is not None
    assert table.unit_of_measure == "ppm"
    for each in table.classes:
        assert each.before - each.after == pytest.approx(25.0, rel=1e-9)
        assert abs(each.after) < 5 * each.floor


def test_whitened_spectrum_is_one_with_the_effect_and_above_without() -> None:
    spectrum = whitened_spectrum(left(diagnosed()))
    assert spectrum is not None
    inside = np.mean((spectrum.after > spectrum.lo) & (spectrum.after < spectrum.hi))
    assert inside >= 0.7  # 95 % expected of about 16 bins; fewer than 12 of 16 has a chance of 1e-4
    assert np.max(spectrum.before / spectrum.hi) > 2


@pytest.mark.parametrize(("name", "size", "over"), [
    ("temperature_squared", SQUARE, "temperature (degC)"),
    ("temperature_rate", SHUPE, "temperature rate (Shupe) (degC/s)"),
])  # fmt: skip
def test_an_effect_is_drawn_over_what_it_is_a_function_of(name: str, size: float, over: str) -> None:
    found = diagnosed(name, size)
    effect = next(each for each in found.diagnosis.effects if each.name == name)
    shown = drawn(left(found), effect, Wording("en", found.data.runs[0]))
    assert shown is not None
    assert shown.label == over
    # the partial residual follows the prediction with a slope of one
    slope = np.polyfit(shown.predicted, shown.partial, 1)[0]
    assert slope == pytest.approx(1.0, abs=0.1)


def test_a_jump_is_drawn_over_the_time_of_its_run_and_a_line_is_not() -> None:
    found = diagnosed()
    residuals = left(found)
    stack = residuals.record.stack
    run = stack.runs[2]
    step = 3.0 * ((stack.run_number == 2) & (stack.column(lambda each: each.time_s) > 3600.0))
    with_jump = replace(residuals, after=residuals.after + step)
    size = (EffectCoefficient("", 3.0, 2.9, 3.1, "deg/h"),)
    jump = a_finding(name="jump", parameters={"run": run.run, "at_s": 3600.0}, coefficients=size)
    shown = drawn(with_jump, jump, Wording("en"))
    assert shown is not None
    assert shown.driver.size == len(run)
    seen = shown.partial[shown.driver > 3600].mean() - shown.partial[shown.driver < 3600].mean()
    quiet = residuals.after[stack.run_number == 2]
    noise = quiet[shown.driver > 3600].mean() - quiet[shown.driver < 3600].mean()
    assert seen == pytest.approx(3.0 + noise, rel=1e-9)
    assert drawn(residuals, a_finding(name="periodic_line", parameters={"frequency_hz": 0.01}), Wording("en")) is None


def test_a_clock_is_asked_for_an_offset_that_a_reader_can_judge() -> None:
    """40 deg/h/(degC/s) over 0.012 deg/h/degC: no clock is off by most of an hour."""
    found = diagnosed()
    others = {each.name: each for each in found.diagnosis.effects[0].confounded}
    late = others["temperature_time_offset"]
    assert late.implied is not None
    # the least that the declared coefficient allows, which is known to about a tenth
    assert 0.5 * SHUPE / 0.012 < late.implied < SHUPE / 0.012
    assert not late.is_plausible
    told = alternative(late, Wording("en"))
    assert "but clocks are off by 120 s at most: unlikely" in told
    assert "时钟偏差至多120 s" in alternative(late, Wording("zh"))
    document = found.diagnosis.document()["confounded"]
    assert [each["implied"]["plausible"] for each in document if each["name"] == "temperature_time_offset"] == [False]
    late = msgspec.structs.replace(late, implied=80.0)
    assert "it would need at least 80 s" in alternative(late, Wording("en"))


NINE_BLOCKS = Bilingual("9 blocks", "9个数据块")


def a_finding(**more: Any) -> FoundEffect:
    coefficient = EffectCoefficient("", 14.5, 13.2, 15.8, "deg/h/(degC/s)")
    head = FoundEffect("temperature_rate", {}, (coefficient,), 13.4, 170.0, {"temperature": "cause"})
    return msgspec.structs.replace(head, **more)


def verdicts() -> Sequence[Diagnosis]:
    confounded = diagnosed().diagnosis.effects[0].confounded
    head: dict[str, Any] = {"units": ("FOG-1",), "signal": "rate", "runs": ("a", "b", "c")}
    jump = msgspec.structs.replace(a_finding(), name="jump", parameters={"run": "a", "at_s": 60.0}, replicates=False)
    return [
        Diagnosis(verdict=ModelVerdict.NOTHING_MISSING, declared_noise=NOISE, **head),
        Diagnosis(verdict=ModelVerdict.NOTHING_MISSING, **head),
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
        Diagnosis(verdict=ModelVerdict.UNREPLICATED, effects=(jump,), **head),
        Diagnosis(verdict=ModelVerdict.UNEXPLAINED, noise_excess=2.5, **head),
        Diagnosis(verdict=ModelVerdict.UNEXPLAINED, effects=(jump, jump), **head),
        Diagnosis(verdict=ModelVerdict.NOT_ENOUGH_DATA, missing=(NINE_BLOCKS,), **head),
    ]  # fmt: skip


def test_every_verdict_is_a_sentence_of_its_own_in_both_languages() -> None:
    assert {each.verdict for each in verdicts()} == set(ModelVerdict)
    for language, stop in (("en", "."), ("zh", "。")):
        told = [verdict_sentence(each, Wording(language)) for each in verdicts()]  # type: ignore[arg-type]
        assert len(set(told)) == len(told)
        for text in told:
            assert text.endswith(stop)
            assert text.count(stop + " ") == 0
            assert not re.search(r"[{}]|None|nan|_", text), text
            assert bool(re.search("[\u4e00-\u9fff]", text)) is (language == "zh")


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


class Page(HTMLParser):
    """Checks that tags close, and gathers pictures and links."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.pictures: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        assert tag not in ("script", "link", "iframe")
        assert "href" not in values
        if tag == "img":
            self.pictures.append(values["src"] or "")
        elif tag != "meta":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_report_needs_nothing_but_itself(language: Language) -> None:
    page = Page()
    page.feed(report_html(as_units(diagnosed()), language))
    page.close()
    assert page.open == []
    assert len(page.pictures) == 4  # driver, runs, spectrum, Allan
    for picture in page.pictures:
        head, data = picture.split(",")
        assert head == "data:image/png;base64"
        assert base64.b64decode(data).startswith(b"\x89PNG")
    text = "".join(page.text)
    for words in ("a <remark>", "a limit", {"en": "as given", "zh": "用户给定"}[language], "scale_factor"):
        assert words in text
    wanted = {
        "en": ("temperature rate (Shupe)", "Tests that separate them", "absent above", "Caveats", "Allan"),
        "zh": ("温度变化率（Shupe效应）", "可区分的测试", "不高于", "本判定的局限", "Allan"),
    }
    for words in wanted[language]:
        assert words in text


def test_of_several_units_those_without_a_finding_come_without_pictures() -> None:
    quiet = diagnosed("temperature_rate", 0.0)
    runs = tuple(replace(run, unit="FOG-<2>") for run in quiet.data.runs)
    other = UnitDiagnosis(replace(quiet.data, runs=runs), quiet.diagnosis)
    assert other.diagnosis.verdict is ModelVerdict.NOTHING_MISSING
    found = as_units(diagnosed(), other)
    assert list(found.own_findings) == ["FOG-0231"]
    page = Page()
    page.feed(report_html(found, "en"))
    assert len(page.pictures) == 4
    assert "FOG-<2>" in "".join(page.text)


def test_what_units_have_in_common_stands_first_in_the_report() -> None:
    units = {}
    for seed in (5, 6, 7):
        campaign = Campaign(
            seed, runs=6, types=("temperature", "static"), duration_s=5400.0, step_s=5.0, unit=f"FOG-{seed}"
        )
        planted = [Planted("temperature_rate", [SHUPE])]
        units[campaign.unit] = tuple(campaign.runs(planted, channels=("input_rate", "temperature")))
    fleet = diagnose_fleet(units, ErrorModel.parse(DECLARED_MODEL), declared_noise=dict.fromkeys(units, NOISE))
    found = UnitsDiagnosis(
        {
            unit: UnitDiagnosis(ReducedUnit(runs, (), NOISE, "as given"), fleet.units[unit])
            for unit, runs in units.items()
        },
        {"FOG-8": "no <signal>"},
        fleet.own_findings,
        fleet,
    )
    for language, words in (
        ("en", "The declared model lacks, in 3 units together: temperature rate"),
        ("zh", "3个产品合并分析，已声明模型缺少"),
    ):
        page = Page()
        page.feed(report_html(found, language))  # type: ignore[arg-type]
        text = "".join(page.text)
        assert words in text
        assert "no <signal>" in text
        assert text.count("FOG-6") >= 3  # in the common table, in the list of units, over its own section
    assert set(found.document()) >= {"verdict", "by_unit", "units", "own_findings", "failed"}


def test_pictures_are_the_same_bytes_each_time(tmp_path: Path) -> None:
    words = Wording("en", diagnosed().data.runs[0])
    first = {path.name: path.read_bytes() for path in write_figures(diagnosed(), tmp_path / "a", words)}
    again = {path.name: path.read_bytes() for path in write_figures(diagnosed(), tmp_path / "b", words)}
    assert first == again
    assert sorted(first) == [
        "FOG-0231-allan.png", "FOG-0231-by-run-temperature_rate.png", "FOG-0231-residual-temperature_rate.png",
        "FOG-0231-spectrum.png",
    ]  # fmt: skip


def test_chinese_pictures_are_drawn_with_the_fonts_that_are_there() -> None:
    figures = figures_of(diagnosed(), Wording("zh", diagnosed().data.runs[0]))
    assert all(isinstance(figure, Figure) for figure in figures.values())
    texts = [text.get_text() for figure in figures.values() for text in figure.texts]
    assert not any("\N{WHITE SQUARE}" in text for text in texts)


def test_a_report_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="name another file"):
        write_report(as_units(diagnosed()), tmp_path / "missing" / "r.html", "en")
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="folder for plots"):
        write_figures(diagnosed(), tmp_path / "file", Wording("en"))


@pytest.mark.parametrize(
    ("language", "words"), [("en", "91% of the excitation of input_rate left out"), ("zh", "略去input_rate的激励的91%")]
)
def test_what_was_left_out_comes_before_the_verdict(
    language: Language, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = diagnosed()
    lost = LeftOut(Bilingual("the excitation of input_rate", "input_rate的激励"), 0.91, NO_CHANNEL_VALUE, is_grave=True)
    diagnosis = msgspec.structs.replace(
        found.diagnosis, left_out=(lost,), limits=(lost.sentence, *found.diagnosis.limits)
    )
    found = replace(found, diagnosis=diagnosis)
    verdict = verdict_sentence(diagnosis, Wording(language, found.data.runs[0]))[:20]
    page = Page()
    page.feed(report_html(as_units(found), language))
    print_unit(found, language)
    for text in ("".join(page.text), capsys.readouterr().out):
        assert 0 <= text.index(words) < text.index(verdict)
        assert text.count(words) == 1


def test_not_enough_data_is_a_report_too() -> None:
    head = diagnosed()
    short = Diagnosis(
        verdict=ModelVerdict.NOT_ENOUGH_DATA,
        units=(head.unit,),
        signal="rate",
        missing=(Bilingual("9 blocks", "9个数据块"),),
    )
    text = report_html(as_units(UnitDiagnosis(head.data, short)), "en")
    assert "Not enough data for a verdict: 9 blocks." in text
    assert "<img" not in text


def test_a_run_to_hold_out_stands_for_its_power_ons() -> None:
    runs = [replace(run, run=name) for run, name in zip(diagnosed().data.runs, ("a#1", "a#2", "b"), strict=False)]
    assert held_out_runs(["a"], runs) == ("a#1", "a#2")
    assert held_out_runs(["a#2", "b"], runs) == ("a#2", "b")
    assert held_out_runs(None, runs) is None
    with pytest.raises(BadInput, match="run to hold out is not there: c; the runs are a#1, a#2, b"):
        held_out_runs(["c"], runs)
