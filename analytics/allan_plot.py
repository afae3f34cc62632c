"""A plot of Allan deviations, for a data sheet or a report: PNG or SVG."""

import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from analytics.limits import (
    ALLAN_DEVIATION,
    ANGLE_RANDOM_WALK,
    ANGLE_RANDOM_WALK_TAU_S,
    SQRT_SECONDS_PER_SQRT_HOUR,
)
from analytics.plot_fonts import chinese_font, set_fonts
from stream.errors import BadInput, UnknownUnit
from stream.events import Limit
from stream.quantities import conversion

Language = Literal["en", "zh", "en+zh"]

_SUFFIXES = (".png", ".svg")
_INK, _SOFT, _GRID, _FLEET = "#1a1a1a", "#5f6b76", "#dfe3e8", "#a9b4be"
_LIMIT = "#a40000"
# Okabe and Ito's colours for all kinds of colour vision, without their yellow, which is lost on white
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#6b4423", "#7a4fa3")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "h")
_WORDS = {
    "en": {
        "tau": "Averaging time τ (s)",
        "deviation": "Allan deviation ({unit})",
        "what": "Overlapping Allan deviation; bands: 95 % confidence",
        "limit": "limit",
        "+1/2": "rate random walk",
        "0": "bias instability",
        "\N{MINUS SIGN}1/2": "angle random walk",
        "record": "{hours} h at {interval} s; {samples} samples, {missing} missing",
        "others": "{n} other units",
    },
    "zh": {
        "tau": "平均时间 τ (s)",
        "deviation": "Allan 标准差 ({unit})",
        "what": "重叠 Allan 标准差；色带：95 % 置信区间",
        "limit": "限值",
        "+1/2": "角速率随机游走",
        "0": "零偏不稳定性",
        "\N{MINUS SIGN}1/2": "角度随机游走",
        "record": "{hours} h，采样间隔 {interval} s；样本 {samples} 个，缺失 {missing} 个",
        "others": "其余 {n} 只",
    },
}
SECONDS_PER_HOUR = 3600.0
_LEFT, _WIDTH = 0.095, 0.745
_NAMED_AT_MOST = 24
_NAME_HEIGHT = 0.0405
_NAME_LENGTH = 19
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


# averaging time in s, deviation in the curves' unit, text
_Mark = tuple[float, float, str]


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviation of one signal over averaging time.

    Parameters
    ----------
    unit, signal, run : str
        Whose curve it is.
    unit_of_measure : str
        Of `adev`, `lo` and `hi`.
    sample_interval_s : float
        Sample interval of the record, seconds.
    samples, missing : int
        Samples in the record, and missing from it.
    tau_s : tuple of float
        Averaging times, seconds, rising.
    adev, lo, hi : tuple of float
        Deviation and its confidence limits (95 %).
    edf : tuple of float
        Equivalent degrees of freedom.

    Raises
    ------
    BadInput
        If the columns differ in length.
    """

    unit: str
    signal: str
    run: str
    unit_of_measure: str
    sample_interval_s: float
    samples: int
    missing: int
    tau_s: tuple[float, ...]
    adev: tuple[float, ...]
    lo: tuple[float, ...]
    hi: tuple[float, ...]
    edf: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check that the columns fit together."""
        if len({len(column) for column in (self.tau_s, self.adev, self.lo, self.hi, self.edf)}) != 1:
            raise BadInput(f"Allan curve of unit {self.unit}, run {self.run}: its columns differ in length")

    def drawable(self) -> "AllanCurve":
        """Return the curve without the points that a logarithmic axis cannot show."""
        rows = [
            row
            for row in zip(self.tau_s, self.adev, self.lo, self.hi, self.edf, strict=True)
            if all(math.isfinite(x) and x > 0 for x in row[:4])
        ]
        columns = zip(*rows, strict=True) if rows else ((),) * 5
        tau_s, adev, lo, hi, edf = (tuple(column) for column in columns)
        head = (self.unit, self.signal, self.run, self.unit_of_measure, self.sample_interval_s)
        return AllanCurve(*head, self.samples, self.missing, tau_s, adev, lo, hi, edf)


