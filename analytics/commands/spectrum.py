"""The command `gyrofleet spectrum`: power spectral density of a recorded signal, its lines and humps."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from storage.commands.stored_names import RUN, SIGNAL, UNIT
from stream.terminal.console import notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from analytics.curves.spectrum import SignalSpectrum

_NONE = "\N{EN DASH}"
_HALF_BAND = 10.0**0.05
_FEW_ROWS = 4


@click.command("spectrum")
@click.option("--unit", type=UNIT, required=True, help="Which unit.")
@click.option("--signal", type=SIGNAL, required=True, help="Which of its signals, as rate or rate_x.")
@click.option("--run", type=RUN, help="Which run; by default the one with the longest record.")
@store_option
@click.option("--plot", "plot_path", type=click.Path(path_type=Path), help="Draw the density: FILE.png or FILE.svg.")
@reporting
def spectrum(unit: str, signal: str, run: str | None, folder: Path, plot_path: Path | None, *, as_json: bool) -> None:
    """Power spectral density of a recorded signal, its sinusoidal lines and its humps, with 95 % confidence bounds.

    A hump is a band wider than a line with more noise than a sum of power laws explains, as of a resonance.
    """
    from analytics.commands.allan import chosen_run
    from analytics.curves.spectrum import spectrum_of
    from storage.sql.catalog import Catalog
    from storage.store import Store

    with Catalog(Store.open(folder)) as catalog:
        found = spectrum_of(catalog, unit, signal, chosen_run(catalog, unit, signal, run))
    if plot_path is not None:
        from analytics.plots.spectrum_plot import plot_spectrum

        plot_spectrum(found, plot_path)
    if as_json:
        print_json(found.document())
        return
    for english, _ in found.remarks:
        results().print(f"warning (警告): {english}", soft_wrap=True)
    if found.lines:
        results().print(_line_table(found))
    else:
        where = f"{found.unit} {found.signal}, run {found.run}"
        results().print(f"No line stands out (无显著谱线) of {where}. {_tested(found)}", soft_wrap=True)
    if found.humps:
        results().print(_hump_table(found))
    results().print(_level_table(found))
    if plot_path is not None:
        notes().print(f"plot: {plot_path}")


def _line_table(found: "SignalSpectrum") -> ResultTable:
    from analytics.curves.spectrum import with_error
    from analytics.curves.spectrum_remarks import LEAST_APART_BINS

    table = ResultTable(
        title=f"Lines (谱线) of {found.unit} {found.signal}, run {found.run}",
        caption=f"{found.confidence * 100:g} % confidence; amplitude is that of the peak. {_tested(found)}; "
        f"of lines closer than {LEAST_APART_BINS * found.bin_width_hz:.3g} Hz only the strongest may be listed",
    )
    for title in (
        "frequency Hz 频率",
        f"amplitude {found.unit_of_measure} 幅值",
        "from",
        "to",
        "times background",
        "over the record",
    ):
        table.add_column(title, justify="right")
    for line in found.lines:
        limits = (_NONE if math.isnan(value) else f"{value:.4g}" for value in (line.amplitude_lo, line.amplitude_hi))
        half_width_hz = line.frequency_hi_hz - line.frequency_hz
        moves = line.is_steady is False
        frequency = (
            f"{line.frequency_lo_hz:.5g} to {line.frequency_hi_hz:.5g}" if moves
            else with_error(line.frequency_hz, half_width_hz)
        )  # fmt: skip
        steady = {True: "steady", False: "not steady 不稳定", None: _NONE}[line.is_steady]
        table.add_row(frequency, f"{line.amplitude:.4g}", *limits, f"{line.background_ratio:,.3g}", steady)
    return table


def _hump_table(found: "SignalSpectrum") -> ResultTable:
    table = ResultTable(
        title=f"Humps (宽带凸起) of {found.unit} {found.signal}, run {found.run}",
        caption=f"bands above the fitted power-law noise model; {found.confidence * 100:g} % confidence; of spectra of "
        f"such noise, at most {found.false_alarm_probability * 100:g} % show one; searched from "
        f"{found.humps_lo_hz:.4g} Hz on, without what sidelobes of lines reach",
    )
    rms = f"excess RMS {found.unit_of_measure} 超出均方根"
    for title in ("from Hz", "to Hz", "times model 与模型之比", "from", "to", rms, "probability by chance"):
        table.add_column(title, justify="right")
    for hump in found.humps:
        numbers = (hump.frequency_lo_hz, hump.frequency_hi_hz, hump.ratio, hump.ratio_lo, hump.ratio_hi, hump.rms)
        table.add_row(*(f"{each:.3g}" for each in numbers), f"{hump.false_alarm_probability:.1g}")
    return table


def _tested(found: "SignalSpectrum") -> str:
    return (
        f"Searched from {found.searched_lo_hz:.4g} to {found.searched_hi_hz:.4g} Hz; "
        f"of spectra without any line, at most {found.false_alarm_probability * 100:g} % show one"
    )


def _level_table(found: "SignalSpectrum") -> ResultTable:
    length_s = found.segment_samples * found.sample_interval_s
    left_out = f", {found.segments_left_out:,} left out for missing samples" if found.segments_left_out else ""
    slow = f"; changes slower than {found.slow_below_hz:.3g} Hz subtracted, {found.slow_span:.3g} "
    slow = f"{slow}{found.unit_of_measure} from the least to the largest" if found.slow_span else ""
    table = ResultTable(
        title=f"Power spectral density (功率谱密度) of {found.unit} {found.signal}, run {found.run}",
        caption=f"{found.samples:,} samples every {found.sample_interval_s:g} s, {found.missing:,} missing; "
        f"resolution {found.bin_width_hz:.4g} Hz: {found.segments:,} segments of {found.segment_samples:,} samples "
        f"({length_s:g} s){left_out}, half overlapping, Hann window{slow}; means over a tenth of a "
        f"decade, lines left out; limits: {found.confidence * 100:g} % confidence",
    )
    for title in (
        "frequency Hz 频率", f"density {found.psd_unit}", "from", "to", f"line seen from {found.unit_of_measure}"
    ):  # fmt: skip
        table.add_column(title, justify="right")
    for frequency_hz in round_frequencies(found.frequency_hz[0], found.frequency_hz[-1]):
        band = np.array([frequency_hz / _HALF_BAND, frequency_hz * _HALF_BAND])
        for level in found.levels(band):
            least = found.least_amplitude(level)
            values = (f"{value:.4g}" for value in (level.psd, level.lo, level.hi))
            table.add_row(f"{level.frequency_hz:.3g}", *values, _NONE if least is None else f"{least:.3g}")
    return table


def round_frequencies(low_hz: float, high_hz: float) -> list[float]:
    """Powers of ten between two frequencies; with their threes where those are few.

    >>> round_frequencies(0.006, 100.0)
    [0.01, 0.1, 1.0, 10.0, 100.0]
    >>> round_frequencies(0.002, 0.5)
    [0.003, 0.01, 0.03, 0.1, 0.3]
    """
    powers = range(math.floor(math.log10(low_hz)), math.floor(math.log10(high_hz)) + 1)
    tens = [float(f"1e{power}") for power in powers]
    decades = [value for value in tens if low_hz <= value <= high_hz]
    if len(decades) >= _FEW_ROWS:
        return decades
    threes = [float(f"{digit}e{power}") for power in powers for digit in (1, 3)]
    return [value for value in threes if low_hz <= value <= high_hz]
