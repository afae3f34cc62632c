"""The report of a unit as data for a page: sentences and tables in both languages, pictures as curves."""

from typing import Any

import msgspec
import numpy as np

from analytics.loop.report import report_tables as tables
from analytics.loop.report.diagnosis_plots import short_names
from analytics.loop.report.drivers import bias_over_temperature, drawn, scale_factor_over_rate
from analytics.loop.report.finding_sentences import alternative, evidence, separating_test
from analytics.loop.report.next_test_rows import next_test_rows, next_test_sentence
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Wording
from analytics.loop.residuals import Residuals, residual_allan
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from analytics.loop.unit_diagnosis import UnitDiagnosis
from analytics.plots.picture import Axis, Curve, Label, Picture

_MOST_POINTS = 800
_BEFORE, _AFTER = Label("declared model", "已声明模型"), Label("model found", "所得模型")
_NOISE = Label("noise alone", "仅噪声")


def embedded_report(found: UnitDiagnosis) -> dict[str, Any]:
    """The report of a diagnosed unit: ``en`` and ``zh`` with its texts, ``pictures`` with the data of its figures."""
    run = found.data.runs[0]
    texts = {"en": _texts(found, Wording("en", run)), "zh": _texts(found, Wording("zh", run))}
    whole: dict[str, Any] = msgspec.to_builtins(texts | {"pictures": _pictures(found)})
    return whole


def _texts(found: UnitDiagnosis, words: Wording) -> dict[str, Any]:
    diagnosis, error = found.diagnosis, found.diagnosis.error
    rows = [] if error is None else [tables.error_rows(error, words), tables.gain_rows(error, words)]
    caveats = [each for each in diagnosis.limits if each not in diagnosis.losses]
    notes = [note.text for note in found.data.notes if note.is_limit]
    planned = found.next_test
    return {
        "verdict": verdict_sentence(diagnosis, words),
        "losses": [words.text(each) for each in diagnosis.losses],
        "effects": [_effect(each, found, words) for each in (*diagnosis.by_size, *diagnosis.unreplicated)],
        "errors": [each for each in rows if each.rows],
        "achieved": None if error is None else tables.achieved(error, words),
        "caveats": [words.text(each) for each in (*caveats, *notes)],
        "next_test": planned and next_test_sentence(planned, words),
        "plans": next_test_rows(planned, words) if planned and planned.plans else None,
        "left": found.left and words.clause(found.left.sentence),
    }


def _effect(effect: FoundEffect, found: UnitDiagnosis, words: Wording) -> dict[str, Any]:
    others = [separating_test(effect, words), *(separating_test(each, words) for each in effect.confounded)]
    return {
        "name": words.effect(effect),
        "coefficient": words.coefficient(effect),
        "evidence": list(evidence(effect, found.diagnosis, words)),
        "alternatives": [alternative(each, words) for each in effect.confounded],
        "separating_tests": list(dict.fromkeys(others)) if effect.confounded else [],
    }


def _pictures(found: UnitDiagnosis) -> dict[str, Picture]:
    """Pictures by name; none without enough data."""
    residuals = found.residuals
    if residuals is None:
        return {}
    pictures: dict[str, Picture] = {}
    for effect in (*found.diagnosis.effects, *found.diagnosis.unreplicated):
        if (drawn_over := _over_driver(effect, residuals)) is not None:
            pictures[f"residual-{effect.name}"] = drawn_over
        if effect.by_run:
            pictures[f"by-run-{effect.name}"] = _by_run(effect)
    if (allan := _allan(residuals)) is not None:
        pictures["allan"] = allan
    for name, over, title in (
        ("temperature", bias_over_temperature(residuals), Label("Bias error over temperature", "零偏误差随温度")),
        ("rate", scale_factor_over_rate(residuals), Label("Scale-factor error over rate", "标度因数误差随角速率")),
    ):
        if over is None:
            continue
        middle = [(each.lo + each.hi) / 2 for each in over.classes]
        pictures[f"over-{name}"] = Picture(
            title=title, x=Axis(label=Label.same(over.channel), unit=over.channel_unit),
            y=Axis(label=title, unit=over.unit_of_measure),
            curves=[
                Curve(name=_BEFORE, x=middle, y=[each.before for each in over.classes], style="both"),
                Curve(
                    name=_AFTER, x=middle, y=[each.after for each in over.classes], style="both",
                    lo=[each.after - 1.96 * each.floor for each in over.classes],
                    hi=[each.after + 1.96 * each.floor for each in over.classes],
                ),
            ],
            note=Label("Bars: 95 % of what noise alone gives.", "误差棒：仅噪声时的 95 % 范围。"),
        )  # fmt: skip
    return pictures


