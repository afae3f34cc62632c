"""Tables of a diagnosis, as rows of text: for the terminal and for the report."""

from collections.abc import Sequence
from dataclasses import dataclass

from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.report.error_by_driver import ErrorOverDriver
from analytics.loop.report.residual_allan import DeviationAt
from analytics.loop.report.wording import Wording, measured, number, told_unit
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.result.error_table import ErrorGain, ErrorTable
from stream.quantities import ANGULAR_RATE_UNIT

_NUMBER_STARTS = "0123456789-\N{EN DASH}"


@dataclass(frozen=True)
class TextTable:
    """A table of text.

    Parameters
    ----------
    title: What it shows.
    columns: Heads.
    rows: Cells; the first is a name or a class.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def is_numeric(self, column: int) -> bool:
        """Whether a column holds numbers, which stand to the right.

        Examples
        --------
        >>> table = TextTable("", ("unit", "value"), (("FOG-1", "3.2"), ("FOG-2", "")))
        >>> table.is_numeric(0), table.is_numeric(1)
        (False, True)
        """
        return column > 0 and all(not row[column] or row[column][0] in _NUMBER_STARTS for row in self.rows)


def error_rows(table: ErrorTable, words: Wording) -> TextTable:
    """RMS of averages before and after, and the floor."""
    where = words.of("held-out runs", "留出试验") if table.is_held_out else words.of("all runs", "全部试验")
    unit = table.unit_of_measure
    title = words.of(f"RMS error of averages, {where} ({unit})", f"平均值的均方根误差，{where}（{unit}）")
    rows = [
        (f"{row.averaging_s:g} s", number(row.before), number(row.after), number(row.floor),
         _excited(row.excited_before, row.excited_after, row.excited_floor), f"{row.averages:,}")
        for row in table.rows
    ]  # fmt: skip
    head = (
        words.of("averages of", "平均时间"),
        *_before_after(words),
        words.of("where the effect is excited", "效应被激励处"),
        words.of("averages", "平均值个数"),
    )
    return TextTable(title, head, tuple(rows))


def gain_rows(table: ErrorTable, words: Wording) -> TextTable:
    """RMS of averages about the mean of their run, and the share of the squared error that is won, raw and within."""
    rows = [
        (f"{row.averaging_s:g} s", number(row.before_within), number(row.after_within), number(row.floor_within),
         _gain(row.gain_within), _gain(row.gain))
        for row in table.rows
        if row.before_within > 0
    ]  # fmt: skip
    unit = table.unit_of_measure
    title = words.of(
        f"The same about the mean of each run ({unit}), and squared error won with its limits over runs",
        f"去除各次试验均值后（{unit}），以及平方误差减少量及其试验间置信限",
    )
    head = (
        words.of("averages of", "平均时间"),
        *_before_after(words),
        words.of("won", "减少"),
        words.of("won with turn-on bias", "含启动零偏的减少"),
    )
    return TextTable(title, head, tuple(rows))


def achieved(table: ErrorTable, words: Wording) -> str | None:
    """Say how much of what could be won was won; None where nothing could be."""
    whole, excited = table.achievable_fraction, table.achievable_fraction_excited
    if whole is None and excited is None:
        return None
    parts = [] if whole is None else [f"{whole:.0%}"]
    if excited is not None:
        parts.append(words.of(f"{excited:.0%} where the effect is excited", f"效应被激励处为{excited:.0%}"))
    told = words.of(", ", "，").join(parts)
    return words.of(f"Of the error that can be won at 1800 s, won: {told}.", f"1800 s处可消除的误差中已消除：{told}。")


def driver_rows(over: ErrorOverDriver, title: str, words: Wording) -> TextTable:
    """Error in classes of a driver."""
    rows = [
        (f"{number(each.lo)} .. {number(each.hi)}", number(each.before), number(each.after), number(each.floor),
         f"{each.blocks:,}")
        for each in over.classes
    ]  # fmt: skip
    head = (f"{over.channel} ({over.channel_unit})", *_before_after(words, "±"), words.of("blocks", "数据块"))
    return TextTable(f"{title} ({over.unit_of_measure})", head, tuple(rows))


def allan_rows(deviations: Sequence[DeviationAt], unit_of_measure: str, words: Wording) -> TextTable:
    """Allan deviation of the residual."""
    rows = [
        (f"{each.tau_s:g} s", number(each.before), f"{number(each.after)} ({number(each.lo)} .. {number(each.hi)})",
         number(each.floor), f"{each.differences:,}")
        for each in deviations
    ]  # fmt: skip
    name = words.of("Allan deviation of the residual", "残差的 Allan 标准差")
    head = (words.of("averages of", "平均时间"), *_before_after(words), words.of("differences", "差分个数"))
    return TextTable(f"{name} ({unit_of_measure})", head, tuple(rows))


def coefficient_rows(model: ErrorModel, title: str, words: Wording) -> TextTable:
    """Coefficients of a fitted model with their standard uncertainty."""
    rows = [
        (label, measured(value, float(error)), number(float(error)), told_unit(unit))
        for label, value, error, unit in zip(model.labels(), model.coefficients, model.errors, model.units, strict=True)
    ]
    head = (words.of("term", "项"), words.of("coefficient", "系数"), "±", words.of("unit", "单位"))
    return TextTable(title, head, tuple(rows))


def noise_rows(diagnosis: Diagnosis, words: Wording) -> TextTable:
    """Noise as declared and as fitted."""
    unit = "" if diagnosis.error is None else diagnosis.error.unit_of_measure
    root = "deg/√h" if unit == ANGULAR_RATE_UNIT else f"{unit}·√h"
    units = (root, unit, f"{unit}/√h", unit)
    names = (
        words.of("N, white", "N，白噪声"),
        words.of("B, flicker", "B，闪烁噪声"),
        words.of("K, random walk", "K，随机游走"),
        words.of("turn-on scatter", "逐次启动散布"),
    )
    known = [_four(each) for each in (diagnosis.declared_noise, diagnosis.noise)]
    rows = [(name, number(known[0][at]), number(known[1][at]), units[at]) for at, name in enumerate(names)]
    head = (
        words.of("noise", "噪声"),
        words.of("declared", "已声明"),
        words.of("fitted with the model found", "随所得模型拟合"),
        words.of("unit", "单位"),
    )
    return TextTable(words.of("Noise", "噪声"), head, tuple(rows))


def absent_rows(diagnosis: Diagnosis, words: Wording) -> TextTable:
    """How large effects that were not found can be at most."""
    rows = [
        (words.name(name), number(limit.absent_above), number(limit.coefficient), told_unit(limit.unit_of_measure))
        for name, limit in diagnosis.detection_limits.items()
    ]
    title = words.of("Looked for and not found", "已查找而未发现")
    head = (
        words.of("effect", "效应"),
        words.of("absent above (95 %)", "不高于（95 %）"),
        words.of("would have been found from (90 %)", "可发现的最小值（90 %）"),
        words.of("unit", "单位"),
    )
    return TextTable(title, head, tuple(rows))


def _before_after(words: Wording, mark: str = "") -> tuple[str, str, str]:
    return (
        words.of("declared model", "已声明模型"),
        words.of("model found", "所得模型"),
        f"{mark} {words.of('noise alone', '仅噪声')}".strip(),
    )


def _excited(*values: float | None) -> str:
    return (
        "" if values[0] is None else " \N{RIGHTWARDS ARROW} ".join(map(number, values[:2])) + f" ({number(values[2])})"
    )


def _gain(gain: ErrorGain | None) -> str:
    """Share of the squared error that is won, with its limits over runs."""
    if gain is None:
        return ""
    limits = "" if gain.lo is None or gain.hi is None else f" ({gain.lo:.0%} .. {gain.hi:.0%})"
    return f"{gain.fraction:.0%}{limits}"


def _four(noise: NoiseCoefficients | None) -> tuple[float | None, ...]:
    return (None,) * 4 if noise is None else (noise.N, noise.B, noise.K, noise.turn_on)
