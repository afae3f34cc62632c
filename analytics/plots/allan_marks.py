"""Marks on a plot of Allan deviations: limits, slopes, names beside the curves' ends, the fitted noise model."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from analytics.curves.noise_coefficients import FittedTerm, NoiseCoefficients
from stream.batch import FloatArray
from stream.errors import BadInput, UnknownUnit
from stream.events import Limit
from stream.quantities import conversion
from stream.worker.limit_checks import (
    ALLAN_DEVIATION,
    ANGLE_RANDOM_WALK,
    ANGLE_RANDOM_WALK_TAU_S,
    SQRT_SECONDS_PER_SQRT_HOUR,
)

INK, SOFT, FLEET = "#1a1a1a", "#5f6b76", "#a9b4be"
MINUS_HALF = "\N{MINUS SIGN}1/2"

_LIMIT = "#a40000"
_NAME_HEIGHT = 0.0405
_HALF_BAR = 1.35
# dashes and colours both tell the terms apart; none is the blue of the curve
_STYLES = {
    "quantization_noise": ("#cc79a7", (0, (1.5, 1.5))),
    "angle_random_walk": ("#d55e00", (0, (5, 2))),
    "bias_instability": ("#009e73", (0, (5, 2, 1, 2))),
    "rate_random_walk": ("#7a4fa3", (0, (8, 3))),
    "rate_ramp": ("#6b4423", (0, (3, 1.5))),
    "markov_noise": ("#b88600", (0, (5, 1.5, 1, 1.5, 1, 1.5))),
}
_PLACES = 200
_FELT = 0.02
_MAY_BE_ABSENT = {"en": ", not observable", "zh": "，不可观测"}


class LimitMark(NamedTuple):
    """A limit as a point of the plot."""

    tau_s: float
    deviation: float
    text: str


class EndName(NamedTuple):
    """A name and the point where its curve ends."""

    name: str
    colour: str
    tau_s: float
    deviation: float


def limit_marks(limits: Iterable[Limit], signals: set[str], unit_of_measure: str) -> list[LimitMark]:
    """Those limits on `signals` that are points of an Allan curve, in its unit of measure."""
    marks = []
    for limit in limits:
        if limit.signal not in signals or limit.characteristic not in {ALLAN_DEVIATION, ANGLE_RANDOM_WALK}:
            continue
        is_walk = limit.characteristic == ANGLE_RANDOM_WALK
        tau_s = ANGLE_RANDOM_WALK_TAU_S if is_walk else limit.tau_s
        try:
            factor = conversion("deg/h" if is_walk else limit.unit_of_measure, unit_of_measure)[0]
        except UnknownUnit as error:
            raise BadInput(f"limit on {limit.characteristic} of signal {limit.signal}: {error}") from error
        assert tau_s is not None
        deviation = limit.upper * factor * (SQRT_SECONDS_PER_SQRT_HOUR if is_walk else 1.0)
        unit = "deg/\N{SQUARE ROOT}h" if is_walk else limit.unit_of_measure
        marks.append(LimitMark(tau_s, deviation, f"{limit.upper:g} {unit}"))
    return marks


def draw_limit(axes: Axes, mark: LimitMark, word: str) -> None:
    """A bar with ticks on its forbidden side, named above."""
    tau_s, deviation, text = mark
    offset: dict[str, Any] = {"textcoords": "offset points"}
    ends = (tau_s / _HALF_BAR, tau_s * _HALF_BAR)
    axes.plot(ends, (deviation, deviation), color=_LIMIT, linewidth=2.0, zorder=5, solid_capstyle="butt")
    tick = {"arrowstyle": "-", "color": _LIMIT, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}
    for k in (-1.0, -1 / 3, 1 / 3, 1.0):
        axes.annotate("", (tau_s * _HALF_BAR**k, deviation), (4, 5), arrowprops=tick, zorder=5, **offset)
    offset |= {"ha": "left", "va": "bottom", "path_effects": [withStroke(linewidth=2.5, foreground="white")]}
    axes.annotate(f"{word} {text}", (ends[0], deviation), (0, 8), color=_LIMIT, fontsize=8.5, zorder=6, **offset)


def draw_slopes(axes: Axes, points: Sequence[tuple[float, float]], words: dict[str, str]) -> None:
    """Draw three short lines of the slopes -1/2, 0 and +1/2 in the corner with the fewest `points`."""
    to_axes = axes.transData + axes.transAxes.inverted()
    places = to_axes.transform(points)

    def crowd(corner: tuple[float, float]) -> int:
        x, y = corner
        inside = (abs(places[:, 0] - x - 0.125) < 0.16) & (abs(places[:, 1] - y) < 0.17)
        return int(inside.sum())

    x, y = min(((0.04, 0.15), (0.72, 0.85), (0.04, 0.85), (0.72, 0.15)), key=crowd)
    start, end = to_axes.inverted().transform([(x, y), (x + 0.09, y)])
    for power, text in ((0.5, "+1/2"), (0.0, "0"), (-0.5, MINUS_HALF)):
        height = start[1] * (end[0] / start[0]) ** power
        axes.plot((start[0], end[0]), (start[1], height), color=FLEET, linewidth=0.9, linestyle=(0, (4, 2)))
        beside: dict[str, Any] = {"textcoords": "offset points", "va": "center"}
        axes.annotate(f"{text}  {words[text]}", (end[0], height), (4, 0), color=SOFT, fontsize=7, **beside)


def write_names(axes: Axes, names: Sequence[EndName]) -> None:
    """Write each name beside the right edge at the height of its curve's end, pushed apart where they would touch."""
    to_axes = axes.transData + axes.transAxes.inverted()
    ends = [tuple(to_axes.transform((end.tau_s, end.deviation))) for end in names]
    order = sorted(range(len(names)), key=lambda i: float(ends[i][1]))
    heights = spread([float(ends[i][1]) for i in order], _NAME_HEIGHT)
    for i, height in zip(order, heights, strict=True):
        name, colour = names[i][:2]
        x, y = ends[i]
        line: dict[str, Any] = {"transform": axes.transAxes, "clip_on": False, "zorder": 1.5}
        axes.plot((x, 1.012, 1.022), (y, height, height), color=colour, linewidth=0.7, alpha=0.8, **line)
        axes.text(1.03, height, name, color=INK, fontsize=8.5, va="center", transform=axes.transAxes)


