"""A diagnosis as one HTML file without network, scripts or other files."""

import base64
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from analytics.loop.effects.registry import effect
from analytics.loop.report import finding_sentences as sentences
from analytics.loop.report import report_tables as tables
from analytics.loop.report.diagnosis_plots import figures_of
from analytics.loop.report.drivers import bias_over_temperature, scale_factor_over_rate
from analytics.loop.report.next_test_rows import bounds_sentence, next_test_rows, next_test_sentence
from analytics.loop.report.scrutiny_rows import coherence_rows, provenance_rows, recovery_sentences, regressor_rows
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Language, Wording
from analytics.loop.residuals import residual_allan
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from analytics.loop.unit_diagnosis import UnitDiagnosis, UnitsDiagnosis
from stream.errors import BadInput

_DPI = 110


def write_report(found: UnitsDiagnosis, path: Path, language: Language) -> None:
    """Write the report of a diagnosis; of several units, those without a finding have tables, but no pictures."""
    try:
        path.write_text(report_html(found, language), encoding="utf-8")
    except OSError as error:
        raise BadInput(f"report {path}: cannot be written ({error.strerror or error}); name another file") from error


def report_html(found: UnitsDiagnosis, language: Language) -> str:
    """The report as HTML."""
    is_one = len(found.units) == 1 and not found.failed and found.fleet is None
    words = Wording(language, next(iter(found.units.values())).data.runs[0])
    count = len(found.units)
    of = next(iter(found.units)) if is_one else words.of(f"{count} units", f"{count}个产品")
    pages = Environment(loader=PackageLoader(__package__), autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    pages.filters["in_language"] = lambda text, words: words.text(text)
    return pages.get_template("diagnosis.html.jinja").render(
        words=words,
        title=f"{words.of('Diagnosis of', '诊断：')} {of}",
        is_one=is_one,
        fleet=found.fleet,
        overview=sentences.unit_rows(found, words),
        units=[_unit(each, Wording(language, each.data.runs[0]), is_one=is_one) for each in found.units.values()],
        library_effect=effect,
        evidence=sentences.evidence,
        alternative=sentences.alternative,
        separating_tests=_separating_tests,
        fleet_rows=sentences.fleet_rows,
        fleet_sentence=sentences.fleet_sentence,
        verdict_sentence=verdict_sentence,
    )


def _separating_tests(found: FoundEffect, words: Wording) -> list[str]:
    others = (sentences.separating_test(each, words) for each in found.confounded)
    return list(dict.fromkeys([sentences.separating_test(found, words), *others]))


def _unit(found: UnitDiagnosis, words: Wording, *, is_one: bool) -> dict[str, Any]:
    """What the template shows of one unit."""
    diagnosis, notes = found.diagnosis, found.data.notes
    declared = [tables.noise_rows(diagnosis, words)]
    if diagnosis.judged is not None:
        title = words.of("Declared model as fitted", "已声明模型的拟合结果")
        declared.insert(0, tables.coefficient_rows(diagnosis.judged, title, words))
    has_pictures = is_one or bool(diagnosis.effects or diagnosis.unreplicated)
    caveats = [each for each in diagnosis.limits if each not in diagnosis.losses]
    return {
        "found": found,
        "words": words,
        "declared": declared,
        **_errors(found, words),
        "pictures": _pictures(figures_of(found, words)) if has_pictures else None,
        "caveats": _texts([*caveats, *(note.text for note in notes if note.is_limit)], words),
        "notes": _texts((note.text for note in notes if not note.is_limit), words),
        "absent": tables.absent_rows(diagnosis, words),
        "scrutiny": [
            *([regressor_rows(found.regressors, words)] if found.regressors else []),
            *([coherence_rows(found.coherence, words)] if found.coherence else []),
            provenance_rows(found.provenance, words),
        ],
        "recovery": recovery_sentences(found.recovery or {}, words),
        "left": found.left and words.clause(found.left.sentence),
        "next_test": found.next_test and next_test_sentence(found.next_test, words),
        "plans": found.next_test and found.next_test.plans and next_test_rows(found.next_test, words),
        "bounds": found.next_test and bounds_sentence(found.next_test, words),
    }


def _errors(found: UnitDiagnosis, words: Wording) -> dict[str, Any]:
    """Tables of the errors before and after; empty without a diagnosis."""
    diagnosis = found.diagnosis
    residuals = found.residuals
    if diagnosis.error is None or residuals is None:
        return {"errors": []}
    curves: list[tables.TextTable] = []
    over_temperature, over_rate = bias_over_temperature(residuals), scale_factor_over_rate(residuals)
    if over_temperature is not None:
        title = words.of("Bias error over temperature, including turn-on scatter", "零偏误差随温度（含逐次启动散布）")
        curves.append(tables.driver_rows(over_temperature, title, words))
    if over_rate is not None:
        title = words.of("Scale-factor error over rate", "标度因数误差随角速率")
        curves.append(tables.driver_rows(over_rate, title, words))
    curves.append(tables.allan_rows(residual_allan(residuals), residuals.unit_of_measure, words))
    if diagnosis.model is not None and diagnosis.effects:
        curves.append(tables.coefficient_rows(diagnosis.model, words.of("Model found", "所得模型"), words))
    errors = [tables.error_rows(diagnosis.error, words), tables.gain_rows(diagnosis.error, words)]
    return {
        "errors": [each for each in errors if each.rows],
        "achieved": tables.achieved(diagnosis.error, words),
        "curves": curves,
    }


def _texts(texts: Iterable[str], words: Wording) -> list[str]:
    return [words.text(each) for each in texts]


def _pictures(figures: dict[str, Figure]) -> dict[str, str]:
    encoded = {}
    for name, figure in figures.items():
        image = io.BytesIO()
        figure.savefig(image, format="png", dpi=_DPI)
        encoded[name] = base64.b64encode(image.getvalue()).decode()
    return encoded
