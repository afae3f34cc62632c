"""Humps of a power spectral density: bands wider than a line with more noise than a sum of power laws explains."""

import itertools
import math

import msgspec
import numpy as np
import scipy.optimize
import scipy.special
from numpy.typing import NDArray

from stream.batch import FloatArray
from stream.estimators.confidence import deviation_bounds

LEAST_BINS = 16  # bins of a cell: a line takes 9
LEAST_EXCESS = 0.1  # relative excess below which a hump is not reported: filters bend every spectrum a little
_CELLS_AN_OCTAVE = 6
_WIDEST = 12
_MOST_HUMPS = 8
_POWERS = (-2, -1, 0, 1, 2)
_IMAGES = np.arange(-10.0, 11.0)  # of flicker above the Nyquist frequency
_ROUNDS = 8
# correlation of the densities one and two bins apart under the Hann window
_NEIGHBOURS = (4.0 / 9.0, 1.0 / 36.0)


class Hump(msgspec.Struct, frozen=True, kw_only=True):
    """A band with excess noise."""

    frequency_lo_hz: float
    frequency_hi_hz: float
    ratio: float  # mean density of the band over the fitted noise model, with confidence bounds
    ratio_lo: float
    ratio_hi: float
    rms: float  # root of the excess power, in the unit of the signal, with confidence bounds
    rms_lo: float
    rms_hi: float
    # bound on the probability that noise of the model shows a hump this significant anywhere
    false_alarm_probability: float


def independent_bins(bins: int) -> float:
    """Number of independent bins that as many neighbours are equivalent to.

    >>> independent_bins(1), round(independent_bins(2), 3), round(independent_bins(100), 1)
    (1.0, 1.385, 51.7)
    """
    correlated = sum(rho * max(0.0, 1.0 - lag / bins) for lag, rho in enumerate(_NEIGHBOURS, 1))
    return bins / (1.0 + 2.0 * correlated)


def find_humps(
    frequency_hz: FloatArray, psd: FloatArray, edf: float, *, sample_interval_s: float, false_alarm_probability: float,
    confidence: float,
) -> tuple[Hump, ...]:  # fmt: skip
    """Humps of a one-sided density, lowest frequency first.

    The bins, of `edf` equivalent degrees of freedom each, increase and are without those of lines. The model is sum a_k
    s**k, s = sin(pi f sample_interval), k from -2 to 2 and a_k >= 0: for sampled quantization noise and random walk
    this is exact; so are two more terms for flicker and random walk that are averaged over the interval. It is fitted
    to the means of cells of a sixth of an octave and 16 bins or more, weighted by their degrees of freedom over the
    squared model. A band is any run of neighbouring cells, two octaves at most. D times its mean ratio of density to
    model is compared with chi-square of D degrees of freedom, D the sum of its cells'; times the number of bands
    (Bonferroni) that is the false-alarm probability, a bound since bands overlap and the fit follows the data. The most
    significant band is left out of the next fit, until none is significant.

    >>> rng = np.random.default_rng(3)
    >>> f = np.arange(1, 2001) * 0.025
    >>> density = np.where((f > 10.0) & (f < 14.0), 2.0, 1.0) * rng.chisquare(40, 2000) / 40
    >>> (found,) = find_humps(f, density, 40.0, sample_interval_s=0.01, false_alarm_probability=0.01, confidence=0.95)
    >>> 9.0 < found.frequency_lo_hz < 10.7, 13.3 < found.frequency_hi_hz < 15.5, found.rms_lo < 2.0 < found.rms_hi
    (True, True, True)
    """
    cells = _cells(frequency_hz)
    if len(cells) <= len(_POWERS) + 1 or not (psd > 0.0).any():
        return ()
    means = np.array([psd[first:last].mean() for first, last in cells])
    freedom = np.array([edf * independent_bins(last - first) for first, last in cells])
    sine = np.sin(np.pi * frequency_hz * sample_interval_s)
    turns = np.add.outer(_IMAGES, frequency_hz * sample_interval_s)
    averaged = sine**2 * (np.abs(turns) ** -3.0).sum(axis=0), sine**-2.0 - 2.0 / 3.0
    shapes = np.stack([*(sine**k for k in _POWERS), *averaged])
    columns = np.array([shapes[:, first:last].mean(axis=1) for first, last in cells])
    bands = [band for band in itertools.combinations(range(len(cells) + 1), 2) if band[1] - band[0] <= _WIDEST]
    kept = np.ones(len(cells), np.bool_)
    found: list[tuple[int, int, float]] = []
    model = _fitted(columns, means, freedom, kept)
    while len(found) < _MOST_HUMPS and kept.sum() > len(_POWERS) + 1:
        ratio = means / model
        free = [(first, last) for first, last in bands if kept[first:last].all()]
        degrees = np.array([freedom[first:last].sum() for first, last in free])
        excess = np.array([freedom[first:last] @ ratio[first:last] for first, last in free])
        chance = len(bands) * scipy.special.chdtrc(degrees, excess)
        significant = (chance <= false_alarm_probability) & (excess >= (1.0 + LEAST_EXCESS) * degrees)
        if not significant.any():
            break
        # the probability of the clearest humps is 0 to all digits: there the deviance decides
        deviance = np.where(significant, excess - degrees - degrees * np.log(excess / degrees), -1.0)
        best = int(deviance.argmax())
        found.append((*free[best], float(min(1.0, chance[best]))))
        kept[slice(*free[best])] = False
        model = _fitted(columns, means, freedom, kept)
    humps = []
    for first, last, chance_of in _joined(found):
        bins = slice(cells[first][0], cells[last - 1][1])
        band = (freedom[first:last], means[first:last], model[first:last])
        humps.append(_hump(frequency_hz[bins], *band, chance_of, confidence))
    return tuple(humps)


