"""Statistics of a stretch of a signal from the means of its blocks, with the uncertainty that its Allan curve gives."""

import math
from typing import NamedTuple

import numpy as np

from analytics.step_records.record_noise import (
    TERMS,
    fit_noise,
    local_share,
    octave_variances,
    variance_freedoms,
    variance_of_mean,
)
from analytics.step_records.scatter import Average, scatter_freedom, scatter_of_averages
from stream.batch import FloatArray, IntArray
from stream.defects.coarse_resolution import rounding_bound
from stream.defects.outliers import count_outliers, piled_share
from stream.defects.repeats import repeated_share

AVERAGES_S = (1.0, 10.0, 100.0)
_ROUNDING = 1e-14  # relative; a hundred times that of a number
# of the samples of an average; less a thousandth, since the interval of uneven times is an estimate
LEAST_SHARE = 0.9 - 1e-3
_LEAST_BLOCKS = 8


class SeriesStatistics(NamedTuple):
    """Statistics of a stretch of a signal."""

    n: int  # samples
    mean: float
    sd: float  # standard deviation (ddof = 1) of the samples; NaN where there is one
    sd_freedom: float  # degrees of freedom of `sd`
    standard_uncertainty: float  # of the mean, with its degrees of freedom; NaN where unknown
    freedom: float
    n_effective: float  # independent samples that would give the same uncertainty: sd**2 over its square
    # white, flicker, walk: parts of the Allan variance, AVAR(tau) = white/tau + flicker + walk*tau, tau in seconds,
    # besides Markov noise; white is 0 where the record does not show it clearly; NaN where unknown
    white: float
    flicker: float
    walk: float
    still: float  # share of the samples in the longest stretch in which all are alike; 0 where the resolution is coarse
    outliers: int  # isolated ones, among the means of the blocks
    outlier_excess: float  # by how much they raise the noise, relative
    piled: float  # share of the samples at one or two values that hold far more than the others, and the first of these
    piled_at: float
    repeated: float  # share of the samples that repeat the one before, beyond what resolution and noise explain
    averages: tuple[Average, ...]  # of `AVERAGES_S`


def samples_statistics(t_ns: IntArray, values: FloatArray, window_ns: tuple[int, int]) -> SeriesStatistics:
    """Statistics of the samples of a window; the median interval is that of their grid."""
    n = len(t_ns)
    interval_ns = max(int(np.median(np.diff(t_ns))) if n > 1 else 1, 1)
    ones, zeros = np.ones(n, np.int64), np.zeros(n)
    return series_statistics(t_ns, ones, values, zeros, base_ns=interval_ns, samples_per_block=1.0, window_ns=window_ns)