def plot_allan(
    curves: Sequence[AllanCurve],
    path: Path,
    *,
    title: str | None = None,
    limits: Iterable[Limit] = (),
    chosen: str | None = None,
    language: Language = "en+zh",
) -> None:
    """Draw Allan deviations over averaging time into a file.

    Parameters
    ----------
    curves : sequence of AllanCurve
        One or several, all in one unit of measure.
    path : Path
        Where to, ``.png`` or ``.svg``.
    title : str, optional
        Title; by default the unit (or how many), signal and run.
    limits : iterable of Limit
        Those on the Allan deviation and on the angle random walk (at 1 s) are marked, for the signal of the curves;
        others, such as on the bias stability, are no points of this plot and are left out.
    chosen : str, optional
        The unit to draw boldly, with the rest as a grey fleet behind it.
    language : {"en+zh", "en", "zh"}
        Of the labels. Chinese needs a font for it; where none is installed, labels are English.

    Raises
    ------
    BadInput
        If there is nothing to draw, the curves differ in unit of measure, no curve is of the chosen unit, the suffix
        is another one, or the file cannot be written.

    Notes
    -----
    Holds no global state of matplotlib: calls may run in several threads.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise BadInput(f"plot {path}: plots are written as .png or .svg, choose one of the two")
    figure = _figure(_checked(curves, chosen), list(limits), title, chosen, language)
    image = io.BytesIO()
    kind = path.suffix.lower()[1:]
    figure.savefig(image, format=kind, dpi=200, metadata={"Date": None} if kind == "svg" else None)
    try:
        path.write_bytes(image.getvalue())
    except OSError as error:
        raise BadInput(f"plot {path}: cannot be written ({error.strerror or error})") from error


def _checked(curves: Sequence[AllanCurve], chosen: str | None) -> list[AllanCurve]:
    """Return the curves that can be drawn, the chosen ones last so that they lie on top."""
    if len({curve.unit_of_measure for curve in curves}) > 1:
        units = ", ".join(sorted({curve.unit_of_measure for curve in curves}))
        raise BadInput(f"Allan curves in {units} cannot share one axis: plot them apart")
    drawn = [curve for curve in (curve.drawable() for curve in curves) if curve.tau_s]
    if not drawn:
        raise BadInput("no Allan curve has a point to draw: a longer record, or one that is not constant, is needed")
    if chosen is not None and all(curve.unit != chosen for curve in drawn):
        known = ", ".join(sorted({curve.unit for curve in drawn}))
        raise BadInput(f"no Allan curve of unit {chosen} to draw; there are {known}")
    return sorted(drawn, key=lambda curve: curve.unit == chosen)


def _figure(
    curves: list[AllanCurve], limits: list[Limit], title: str | None, chosen: str | None, language: Language
) -> Figure:
    wanted = [part for part in language.split("+") if part == "en" or chinese_font() is not None] or ["en"]
    words = _WORDS[wanted[0]]
    figure = Figure(figsize=(8.2, 5.4), facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((_LEFT, 0.135, _WIDTH, 0.725))
    marks = _limit_marks(curves, limits)
    _scales(axes, curves, marks)
    _slope_key(axes, curves, marks, words)
    names: list[tuple[str, str, AllanCurve]] = []
    for i, curve in enumerate(curves):
        _curve(axes, curve, i, len(curves), chosen)
        if chosen is None or curve.unit == chosen:
            names.append((_name(curve, curves), _colour(i, curve, chosen), curve))
    others = [curve for curve in curves if chosen is not None and curve.unit != chosen]
    if others:
        middle = sorted(others, key=lambda curve: curve.adev[-1])[len(others) // 2]
        names.append((words["others"].format(n=len({curve.unit for curve in others})), _SOFT, middle))
    if len(names) <= _NAMED_AT_MOST:
        _write_names(axes, names)
    for tau_s, deviation, text in marks:
        _limit(axes, tau_s, deviation, f"{words['limit']} {text}")
    axes.set_xlabel(words["tau"], color=_INK, fontsize=10)
    axes.set_ylabel(words["deviation"].format(unit=curves[0].unit_of_measure), color=_INK, fontsize=10)
    figure.text(_LEFT, 0.945, title or _title(curves, chosen), fontsize=13, fontweight="bold", color=_INK)
    what = "  \N{MIDDLE DOT}  ".join(_WORDS[part]["what"] for part in wanted)
    figure.text(_LEFT, 0.893, what, fontsize=8.5, color=_SOFT)
    shown = [curve for curve in curves if chosen in (None, curve.unit)]
    figure.text(_LEFT, 0.022, _record(shown, words), fontsize=7.5, color=_SOFT)
    set_fonts(figure)
    return figure


def _scales(axes: Axes, curves: list[AllanCurve], marks: list[_Mark]) -> None:
    """Logarithmic axes around all there is to see, one line of the grid a decade."""
    tau_s = [t for curve in curves for t in curve.tau_s] + [t for t, _, _ in marks]
    low = [y for curve in curves for y in curve.lo] + [y for _, y, _ in marks]
    # an upper limit at one or two degrees of freedom is ten times the value and would press the rest flat
    high = [min(hi, 3 * y) for curve in curves for hi, y in zip(curve.hi, curve.adev, strict=True)]
    high += [1.3 * y for _, y, _ in marks]
    bottom, top = min(low) / 1.25, max(high) * 1.25
    stretch = math.sqrt(max(1.0, 20.0 * bottom / top))
    axes.set(xscale="log", yscale="log", xlim=(min(tau_s) / 1.4, max(tau_s) * 1.4))
    axes.set_ylim(bottom / stretch, top * stretch)
    axes.set_axisbelow(True)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(10, numticks=99))
        axis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=99))
        axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value)))
        axis.set_minor_formatter(NullFormatter())
        axis.grid(True, which="major", color=_GRID, linewidth=0.9)
        axis.grid(True, which="minor", color=_GRID, linewidth=0.35)
    axes.tick_params(which="both", color=_FLEET, labelcolor=_INK, labelsize=9, direction="out")
    for spine in axes.spines.values():
        spine.set_color(_FLEET)


def _plain(value: float) -> str:
    """A power of ten as people write it: 0.01, 100, 10\N{SUPERSCRIPT FIVE}."""
    exponent = round(math.log10(value))
    if -4 < exponent < 5:
        return f"{value:.{max(0, -exponent)}f}"
    return "10" + str(exponent).translate(_SUPERSCRIPTS)


def _colour(i: int, curve: AllanCurve, chosen: str | None) -> str:
    if chosen is None:
        return _COLOURS[i % len(_COLOURS)]
    return _COLOURS[0] if curve.unit == chosen else _FLEET


def _curve(axes: Axes, curve: AllanCurve, i: int, total: int, chosen: str | None) -> None:
    colour = _colour(i, curve, chosen)
    bold = total == 1 or curve.unit == chosen
    if chosen is not None and not bold:
        axes.plot(curve.tau_s, curve.adev, color=colour, linewidth=0.8)
        return
    axes.fill_between(curve.tau_s, curve.lo, curve.hi, color=colour, alpha=0.22 if bold else 0.07, linewidth=0)
    axes.plot(
        curve.tau_s,
        curve.adev,
        color=colour,
        linewidth=2.0 if bold else 1.25,
        marker=_MARKERS[i % len(_MARKERS)] if chosen is None else "o",
        markersize=4.2 if bold else 3.4,
        markeredgewidth=0.5,
        markeredgecolor="white",
    )


def _write_names(axes: Axes, names: list[tuple[str, str, AllanCurve]]) -> None:
    """Write each name beside the right edge at the height of its curve's end, pushed apart where they would touch."""
    to_axes = axes.transData + axes.transAxes.inverted()
    ends = [tuple(to_axes.transform((curve.tau_s[-1], curve.adev[-1]))) for _, _, curve in names]
    order = sorted(range(len(names)), key=lambda i: float(ends[i][1]))
    heights = _spread([float(ends[i][1]) for i in order], _NAME_HEIGHT)
    for i, height in zip(order, heights, strict=True):
        name, colour, _ = names[i]
        x, y = ends[i]
        axes.plot(
            (x, 1.012, 1.022),
            (y, height, height),
            color=colour,
            linewidth=0.7,
            alpha=0.8,
            transform=axes.transAxes,
            clip_on=False,
            zorder=1.5,
        )
        axes.text(1.03, height, name, color=_INK, fontsize=8.5, va="center", transform=axes.transAxes)