def _joined(bands: list[tuple[int, int, float]]) -> list[tuple[int, int, float]]:
    """Bands in order of frequency; those that touch are one, such as the flanks of a strong hump."""
    joined: list[tuple[int, int, float]] = []
    for first, last, chance in sorted(bands):
        if joined and joined[-1][1] == first:
            joined[-1] = (joined[-1][0], last, min(joined[-1][2], chance))
        else:
            joined.append((first, last, chance))
    return joined


def _hump(
    frequency_hz: FloatArray, freedom: FloatArray, means: FloatArray, model: FloatArray, chance: float,
    confidence: float,
) -> Hump:  # fmt: skip
    degrees = float(freedom.sum())
    ratio = float(freedom @ (means / model)) / degrees
    ratio_lo, ratio_hi = (ratio * bound**2 for bound in deviation_bounds(1.0, degrees, confidence))
    step_hz = float(np.median(np.diff(frequency_hz)))
    power = float(freedom @ model) / degrees * (frequency_hz[-1] - frequency_hz[0] + step_hz)
    rms, rms_lo, rms_hi = (math.sqrt(max(0.0, power * (each - 1.0))) for each in (ratio, ratio_lo, ratio_hi))
    return Hump(
        frequency_lo_hz=float(frequency_hz[0]), frequency_hi_hz=float(frequency_hz[-1]),
        ratio=ratio, ratio_lo=ratio_lo, ratio_hi=ratio_hi, rms=rms, rms_lo=rms_lo, rms_hi=rms_hi,
        false_alarm_probability=chance,
    )  # fmt: skip


def _cells(frequency_hz: FloatArray) -> list[tuple[int, int]]:
    """First bin and the one after the last of each cell."""
    edges = [0]
    while edges[-1] < len(frequency_hz):
        wide = int(np.searchsorted(frequency_hz, frequency_hz[edges[-1]] * 2.0 ** (1.0 / _CELLS_AN_OCTAVE)))
        edges.append(max(edges[-1] + LEAST_BINS, wide))
    if edges[-1] > len(frequency_hz):
        edges[-1] = len(frequency_hz)
        if len(edges) > 2 and edges[-1] - edges[-2] < LEAST_BINS:
            del edges[-2]
    return list(itertools.pairwise(edges))


def _fitted(columns: FloatArray, means: FloatArray, freedom: FloatArray, kept: NDArray[np.bool_]) -> FloatArray:
    """The model in every cell, fitted to those kept."""
    model = np.maximum(means, 1e-300)
    for _ in range(_ROUNDS):
        weight = np.sqrt(freedom[kept] / 2.0) / model[kept]
        design = columns[kept] * weight[:, np.newaxis]
        sizes = np.sqrt((design**2).sum(axis=0))
        solved, _ = scipy.optimize.nnls(design / sizes, means[kept] * weight)
        model = np.maximum(columns @ (solved / sizes), 1e-12 * means.max())
    return np.asarray(model, np.float64)