def _over_driver(effect: FoundEffect, residuals: Residuals) -> Picture | None:
    """Residual with one effect left in over its driver, with what the effect predicts."""
    run = residuals.record.stack.runs[0]
    over = drawn(residuals, effect, english := Wording("en", run))
    in_chinese = drawn(residuals, effect, chinese := Wording("zh", run))
    if over is None or in_chinese is None:
        return None
    curves = []
    for mask, name in (
        (~over.held_out, Label("blocks of the training runs", "训练试验的数据块")),
        (over.held_out, Label("blocks of the held-out runs", "留出试验的数据块")),
    ):
        rows = np.flatnonzero(mask)
        rows = rows[:: max(1, -(-rows.size // _MOST_POINTS))]
        if rows.size:
            x, y = over.driver[rows].tolist(), over.partial[rows].tolist()
            curves.append(Curve(name=name, x=x, y=y, style="points"))
    order = np.argsort(over.driver, kind="stable")
    order = order[:: max(1, -(-order.size // _MOST_POINTS))]
    x, y = over.driver[order].tolist(), over.predicted[order].tolist()
    means = over.binned()
    curves += [
        Curve(name=Label("effect", "效应"), x=x, y=y, style="line"),
        Curve(name=Label("means of the blocks", "数据块均值"), x=means[0].tolist(), y=means[1].tolist(), style="both"),
    ]
    return Picture(
        title=Label(
            f"Residual over its driver: {english.effect(effect)}", f"残差与驱动量：{chinese.effect(effect)}"
        ),
        x=Axis(label=Label(over.label, in_chinese.label)),
        y=Axis(label=Label("residual including the effect", "未扣除该效应的残差"), unit=residuals.unit_of_measure),
        curves=curves, note=Label("Less the constant of each run.", "已去除各试验常值。"),
    )  # fmt: skip


def _by_run(effect: FoundEffect) -> Picture:
    """First coefficient of an effect in each run that excites it, with 95 % bounds, and that of all."""
    pooled, x = effect.coefficients[0], [float(i) for i in range(len(effect.by_run))]
    values = [value for value, _ in effect.by_run.values()]
    errors = [1.96 * error for _, error in effect.by_run.values()]
    name = Label(Wording("en").effect(effect), Wording("zh").effect(effect))
    runs = [Label.same(each) for each in short_names(list(effect.by_run))]
    whole = Curve(
        name=Label("all training runs", "全部训练试验"), x=x, y=[pooled.value] * len(x),
        lo=[pooled.lo] * len(x), hi=[pooled.hi] * len(x),
    )  # fmt: skip
    return Picture(
        title=Label(f"Coefficient by run: {name.en}", f"各试验的系数：{name.zh}"),
        x=Axis(label=Label("run", "试验"), scale="names", names=runs),
        y=Axis(label=Label("coefficient", "系数"), unit=pooled.unit_of_measure),
        curves=[
            Curve(
                name=Label("one run", "单次试验"), x=x, y=list(values), style="points", texts=list(effect.by_run),
                lo=[value - error for value, error in zip(values, errors, strict=True)],
                hi=[value + error for value, error in zip(values, errors, strict=True)],
            ),
            whole,
        ],
    )  # fmt: skip


def _allan(residuals: Residuals) -> Picture | None:
    """Allan deviation of the residual before and after, and of the noise alone."""
    deviations = residual_allan(residuals)
    if not deviations:
        return None
    tau_s = [each.tau_s for each in deviations]
    after = Curve(
        name=_AFTER, x=tau_s, y=[each.after for each in deviations], style="both",
        lo=[each.lo for each in deviations], hi=[min(each.hi, 3 * each.after) for each in deviations],
    )  # fmt: skip
    return Picture(
        title=Label("Allan deviation of the residual", "残差的 Allan 标准差"),
        x=Axis(label=Label("averaging time", "平均时间"), unit="s", scale="log"),
        y=Axis(label=Label("Allan deviation", "Allan 标准差"), unit=residuals.unit_of_measure, scale="log"),
        curves=[
            Curve(name=_BEFORE, x=tau_s, y=[each.before for each in deviations], style="both"),
            after,
            Curve(name=_NOISE, x=tau_s, y=[each.floor for each in deviations]),
        ],
        note=Label(
            "Held-out runs; bars: 95 % bounds, drawn up to three times the value.",
            "留出试验；误差棒：95 % 区间，最多绘至数值的三倍。",
        )
        if residuals.held_out.any() else None,
    )  # fmt: skip
