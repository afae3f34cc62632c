"""A plot of a power spectral density with its lines, for a data sheet or a report: PNG or SVG."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.markers import CARETDOWN

from analytics.curves.spectrum import Level, SignalSpectrum, with_error
from analytics.plots.allan_marks import FLEET, INK, SOFT
from analytics.plots.figure_file import LEFT, check_suffix, in_both, logarithmic_grid, page, widened, write_figure
from analytics.plots.plot_fonts import set_fonts
from stream.errors import BadInput
from stream.estimators.spectral_density import FIRST_BIN
from stream.estimators.spectrum.spectral_lines import SpectralLine

_DENSITY, _LINE = "#0072b2", "#d55e00"
_BANDS_A_DECADE = 20
_NAMED_AT_MOST = 11
_NAME_HEIGHT = 0.078
_LONGEST_NUMBER = 8
_NUMBER_ABOVE, _NUMBER_WIDTH = 6.0, 8.0
_POINTS_PER_INCH = 72.0
_DOT = "  \N{MIDDLE DOT}  "
_MOST_OVER = 3.0


def plot_spectrum(spectrum: SignalSpectrum, path: Path) -> None:
    """Draw a power spectral density into a file, PNG or SVG.

    Every bin is drawn lightly; boldly the mean over a twentieth of a decade without the bins of lines, with its limits.
    """
    check_suffix(path)
    write_figure(_figure(spectrum), path)


def _figure(spectrum: SignalSpectrum) -> Figure:
    low_hz, high_hz = spectrum.frequency_hz[0], spectrum.frequency_hz[-1]
    decades = math.log10(high_hz / low_hz)
    edges = np.geomspace(low_hz, high_hz, max(2, math.ceil(decades * _BANDS_A_DECADE) + 1))
    edges[0], edges[-1] = 0.99 * edges[0], 1.01 * edges[-1]
    levels = [level for level in spectrum.levels(edges) if level.lo > 0.0]
    if not levels:
        raise BadInput(
            f"unit {spectrum.unit}, signal {spectrum.signal}, run {spectrum.run}: no density above 0 to draw; "
            "the output is constant"
        )
    name = in_both("Power spectral density", "功率谱密度")
    figure, axes = page(
        _DOT.join((spectrum.unit, spectrum.signal, f"run {spectrum.run}")),
        f"{name}; grey: every bin; bold: mean of 1/{_BANDS_A_DECADE} decade, lines left out; "
        f"band: {spectrum.confidence * 100:g} % confidence",
        0.745 if spectrum.lines else 0.875,  # the lines are listed beside the axes
    )
    _scales(axes, spectrum, levels)
    # a path of every bin would make an SVG of megabytes
    axes.plot(spectrum.frequency_hz, spectrum.psd, color=FLEET, alpha=0.7, linewidth=0.5, rasterized=True)
    middles = [level.frequency_hz for level in levels]
    lows, highs = [level.lo for level in levels], [level.hi for level in levels]
    axes.fill_between(middles, lows, highs, color=_DENSITY, alpha=0.25, linewidth=0)
    axes.plot(middles, [level.psd for level in levels], color=_DENSITY, linewidth=1.8)
    strongest = sorted(spectrum.lines, key=lambda line: line.background_ratio)[-_NAMED_AT_MOST:]
    named = sorted(strongest, key=lambda line: line.frequency_hz)
    _mark(axes, spectrum, named)
    for hump in spectrum.humps:
        axes.axvspan(hump.frequency_lo_hz, hump.frequency_hi_hz, color=_LINE, alpha=0.12, linewidth=0, zorder=0.5)
    _write_record(figure, axes, spectrum)
    if named:
        _list_lines(axes, spectrum, named)
    set_fonts(figure)
    return figure


def _scales(axes: Axes, spectrum: SignalSpectrum, levels: list[Level]) -> None:
    """Logarithmic axes around all densities, one grid line a decade."""
    # a band of one bin of few segments has limits far apart, which would press the rest flat
    highs = [min(level.hi, _MOST_OVER * level.psd) for level in levels]
    high = max(*highs, *spectrum.psd)
    low = min(max(level.lo, level.psd / _MOST_OVER) for level in levels)
    axes.set(xscale="log", yscale="log")
    axes.set_xlim(spectrum.frequency_hz[0] / 1.15, spectrum.frequency_hz[-1] * 1.15)
    axes.set_ylim(widened(low / 2.0, high * (2.5 if spectrum.lines else 1.3), 100.0))
    axes.set_axisbelow(True)
    logarithmic_grid(axes, most_decades=12)


def _mark(axes: Axes, spectrum: SignalSpectrum, named: Sequence[SpectralLine]) -> None:
    """A caret on every line, with its number, if any, above other marks."""
    peaks = [spectrum.psd[round(line.frequency_hz / spectrum.bin_width_hz) - FIRST_BIN] for line in spectrum.lines]
    points = [(line.frequency_hz, peak) for line, peak in zip(spectrum.lines, peaks, strict=True)]
    taken = (axes.transData.transform(points) * _POINTS_PER_INCH / axes.figure.dpi).tolist()
    for i, line in enumerate(spectrum.lines):
        axes.plot(*points[i], marker=CARETDOWN, markersize=5.5, color=_LINE, zorder=5)
        if line not in named:
            continue
        x, y = taken[i]
        height = _NUMBER_ABOVE
        while any(abs(x - other) < _NUMBER_WIDTH and -8.0 < top - y - height < 9.0 for other, top in taken):
            height += 1.0
        taken.append([x, y + height])
        above: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "va": "bottom", "fontweight": "bold"}
        number = str(named.index(line) + 1)
        axes.annotate(number, points[i], (0, height), color=_LINE, fontsize=8, zorder=6, **above)


def _list_lines(axes: Axes, spectrum: SignalSpectrum, named: Sequence[SpectralLine]) -> None:
    """The lines by number beside the axes, with frequency and amplitude."""
    beside: dict[str, Any] = {"va": "top", "transform": axes.transAxes}
    axes.text(1.025, 1.0, in_both("Lines", "谱线"), color=INK, fontsize=8.5, fontweight="bold", **beside)
    for i, line in enumerate(named):
        top = 0.945 - i * _NAME_HEIGHT
        frequency = with_error(line.frequency_hz, line.frequency_hi_hz - line.frequency_hz, digits=1).split(" ")[0]
        frequency = frequency if len(frequency) <= _LONGEST_NUMBER else f"{line.frequency_hz:.7g}"
        amplitude = f"{line.amplitude:.3g} {spectrum.unit_of_measure}"
        axes.text(1.025, top, str(i + 1), color=_LINE, fontsize=8, fontweight="bold", **beside)
        axes.text(1.06, top, f"{frequency} Hz", color=INK, fontsize=8, **beside)
        axes.text(1.06, top - 0.031, amplitude, color=SOFT, fontsize=7.5, **beside)
    if len(spectrum.lines) > len(named):
        text = f"and {len(spectrum.lines) - len(named)} weaker"
        axes.text(1.025, 0.945 - len(named) * _NAME_HEIGHT, text, color=SOFT, fontsize=7.5, **beside)


def _write_record(figure: Figure, axes: Axes, spectrum: SignalSpectrum) -> None:
    """Axis labels and record."""
    unit = spectrum.psd_unit.replace("^2", "\N{SUPERSCRIPT TWO}")
    axes.set_xlabel(in_both("Frequency (Hz)", "频率"), color=INK, fontsize=10)
    axes.set_ylabel(f"One-sided power spectral density ({unit})", color=INK, fontsize=10)
    hours = spectrum.samples * spectrum.sample_interval_s / 3600
    record = (
        f"{hours:.3g} h at {spectrum.sample_interval_s:g} s; {spectrum.samples:,} samples, "
        f"{spectrum.missing:,} missing; {spectrum.segments:,} segments, resolution {spectrum.bin_width_hz:.3g} Hz"
    )
    if not spectrum.lines:
        record += f"; no line stands out from {spectrum.searched_lo_hz:.3g} to {spectrum.searched_hi_hz:.3g} Hz"
    if spectrum.humps:
        record += "; shaded: humps"
    figure.text(LEFT, 0.022, record, fontsize=7.5, color=SOFT)
