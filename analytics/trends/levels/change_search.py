"""The evidence for one or two more changes of level in a series, whatever its noise does."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from analytics.trends.wander import NOISES, Noise, Reduced, prior, products, reduced
from stream.batch import FloatArray, IntArray

LEAST_SEGMENT = 4
# most moments of which all pairs are compared
_MOST_MOMENTS = 42
# noises in which moments of pairs are sought: independent points, a fast and a slow wander
_SEEN_IN = [NOISES.index(Noise(*each)) for each in ((0.0, 1.0), (0.7, 1.0), (0.96, 0.4))]


class Evidence(NamedTuple):
    """Evidence for more changes: twice the log of how much more probable they make the values."""

    ratio: float
    at: tuple[int, ...]  # the most probable moments


class Moments(NamedTuple):
    """The moments of one change with each noise."""

    at: IntArray  # shape (k,); possible moments
    weight: FloatArray  # shape (noises, k); posterior probability
    size: FloatArray  # shape (noises, k); change of level
    error: FloatArray  # shape (noises, k); scale of its Student's t
    freedom: int


class ChangeSearch:
    """The search for changes beside those known.

    The level has a flat prior, changes one in standard deviations of the noise, its variance that of Jeffreys; moments
    are equally probable; the noise is averaged over `wander.NOISES`.
    """

    def __init__(self, values: FloatArray, changes: tuple[int, ...] = ()) -> None:
        self._values = values
        n = values.size
        self.changes = tuple(sorted(changes))
        self.columns = np.vstack([np.ones(n), *((np.arange(n) >= at) * 1.0 for at in self.changes)])
        self._reduced = reduced(values, self.columns)
        is_free = np.zeros(n, np.bool_)
        for first, last in pairwise([0, *self.changes, n]):
            is_free[first + LEAST_SEGMENT : max(last - LEAST_SEGMENT + 1, 0)] = True
        self._free = np.flatnonzero(is_free)

    def one(self) -> Evidence | None:
        """Evidence for one change more; None where none fits between the known ones."""
        if not self._free.size:
            return None
        logs = _over_noises(self._reduced.with_steps()[:, self._free])
        return Evidence(2 * (_log_mean(logs) - self.known), (int(self._free[logs.argmax()]),))

    def two(self) -> Evidence | None:
        """Evidence for two changes more at once: a bump that returns, which one change hardly explains."""
        moments = self._pair_moments()
        first, second = np.triu_indices(moments.size, 1)
        is_apart = moments[second] - moments[first] >= LEAST_SEGMENT
        first, second = first[is_apart], second[is_apart]
        if not first.size:
            return None
        logs = _over_noises(self._with_pairs(moments, first, second))
        # moments left out as worse than their neighbours count as well
        free = self._free.size
        ratio = float(np.logaddexp.reduce(logs)) - np.log(free * (free - 1) / 2) - self.known
        best = int(logs.argmax())
        return Evidence(2 * ratio, (int(moments[first[best]]), int(moments[second[best]])))

    @property
    def known(self) -> float:
        """Log of the probability of the values with the known changes, up to a constant."""
        return float(_over_noises(self._reduced.log_likelihood))

    def _pair_moments(self) -> IntArray:
        """All moments where they are few; else those where rises and falls are likeliest in fast and slow noise."""
        free = self._free
        if free.size <= _MOST_MOMENTS:
            return free
        apart = max(1, self._values.size // (2 * _MOST_MOMENTS))
        signed = self._reduced.across[_SEEN_IN] / np.sqrt(self._reduced.information[_SEEN_IN])
        chosen: set[int] = set()
        share = _MOST_MOMENTS // (2 * len(_SEEN_IN))
        for of_noise in signed[:, free]:
            for height in (of_noise, -of_noise):
                chosen.update(free[_peaks(height, share, apart)].tolist())
        return np.array(sorted(chosen), np.int64)

    def _with_pairs(self, moments: IntArray, first: IntArray, second: IntArray) -> FloatArray:
        """Restricted log-likelihood with each pair of steps, of shape (noises, pairs)."""
        known, n = self._reduced, self._values.size
        series = np.vstack([self.columns, *((np.arange(n) >= at) * 1.0 for at in moments)])
        among, c = products(series).among, len(self.columns)
        mixed = among[:, :c, c:]
        beside = among[:, c:, c:] - np.swapaxes(mixed, 1, 2) @ np.linalg.solve(among[:, :c, :c], mixed)
        across = known.across[:, moments]
        own = np.maximum(np.einsum("pii->pi", beside), 1e-12)
        a, b, cross = own[:, first], own[:, second], beside[:, first, second]
        determinant = np.maximum(a * b - cross**2, 1e-12 * a * b)
        x, y = across[:, first], across[:, second]
        explained = (b * x**2 - 2 * cross * x * y + a * y**2) / determinant
        left = np.maximum(known.squares[:, None] - explained, 1e-12 * known.squares[:, None])
        start = known.log_likelihood + 0.5 * known.freedom * np.log(known.squares)
        gained = -0.5 * np.log(determinant / known.freedom**2) - 0.5 * known.freedom * np.log(left)
        return np.asarray(start[:, None] + gained, np.float64)

    def moments(self) -> Moments:
        """All moments of one change more; their weights add to one."""
        found: Reduced = self._reduced
        logs = found.with_steps()[:, self._free] + np.log(prior())[:, None]
        weight = np.exp(logs - logs.max())
        across, information = found.across[:, self._free], found.information[:, self._free]
        left = np.maximum(found.squares[:, None] - across**2 / information, 1e-12 * found.squares[:, None])
        freedom = found.freedom - 1
        error = np.sqrt(left / freedom / information)
        return Moments(self._free, weight / weight.sum(), across / information, error, freedom)

    def of_line(self) -> float:
        """Twice the log of how much more probable a straight line across the series makes the values."""
        line = np.linspace(0.0, 1.0, self._values.size)
        return self._gained(np.vstack([self.columns, line]))

    def of_changes(self, changes: tuple[int, ...]) -> float:
        """Evidence for so many changes more, had one only looked there; each costs the choice of its moment."""
        beside = ChangeSearch(self._values, (*self.changes, *changes))
        return self._gained(beside.columns) - 2 * len(changes) * math.log(self._values.size)

    def _gained(self, columns: FloatArray) -> float:
        found = reduced(self._values, columns)
        more = len(columns) - len(self.columns)
        like_steps = found.log_likelihood - 0.5 * more * np.log(found.squares / self._reduced.freedom)
        return 2.0 * (float(_over_noises(like_steps)) - self.known)

    def noise_weights(self) -> FloatArray:
        """Posterior probability of each noise of `wander.NOISES` beside the known changes."""
        logs = self._reduced.log_likelihood + np.log(prior())
        weight = np.exp(logs - logs.max())
        return np.asarray(weight / weight.sum(), np.float64)


def _over_noises(logs: FloatArray) -> FloatArray:
    """Log of the mean over the noises, the first axis."""
    weight = np.log(prior()).reshape(-1, *[1] * (logs.ndim - 1))
    return np.asarray(np.logaddexp.reduce(logs + weight, axis=0), np.float64)


def _log_mean(logs: FloatArray) -> float:
    return float(np.logaddexp.reduce(logs)) - float(np.log(logs.size))


def _peaks(height: FloatArray, most: int, apart: int) -> list[int]:
    """Places of the highest values, at least so far apart."""
    left = height.copy()
    found = []
    for _ in range(most):
        at = int(left.argmax())
        if not left[at] > 0:
            break
        found.append(at)
        left[max(at - apart, 0) : at + apart + 1] = -np.inf
    return found
