"""Samples that no noise explains: isolated outliers, and single values that hold a pile of samples."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stream.batch import FloatArray

FAR = 9.0  # threshold, in standard deviations from the mean of the neighbours: in white noise 1 sample in 10^13
_CALM = 0.6
_MOTION = 0.01
_PER_MEDIAN = 1.4826
_BESIDE = 3
WORTH_A_WORD = 0.01  # relative increase of N from which outliers are reported
FEWEST_LEVELS, _FEWEST_PILED, _LEAST_PILED, _PILED_TIMES, _APART_TIMES = 16, 10, 0.01, 3.0, 3.0
_MARGIN, _FEWEST_AFTER = 5.0, 5


@dataclass(frozen=True)
class IsolatedOutliers:
    """Isolated outliers of a signal."""

    count: int
    largest: float  # the largest departure from the neighbours, in standard deviations of the noise between samples
    raise_n_by: float  # relative increase of N, as estimated from the Allan deviation

    @property
    def is_worth_a_word(self) -> bool:
        """Whether they raise N by 1 % or more."""
        return self.raise_n_by >= WORTH_A_WORD

    @property
    def sentence(self) -> str:
        """The report of the outliers."""
        return (
            f"{self.count:,} isolated outliers, up to {self.largest:.3g} times the noise, raise N by "
            f"{self.raise_n_by:.0%}: leave them out, or find what makes them"
        )

    @property
    def chinese(self) -> str:
        """The same in Chinese."""
        return (
            f"{self.count:,} 个孤立离群值，最大为噪声的 {self.largest:.3g} 倍，使 N 偏大 {self.raise_n_by:.0%}："
            "应剔除，或查明其原因"
        )


def count_outliers(pieces: Iterable[FloatArray]) -> IsolatedOutliers:
    """Count the single samples that leave the mean of their neighbours by nine standard deviations of the noise.

    The noise is from the median difference between samples; a lasting change is no outlier, nor is the tail of a noise
    in which one sample in a hundred lies outside.

    >>> noise = np.random.default_rng(1).standard_normal(10_000)
    >>> noise[5000] += 35.0
    >>> found = count_outliers([noise])
    >>> found.count, round(found.raise_n_by, 2)
    (1, 0.06)
    >>> count_outliers([np.arange(100.0)]).count
    0
    """
    samples, count, largest, squares, variance = 0, 0, 0.0, 0.0, 0.0
    last: tuple[float, float] = 0.0, 0.0
    for piece in pieces:
        value = piece[np.isfinite(piece)]
        if value.size <= 2 * _BESIDE or np.ptp(value) == 0.0:
            continue
        sigma = _noise(value)
        samples += value.size
        variance += sigma**2 * value.size
        found = list(_inside(value, sigma).values())
        if samples == value.size:  # the first of all
            found += filter(None, [_end(value[:4], sigma)])
        last = _end(value[:-5:-1], sigma), sigma
        for each in found:
            count, squares, largest = count + 1, squares + each**2, max(largest, abs(each) / sigma)
    if last[0]:
        count, squares, largest = count + 1, squares + last[0] ** 2, max(largest, abs(last[0]) / last[1])
    if count == 0 or is_motion(count, samples):
        return IsolatedOutliers(0, 0.0, 0.0)
    return IsolatedOutliers(count, largest, float(np.sqrt(1.0 + squares / variance) - 1.0))


def isolated_at(values: FloatArray) -> dict[int, float]:
    """Where isolated outliers stand in a piece of a signal, its ends included, and how many deviations off.

    >>> noise = np.random.default_rng(1).standard_normal(100)
    >>> noise[[0, 50]], noise[7] = 35.0, np.nan
    >>> sorted(isolated_at(noise))
    [0, 50]
    """
    places = np.flatnonzero(np.isfinite(values))
    value = values[places]
    if value.size <= 2 * _BESIDE or np.ptp(value) == 0.0:
        return {}
    sigma = _noise(value)
    found = _inside(value, sigma)
    for at, end in ((0, value[:4]), (value.size - 1, value[:-5:-1])):
        if off := _end(end, sigma):
            found[at] = off
    return {int(places[at]): abs(off) / sigma for at, off in found.items()}


def is_motion(count: int, samples: int) -> bool:
    """Whether so many samples stand out that they are a motion or the tail of a noise, and no outliers."""
    return count > _MOTION * samples


def _noise(values: FloatArray) -> float:
    """Standard deviation from the median difference; an output that stood still for a part has no noise there."""
    moves = np.abs(np.diff(values))
    return float(_PER_MEDIAN * np.median(moves[moves > 0]) * 0.5**0.5)


def _inside(values: FloatArray, sigma: float) -> dict[int, float]:
    """Where outliers stand that have a neighbour on both sides, and how far they are from the mean of these."""
    off = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    found = {}
    for at in (np.flatnonzero(np.abs(off) > FAR * np.sqrt(1.5) * sigma) + 1).tolist() if sigma > 0 else ():
        around = np.concatenate([values[max(0, at - _BESIDE) : at], values[at + 1 : at + 1 + _BESIDE]])
        if np.ptp(around) < _CALM * abs(off[at - 1]):
            found[at] = float(off[at - 1])
    return found


def _end(values: FloatArray, sigma: float) -> float:
    """How far the first of four values is from the line through the others, if it is an outlier; else 0."""
    off = float(values[0] - values[1:].mean() - (values[1] - values[3]))
    is_far = sigma > 0 and abs(off) > FAR * (10.0 / 3.0) ** 0.5 * sigma
    return off if is_far and np.ptp(values[1:]) < _CALM * abs(off) else 0.0


def piled_share(values: FloatArray) -> tuple[float, float]:
    """Share of the samples at one value, or at two, that hold far more than any other; and that value.

    As of an output that is clipped at an end of its range, or of lost samples that are written as 0: at least 10
    samples and 1 %, and three times as many as the third most frequent value where the middle nine tenths of the
    samples are at 16 values or more; of any resolution two samples or more, farther from all others than three times
    their range. 0 and NaN where there is none.

    >>> noise = np.random.default_rng(1).standard_normal(1000)
    >>> piled_share(np.minimum(noise, 1.0)), piled_share(noise)[0], piled_share(np.round(noise))[0]
    ((0.126, 1.0), 0.0, 0.0)
    """
    levels, counts = np.unique(values, return_counts=True)
    piled = [at for at in {0, levels.size - 1} if counts[at] > 1 and is_apart(levels, at)]
    ends = np.searchsorted(np.cumsum(counts), values.size * np.array([0.05, 0.95]))
    if not piled and int(np.ptp(ends)) + 1 >= FEWEST_LEVELS:
        first = np.argsort(-counts, kind="stable")[:3]
        usual = _PILED_TIMES * float(counts[first[2]])
        # beyond what counts scatter by
        least = max(_FEWEST_PILED, _LEAST_PILED * values.size, usual + _MARGIN * usual**0.5)
        piled = [int(at) for at in first[:2] if counts[at] > least]
        piled = piled if piled and _levels_after(values, levels[piled]) >= _FEWEST_AFTER else []
    if not piled:
        return 0.0, float("nan")
    return float(counts[piled].sum() / values.size), float(levels[piled[0]])


def _levels_after(values: FloatArray, piled: FloatArray) -> int:
    """How many values follow upon those of the pile: few where the output is coarse for a part of the record."""
    is_piled = np.isin(values, piled)
    return int(np.unique(values[1:][is_piled[:-1] & ~is_piled[1:]]).size)


def is_apart(levels: FloatArray, at: int) -> bool:
    """Whether a value is farther from all others than three times their range."""
    others = np.delete(levels, at)
    return others.size > 1 and float(np.abs(others - levels[at]).min()) > _APART_TIMES * float(np.ptp(others))
