"""What all plots share: the file they are written to, and logarithmic axes that people can read."""

import io
import math
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from analytics.plots.allan_marks import FLEET, INK, SOFT
from analytics.plots.plot_fonts import chinese_font
from stream.errors import BadInput

_GRID = "#dfe3e8"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


LEFT = 0.095


def page(title: str, what: str, width: float) -> tuple[Figure, Axes]:
    """A figure with one pair of axes of this width, a title and a line below it."""
    figure = Figure(figsize=(8.2, 5.4), facecolor="white")
    axes = figure.add_axes((LEFT, 0.135, width, 0.725))
    figure.text(LEFT, 0.945, title, fontsize=13, fontweight="bold", color=INK)
    figure.text(LEFT, 0.893, what, fontsize=8.5, color=SOFT)
    return figure, axes


def in_both(en: str, zh: str, between: str = "  ") -> str:
    """A label in English and, where there is a font for it, in Chinese."""
    return en if chinese_font() is None else f"{en}{between}{zh}"


def check_suffix(path: Path) -> None:
    """Refuse a file that is to be neither PNG nor SVG."""
    if path.suffix.lower() not in {".png", ".svg"}:
        raise BadInput(f"plot {path}: plots are written as .png or .svg, choose one of the two")


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure as its suffix says; the same figure gives the same bytes."""
    image = io.BytesIO()
    kind = path.suffix.lower()[1:]
    with rc_context({"svg.hashsalt": "gyrofleet"}):  # else the names in an SVG differ from time to time
        figure.savefig(image, format=kind, dpi=200, metadata={"Date": None} if kind == "svg" else None)
    try:
        path.write_bytes(image.getvalue())
    except OSError as error:
        raise BadInput(f"plot {path}: cannot be written ({error.strerror or error})") from error


def logarithmic_grid(axes: Axes, most_decades: int = 99) -> None:
    """Label both logarithmic axes at powers of ten, with a grid."""
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(10, numticks=most_decades))
        axis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=most_decades))
        axis.set_major_formatter(FuncFormatter(lambda value, _: power_of_ten(value)))
        axis.set_minor_formatter(NullFormatter())
        axis.grid(True, which="major", color=_GRID, linewidth=0.9)
        axis.grid(True, which="minor", color=_GRID, linewidth=0.35)
    axes.tick_params(which="both", color=FLEET, labelcolor=INK, labelsize=9, direction="out")
    for spine in axes.spines.values():
        spine.set_color(FLEET)


def widened(low: float, high: float, least_ratio: float) -> tuple[float, float]:
    """Widen a range that might hold too few powers of ten to label."""
    stretch = math.sqrt(max(1.0, least_ratio * low / high))
    return low / stretch, high * stretch


def power_of_ten(value: float) -> str:
    """A power of ten as people write it.

    >>> power_of_ten(0.01), power_of_ten(100.0), power_of_ten(1e5)
    ('0.01', '100', '10⁵')
    """
    exponent = round(math.log10(value))
    if -4 < exponent < 5:
        return f"{value:.{max(0, -exponent)}f}"
    return "10" + str(exponent).translate(_SUPERSCRIPTS)