def _spread(heights: list[float], gap: float) -> list[float]:
    """Move rising heights apart by at least `gap`, each as little as the others allow, and keep them in [0, 1].

    Examples
    --------
    >>> [round(h, 2) for h in _spread([0.5, 0.5, 0.9], 0.1)]
    [0.45, 0.55, 0.9]
    """
    groups: list[tuple[float, int]] = []
    for height in heights:
        centre, n = height, 1
        while groups and groups[-1][0] + groups[-1][1] * gap / 2 > centre - n * gap / 2:
            before, m = groups.pop()
            centre, n = (before * m + centre * n) / (m + n), m + n
        half = (n - 1) * gap / 2
        groups.append((min(max(centre, half), max(half, 1 - half)), n))
    return [centre + (k - (n - 1) / 2) * gap for centre, n in groups for k in range(n)]


def _limit_marks(curves: list[AllanCurve], limits: list[Limit]) -> list[_Mark]:
    """Averaging time, deviation in the curves' unit, and text of each limit that is a point of this plot."""
    target = curves[0].unit_of_measure
    signals = {curve.signal for curve in curves}
    marks = []
    for limit in limits:
        if limit.signal not in signals or limit.characteristic not in {ALLAN_DEVIATION, ANGLE_RANDOM_WALK}:
            continue
        is_walk = limit.characteristic == ANGLE_RANDOM_WALK
        tau_s = ANGLE_RANDOM_WALK_TAU_S if is_walk else limit.tau_s
        try:
            factor = conversion("deg/h" if is_walk else limit.unit_of_measure, target)[0]
        except UnknownUnit as error:
            raise BadInput(f"limit on {limit.characteristic} of signal {limit.signal}: {error}") from error
        assert tau_s is not None
        deviation = limit.upper * factor * (SQRT_SECONDS_PER_SQRT_HOUR if is_walk else 1.0)
        unit = "deg/\N{SQUARE ROOT}h" if is_walk else limit.unit_of_measure
        marks.append((tau_s, deviation, f"{limit.upper:g} {unit}"))
    return marks


