"""A plot of Allan deviations, for a data sheet or a report: PNG or SVG."""

import tomllib
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal
from unicodedata import east_asian_width

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analytics.curves.allan_curve import AllanCurve
from analytics.curves.noise_coefficients import NoiseCoefficients
from analytics.plots import allan_marks
from analytics.plots.allan_marks import FLEET, INK, SOFT, EndName, LimitMark
from analytics.plots.figure_file import LEFT, check_suffix, logarithmic_grid, page, widened, write_figure
from analytics.plots.plot_fonts import chinese_font, set_fonts
from stream.errors import BadInput
from stream.events import Limit

Language = Literal["en", "zh", "en+zh"]

_LANGUAGES = ("en", "zh")
# Okabe and Ito's colours for all kinds of colour vision, without their yellow, which is lost on white
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#6b4423", "#7a4fa3")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "h")
_WORDS = tomllib.loads(files("analytics.plots").joinpath("allan_words.toml").read_text(encoding="utf-8"))
_NAMED_AT_MOST = 24
_NAME_LENGTH = 16
_NAME_END = 10


def plot_allan(
    curves: Sequence[AllanCurve], path: Path, *, title: str | None = None, limits: Iterable[Limit] = (),
    chosen: str | None = None, found: NoiseCoefficients | None = None, language: Language = "en+zh",
) -> None:  # fmt: skip
    """Draw Allan deviations over averaging time into a file.

    The curves are all in one unit of measure. Of the limits those on the Allan deviation and on the angle random walk
    (at 1 s) are marked, for the signal of the curves; others, such as on the bias stability, are no points of this
    plot. `chosen`: the unit to emphasise, the others in grey behind it. `found`: noise fitted to the curve of `chosen`,
    or to the only one: drawn over it, with its terms and a legend. `language`: of the labels; Chinese needs a font for
    it, and where none is installed, labels are English.

    Holds no global state of matplotlib: calls may run in several threads.
    """
    check_suffix(path)
    write_figure(_figure(_checked(curves, chosen), list(limits), title, chosen, language, found), path)


