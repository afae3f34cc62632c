"""A diagnosis as one HTML file that needs nothing else: no network, no script, pictures inside."""

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from string import Template

from matplotlib.figure import Figure

from analytics.loop.effects.registry import effect
from analytics.loop.report.diagnosis_plots import figures_of
from analytics.loop.report.error_by_driver import bias_over_temperature, scale_factor_over_rate
from analytics.loop.report.finding_sentences import alternative, evidence, separating_test
from analytics.loop.report.fleet_sentences import fleet_rows, fleet_sentence, unit_rows
from analytics.loop.report.report_tables import (
    TextTable,
    absent_rows,
    achieved,
    allan_rows,
    coefficient_rows,
    driver_rows,
    error_rows,
    gain_rows,
    noise_rows,
)
from analytics.loop.report.residual_allan import residual_allan
from analytics.loop.report.residuals import residuals_of
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Language, Wording
from analytics.loop.tracing.fleet import FleetDiagnosis
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.result.finding import FoundEffect
from analytics.loop.unit_diagnosis import UnitDiagnosis, UnitsDiagnosis
from stream.errors import BadInput

_DPI = 110
_PAGE = Template("""<!DOCTYPE html>
<html lang="$language">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { font: 15px/1.5 "Segoe UI", "Helvetica Neue", Arial, "Noto Sans CJK SC", "Microsoft YaHei", sans-serif;
  color: #1a1a1a; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #dfe3e8; }
h3 { font-size: 1rem; margin-bottom: 0.3rem; }
.verdict { font-size: 1.1rem; border-left: 5px solid #0072b2; background: #f3f7fa; padding: 0.7rem 1rem; }
table { border-collapse: collapse; margin: 0.6rem 0 1.2rem; font-size: 0.9rem; }
caption { text-align: left; font-weight: 600; padding-bottom: 0.2rem; }
th, td { padding: 0.2rem 0.8rem 0.2rem 0; border-bottom: 1px solid #dfe3e8; text-align: left; }
.number { text-align: right; }
th { color: #5f6b76; font-weight: 600; }
img { max-width: 100%; display: block; margin: 0.8rem 0; }
.soft { color: #5f6b76; font-size: 0.85rem; }
code { background: #f3f5f7; padding: 0.1rem 0.3rem; }
</style>
</head>
<body>
$body
</body>
</html>
""")


def write_report(found: UnitsDiagnosis, path: Path, language: Language) -> None:
    """Write the report of a diagnosis.

    Parameters
    ----------
    found: Of one unit or several; of several, those without a finding come with their tables, not with pictures.
    path: Where to.
    language: Of the text. What the reduction and the search remark stays English.

    Raises
    ------
    BadInput: If the file cannot be written.
    """
    try:
        path.write_text(report_html(found, language), encoding="utf-8")
    except OSError as error:
        raise BadInput(f"report {path}: cannot be written ({error.strerror or error}); name another file") from error


def report_html(found: UnitsDiagnosis, language: Language) -> str:
    """Return the report as HTML."""
    is_one = len(found.units) == 1 and not found.failed and found.fleet is None
    plain = Wording(language, next(iter(found.units.values())).data.runs[0])
    parts = []
    units = list(found.units)
    many = plain.of(f"{len(units)} units", f"{len(units)}个产品")
    title = f"{plain.of('Diagnosis of', '诊断：')} {units[0] if is_one else many}"
    if not is_one:
        parts.append(_overview(found, plain, title))
    for each in found.units.values():
        with_pictures = is_one or bool(each.diagnosis.effects or each.diagnosis.unreplicated)
        parts.append(_unit(each, Wording(language, each.data.runs[0]), with_pictures=with_pictures))
    return _PAGE.substitute(language=language, title=escape(title), body="\n".join(parts))


def _overview(found: UnitsDiagnosis, words: Wording, title: str) -> str:
    parts = [_heading(1, title)]
    if found.fleet is not None:
        parts.append(f'<p class="verdict">{escape(fleet_sentence(found.fleet, words))}</p>')
        parts += [_effect(each, found.fleet, words) for each in found.fleet.effects]
        parts += [_table(fleet_rows(name, rows, words)) for name, rows in found.fleet.by_unit.items()]
        parts.append(_listed(map(words.remark, found.fleet.limits)))
    parts.append(_table(unit_rows(found, words)))
    return "\n".join(parts)


def _unit(found: UnitDiagnosis, words: Wording, *, with_pictures: bool) -> str:
    diagnosis = found.diagnosis
    heading = f"{found.unit} \N{MIDDLE DOT} {diagnosis.signal}"
    parts = [
        _heading(1, heading),
        *(f'<p class="verdict">{escape(words.remark(text))}</p>' for text in diagnosis.losses),
        f'<p class="verdict">{escape(verdict_sentence(diagnosis, words))}</p>',
        _declared(found, words),
    ]
    parts += [_effect(each, diagnosis, words) for each in diagnosis.effects]
    if diagnosis.unreplicated:
        parts.append(_heading(2, words.of("Seen, but not repeated", "见到而未重现")))
        parts += [_effect(each, diagnosis, words, level=3) for each in diagnosis.unreplicated]
    parts.append(_error(found, words))
    if with_pictures:
        parts.append(_heading(2, words.of("Pictures", "图")))
        parts += [_picture(figure, name) for name, figure in figures_of(found, words).items()]
    parts.append(_limits(found, words))
    return "\n".join(parts)


