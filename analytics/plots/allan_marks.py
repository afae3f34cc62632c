"""Marks on a plot of Allan deviations: limits, slopes, names beside the curves' ends."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

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
    axes.plot(
        (tau_s / _HALF_BAR, tau_s * _HALF_BAR),
        (deviation, deviation),
        color=_LIMIT,
        linewidth=2.0,
        zorder=5,
        solid_capstyle="butt",
    )
    for k in (-1.0, -1 / 3, 1 / 3, 1.0):
        axes.annotate(
            "",
            (tau_s * _HALF_BAR**k, deviation),
            (4, 5),
            textcoords="offset points",
            arrowprops={"arrowstyle": "-", "color": _LIMIT, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0},
            zorder=5,
        )
    axes.annotate(
        f"{word} {text}",
        (tau_s / _HALF_BAR, deviation),
        (0, 8),
        textcoords="offset points",
        ha="left",
        va="bottom",
        color=_LIMIT,
        fontsize=8.5,
        zorder=6,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
    )


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
        axes.annotate(
            f"{text}  {words[text]}",
            (end[0], height),
            (4, 0),
            textcoords="offset points",
            va="center",
            color=SOFT,
            fontsize=7,
        )


def write_names(axes: Axes, names: Sequence[EndName]) -> None:
    """Write each name beside the right edge at the height of its curve's end, pushed apart where they would touch."""
    to_axes = axes.transData + axes.transAxes.inverted()
    ends = [tuple(to_axes.transform((end.tau_s, end.deviation))) for end in names]
    order = sorted(range(len(names)), key=lambda i: float(ends[i][1]))
    heights = spread([float(ends[i][1]) for i in order], _NAME_HEIGHT)
    for i, height in zip(order, heights, strict=True):
        name, colour = names[i][:2]
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
        axes.text(1.03, height, name, color=INK, fontsize=8.5, va="center", transform=axes.transAxes)


def spread(heights: list[float], gap: float) -> list[float]:
    """Move rising heights apart by at least `gap`, each as little as the others allow, and keep them in [0, 1].

    Examples
    --------
    >>> [round(h, 2) for h in spread([0.5, 0.5, 0.9], 0.1)]
    [0.45, 0.55, 0.9]
    """
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
