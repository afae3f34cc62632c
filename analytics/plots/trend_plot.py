"""Control charts as a picture: values with their uncertainty, limits, changes of level, and moving averages below."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from analytics.plots.allan_marks import FLEET, INK, SOFT
from analytics.plots.figure_file import check_suffix, in_both, write_figure
from analytics.plots.plot_fonts import set_fonts
from analytics.trends.charts.capability import LimitStretch, SpecifiedLimits
from analytics.trends.charts.control_chart import IndividualsChart
from analytics.trends.levels.change_points import Changes
from analytics.trends.series import NS_PER_DAY, MetricSeries
from analytics.trends.trend import Chart, Trend
from analytics.trends.words import behind

_MOST_CHARTS = 8
_ROOM = 0.14  # part of the height beyond limits of a specification, for their names
_CENTRE, _ALARM, _LEVEL, _SPECIFIED = "#2f6f4f", "#a40000", "#c46a00", "#6a3d9a"
_COLOURS = ("#1f4e79", "#b3541e", "#4b7f52", "#7a4988", "#8a6d1d", "#3f7f93")


def plot_trend(trend: Trend, path: Path) -> None:
    """Draw the charts of a trend into a file, PNG or SVG; of many, the significant ones."""
    check_suffix(path)
    order = sorted(trend.charts, key=lambda chart: (chart.in_control is not False, chart.in_control is None))
    shown = order[:_MOST_CHARTS]
    figure = Figure(figsize=(9.5, 1.1 + (4.6 if len(shown) == 1 else 2.3 * len(shown))), facecolor="white")
    top = 1 - 0.75 / figure.get_figheight()
    grid: dict[str, Any] = {"left": 0.1, "right": 0.87, "top": top, "bottom": 0.7 / figure.get_figheight()}
    if len(shown) == 1:
        axes = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 1.3], "hspace": 0.08, **grid})
        _draw_chart(axes[0], shown[0], trend)
        _draw_averages(axes[1], shown[0])
        _name_axis(axes[1], trend.series)
    else:
        # units and products differ by more than each scatters; stations, lots and fixtures are to be compared
        is_of_units = trend.by in {"unit", "product"}
        axes = figure.subplots(len(shown), 1, sharex=True, sharey=not is_of_units, gridspec_kw={"hspace": 0.12, **grid})
        for each, chart in zip(axes, shown, strict=True):
            _draw_chart(each, chart, trend)
            each.set_title(chart.name, loc="left", fontsize=8.5, color=INK, pad=3)
        _name_axis(axes[-1], trend.series)
    t = _times(trend.series)
    margin = 0.02 * float(np.ptp(t)) or 0.5
    for each in figure.axes:
        each.set_xlim(float(t.min()) - margin, float(t.max()) + margin)
    _write_title(figure, trend, len(order) - len(shown))
    set_fonts(figure)
    write_figure(figure, path)


def _write_title(figure: Figure, trend: Trend, more: int) -> None:
    series, header = trend.series, trend.series.header
    name = series.metric if header is None else in_both(header.en, header.zh, "  ·  ")
    height = figure.get_figheight()
    unit = behind(series.unit_of_measure)
    figure.text(0.1, 1 - 0.3 / height, f"{name},{unit}" if unit else name, fontsize=13, fontweight="bold", color=INK)
    subtitle = f"{series.variant}; {series.value.size} values of {len(set(series.serial))} units"
    if more > 0:
        subtitle += f"; {more} charts are not drawn"
    figure.text(0.1, 1 - 0.52 / height, subtitle, fontsize=8.5, color=SOFT)
    marks = "Bars: standard uncertainty. Circles: points that meet rules of Nelson, with their numbers."
    if any(chart.has_changed or chart.shifts for chart in trend.charts):
        marks += " Shaded: where a change of level lies (95 %)."
    if any(chart.is_adjusted for chart in trend.charts):
        whose = "what is found of stations and fixtures" if trend.by == "unit" else "each unit's own level"
        marks += f" Points: {whose} taken off."
    figure.text(0.87, 0.1 / height, marks, fontsize=7, color=SOFT, ha="right")


def _times(series: MetricSeries) -> np.ndarray[Any, np.dtype[np.float64]]:
    if not series.dated:
        return np.arange(1, series.value.size + 1, dtype=np.float64)
    # matplotlib counts days from the same moment
    return np.asarray(series.t_ns / NS_PER_DAY, np.float64)


def _name_axis(axes: Axes, series: MetricSeries) -> None:
    if series.dated:
        locator = AutoDateLocator()  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes.set_xlabel(in_both("Time (UTC)" if series.dated else "Point", "时间"), color=INK)


def _draw_chart(axes: Axes, chart: Chart, trend: Trend) -> None:
    series = chart.series
    names = [each.name for each in trend.charts]
    specification = trend.specifications[names.index(chart.name)]
    t, values = _times(series), chart.charted
    if trend.by is None and series.value.size < trend.series.value.size:
        axes.plot(_times(trend.series), trend.series.value, ".", ms=3, color=FLEET, zorder=1.5, label="measured again")
    known = np.nan_to_num(series.uncertainty)
    axes.errorbar(t, values, yerr=known, fmt="none", ecolor=FLEET, elinewidth=0.8, zorder=2)
    groups = series.groups["station"]
    levels = sorted(set(groups))
    for level, colour in zip(levels[: len(_COLOURS)], _COLOURS, strict=False):
        at = np.array([each == level for each in groups])
        axes.plot(t[at], values[at], "o", ms=3, color=colour, zorder=3, label=level)
    rest = np.array([each in levels[len(_COLOURS) :] for each in groups])
    axes.plot(t[rest], values[rest], "o", ms=3, color=SOFT, zorder=3)
    if len(levels) > 1:
        axes.legend(fontsize=7, loc="lower right", bbox_to_anchor=(1, 0.99), ncols=6, frameon=False)
    if isinstance(chart.limits, IndividualsChart):
        _draw_limits(axes, chart, chart.limits, t)
    if isinstance(chart.changes, Changes) and chart.changes.points:
        _draw_levels(axes, chart.changes, t)
    elif not chart.is_adjusted:
        for shift in chart.shifts:
            ends = _times(trend.series.where([shift.first, shift.last])) if trend.series.dated else None
            first, last = (shift.first + 1, shift.last + 1) if ends is None else ends
            axes.axvspan(first, last, color=_LEVEL, alpha=0.15, linewidth=0)
    if not chart.is_adjusted:  # limits are of values, not of what is left of them
        _draw_specified(axes, specification, t, series)
    axes.tick_params(colors=INK, labelsize=8)


def _draw_specified(
    axes: Axes, specification: SpecifiedLimits, t: np.ndarray[Any, Any], series: MetricSeries
) -> None:  # fmt: skip
    """Limits of the specification, each over the values that were measured while it was valid."""
    whole = LimitStretch(specification.lower, specification.upper, "", int(series.t_ns[0]), int(series.t_ns[-1]) + 1)
    for valid in specification.stretches if series.dated and specification.stretches else (whole,):
        at = np.flatnonzero((series.t_ns >= valid.from_ns) & (series.t_ns < valid.until_ns))
        if not at.size:
            continue
        for side, name, below in ((valid.lower, "lower", "top"), (valid.upper, "upper", "bottom")):
            if side is not None:  # its name beyond it, where points are few, and within the frame
                axes.plot((t[at[0]], t[at[-1]]), (side, side), color=_SPECIFIED, linewidth=1.4)
                axes.annotate(f"{name} {side:.4g}", (t[at[0]], side), fontsize=7, color=_SPECIFIED, va=below)
                axes.margins(y=_ROOM)


def _draw_limits(axes: Axes, chart: Chart, limits: IndividualsChart, t: np.ndarray[Any, Any]) -> None:
    axes.axhline(limits.centre, color=_CENTRE, linewidth=1.0)
    for sigmas, style in ((1, (0, (1, 4))), (2, (0, (3, 4)))):
        for sign in (-1, 1):
            axes.axhline(limits.centre + sign * sigmas * limits.sigma, color=FLEET, linewidth=0.6, linestyle=style)
    lower = f"-3σ {limits.lower:.4g}" if limits.lower else "-3σ < 0"
    for side, text in ((limits.lower, lower), (limits.upper, f"+3σ {limits.upper:.4g}")):
        axes.axhline(side, color=_ALARM, linewidth=0.9, linestyle=(0, (6, 3)))
        _write_at(axes, side, text, _ALARM)
    _write_at(axes, limits.centre, f"{limits.centre:.4g}", _CENTRE)
    if limits.baseline < chart.series.value.size:
        axes.axvline(t[limits.baseline - 1], color=_CENTRE, linewidth=0.7, linestyle=(0, (2, 2)))
    rules: dict[int, list[str]] = {}
    for rule, points in chart.signals.items():
        for point in points:
            rules.setdefault(point, []).append(str(rule))
    if rules:
        at = sorted(rules)
        values = chart.charted
        axes.plot(t[at], values[at], "o", ms=6.5, mfc="none", mec=_ALARM, mew=0.9, zorder=4)
        for point in at if len(at) <= 40 else []:
            where = (t[point], values[point])
            axes.annotate("·".join(rules[point]), where, (3, 4), textcoords="offset points", fontsize=6, color=_ALARM)


def _write_at(axes: Axes, height: float, text: str, colour: str) -> None:
    place = axes.get_yaxis_transform()
    axes.text(1.008, height, text, transform=place, fontsize=7, color=colour, va="center", clip_on=False)


def _draw_levels(axes: Axes, changes: Changes, t: np.ndarray[Any, Any]) -> None:
    edges = [0, *(point.at for point in changes.points), t.size]
    for first, last, level in zip(edges[:-1], edges[1:], changes.levels, strict=True):
        axes.plot((t[first], t[last - 1]), (level, level), color=_LEVEL, linewidth=2.2, alpha=0.8, zorder=2.5)
    for point in changes.points:
        axes.axvspan(t[point.first - 1], t[point.last], color=_LEVEL, alpha=0.15, linewidth=0)


def _draw_averages(axes: Axes, chart: Chart) -> None:
    axes.set_ylabel(in_both("EWMA", "指数加权平均"), color=INK, fontsize=8)
    axes.tick_params(colors=INK, labelsize=8)
    found = chart.averages
    if found is None:
        axes.set_yticks([])
        return
    t = _times(chart.series)
    axes.fill_between(t, found.lower, found.upper, step="mid", color="#e8efe9", linewidth=0)
    axes.plot(t, found.averages, color=_COLOURS[0], linewidth=1.1)
    if found.outside:
        axes.plot(t[found.outside], found.averages[found.outside], "o", ms=3.5, color=_ALARM)
