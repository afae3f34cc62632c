"""The report of a diagnosis as HTML, pictures and text on the terminal."""

import base64
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import pytest
from matplotlib.figure import Figure

from analytics.commands.closed_loop.diagnose_output import print_unit
from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.left_out import LeftOut
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.report.diagnosis_html import report_html, write_report
from analytics.loop.report.diagnosis_plots import figures_of, write_figures
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Language, Wording
from analytics.loop.tracing.fleet import diagnose_fleet
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.tracing.whitening.stack import NO_CHANNEL_VALUE
from analytics.loop.unit_diagnosis import UnitDiagnosis, UnitsDiagnosis, held_out_runs
from analytics.loop.unit_reduction import GIVEN, ReducedUnit
from stream.errors import BadInput
from tests.bench.loop_campaign import DECLARED_MODEL, Campaign, Planted
from tests.diagnosed_units import NOISE, SHUPE, as_units, diagnosed


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


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
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
        {unit: UnitDiagnosis(ReducedUnit(runs, (), NOISE, GIVEN), fleet.units[unit]) for unit, runs in units.items()},
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


@pytest.mark.long
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


@pytest.mark.long
def test_a_report_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="name another file"):
        write_report(as_units(diagnosed()), tmp_path / "missing" / "r.html", "en")
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="folder for plots"):
        write_figures(diagnosed(), tmp_path / "file", Wording("en"))


@pytest.mark.in_gate("zh")
@pytest.mark.parametrize(
    ("language", "words"),
    [("en", "91% of the excitation of input_rate left out"), ("zh", "略去input_rate的激励的91%")],
    ids=["en", "zh"],
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