def _checked(curves: Sequence[AllanCurve], chosen: str | None) -> list[AllanCurve]:
    """The drawable curves, the chosen ones last so that they lie on top."""
    if len({curve.deviation for curve in curves}) > 1:
        kinds = ", ".join(sorted({curve.deviation for curve in curves}))
        raise BadInput(f"curves of {kinds} cannot share one axis: plot them apart")
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
    curves: list[AllanCurve], limits: list[Limit], title: str | None, chosen: str | None, language: Language,
    found: NoiseCoefficients | None = None,
) -> Figure:  # fmt: skip
    wanted = [part for part in language.split("+") if part == "en" or chinese_font() is not None] or ["en"]
    words = _WORDS[wanted[0]]
    names_of = {part: curves[0].names[_LANGUAGES.index(part)] for part in wanted}
    what = "  \N{MIDDLE DOT}  ".join(_WORDS[part]["what"].format(overlapping=name) for part, name in names_of.items())
    figure, axes = page(title or _title(curves, chosen), what, width=0.745)
    marks = allan_marks.limit_marks(limits, {curve.signal for curve in curves}, curves[0].unit_of_measure)
    _scales(axes, curves, marks)
    if found is None:
        allan_marks.draw_slopes(axes, _crowd(curves, marks), words)
    names: list[EndName] = []
    for i, curve in enumerate(curves):
        _curve(axes, curve, i, len(curves), chosen)
        if chosen is None or curve.unit == chosen:
            names.append(EndName(_name(curve, curves), _colour(i, curve, chosen), *curve.end))
    others = [curve for curve in curves if chosen is not None and curve.unit != chosen]
    if others:
        middle = sorted(others, key=lambda curve: curve.adev[-1])[len(others) // 2]
        names.append(EndName(words["others"].format(n=len({c.unit for c in others})), SOFT, *middle.end))
    if len(names) <= _NAMED_AT_MOST:
        allan_marks.write_names(axes, names)
    for mark in marks:
        allan_marks.draw_limit(axes, mark, words["limit"])
    if found is not None:
        allan_marks.draw_fit(axes, found, curves[-1].tau_s, wanted[0], words["fit"])
    axes.set_xlabel(words["tau"], color=INK, fontsize=10)
    bare = curves[0].bare_names[_LANGUAGES.index(wanted[0])]
    axes.set_ylabel(words["deviation"].format(name=bare, unit=curves[0].unit_of_measure), color=INK, fontsize=10)
    shown = [curve for curve in curves if chosen in (None, curve.unit)]
    figure.text(LEFT, 0.022, _record(shown, words), fontsize=7.5, color=SOFT)
    set_fonts(figure)
    return figure


def _crowd(curves: list[AllanCurve], marks: list[LimitMark]) -> list[tuple[float, float]]:
    """Points to keep clear of; a limit with its text weighs as much as many points of a curve."""
    lines = [(curve.tau_s, line) for curve in curves for line in (curve.adev, curve.lo, curve.hi)]
    points = [point for taus_s, line in lines for point in zip(taus_s, line, strict=True)]
    return points + [(mark.tau_s, mark.deviation) for mark in marks for _ in range(20)]


def _scales(axes: Axes, curves: list[AllanCurve], marks: list[LimitMark]) -> None:
    """Logarithmic axes around all curves and limits, one grid line a decade."""
    tau_s = [t for curve in curves for t in curve.tau_s] + [t for t, _, _ in marks]
    low = [y for curve in curves for y in curve.lo] + [y for _, y, _ in marks]
    # an upper limit at one or two degrees of freedom is ten times the value and would press the rest flat
    high = [min(hi, 3 * y) for curve in curves for hi, y in zip(curve.hi, curve.adev, strict=True)]
    high += [1.3 * y for _, y, _ in marks]
    axes.set(xscale="log", yscale="log")
    axes.set_xlim(widened(min(tau_s) / 1.4, max(tau_s) * 1.4, 20.0))
    axes.set_ylim(widened(min(low) / 1.25, max(high) * 1.25, 20.0))
    axes.set_axisbelow(True)
    logarithmic_grid(axes)


def _colour(i: int, curve: AllanCurve, chosen: str | None) -> str:
    if chosen is None:
        return _COLOURS[i % len(_COLOURS)]
    return _COLOURS[0] if curve.unit == chosen else FLEET


def _curve(axes: Axes, curve: AllanCurve, i: int, total: int, chosen: str | None) -> None:
    colour = _colour(i, curve, chosen)
    bold = total == 1 or curve.unit == chosen
    if chosen is not None and not bold:
        axes.plot(curve.tau_s, curve.adev, color=colour, linewidth=0.8)
        return
    axes.fill_between(curve.tau_s, curve.lo, curve.hi, color=colour, alpha=0.22 if bold else 0.07, linewidth=0)
    marker = _MARKERS[i % len(_MARKERS)] if chosen is None else "o"
    width, size = (2.0, 4.2) if bold else (1.25, 3.4)
    edge: dict[str, Any] = {"markeredgewidth": 0.5, "markeredgecolor": "white"}
    axes.plot(curve.tau_s, curve.adev, color=colour, linewidth=width, marker=marker, markersize=size, **edge)


def _name(curve: AllanCurve, curves: list[AllanCurve]) -> str:
    """Name by what distinguishes the curves."""
    parts = [curve.unit]
    parts += [curve.signal] if len({other.signal for other in curves}) > 1 else []
    parts += [curve.run] if len({other.run for other in curves}) > 1 else []
    return shortened(" ".join(parts))


def shortened(name: str) -> str:
    """A name that fits beside the axes: of a long one the beginning and the end."""
    if _width(name) <= _NAME_LENGTH:
        return name
    end = next(at for at in range(len(name)) if _width(name[at:]) <= _NAME_END)
    begin = next(at for at in range(end, -1, -1) if _width(name[:at]) < _NAME_LENGTH - _NAME_END)
    return f"{name[:begin]}\N{HORIZONTAL ELLIPSIS}{name[end:]}"


def _width(text: str) -> int:
    """Characters, of which Chinese ones are as wide as two."""
    return sum(2 if east_asian_width(each) in "WF" else 1 for each in text)


def _title(curves: list[AllanCurve], chosen: str | None) -> str:
    units, runs = {curve.unit for curve in curves}, {curve.run for curve in curves}
    who = chosen or (curves[0].unit if len(units) == 1 else f"{len(units)} units")
    signals = ", ".join(sorted({curve.signal for curve in curves}))
    which = f"run {curves[0].run}" if len(runs) == 1 else f"{len(runs)} runs"
    return f"{who}  \N{MIDDLE DOT}  {signals}  \N{MIDDLE DOT}  {which}"


def _record(curves: list[AllanCurve], words: dict[str, str]) -> str:
    """Lengths of the records and missing samples."""
    hours = sorted(curve.samples * curve.sample_interval_s / 3600 for curve in curves)
    least, most = f"{hours[0]:.3g}", f"{hours[-1]:.3g}"
    return words["record"].format(
        hours=least if least == most else f"{least} \N{EN DASH} {most}",
        interval=", ".join(sorted({f"{curve.sample_interval_s:g}" for curve in curves})),
        samples=f"{sum(curve.samples for curve in curves):,}",
        missing=f"{sum(curve.missing for curve in curves):,}",
    )
