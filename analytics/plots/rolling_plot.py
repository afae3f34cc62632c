"""The rolling Allan deviation as a surface seen from above: time, averaging time, deviation by colour."""

from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from analytics.curves.rolling_allan import RollingAllan
from analytics.plots.allan_marks import INK
from analytics.plots.figure_file import check_suffix, in_both, page, write_figure
from analytics.plots.plot_fonts import set_fonts
from stream.batch import FloatArray
from stream.errors import BadInput

_LEAST_SPREAD = 1.5


def plot_rolling(surface: RollingAllan, path: Path) -> None:
    """Draw a rolling Allan deviation into a file, PNG or SVG."""
    check_suffix(path)
    values = np.array([[np.nan if cell is None or cell <= 0.0 else cell for cell in row] for row in surface.adev])
    if np.isnan(values).all():
        where = f"unit {surface.unit}, signal {surface.signal}"
        raise BadInput(f"{where}: no deviation above 0 to draw; the output is constant")
    window_h, step_h = surface.window_s / 3600, surface.step_s / 3600
    what = in_both("Rolling Allan deviation", "动态 Allan 标准差", "  ·  ")
    title = f"{surface.unit} {surface.signal}, run {surface.run}"
    figure, axes = page(title, f"{what}; windows of {window_h:g} h every {step_h:g} h", 0.735)
    middles_h = np.array(surface.start_h) + surface.window_s / 2 / 3600
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    norm = LogNorm(low, max(high, low * _LEAST_SPREAD))
    taus_s = np.array(surface.tau_s)
    columns = _edges(middles_h, step_h)
    rows = np.exp(_edges(np.log(taus_s), np.log(2.0)))
    image = axes.pcolormesh(columns, rows, values.T, norm=norm, cmap="viridis", rasterized=True)
    if min(values.shape) >= 2 and high > low * _LEAST_SPREAD:
        levels = np.geomspace(low, high, 10)[1:-1]
        axes.contour(middles_h, taus_s, values.T, levels=levels, colors="white", linewidths=0.6, alpha=0.7)
    axes.set_yscale("log")
    # the fonts are set for plain text, which powers of ten are not
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel("Averaging time τ (s)", color=INK)
    axes.set_xlabel(in_both("Middle of the window (h)", "窗口中点"), color=INK)
    axes.tick_params(colors=INK)
    bar = figure.colorbar(image, cax=figure.add_axes((0.85, 0.135, 0.025, 0.725)), format=StrMethodFormatter("{x:g}"))
    bar.ax.yaxis.set_minor_formatter(NullFormatter())
    bar.set_label(f"Allan deviation ({surface.unit_of_measure})", color=INK)
    set_fonts(figure)
    write_figure(figure, path)


def _edges(middles: FloatArray, only: float) -> FloatArray:
    """Edges of cells around their middles; `only` is the width of a single one."""
    if len(middles) == 1:
        return np.array([middles[0] - only / 2, middles[0] + only / 2])
    between = (middles[1:] + middles[:-1]) / 2
    return np.concatenate([[2 * middles[0] - between[0]], between, [2 * middles[-1] - between[-1]]])
