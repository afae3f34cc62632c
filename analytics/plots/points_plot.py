"""A plot of measured points with their uncertainties over one quantity, for a report or a certificate."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from analytics.plots.allan_marks import FLEET, INK
from analytics.plots.figure_file import check_suffix, page, write_figure
from analytics.plots.plot_fonts import set_fonts
from stream.errors import BadInput

_COLOUR = "#0072b2"


class Axis(NamedTuple):
    """What an axis shows: values in their order, and a label with the unit of measure."""

    values: Sequence[float]
    label: str


def plot_points(x: Axis, y: Axis, expanded: Sequence[float | None], path: Path, *, title: str, what: str) -> None:
    """Draw points with bars of their expanded uncertainties into a file, PNG or SVG; those without one get no bar."""
    check_suffix(path)
    if not x.values:
        raise BadInput(f"{title}: there are no points to draw")
    figure, axes = page(title, what, width=0.87)
    axes.axhline(0.0, color=FLEET, linewidth=0.8)
    bars = [each or 0.0 for each in expanded]
    axes.errorbar(x.values, y.values, yerr=bars, fmt="o", markersize=4.5, color=_COLOUR, elinewidth=1.1, capsize=3.0)
    axes.grid(visible=True, linewidth=0.5, alpha=0.5)
    axes.set_xlabel(x.label, color=INK)
    axes.set_ylabel(y.label, color=INK)
    axes.tick_params(colors=INK)
    for spine in axes.spines.values():
        spine.set_color(FLEET)
    set_fonts(figure)
    write_figure(figure, path)
