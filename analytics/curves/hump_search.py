"""Humps of a record: beside its lines, above what its slow changes reach, and no single peak taken for one."""

import numpy as np
from numpy.typing import NDArray

from analytics.curves.humps import Hump, find_humps
from analytics.curves.steady_lines import reach_of, smoothed
from stream.estimators.spectral_density import FIRST_BIN
from stream.estimators.spectrum.spectral_lines import Spectrum

_SLOW_SHARE = 0.05  # of the density, that slow changes may have in a bin
_MOST_PEAKS = 3
_LEAST_RESPONSE = 0.0625  # of the window, squared, in the bin beside a line: one at the Nyquist frequency has no own
_BESIDE = np.array([-7, -6, -5, 5, 6, 7])


def first_clear(slow_part: NDArray[np.float64], spectrum: Spectrum) -> int:
    """Number of the first bin of a spectrum from which on slow changes have at most a twentieth of the density."""
    reached = slow_part[FIRST_BIN : FIRST_BIN + spectrum.density.size] > _SLOW_SHARE * spectrum.density
    # three in a row are not reached: single densities of few segments scatter
    after = np.flatnonzero(~(reached[:-2] | reached[1:-1] | reached[2:]))
    return int(after[0]) if after.size else len(reached)


def search_humps(
    spectrum: Spectrum, clear: NDArray[np.bool_], searched_hz: tuple[float, float], *, band_edf: float,
    sample_interval_s: float, false_alarm_probability: float,
) -> tuple[tuple[Hump, ...], tuple[float, ...]]:  # fmt: skip
    """Humps of the bins that are clear, and frequencies of peaks that are as narrow as a line.

    Beyond the band that is searched for lines, a hump that is none without the bins that its sharpest peak reaches, or
    up to three peaks, is these peaks.
    """

    def found(bins: NDArray[np.bool_]) -> tuple[Hump, ...]:
        return find_humps(
            spectrum.frequency_hz[bins], spectrum.density[bins], band_edf, sample_interval_s=sample_interval_s,
            false_alarm_probability=false_alarm_probability, confidence=spectrum.confidence,
        )  # fmt: skip

    frequency_hz, smooth = spectrum.frequency_hz, smoothed(spectrum.density)
    humps, narrow = found(clear), list[float]()
    for hump in humps:
        kept, peaks = clear.copy(), list[float]()
        inside = (frequency_hz >= hump.frequency_lo_hz) & (frequency_hz <= hump.frequency_hi_hz)
        for _ in range(_MOST_PEAKS):
            peak = _sharpest(spectrum.density, inside & kept)
            if peak is None or searched_hz[0] <= frequency_hz[peak] <= searched_hz[1]:
                break
            reach = reach_of(float(spectrum.density[peak]) / _LEAST_RESPONSE, smooth, peak, peak)
            kept[max(0, peak - reach) : peak + reach + 1] = False
            peaks.append(float(frequency_hz[peak]))
            if not any(_overlap(hump, each) for each in found(kept)):
                clear = kept
                narrow += peaks
                break
    return found(clear) if narrow else humps, tuple(sorted(narrow))


def _sharpest(density: NDArray[np.float64], bins: NDArray[np.bool_]) -> int | None:
    """The bin that is highest over the median of those 5 to 7 bins beside it."""
    places = np.flatnonzero(bins)
    if not places.size:
        return None
    beside = np.add.outer(places, _BESIDE)
    mirrored = np.add.outer(places, -_BESIDE)  # beyond an end stands the other side
    beside = np.clip(np.where((beside < 0) | (beside >= len(density)), mirrored, beside), 0, len(density) - 1)
    ratio = density[places] / np.maximum(np.median(density[beside], axis=1), 1e-300)
    return int(places[ratio.argmax()])


def _overlap(one: Hump, other: Hump) -> bool:
    return one.frequency_lo_hz <= other.frequency_hi_hz and other.frequency_lo_hz <= one.frequency_hi_hz