def series_statistics(
    start_ns: IntArray, counts: IntArray, means: FloatArray, squares: FloatArray, *, base_ns: int,
    samples_per_block: float, window_ns: tuple[int, int], step: float = 0.0, samples: FloatArray | None = None,
    look: FloatArray | None = None,
) -> SeriesStatistics:  # fmt: skip
    """Reduce the blocks of a stretch.

    `start_ns`, `counts`, `means`, `squares` of shape (blocks,): where each block begins, increasing, its samples, their
    mean, and the sum of squares about it; a block, `base_ns` long, may be one sample. `window_ns`: within which a block
    may begin, both ends included; only averages wholly within it count. `step`: of the quantisation in the samples'
    unit, 0 if none.

    The uncertainty of the mean over T seconds is sqrt(AVAR(T)), AVAR = white/tau + flicker + walk*tau fitted to the
    overlapping Allan variance of the record (IEEE 952 annex C) with weights by degrees of freedom; of white noise alone
    it is sd/sqrt(n). Every subset of the three parts without a negative one is weighted by its likelihood,
    exp(-chi-square/2), with a penalty for each part; below 48 blocks only white noise with at most one other part,
    below 24 with flicker. Markov noise with at least 30 correlation times in the record is a fourth part, beside white
    noise and one other: taken as a walk, it made the uncertainty of a filtered output 5 to 150 times too large. The
    uncertainty is the standard deviation of the means of further such records, flicker and random walk included. Its
    degrees of freedom are those of its parts by Welch and Satterthwaite (JCGM 100:2008 G.4.1), less where the subsets
    differ. With fewer than 8 blocks it is sd/sqrt(n).

    `samples`: raw ones to look at for values that are too frequent, and for a coarse resolution; by default the means
    where each block is one sample, else none. `look`: consecutive raw samples to look at for those that repeat the one
    before; by default `samples`.

    For a signal constant at one count the quantisation, step/sqrt(12), is added where sd < step; for noise that is
    rounded to few values `rounding_bound` as the half width of an arcsine distribution, bound/sqrt(2), if that is more.
    The degrees of freedom stay those of the scatter.

    The standard deviation of P-second means (JJF 2014-2022 7.2.14 (29)) takes means on the grid of the source's clock
    that have 90 % of their samples.

    >>> values = np.random.default_rng(1).standard_normal(6000)
    >>> t_ns = np.arange(6000) * 10_000_000
    >>> found = series_statistics(t_ns, np.ones(6000, int), values, np.zeros(6000), base_ns=10_000_000,
    ...                           samples_per_block=1.0, window_ns=(0, 60_000_000_000))
    >>> found.n, found.averages[0].n, 0.5 < found.standard_uncertainty * 6000**0.5 < 2
    (6000, 60, True)
    """
    n = int(counts.sum())
    # scaled to near 1: squares of very large or small numbers would overflow; a power of two changes no digit
    exponent = int(np.frexp(np.abs(means).max())[1])
    means, squares = np.ldexp(means, -exponent), np.ldexp(squares, -2 * exponent)
    step = math.ldexp(step, -exponent)
    mean = float(np.dot(counts, means - means[0]) / n + means[0])
    still, is_only_coarse = _still_share(counts, means, squares, step)
    # samples that are all alike scatter by the rounding of their sums only
    within = 0.0 if still == 1.0 else float(squares.sum())
    between = 0.0 if still == 1.0 else float(np.dot(counts, (means - mean) ** 2))
    sd = math.sqrt((within + between) / (n - 1)) if n > 1 else math.nan
    grid = (samples_per_block, base_ns, window_ns)
    averages = tuple(_average(start_ns, counts, means, round(each * 1e9), *grid) for each in AVERAGES_S)
    dense = _dense((start_ns - start_ns[0] + base_ns // 2) // base_ns, counts, means - mean, samples_per_block)
    variances, factors = octaves = octave_variances(dense)
    if dense.size < _LEAST_BLOCKS or variances.size < TERMS:
        u_squared = (within + between) / (n - 1) / n if n > 1 else math.nan
        parts, freedom = np.full(TERMS, np.nan), float(n - 1)
    else:
        base_s = base_ns / 1e9
        # means of octaves have as many losses as the record where these are single, and none beside a gap
        valid_s = float(np.count_nonzero(~np.isnan(dense))) * base_s / local_share(dense)
        freedoms = variance_freedoms(factors, dense.size)
        taus_s = np.asarray(factors * base_s, np.float64)
        fit = fit_noise(taus_s, variances, freedoms, duration_s=valid_s, sample_s=base_s / samples_per_block)
        u_squared, freedom = variance_of_mean(fit, valid_s, dense.size)
        parts = fit.mean
    samples = np.ldexp(samples, -exponent) if samples is not None else means[: means.size * (n == means.size)]
    u_squared += max(step * step / 12 if sd < step else 0.0, rounding_bound(samples) ** 2 / 2)
    far = count_outliers([means])
    repeated = repeated_share(samples if look is None else look)
    piled, piled_at = piled_share(samples) if samples.size and still < 1.0 else (0.0, math.nan)
    effective = min(float(n), sd * sd / u_squared) if u_squared > 0 else (float(n) if n > 1 else math.nan)
    return SeriesStatistics(
        n=n, mean=_scaled(mean, exponent), sd=_scaled(sd, exponent),
        sd_freedom=_sd_freedom(n, means.size, within, between, dense, octaves),
        standard_uncertainty=_scaled(math.sqrt(u_squared), exponent), freedom=freedom, n_effective=effective,
        white=_scaled(float(parts[0]), 2 * exponent), flicker=_scaled(float(parts[1]), 2 * exponent),
        walk=_scaled(float(parts[2]), 2 * exponent), still=0.0 if sd < step and is_only_coarse else still,
        outliers=far.count, outlier_excess=far.raise_n_by, piled=piled, piled_at=_scaled(piled_at, exponent),
        repeated=0.0 if piled else repeated,
        averages=tuple(each._replace(sd=_scaled(each.sd, exponent)) for each in averages),
    )  # fmt: skip


def _still_share(counts: IntArray, means: FloatArray, squares: FloatArray, step: float = 0.0) -> tuple[float, bool]:
    """Share of the samples in the longest stretch of blocks in which all are alike, and whether the step explains it.

    It does where the others scatter by less than one step, and are not all alike as well.

    >>> ones, zeros = np.ones(8, int), np.zeros(8)
    >>> _still_share(ones, np.array([1.0, 2.0, 5.0, 5.0, 5.0, 5.0, 1.0, 1.0]), zeros, step=0.1)
    (0.5, False)
    >>> _still_share(ones, np.array([1.0, 1.0, 2.0, 1.0, 1.0, 2.0, 1.0, 1.0]), zeros, step=1.0)
    (0.25, True)
    >>> _still_share(ones, np.arange(8.0), zeros)
    (0.0, False)

    Means and squares of blocks of samples that are alike differ by the rounding of their sums.
    """
    rounding = _ROUNDING * float(np.abs(means).max())
    alike = squares <= counts * rounding**2
    goes_on = (np.abs(means[1:] - means[:-1]) <= rounding) & alike[1:] & alike[:-1]
    if not goes_on.any():
        return 0.0, False
    begins = np.flatnonzero(np.r_[True, ~goes_on])
    stretches = np.add.reduceat(counts, begins)
    longest = int(np.argmax(stretches))
    others = np.ones(means.size, np.bool_)
    others[begins[longest] : begins[longest + 1] if longest + 1 < begins.size else means.size] = False
    share, n = float(stretches[longest] / counts.sum()), int(counts[others].sum())
    if n < 2:
        return share, False
    mean = float(np.dot(counts[others], means[others]) / n)
    scatter = float(np.dot(counts[others], (means[others] - mean) ** 2) + squares[others].sum()) / (n - 1)
    return share, scatter < step * step


def _scaled(value: float, exponent: int) -> float:
    """Times a power of two; infinite where that is too large."""
    with np.errstate(over="ignore", under="ignore"):
        return float(np.ldexp(value, exponent))


def _average(
    start_ns: IntArray, counts: IntArray, means: FloatArray, average_ns: int, samples_per_block: float, base_ns: int,
    window_ns: tuple[int, int],
) -> Average:  # fmt: skip
    expected = samples_per_block * average_ns / base_ns
    if average_ns < base_ns or (average_ns % base_ns and expected < 2):
        return Average(0, math.nan, math.nan)
    number = start_ns // average_ns
    edges = np.flatnonzero(np.r_[True, number[1:] != number[:-1]])
    of_block = number[edges]
    n = np.add.reduceat(counts, edges)
    sums = np.add.reduceat(counts * (means - means[0]), edges)
    # a sample has the time of its beginning: the last one is a block before the window's end
    whole = (of_block * average_ns >= window_ns[0]) & ((of_block + 1) * average_ns <= window_ns[1] + base_ns)
    full = whole & (n >= LEAST_SHARE * expected)
    return scatter_of_averages(of_block[full], sums[full] / n[full])


def _sd_freedom(
    n: int, blocks: int, within: float, between: float, dense: FloatArray, octaves: tuple[FloatArray, IntArray]
) -> float:
    """Degrees of freedom of the deviation of all samples; those within blocks count as white."""
    if n < 2 or within + between == 0:
        return float(max(n - 1, 0))
    known = dense[~np.isnan(dense)]
    freedom = scatter_freedom(dense, float(known.var(ddof=1)), octaves) if known.size > 1 else 1.0
    spread = (within * within / (n - blocks) if n > blocks else 0.0) + between * between / freedom
    return min(n - 1.0, max(1.0, (within + between) ** 2 / spread))


def _dense(places: IntArray, counts: IntArray, values: FloatArray, expected: float) -> FloatArray:
    """Block means on their grid, NaN where a block is missing or not full."""
    dense = np.full(int(places[-1]) + 1, np.nan)
    full = counts >= LEAST_SHARE * expected
    dense[places[full]] = values[full]
    return dense
