"""Whether the lines of a record are steady sinusoids; frequency and amplitude of those that are not."""

import math
from typing import NamedTuple

import msgspec
import numpy as np
import scipy.special

from analytics.curves.baseband import Baseband, ComplexArray, phasor
from stream.batch import FloatArray, IntArray
from stream.estimators.spectral_density import FIRST_BIN
from stream.estimators.spectrum.spectral_lines import (
    FLANK_BINS,
    GUARD_BINS,
    WINDOW_CORRELATION,
    SpectralLine,
    Spectrum,
    background_edf,
    median_ratio,
)

BLOCKS_A_SEGMENT = 4  # blocks of a line's amplitude and phase are this much shorter than segments
_FEWEST_BLOCKS = 4
_ALPHA = 0.001
_BESIDE = 0.05  # probability by chance of a bin that counts to a band
_LEAST_EXCESS = 0.1
_ROUNDS = 3
_REACH_BINS = 1.5  # how far a steady line may be from where it was found
_SIDELOBES = 0.01  # of the background, beyond which they matter
_FEWEST_DIPS = 2  # bins in a row without excess that end a band
_SPAN = 0.95  # share of the power that the span of frequencies holds
# sums of squared correlations under the Hann window, of noise with itself and with a line
_NOISE_SUM, _CROSS_SUM = 1.0 + 2.0 * (4.0 / 9.0 + 1.0 / 36.0), 1.0 + 2.0 * (2.0 / 3.0 + 1.0 / 6.0)


class RecordedLine(SpectralLine, frozen=True, kw_only=True):
    """A line of a record.

    One that is not steady has the centre of its power as its frequency and, as limits of that, the span that holds 95 %
    of the power; its amplitude is that of a sinusoid of the power in its band. NaN stands for limits of an amplitude
    that the data do not give.
    """

    is_steady: bool | None  # None: too few blocks to test it
    reach_lo_hz: float  # where its sidelobes matter, which levels and humps leave out
    reach_hi_hz: float


class _Band(NamedTuple):
    """Bins, from 0 on, that a line has power in, and the background beside them."""

    first: int
    last: int
    background: float


def judge_lines(
    lines: tuple[SpectralLine, ...], spectrum: Spectrum, base: Baseband, scale: float
) -> tuple[RecordedLine, ...]:
    """The lines, each with whether it is one steady sinusoid over the record; those that are not, measured again.

    A line's amplitude and phase in blocks of a quarter of a segment are compared with those of one sinusoid fitted to
    them, less what the other lines give there. The mean square of what is left over that of noise of the background's
    density is compared with F(2 (2n - 3)/2.11, `background_edf`), n the blocks, 2.11/2 for their overlap; beyond the
    0.1 % point and 10 % more than noise, the line is not steady. What an unsteady line leaves at its neighbours counts
    as noise there. `scale` is that from mean squares to densities.
    """
    if not lines:
        return ()
    density = np.concatenate([np.zeros(FIRST_BIN), spectrum.density])
    smooth = smoothed(density)
    width_hz = float(spectrum.frequency_hz[0]) / FIRST_BIN
    peaks = [_peak(density, line.frequency_hz / width_hz) for line in lines]
    backgrounds = np.array([density[k] / line.background_ratio for k, line in zip(peaks, lines, strict=True)])
    places, means = base.blocks()
    variance = 1.5 * backgrounds / (base.size * scale)
    steady = _steadiness(places, means, base, variance, background_edf(spectrum.edf))
    bands = {
        i: _band(density, k, backgrounds[i], spectrum.edf)
        for i, k in enumerate(peaks) if steady[i] is False
    }  # fmt: skip
    judged = []
    for i, line in enumerate(lines):
        if i not in bands:
            reach = reach_of(line.amplitude**2 / (0.75 * width_hz), smooth, peaks[i], peaks[i]) * width_hz
            judged.append(
                RecordedLine(
                    **msgspec.structs.asdict(line), is_steady=steady[i], reach_lo_hz=line.frequency_hz - reach,
                    reach_hi_hz=line.frequency_hz + reach,
                )
            )  # fmt: skip
            continue
        same = [j for j, band in bands.items() if band.first <= peaks[i] <= band.last or _overlap(band, bands[i])]
        if i == max(same, key=lambda j: lines[j].background_ratio):
            first, last = min(bands[j].first for j in same), max(bands[j].last for j in same)
            others = [k for j, k in enumerate(peaks) if j not in same]
            band = _Band(first, last, bands[i].background)
            uneven = _unevenness(places, np.abs(means[:, i]) ** 2 - variance[i])
            judged.append(_moving(line, density, band, others, spectrum, width_hz, uneven))
    return tuple(judged)