def spread(heights: list[float], gap: float) -> list[float]:
    """Move rising heights apart by at least `gap`, each as little as the others allow, and keep them in [0, 1]."""
    groups: list[tuple[float, int]] = []
    for height in heights:
        centre, n = min(max(height, 0.0), 1.0), 1
        while groups and groups[-1][0] + groups[-1][1] * gap / 2 > centre - n * gap / 2:
            before, m = groups.pop()
            centre, n = (before * m + centre * n) / (m + n), m + n
            half = (n - 1) * gap / 2
            centre = min(max(centre, half), max(half, 1 - half))
        groups.append((centre, n))
    return [centre + (k - (n - 1) / 2) * gap for centre, n in groups for k in range(n)]


def draw_fit(axes: Axes, found: NoiseCoefficients, taus_s: tuple[float, ...], language: str, word: str) -> None:
    """Draw a fitted model over the curve it was fitted to, and a legend of its terms.

    The logarithmic axes, in seconds and deg/h, have their limits set and everything else drawn. The sum of all terms,
    named by `word`, is drawn between the first and the last averaging time of the curve.
    """
    along = np.geomspace(taus_s[0], taus_s[-1], _PLACES)
    lines = axes.plot(along, found.deviation(along), color=INK, linewidth=0.9, zorder=4, label=word)
    whole = np.geomspace(*axes.get_xlim(), _PLACES)
    for fitted in found.terms:
        # a term that is not observable changes the sum where it is not zero
        is_felt = bool((fitted.variance(along) > _FELT * found.deviation(along) ** 2).any())
        if fitted.coefficient.observable or is_felt:
            lines.append(_term(axes, whole, fitted, language))
    legend = axes.legend(
        handles=lines, loc="best", fontsize=7, handlelength=3.2, labelspacing=0.35, borderpad=0.5, borderaxespad=0.8,
        framealpha=0.92, edgecolor="#dfe3e8", fancybox=False, labelcolor=INK,
    )  # fmt: skip
    legend.set_zorder(7)


def _term(axes: Axes, taus_s: FloatArray, fitted: FittedTerm, language: str) -> Line2D:
    colour, dashes = _STYLES[fitted.term.key]
    deviations = np.sqrt(fitted.variance(taus_s))
    is_seen = fitted.coefficient.observable
    label = f"{fitted.term.names[language]}  {fitted.term.symbol} = {_amount(fitted)}"
    if not is_seen:
        label += _MAY_BE_ABSENT[language]
    if fitted.correlation_s is not None:
        label += f", {fitted.correlation_s:.3g} s"
    width = 0.95 if is_seen else 0.6
    return axes.plot(taus_s, deviations, color=colour, linewidth=width, linestyle=dashes, zorder=3.5, label=label)[0]


def _amount(fitted: FittedTerm) -> str:
    """Value and bounds with enough digits to distinguish them, three at least."""
    coefficient = fitted.coefficient
    value, lo, hi = coefficient.value, coefficient.lo, coefficient.hi
    width = max(hi - lo, 1e-5 * value)
    digits = max(3, math.ceil(math.log10(value / width)) + 1) if value > 0.0 else 3
    unit = coefficient.unit_of_measure.replace("sqrt(h)", "\N{SQUARE ROOT}h")
    return f"{value:.{digits}g} ({lo:.{digits}g} \N{EN DASH} {hi:.{digits}g}) {unit}"
