"""Statistics of a stretch of a signal from the means of its blocks, with the uncertainty that its Allan curve gives."""

import math
from typing import NamedTuple

import numpy as np

from stream.batch import BoolArray, FloatArray, IntArray
from stream.compiled import compiled

AVERAGES_S = (1.0, 10.0, 100.0)
_ROUNDING = 1e-14  # relative; a hundred times that of a number
LEAST_SHARE = 0.9
_LEAST_BLOCKS = 8
_TERMS = 3  # white, flicker, random walk
_SUBSETS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1]], np.bool_)
# Three octaves cannot separate three parts: the uncertainty of 20 samples was larger than that of 10.
_FEW_OCTAVES = {3: _SUBSETS[[0, 3]], 4: _SUBSETS[[0, 3, 4]]}
# Penalty of a further part, in chi-square. In 95 % of records the uncertainty of white noise is at most 4.6 times the
# true one at 0.5, 3.3 at 4, 2.5 at 6; means of an hour of clear flicker lie within their bounds in 94, 91 and 89 %, and
# in 85 % where the best subset alone counts.
_PENALTY = 4.0
_LEAST_FREEDOM = 3.0  # of a random walk fitted to a record


class Average(NamedTuple):
    """Standard deviation of consecutive averages: how many, their deviation, and its degrees of freedom."""

    n: int
    sd: float
    freedom: float


class SeriesStatistics(NamedTuple):
    """Statistics of a stretch of a signal."""

    n: int  # samples
    mean: float
    sd: float  # standard deviation (ddof = 1) of the samples; NaN where there is one
    sd_freedom: float  # degrees of freedom of `sd`
    standard_uncertainty: float  # of the mean, with its degrees of freedom; NaN where unknown
    freedom: float
    n_effective: float  # independent samples that would give the same uncertainty: sd**2 over its square
    # white, flicker, walk: parts of the Allan variance, AVAR(tau) = white/tau + flicker + walk*tau, tau in seconds; NaN
    # where unknown
    white: float
    flicker: float
    walk: float
    still: float  # share of the samples in the longest stretch in which all are alike; 0 where the resolution is coarse
    averages: tuple[Average, ...]  # of `AVERAGES_S`


def samples_statistics(t_ns: IntArray, values: FloatArray, window_ns: tuple[int, int]) -> SeriesStatistics:
    """Statistics of the samples of a window; the median interval is that of their grid."""
    n = len(t_ns)
    interval_ns = max(int(np.median(np.diff(t_ns))) if n > 1 else 1, 1)
    ones, zeros = np.ones(n, np.int64), np.zeros(n)
    return series_statistics(t_ns, ones, values, zeros, base_ns=interval_ns, samples_per_block=1.0, window_ns=window_ns)