def _overlap(one: _Band, other: _Band) -> bool:
    return one.first <= other.last and other.first <= one.last


def _peak(density: FloatArray, place: float) -> int:
    near = round(place)
    around = density[near - 1 : near + 2]
    return near - 1 + int(around.argmax())


def _steadiness(
    places: IntArray, means: ComplexArray, base: Baseband, variance: FloatArray, freedom: float
) -> list[bool | None]:
    """Whether each line is steady; None with fewer than four blocks."""
    n, lines = means.shape
    if n < _FEWEST_BLOCKS:
        return [None] * lines
    frequencies, slots = base.frequencies.copy(), places * (base.size // 2)
    phasors = np.zeros(lines, np.complex128)
    left = np.zeros(lines)
    reach = _REACH_BINS / (2.0 * BLOCKS_A_SEGMENT)
    for _ in range(_ROUNDS):
        for i in range(lines):
            clean = means[:, i] - _others(i, base, frequencies, phasors, slots)
            phasors[i], shift = phasor(places, clean, reach)
            frequencies[i] = base.frequencies[i] + shift / (base.size // 2)
            left[i] = float((np.abs(clean - phasors[i] * np.exp(2j * np.pi * shift * places)) ** 2).sum())
    overlap = 1.0 + 2.0 * WINDOW_CORRELATION**2
    degrees = 2 * n - 3
    steady: list[bool | None] = [True] * lines
    powers = (np.abs(means) ** 2).mean(axis=0)
    for i in np.argsort(-powers).tolist():
        unsteady = [j for j in range(lines) if steady[j] is False]
        offsets = base.frequencies[unsteady] - base.frequencies[i]
        leaks = powers[unsteady] * np.abs(base.response(offsets)) ** 2
        ratio = 2.0 * left[i] / degrees / (variance[i] + float(leaks.sum()))
        chance = scipy.special.fdtrc(degrees / overlap, freedom, ratio)
        steady[i] = not (chance <= _ALPHA and ratio >= 1.0 + _LEAST_EXCESS)
    return steady


def _unevenness(places: IntArray, powers: FloatArray) -> float:
    """By how much the mean power of all blocks differs from that as the segments weigh them, relatively to the latter.

    Windows give moments different weights, those at the ends of the record and beside gaps the least. Blocks too see
    little of the ends: the shares of the first and the last are added.

    >>> round(_unevenness(np.arange(15), np.where(np.arange(15) == 3, 1.0, 0.0)), 3)
    0.4
    """
    within = np.arange(2 * BLOCKS_A_SEGMENT - 1)
    there = np.zeros(int(places[-1]) + 1, np.bool_)
    there[places] = True
    segments = np.add.outer(np.arange(0, max(0, len(there) - len(within) + 1), BLOCKS_A_SEGMENT), within)
    segments = segments[there[segments].all(axis=1)]
    shares = np.tile(np.sin(np.pi * (within + 1) / (len(within) + 1)) ** 4, len(segments))
    weights = np.bincount(segments.ravel(), shares, len(there))[places]
    total, weighted = float(powers.sum()), float(weights @ powers)
    if min(total, weighted) <= 0.0:
        return 0.0
    of_ends = float(np.clip(powers[[0, -1]], 0.0, None).sum()) / total
    return abs(total * float(weights.mean()) / weighted - 1.0) + of_ends


def _others(i: int, base: Baseband, frequencies: FloatArray, phasors: ComplexArray, slots: IntArray) -> ComplexArray:
    """What all other lines, and all images at negative frequencies, give in the blocks of line i."""
    signed = np.concatenate([np.delete(frequencies, i), -frequencies])
    strengths = np.concatenate([np.delete(phasors, i), phasors.conj()])
    offsets = signed - base.frequencies[i]
    return np.asarray(np.exp(2j * np.pi * np.outer(slots, offsets)) @ (strengths * base.response(offsets)))


def smoothed(density: FloatArray) -> FloatArray:
    """Medians of nine bins."""
    padded = np.pad(density, GUARD_BINS, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * GUARD_BINS + 1), axis=1)


def reach_of(power: float, smooth: FloatArray, first: int, last: int) -> int:
    """Bins beside a line where its sidelobes matter; `power` is its density over the square of the window's response.

    k bins away that response of the Hann window is at most 1/(2 pi k (k**2 - 1)). The density there is what counts:
    bins near a strong line have no other than its sidelobes.

    >>> reach_of(100.0, np.ones(100), 50, 50), reach_of(1e7, np.ones(100), 50, 50)
    (4, 18)
    """
    k = np.arange(GUARD_BINS, len(smooth), dtype=np.float64)
    sidelobes = power / (2.0 * np.pi * k * (k * k - 1.0)) ** 2
    left, right = np.maximum(first - k, FIRST_BIN), np.minimum(last + k, len(smooth) - 1)
    beside = np.minimum(smooth[left.astype(np.int64)], smooth[right.astype(np.int64)])
    return GUARD_BINS + int(np.flatnonzero(sidelobes > _SIDELOBES * beside).max(initial=-1)) + 1


def _band(density: FloatArray, peak: int, background: float, edf: float) -> _Band:
    """The bins around a peak that exceed the background, as it is beyond them."""
    first = last = peak
    least = float(scipy.special.fdtri(edf, background_edf(edf), 1.0 - _BESIDE))
    for _ in range(_ROUNDS):
        above = density > least * background
        first, last = _end(above, peak, -1), _end(above, peak, 1)
        # the sidelobes of the line that stands still at one end reach as far as those of a steady one
        flanks = [
            density[max(FIRST_BIN, first - GUARD_BINS - FLANK_BINS) : max(FIRST_BIN, first - GUARD_BINS)],
            density[last + GUARD_BINS + 1 : last + GUARD_BINS + 1 + FLANK_BINS],
        ]
        if any(len(flank) < FLANK_BINS for flank in flanks):
            return _Band(first, last, math.nan)
        background = sum(float(np.median(flank)) for flank in flanks) / 2.0 / median_ratio(edf)
    return _Band(first, last, background)


def _end(above: np.ndarray[tuple[int], np.dtype[np.bool_]], peak: int, step: int) -> int:
    """The last bin from a peak on that is above, before more than two in a row that are not."""
    end = at = peak
    while FIRST_BIN <= at < len(above) and abs(at - end) <= _FEWEST_DIPS:
        if above[at]:
            end = at
        at += step
    return end


def _moving(
    line: SpectralLine, density: FloatArray, band: _Band, others: list[int], spectrum: Spectrum, width_hz: float,
    uneven: float,
) -> RecordedLine:  # fmt: skip
    """Frequency and amplitude of a line that is not steady.

    The power is the sum over its band, 4 bins more on either side, less the background. Its variance is that of noise
    in m bins, of noise times line, and of the background:

        B**2 (1.94 m 2/edf + 2.67 (2/edf) 2 sum q + m**2 2/background_edf),    q the excess over B.

    The limits are wider by the share `uneven` of the power (`_unevenness`).
    """
    first = max([FIRST_BIN, band.first - GUARD_BINS, *(k + GUARD_BINS + 1 for k in others if k < band.first)])
    last = min([len(density) - 1, band.last + GUARD_BINS, *(k - GUARD_BINS - 1 for k in others if k > band.last)])
    excess = density[first : last + 1] / band.background - 1.0
    core = np.clip(density[band.first : band.last + 1] - np.nan_to_num(band.background), 0.0, None)
    bins = np.arange(band.first, band.last + 1)
    summed = np.cumsum(core) / core.sum()
    # each bin stands for the frequencies half a bin about it
    edges = np.concatenate([[bins[0] - 0.5], bins + 0.5])
    span = np.interp([(1.0 - _SPAN) / 2.0, (1.0 + _SPAN) / 2.0], np.concatenate([[0.0], summed]), edges)
    centre = float(core @ bins / core.sum())
    m, noise = len(excess), 2.0 / spectrum.edf
    power = float(excess.sum())
    variance = noise * (_NOISE_SUM * m + 2.0 * _CROSS_SUM * max(power, 0.0)) + m * m * 2.0 / background_edf(
        spectrum.edf
    )
    half = float(scipy.special.ndtri(0.5 + spectrum.confidence / 2.0)) * math.sqrt(variance)
    half += uneven * max(power, 0.0)
    low, middle, high = (
        math.sqrt(2.0 * band.background * width_hz * max(each, 0.0)) if math.isfinite(each) else math.nan
        for each in (power - half, power, power + half)
    )
    strength = power / 0.375 * band.background if power > 0.0 else 0.0
    reach = reach_of(strength, smoothed(density), band.first, band.last)
    return RecordedLine(
        frequency_hz=centre * width_hz, frequency_lo_hz=float(span[0]) * width_hz,
        frequency_hi_hz=float(span[1]) * width_hz, amplitude=line.amplitude if math.isnan(middle) else middle,
        amplitude_lo=low, amplitude_hi=high, background_ratio=line.background_ratio,
        false_alarm_probability=line.false_alarm_probability, is_steady=False,
        reach_lo_hz=(band.first - reach) * width_hz, reach_hi_hz=(band.last + reach) * width_hz,
    )  # fmt: skip
