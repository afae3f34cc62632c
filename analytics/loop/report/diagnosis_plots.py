"""Figures of a diagnosis: residual over the driver, coefficient by run, whitened spectrum, Allan deviation."""

import re
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from analytics.loop.report.drivers import Drawn, drawn
from analytics.loop.report.wording import Wording
from analytics.loop.residuals import DeviationAt, WhitenedSpectrum, residual_allan, whitened_spectrum
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from analytics.loop.tracing.result.holdout import HoldoutSlope
from analytics.loop.unit_diagnosis import UnitDiagnosis
from analytics.plots.allan_marks import FLEET, INK, SOFT
from analytics.plots.figure_file import logarithmic_grid, write_figure
from analytics.plots.plot_fonts import chinese_font, set_fonts
from stream.batch import FloatArray
from stream.errors import BadInput

BEFORE, AFTER, NOISE = "#d55e00", "#0072b2", "#1a1a1a"
_GRID = "#dfe3e8"
_MOST_POINTS = 4000
_LEGEND_SIZE = 8.5
_FEW_DECADES = 300.0


def figures_of(found: UnitDiagnosis, words: Wording) -> dict[str, Figure]:
    """Figures of a diagnosed unit by name; none without enough data; Chinese labels need a Chinese font."""
    residuals = found.residuals
    if residuals is None:
        return {}
    if words.language == "zh" and chinese_font() is None:
        words = Wording("en", found.data.runs[0])
    figures: dict[str, Figure] = {}
    holdout = found.diagnosis.holdout
    for effect in (*found.diagnosis.effects, *found.diagnosis.unreplicated):
        name = _file_name(effect.name)
        over = drawn(residuals, effect, words)
        if over is not None:
            figures[f"residual-{name}"] = residual_figure(effect, over, residuals.unit_of_measure, words)
        if effect.by_run:
            slope = None if holdout is None else holdout.slope(effect.name)
            figures[f"by-run-{name}"] = coefficient_figure(effect, slope, words)
    if (spectrum := whitened_spectrum(residuals)) is not None:
        figures["spectrum"] = spectrum_figure(spectrum, words)
    if deviations := residual_allan(residuals):
        figures["allan"] = allan_figure(deviations, residuals.unit_of_measure, words)
    return figures