def _declared(found: UnitDiagnosis, words: Wording) -> str:
    diagnosis = found.diagnosis
    parts = [_heading(2, words.of("What was declared", "已声明的内容"))]
    if diagnosis.judged is not None:
        parts.append(f"<p><code>{escape(str(diagnosis.judged))}</code></p>")
        title = words.of("Declared model as fitted", "已声明模型的拟合结果")
        parts.append(_table(coefficient_rows(diagnosis.judged, title, words)))
    parts.append(_table(noise_rows(diagnosis, words)))
    source = words.of("Declared noise", "已声明噪声的来源")
    parts.append(f'<p class="soft">{source}: {escape(words.remark(found.data.noise_source))}</p>')
    trained, runs = words.of("Training", "训练"), words.of("of", "共")
    counted = f"{trained}: {', '.join(diagnosis.training_runs)} ({runs} {', '.join(diagnosis.runs)})"
    parts.append(f'<p class="soft">{escape(counted)}</p>')
    return "\n".join(parts)


def _effect(found: FoundEffect, diagnosis: Diagnosis | FleetDiagnosis, words: Wording, level: int = 2) -> str:
    known = effect(found.name)
    start = words.of("Found: ", "发现：") if level == 2 else ""
    parts = [
        _heading(level, f"{start}{words.effect(found)}"),
        f"<p>{escape(words.coefficient(found))}</p>",
        f"<p>{escape(words.of(known.cause, known.cause_zh))}</p>",
        f'<p class="soft">{escape(known.reference)}</p>',
        _listed(evidence(found, diagnosis, words)),
    ]
    if found.confounded:
        parts.append(_heading(3, words.of("What these data cannot tell from it", "现有数据无法与之区分的效应")))
        parts.append(_listed(alternative(each, words) for each in found.confounded))
        parts.append(_heading(3, words.of("What would tell", "可区分的测试")))
        tests = [separating_test(found, words), *(separating_test(each, words) for each in found.confounded)]
        parts.append(_listed(dict.fromkeys(tests)))
    return "\n".join(parts)


def _error(found: UnitDiagnosis, words: Wording) -> str:
    diagnosis = found.diagnosis
    residuals = residuals_of(found.data.runs, diagnosis)
    if diagnosis.error is None or residuals is None:
        return ""
    parts = [_heading(2, words.of("Error before and after", "前后误差")), _table(error_rows(diagnosis.error, words))]
    if (within := gain_rows(diagnosis.error, words)).rows:
        parts.append(_table(within))
    if (won := achieved(diagnosis.error, words)) is not None:
        parts.append(f"<p>{escape(won)}</p>")
    over_temperature, over_rate = bias_over_temperature(residuals), scale_factor_over_rate(residuals)
    if over_temperature is not None:
        title = words.of("Bias error over temperature, turn-on scatter included", "零偏误差随温度（含逐次启动散布）")
        parts.append(_table(driver_rows(over_temperature, title, words)))
    if over_rate is not None:
        title = words.of("Scale-factor error over rate", "标度因数误差随角速率")
        parts.append(_table(driver_rows(over_rate, title, words)))
    parts.append(_table(allan_rows(residual_allan(residuals), residuals.unit_of_measure, words)))
    if diagnosis.model is not None and diagnosis.effects:
        title = words.of("Model found", "所得模型")
        parts.append(_table(coefficient_rows(diagnosis.model, title, words)))
    return "\n".join(parts)


def _limits(found: UnitDiagnosis, words: Wording) -> str:
    diagnosis = found.diagnosis
    parts = [_heading(2, words.of("Limits of this verdict", "本判定的局限"))]
    of_data = [note.text for note in found.data.notes if note.is_limit]
    limits = _listed(
        map(words.remark, [*(each for each in diagnosis.limits if each not in diagnosis.losses), *of_data])
    )
    parts.append(limits or f"<p>{words.of('None is known.', '无已知局限。')}</p>")
    if remarks := [note.text for note in found.data.notes if not note.is_limit]:
        parts += [_heading(3, words.of("Reduction", "数据归约")), _listed(map(words.remark, remarks))]
    if diagnosis.detection_limits:
        parts.append(_table(absent_rows(diagnosis, words)))
    if diagnosis.not_tested:
        parts.append(_heading(3, words.of("Could not be looked for", "无法查找的效应")))
        colon = words.of(": ", "：")
        reasons = diagnosis.not_tested.items()
        parts.append(_listed(f"{words.name(name)}{colon}{words.remark(why)}" for name, why in reasons))
    return "\n".join(parts)


def _heading(level: int, text: str) -> str:
    return f"<h{level}>{escape(text)}</h{level}>"


def _listed(texts: Iterable[str]) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f"<ul>{items}</ul>" if items else ""


def _table(table: TextTable) -> str:
    numeric = [table.is_numeric(at) for at in range(len(table.columns))]
    head = _cells(table.columns, "th", numeric)
    rows = "\n".join(_cells(row, "td", numeric) for row in table.rows)
    return f"<table><caption>{escape(table.title)}</caption>\n{head}\n{rows}</table>"


def _cells(texts: Sequence[str], tag: str, numeric: Sequence[bool]) -> str:
    kinds = [' class="number"' if each else "" for each in numeric]
    cells = [f"<{tag}{kind}>{escape(text)}</{tag}>" for text, kind in zip(texts, kinds, strict=True)]
    return f"<tr>{''.join(cells)}</tr>"


def _picture(figure: Figure, name: str) -> str:
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=_DPI)
    data = base64.b64encode(image.getvalue()).decode()
    return f'<img alt="{escape(name)}" src="data:image/png;base64,{data}">'
