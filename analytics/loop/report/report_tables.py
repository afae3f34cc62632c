"""Tables of a diagnosis as rows of text, for the terminal and the report."""

from collections.abc import Sequence
from dataclasses import dataclass

from analytics.loop.model.error_model import ErrorModel
from analytics.loop.report.drivers import ErrorOverDriver
from analytics.loop.report.wording import LEAST_SHARE, Wording, measured, number, percent
from analytics.loop.residuals import DeviationAt
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.result.holdout import ErrorGain, ErrorTable
from stream.quantities import ANGULAR_RATE_UNIT, format_unit

_NUMBER_STARTS = "0123456789-\N{EN DASH}"
_TIME, _UNIT = ("averaging time", "平均时间"), ("unit", "单位")
_ERRORS = ("declared model", "已声明模型"), ("model found", "所得模型"), ("noise alone", "仅噪声")


@dataclass(frozen=True)
class TextTable:
    """A table of text; the first cell of a row is a name or a class."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def is_numeric(self, column: int) -> bool:
        """Whether a column holds numbers, which are aligned to the right.

        >>> table = TextTable("", ("unit", "value"), (("FOG-1", "3.2"), ("FOG-2", "")))
        >>> table.is_numeric(0), table.is_numeric(1)
        (False, True)
        """
        return column > 0 and all(not row[column] or row[column][0] in _NUMBER_STARTS for row in self.rows)


def error_rows(table: ErrorTable, words: Wording) -> TextTable:
    """RMS of averages before and after, and the floor."""
    where = words.of("held-out runs", "留出试验") if table.is_held_out else words.of("all runs", "全部试验")
    unit = table.unit_of_measure
    rows = [
        (_seconds(row.averaging_s), number(row.before), number(row.after), number(row.floor),
         _excited(row.excited_before, row.excited_after, row.excited_floor), f"{row.averages:,}")
        for row in table.rows
    ]  # fmt: skip
    title = words.of(f"RMS error of averages, {where} ({unit})", f"平均值的均方根误差，{where}（{unit}）")
    excited = ("where the effect is excited", "效应被激励处")
    return TextTable(title, words.each(_TIME, *_ERRORS, excited, ("averages", "平均值个数")), tuple(rows))


def gain_rows(table: ErrorTable, words: Wording) -> TextTable:
    """RMS of averages about the mean of their run, and the decrease of the squared error, raw and within runs."""
    rows = [
        (_seconds(row.averaging_s), number(row.before_within), number(row.after_within), number(row.floor_within),
         _gain(row.gain_within), _gain(row.gain))
        for row in table.rows
        if row.before_within > 0
    ]  # fmt: skip
    unit = table.unit_of_measure
    title = words.of(
        f"The same about the mean of each run ({unit}), and decrease of the squared error with bounds over runs",
        f"去除各次试验均值后（{unit}），以及平方误差减少量及其试验间置信限",
    )
    decreases = ("decrease", "减少"), ("decrease with turn-on bias", "含启动零偏的减少")
    return TextTable(title, words.each(_TIME, *_ERRORS, *decreases), tuple(rows))


def achieved(table: ErrorTable, words: Wording) -> str | None:
    """The achieved and the expected decrease of the error; None if nothing is achievable or expected."""
    whole, excited = table.achievable_fraction, table.achievable_fraction_excited
    sentences = []
    if whole is not None or excited is not None:
        parts = [] if whole is None else [f"{whole:.0%}"]
        if excited is not None:
            parts.append(words.of(f"{excited:.0%} where the effect is excited", f"效应被激励处为{excited:.0%}"))
        shares = words.of(", ", "，").join(parts)
        sentences.append(
            words.of(
                f"Achieved share of the possible decrease of the squared error at 1800 s: {shares}.",
                f"1800 s处可消除的平方误差中已消除：{shares}。",
            )
        )
    if table.gain is not None and table.is_held_out and abs(table.gain.fraction) >= LEAST_SHARE:
        seconds, gain = f"{table.gain.averaging_s:g} s", _gain(table.gain)
        sentences.append(
            words.of(
                f"New runs like these: squared error about the mean of each run, over {seconds}, expected to fall by "
                f"{gain}.",
                f"对同类新试验，{seconds}平均值去除各次均值后的平方误差预期下降{gain}。",
            )
        )
    return words.of(" ", "").join(sentences) or None


def driver_rows(over: ErrorOverDriver, title: str, words: Wording) -> TextTable:
    """Error in classes of a driver."""
    rows = [
        (f"{number(each.lo)} .. {number(each.hi)}", number(each.before), number(each.after), number(each.floor),
         f"{each.blocks:,}")
        for each in over.classes
    ]  # fmt: skip
    errors = words.each(*_ERRORS[:2], ("± noise alone", "± 仅噪声"), ("blocks", "数据块"))
    head = (f"{over.channel} ({over.channel_unit})", *errors)
    return TextTable(f"{title} ({over.unit_of_measure})", head, tuple(rows))


def allan_rows(deviations: Sequence[DeviationAt], unit_of_measure: str, words: Wording) -> TextTable:
    """Allan deviation of the residual."""
    rows = [
        (_seconds(each.tau_s), number(each.before), f"{number(each.after)} ({number(each.lo)} .. {number(each.hi)})",
         number(each.floor), f"{each.differences:,}")
        for each in deviations
    ]  # fmt: skip
    name = words.of("Allan deviation of the residual", "残差的 Allan 标准差")
    head = words.each(_TIME, *_ERRORS, ("differences", "差分个数"))
    return TextTable(f"{name} ({unit_of_measure})", head, tuple(rows))


def coefficient_rows(model: ErrorModel, title: str, words: Wording) -> TextTable:
    """Coefficients of a fitted model with their standard uncertainty."""
    rows = [
        (label, measured(value, float(error)), number(float(error)), format_unit(unit))
        for label, value, error, unit in zip(model.labels(), model.coefficients, model.errors, model.units, strict=True)
    ]
    head = words.each(("term", "项"), ("coefficient", "系数"), ("±", "±"), _UNIT)
    return TextTable(title, head, tuple(rows))


def noise_rows(diagnosis: Diagnosis, words: Wording) -> TextTable:
    """Noise as declared and as fitted."""
    unit = "" if diagnosis.error is None else diagnosis.error.unit_of_measure
    root = "deg/√h" if unit == ANGULAR_RATE_UNIT else f"{unit}·√h"
    terms = (
        ("N", words.of("N, white", "N，白噪声"), root),
        ("B", words.of("B, flicker", "B，闪烁噪声"), unit),
        ("K", words.of("K, random walk", "K，随机游走"), f"{unit}/√h"),
        ("turn_on", words.of("turn-on scatter", "逐次启动散布"), unit),
    )
    both = diagnosis.declared_noise, diagnosis.noise
    rows = [
        (name, *(number(None if noise is None else getattr(noise, term)) for noise in both), own_unit)
        for term, name, own_unit in terms
    ]
    noises = ("noise", "噪声"), ("declared", "已声明"), ("fitted with the model found", "随所得模型拟合")
    head = words.each(*noises, _UNIT)
    return TextTable(words.of("Noise", "噪声"), head, tuple(rows))


def absent_rows(diagnosis: Diagnosis, words: Wording) -> TextTable:
    """Detection limits of effects that were not found."""
    rows = [
        (words.name(name), number(limit.absent_above), number(limit.coefficient), format_unit(limit.unit_of_measure))
        for name, limit in diagnosis.detection_limits.items()
    ]
    limits = ("absent above (95 %)", "不高于（95 %）"), ("detection limit (90 %)", "检出限（90 %）")
    head = words.each(("effect", "效应"), *limits, _UNIT)
    title = words.of(
        "Tested and not found, each alone beside the model found", "已检验而未发现（各自单独加入所得模型）"
    )
    return TextTable(title, head, tuple(rows))


def _seconds(value: float) -> str:
    return f"{value:g} s"


def _excited(before: float | None, after: float | None, floor: float | None) -> str:
    return "" if before is None else f"{number(before)} \N{RIGHTWARDS ARROW} {number(after)} ({number(floor)})"


def _gain(gain: ErrorGain | None) -> str:
    if gain is None:
        return ""
    bounds = "" if gain.lo is None or gain.hi is None else f" ({_percent(gain.lo)} .. {_percent(gain.hi)})"
    return f"{_percent(gain.fraction)}{bounds}"


def _percent(share: float) -> str:
    return f"{percent(share)}%"