def series_statistics(
    start_ns: IntArray, counts: IntArray, means: FloatArray, squares: FloatArray, *, base_ns: int,
    samples_per_block: float, window_ns: tuple[int, int], step: float = 0.0,
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
    below 24 with flicker. It is the standard deviation of the means of further such records, flicker and random walk
    included. Its degrees of freedom are those of its parts by Welch and Satterthwaite (JCGM 100:2008 G.4.1), less where
    the subsets differ. With fewer than 8 blocks it is sd/sqrt(n).

    For a signal constant at one count the quantisation, step/sqrt(12), is added where sd < step.

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
    still = _still_share(counts, means, squares)
    # samples that are all alike scatter by the rounding of their sums only
    within = 0.0 if still == 1.0 else float(squares.sum())
    between = 0.0 if still == 1.0 else float(np.dot(counts, (means - mean) ** 2))
    sd = math.sqrt((within + between) / (n - 1)) if n > 1 else math.nan
    grid = (samples_per_block, base_ns, window_ns)
    averages = tuple(_average(start_ns, counts, means, round(each * 1e9), *grid) for each in AVERAGES_S)
    dense = _dense((start_ns - start_ns[0] + base_ns // 2) // base_ns, counts, means - mean, samples_per_block)
    variances, factors = _allan(dense)
    if dense.size < _LEAST_BLOCKS or variances.size < _TERMS:
        u_squared = (within + between) / (n - 1) / n if n > 1 else math.nan
        parts, freedom = np.full(_TERMS, np.nan), float(n - 1)
    else:
        base_s = base_ns / 1e9
        fit = _fit(np.asarray(factors * base_s, np.float64), variances, _freedoms(factors, dense.size))
        valid_s = float(np.count_nonzero(~np.isnan(dense))) * base_s
        u_squared, freedom = _of_mean(fit, valid_s, dense.size)
        parts = fit.mean
    if sd < step:
        u_squared += step * step / 12
    effective = min(float(n), sd * sd / u_squared) if u_squared > 0 else (float(n) if n > 1 else math.nan)
    return SeriesStatistics(
        n=n, mean=_scaled(mean, exponent), sd=_scaled(sd, exponent),
        sd_freedom=_sd_freedom(n, means.size, within, between, dense),
        standard_uncertainty=_scaled(math.sqrt(u_squared), exponent), freedom=freedom, n_effective=effective,
        white=_scaled(float(parts[0]), 2 * exponent), flicker=_scaled(float(parts[1]), 2 * exponent),
        walk=_scaled(float(parts[2]), 2 * exponent), still=0.0 if sd < step else still,
        averages=tuple(each._replace(sd=_scaled(each.sd, exponent)) for each in averages),
    )  # fmt: skip


def _still_share(counts: IntArray, means: FloatArray, squares: FloatArray) -> float:
    """Share of the samples in the longest stretch of blocks in which all are alike.

    >>> ones, zeros = np.ones(8, int), np.zeros(8)
    >>> _still_share(ones, np.array([1.0, 2.0, 5.0, 5.0, 5.0, 5.0, 1.0, 1.0]), zeros)
    0.5
    >>> _still_share(ones, np.arange(8.0), zeros)
    0.0

    Means and squares of blocks of samples that are alike differ by the rounding of their sums.
    """
    rounding = _ROUNDING * float(np.abs(means).max())
    alike = squares <= counts * rounding**2
    goes_on = (np.abs(means[1:] - means[:-1]) <= rounding) & alike[1:] & alike[:-1]
    if not goes_on.any():
        return 0.0
    stretches = np.add.reduceat(counts, np.flatnonzero(np.r_[True, ~goes_on]))
    return float(stretches.max() / counts.sum())


def _scaled(value: float, exponent: int) -> float:
    """Times a power of two; infinite where that is too large."""
    with np.errstate(over="ignore", under="ignore"):
        return float(np.ldexp(value, exponent))


def bartlett_freedom(n: int, correlation: float) -> float:
    """Degrees of freedom of the variance of `n` values whose neighbours correlate (Bartlett 1946), within 1 and n - 1.

    >>> bartlett_freedom(101, 0.5)
    60.0
    """
    square = min(correlation * correlation, 1.0)
    return min(n - 1.0, max(1.0, (n - 1) * (1 - square) / (1 + square)))


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


def scatter_of_averages(number: IntArray, values: FloatArray) -> Average:
    """Standard deviation of consecutive averages; its degrees of freedom allow for correlated neighbours.

    `number`: shape (n,); place of each average on its grid, increasing.

    >>> scatter_of_averages(np.array([0, 1, 3]), np.array([1.0, 2.0, 3.0]))
    Average(n=3, sd=1.0, freedom=2.0)
    """
    if values.size < 2:
        return Average(int(values.size), math.nan, math.nan)
    centred = values - values.mean()
    neighbours = np.diff(number) == 1
    total = float(centred @ centred)
    correlation = float(centred[:-1][neighbours] @ centred[1:][neighbours]) / total if total > 0 else 0.0
    return Average(values.size, math.sqrt(total / (values.size - 1)), bartlett_freedom(values.size, correlation))


def _sd_freedom(n: int, blocks: int, within: float, between: float, dense: FloatArray) -> float:
    """Degrees of freedom of the deviation of all samples; those within blocks count as white."""
    if n < 2 or within + between == 0:
        return float(max(n - 1, 0))
    known = dense[~np.isnan(dense)]
    pairs = ~np.isnan(dense[1:]) & ~np.isnan(dense[:-1])
    power = float(known @ known)
    correlation = float(dense[1:][pairs] @ dense[:-1][pairs]) / power if power > 0 else 0.0
    freedom = bartlett_freedom(blocks, correlation) if blocks > 1 else 1.0
    spread = (within * within / (n - blocks) if n > blocks else 0.0) + between * between / freedom
    return min(n - 1.0, max(1.0, (within + between) ** 2 / spread))


def _dense(places: IntArray, counts: IntArray, values: FloatArray, expected: float) -> FloatArray:
    """Block means on their grid, NaN where a block is missing or not full."""
    dense = np.full(int(places[-1]) + 1, np.nan)
    full = counts >= LEAST_SHARE * expected
    dense[places[full]] = values[full]
    return dense


@compiled
def _allan_kernel(dense: FloatArray, factors: IntArray) -> tuple[FloatArray, IntArray]:
    size = dense.size
    sums = np.zeros(size + 1)
    valid = np.zeros(size + 1, np.int64)
    for i in range(size):
        known = not np.isnan(dense[i])
        sums[i + 1] = sums[i] + (dense[i] if known else 0.0)
        valid[i + 1] = valid[i] + (1 if known else 0)
    variances = np.zeros(factors.size)
    windows = np.zeros(factors.size, np.int64)
    for j in range(factors.size):
        m = factors[j]
        least = 0.9 * m
        stride = max(1, m // 16)
        total = 0.0
        for i in range(0, size - 2 * m + 1, stride):
            first = valid[i + m] - valid[i]
            second = valid[i + 2 * m] - valid[i + m]
            if first >= least and second >= least:
                d = (sums[i + 2 * m] - sums[i + m]) / second - (sums[i + m] - sums[i]) / first
                total += d * d
                windows[j] += 1
        variances[j] = total / (2.0 * windows[j]) if windows[j] else np.nan
    return variances, windows


def _allan(dense: FloatArray) -> tuple[FloatArray, IntArray]:
    """Overlapping Allan variance by octaves up to a third of the stretch."""
    most = max(dense.size // 3, 1)
    factors = 2 ** np.arange(int(math.log2(most)) + 1, dtype=np.int64)
    variances, windows = _allan_kernel(dense, factors)
    known = (windows > 0) & (variances > 0)
    return variances[known], factors[known]


def _freedoms(factors: IntArray, size: int) -> FloatArray:
    """Degrees of freedom of an overlapping Allan variance of random walk, the least (NIST SP 1065 table 5)."""
    m = factors.astype(np.float64)
    return np.maximum(1.0, (size - 2) / m * ((size - 1) ** 2 - 3 * m * (size - 1) + 4 * m * m) / (size - 3) ** 2)


class _Fit(NamedTuple):
    """Parts of the Allan variance in every subset that fits without a negative one, and how likely each subset is."""

    parts: FloatArray  # (subsets, _TERMS)
    weights: FloatArray  # (subsets,), their sum is 1

    @property
    def mean(self) -> FloatArray:
        return np.asarray(self.weights @ self.parts, dtype=np.float64)


def _fit(taus_s: FloatArray, variances: FloatArray, freedoms: FloatArray) -> _Fit:
    """White, flicker and random walk parts, none negative; weighted by what was fitted, twice over."""
    columns = np.stack([1 / taus_s, np.ones_like(taus_s), taus_s], axis=1)
    model = variances
    for _ in range(3):
        root = np.sqrt(freedoms / 2) / model
        subsets = _FEW_OCTAVES.get(len(taus_s), _SUBSETS)
        fit = _least_squares(columns * root[:, None], variances * root, subsets)
        model = np.maximum(columns @ fit.mean, 1e-3 * variances)
    return fit


def _least_squares(design: FloatArray, target: FloatArray, subsets: BoolArray) -> _Fit:
    """`subsets`: shape (subsets, _TERMS); the terms of each."""
    scale = np.sqrt((design * design).sum(axis=0))
    gram = (design / scale).T @ (design / scale)
    moment = (design / scale).T @ target
    # terms that a subset lacks have equations of their own, with the solution 0
    systems = np.where(subsets[:, :, None] & subsets[:, None, :], gram, np.eye(_TERMS))
    moments = np.where(subsets, moment, 0.0)
    try:
        parts = np.linalg.solve(systems, moments[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        is_regular = np.linalg.matrix_rank(systems) == _TERMS
        return _least_squares(design, target, subsets[is_regular])
    is_possible = (parts >= 0).all(axis=1)
    parts = parts[is_possible]
    costs = _PENALTY * subsets[is_possible].sum(axis=1) - (parts * moments[is_possible]).sum(axis=1)
    weights = np.exp((costs.min() - costs) / 2)
    return _Fit(parts / scale, weights / weights.sum())


def _of_mean(fit: _Fit, duration_s: float, blocks: int) -> tuple[float, float]:
    """Variance of the mean over `duration_s`, and its degrees of freedom."""
    shares = fit.parts * np.array([1 / duration_s, 1.0, duration_s])
    totals = shares.sum(axis=1)
    mean = float(fit.weights @ totals)
    if mean <= 0:
        return 0.0, float(blocks - 1)
    # the shortest averaging times determine white noise, the longest flicker and random walk
    freedoms = np.array([max(1.0, blocks / 1.5), max(1.0, blocks / 20.0), _LEAST_FREEDOM])
    freedoms[1:] = np.minimum(freedoms[1:], [12.0, _LEAST_FREEDOM])
    # the uncertainty within each subset, and the scatter between them
    spread = 2 * (shares * shares / freedoms).sum(axis=1) + (totals - mean) ** 2
    return mean, max(_LEAST_FREEDOM, 2 * mean * mean / float(fit.weights @ spread))