def write_figures(found: UnitDiagnosis, folder: Path, words: Wording) -> list[Path]:
    """Write the figures of a unit into a folder as PNG; returns the files."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"folder for plots {folder}: {error.strerror or error}; name one that can be made") from error
    paths = []
    for name, figure in figures_of(found, words).items():
        paths.append(folder / f"{_file_name(found.unit)}-{name}.png")
        write_figure(figure, paths[-1])
    return paths


def residual_figure(effect: FoundEffect, over: Drawn, unit_of_measure: str, words: Wording) -> Figure:
    """Residual with one effect left in over its driver, and the prediction of the effect."""
    freed = words.of("less the constant of each run", "已去除各试验常值")
    figure, axes = _figure(words.of("Residual over its driver", "残差与驱动量"), f"{words.effect(effect)}; {freed}")
    for mask, colour, label in (
        (~over.held_out, FLEET, words.of("blocks of the training runs", "训练试验的数据块")),
        (over.held_out, "#56b4e9", words.of("blocks of the held-out runs", "留出试验的数据块")),
    ):
        if mask.any():
            rows = np.flatnonzero(mask)[:: max(1, int(np.count_nonzero(mask)) // _MOST_POINTS)]
            axes.plot(over.driver[rows], over.partial[rows], ".", color=colour, markersize=3, alpha=0.7, label=label)
    order = np.argsort(over.driver, kind="stable")
    axes.plot(over.driver[order], over.predicted[order], color=AFTER, linewidth=2, label=words.of("effect", "效应"))
    axes.plot(*over.binned(), "o", color=INK, markersize=4.5, label=words.of("means of the blocks", "数据块均值"))
    what = words.of("residual including the effect", "未扣除该效应的残差")
    _labels(axes, over.label, f"{what} ({unit_of_measure})")
    low, high = np.quantile(over.partial, [0.001, 0.999])
    low, high = min(low, over.predicted.min()), max(high, over.predicted.max())
    axes.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    return _finished(figure, axes)


def coefficient_figure(effect: FoundEffect, slope: HoldoutSlope | None, words: Wording) -> Figure:
    """First coefficient of an effect in each run that excites it and in the held-out runs, with 95 % bounds."""
    figure, axes = _figure(words.of("Coefficient by run", "各试验的系数"), words.effect(effect))
    pooled = effect.coefficients[0]
    runs: Mapping[str, tuple[float, float]] = effect.by_run
    names = list(runs)
    axes.axhspan(pooled.lo, pooled.hi, color=AFTER, alpha=0.15, linewidth=0)
    axes.axhline(pooled.value, color=AFTER, linewidth=1.5, label=words.of("all training runs", "全部训练试验"))
    values, errors = np.array(list(runs.values())).T
    label = words.of("one run", "单次试验")
    axes.errorbar(np.arange(len(names)), values, 1.96 * errors, fmt="o", color=INK, capsize=3, label=label)
    if slope is not None:
        names.append(words.of("held out", "留出"))
        value, error = pooled.value * slope.slope, abs(pooled.value) * slope.slope_se
        label = words.of("held-out runs", "留出试验")
        axes.errorbar([len(names) - 1], [value], 1.96 * error, fmt="s", color=BEFORE, capsize=3, label=label)
    axes.axhline(0.0, color=FLEET, linewidth=0.8)
    shown = [*short_names(list(runs)), *names[len(runs) :]]
    are_many = len(shown) > 6
    axes.set_xticks(np.arange(len(shown)), shown, rotation=45 if are_many else 0, ha="right" if are_many else "center")
    first = f"{pooled.name} " if pooled.name else ""
    _labels(axes, "", f"{first}({pooled.unit_of_measure})")
    return _finished(figure, axes)


def short_names(names: Sequence[str]) -> list[str]:
    """Names of runs without their common leading words but the last.

    >>> short_names(["lot7-t1-cycle-1", "lot7-t1-cycle-12"]), short_names(["r1", "r2"]), short_names(["lot7-t1"])
    (['…cycle-1', '…cycle-12'], ['r1', 'r2'], ['lot7-t1'])
    """
    words = [re.findall(r"[^-_. ]*[-_. ]?", name) for name in names]
    alike = list(takewhile(lambda each: len(set(each)) == 1, zip(*words, strict=False)))
    begin = "".join(each[0] for each in alike[:-1]) if len(names) > 1 else ""
    return ["…" + name.removeprefix(begin) for name in names] if len(begin) > 2 else list(names)


def spectrum_figure(spectrum: WhitenedSpectrum, words: Wording) -> Figure:
    """Whitened spectrum before and after."""
    subtitle = words.of(
        "1 if only the fitted noise is left; band: 95 % of the bins in that case",
        "仅剩拟合噪声时各处为1；色带：此时95 %的频段",
    )
    figure, axes = _figure(words.of("Whitened spectrum", "白化谱"), subtitle)
    axes.set(xscale="log", yscale="log")
    axes.fill_between(spectrum.frequency_hz, spectrum.lo, spectrum.hi, color=FLEET, alpha=0.3, linewidth=0)
    axes.axhline(1.0, color=NOISE, linewidth=0.8)
    _before_after(axes, spectrum.frequency_hz, spectrum.before, spectrum.after, words)
    _logarithmic(axes)
    _labels(axes, words.of("frequency (Hz)", "频率 (Hz)"), words.of("power relative to the noise", "相对噪声的功率"))
    return _finished(figure, axes)


def allan_figure(deviations: tuple[DeviationAt, ...], unit_of_measure: str, words: Wording) -> Figure:
    """Allan deviation of the residual before and after, and of the noise alone."""
    figure, axes = _figure(
        words.of("Allan deviation of the residual", "残差的 Allan 标准差"),
        words.of("band: 95 % confidence of the model found", "色带：所得模型的95 %置信区间"),
    )
    tau_s = np.array([each.tau_s for each in deviations])
    axes.set(xscale="log", yscale="log")
    lo, hi = [each.lo for each in deviations], [min(each.hi, 3 * each.after) for each in deviations]
    axes.fill_between(tau_s, lo, hi, color=AFTER, alpha=0.18, linewidth=0)
    before, after, floor = (
        np.array([getattr(each, key) for each in deviations]) for key in ("before", "after", "floor")
    )
    axes.plot(tau_s, floor, color=NOISE, linewidth=1, linestyle="--", label=words.of("noise alone", "仅噪声"))
    _before_after(axes, tau_s, before, after, words)
    _logarithmic(axes)
    name = words.of("Allan deviation", "Allan 标准差")
    _labels(axes, words.of("averaging time τ (s)", "平均时间 τ (s)"), f"{name} ({unit_of_measure})")
    return _finished(figure, axes)


def _before_after(axes: Axes, x: FloatArray, before: FloatArray, after: FloatArray, words: Wording) -> None:
    axes.plot(x, before, "o-", color=BEFORE, markersize=4, label=words.of("declared model", "已声明模型"))
    axes.plot(x, after, "s-", color=AFTER, markersize=4, label=words.of("model found", "所得模型"))


def _figure(title: str, subtitle: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(8.2, 4.6), facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.11, 0.15, 0.86, 0.68))
    figure.text(0.11, 0.935, title, fontsize=13, fontweight="bold", color=INK)
    figure.text(0.11, 0.875, subtitle, fontsize=8.5, color=SOFT)
    axes.grid(True, color=_GRID, linewidth=0.9)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color(FLEET)
    axes.tick_params(which="both", color=FLEET, labelcolor=INK, labelsize=9)
    return figure, axes


def _logarithmic(axes: Axes) -> None:
    """Grid of logarithmic axes; over few decades, 2 and 5 are labelled as well."""
    logarithmic_grid(axes)
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if high / low < _FEW_DECADES:
            axis.set_minor_formatter(FuncFormatter(_two_or_five))
    axes.tick_params(which="minor", labelsize=8)


def _two_or_five(value: float, _place: int) -> str:
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""


def _labels(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x, color=INK, fontsize=10)
    axes.set_ylabel(y, color=INK, fontsize=9)


def _finished(figure: Figure, axes: Axes) -> Figure:
    axes.legend(fontsize=_LEGEND_SIZE, frameon=True, framealpha=0.85, edgecolor="none")
    set_fonts(figure)
    return figure


def _file_name(name: str) -> str:
    return "".join(each if each.isalnum() or each in "-_." else "_" for each in name)