def _limit(axes: Axes, tau_s: float, deviation: float, text: str) -> None:
    """A bar with ticks on its forbidden side, named above."""
    half = 1.35
    axes.plot(
        (tau_s / half, tau_s * half),
        (deviation, deviation),
        color=_LIMIT,
        linewidth=2.0,
        zorder=5,
        solid_capstyle="butt",
    )
    for k in (-1.0, -1 / 3, 1 / 3, 1.0):
        axes.annotate(
            "",
            (tau_s * half**k, deviation),
            (4, 5),
            textcoords="offset points",
            arrowprops={"arrowstyle": "-", "color": _LIMIT, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0},
            zorder=5,
        )
    axes.annotate(
        text,
        (tau_s / half, deviation),
        (0, 8),
        textcoords="offset points",
        ha="left",
        va="bottom",
        color=_LIMIT,
        fontsize=8.5,
        zorder=6,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
    )


def _slope_key(axes: Axes, curves: list[AllanCurve], marks: list[_Mark], words: dict[str, str]) -> None:
    """Three short lines of the slopes -1/2, 0 and +1/2, in the emptiest corner."""
    to_axes = axes.transData + axes.transAxes.inverted()
    points = [
        (t, y)
        for curve in curves
        for line in (curve.adev, curve.lo, curve.hi)
        for t, y in zip(curve.tau_s, line, strict=True)
    ]
    points += [(t, y) for t, y, _ in marks for _ in range(20)]
    places = to_axes.transform(points)

    def crowd(corner: tuple[float, float]) -> int:
        x, y = corner
        inside = (abs(places[:, 0] - x - 0.125) < 0.16) & (abs(places[:, 1] - y) < 0.17)
        return int(inside.sum())

    x, y = min(((0.04, 0.15), (0.72, 0.85), (0.04, 0.85), (0.72, 0.15)), key=crowd)
    start, end = to_axes.inverted().transform([(x, y), (x + 0.09, y)])
    for power, slope in ((0.5, "+1/2"), (0.0, "0"), (-0.5, "\N{MINUS SIGN}1/2")):
        height = start[1] * (end[0] / start[0]) ** power
        axes.plot((start[0], end[0]), (start[1], height), color=_FLEET, linewidth=0.9, linestyle=(0, (4, 2)))
        axes.annotate(text, (end[0], height), (4, 0), textcoords="offset points", va="center", color=_SOFT, fontsize=7)


def _name(curve: AllanCurve, curves: list[AllanCurve]) -> str:
    """Name by what tells the curves apart."""
    parts = [curve.unit]
    parts += [curve.signal] if len({other.signal for other in curves}) > 1 else []
    parts += [curve.run] if len({other.run for other in curves}) > 1 else []
    name = " ".join(parts)
    return name if len(name) <= _NAME_LENGTH else f"{name[: _NAME_LENGTH - 11]}\N{HORIZONTAL ELLIPSIS}{name[-10:]}"


def _title(curves: list[AllanCurve], chosen: str | None) -> str:
    units = {curve.unit for curve in curves}
    runs = {curve.run for curve in curves}
    who = chosen or (curves[0].unit if len(units) == 1 else f"{len(units)} units")
    signals = ", ".join(sorted({curve.signal for curve in curves}))
    return f"{who}  \N{MIDDLE DOT}  {signals}  \N{MIDDLE DOT}  " + (
        f"run {curves[0].run}" if len(runs) == 1 else f"{len(runs)} runs"
    )


def _record(curves: list[AllanCurve], words: dict[str, str]) -> str:
    """How long the records are and what they lack."""
    hours = sorted(curve.samples * curve.sample_interval_s / SECONDS_PER_HOUR for curve in curves)
    least, most = f"{hours[0]:.3g}", f"{hours[-1]:.3g}"
    return words["record"].format(
        hours=least if least == most else f"{least} \N{EN DASH} {most}",
        interval=", ".join(sorted({f"{curve.sample_interval_s:g}" for curve in curves})),
        samples=f"{sum(curve.samples for curve in curves):,}",
        missing=f"{sum(curve.missing for curve in curves):,}",
    )
