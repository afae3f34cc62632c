"""Values in sessions of stations: units as random effects, sessions that wander, and white noise.

y = levels + unit + session + noise. All fixed effects are constant within a session, so that everything that is asked
of the values is a function of J sums over the sessions and of one sum of squares, however many values there are.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from analytics.trends.mixed_model import MixedModel
from stream.batch import FloatArray, IntArray

# variance of the sessions over that of the noise of a session's mean, and correlation of neighbouring sessions
_RATIOS = (0.3, 1.0, 3.0, 10.0, 30.0)
_CORRELATIONS = (0.0, 0.3, 0.6, 0.8, 0.9, 0.97)


class Noise(NamedTuple):
    """Noise of the sessions.

    Parameters
    ----------
    ratio: Variance of a session's effect over that of the noise of a session's mean; 0: there is none.
    correlation: Of neighbouring sessions of a station.
    """

    ratio: float
    correlation: float

    @property
    def slow(self) -> float:
        """Variance of a mean over many sessions, in units of that of one session's white noise."""
        return self.ratio * (1 + self.correlation) / (1 - self.correlation)


class Sums(NamedTuple):
    """Of one or more series on the same sessions.

    Parameters
    ----------
    products: shape (sessions, series); sums over sessions of the values, whitened of their units.
    squares: shape (series,); sums of squares, likewise.
    """

    products: FloatArray
    squares: FloatArray


class Whitened(NamedTuple):
    """What one noise makes of the sessions: Z'V^-1 Z, the map from Z'A y to Z'V^-1 y, and what it takes off y'A y."""

    noise: Noise
    weight: FloatArray
    turn: FloatArray
    inner: FloatArray
    log_det: float


@dataclass(frozen=True)
class SessionModel:
    """Sessions of stations, in order of station and time.

    Parameters
    ----------
    session: shape (n,); which session each value is of, from 0.
    unit: shape (n,); which unit, from 0.
    station: shape (sessions,); which station each session is of, rising.
    unit_ratio: Variance from unit to unit over that of the noise.
    """

    session: IntArray
    unit: IntArray
    station: IntArray
    unit_ratio: float

    @property
    def values(self) -> int:
        """How many."""
        return self.session.size

    @property
    def sessions(self) -> int:
        """How many."""
        return self.station.size

    @cached_property
    def _counts(self) -> FloatArray:
        """Values of each unit in each session."""
        counts = np.zeros((int(self.unit.max()) + 1, self.sessions))
        np.add.at(counts, (self.unit, self.session), 1.0)
        return counts

    @cached_property
    def _unit_weights(self) -> FloatArray:
        return np.asarray(self.unit_ratio / (1 + self.unit_ratio * self._counts.sum(axis=1)), np.float64)

    @cached_property
    def gram(self) -> FloatArray:
        """Z'A Z, with Z the indicators of the sessions and A the inverse covariance of noise and units."""
        counts = self._counts
        of_units = counts.T @ (self._unit_weights[:, None] * counts)
        return np.asarray(np.diag(counts.sum(axis=0)) - of_units, np.float64)

    @cached_property
    def mean_size(self) -> float:
        """Mean number of values in a session."""
        return self.values / self.sessions

    def sums(self, y: FloatArray) -> Sums:
        """Sums of one series, of shape (n,)."""
        of_unit = np.bincount(self.unit, y, self._unit_weights.size)
        products = np.bincount(self.session, y, self.sessions) - self._counts.T @ (self._unit_weights * of_unit)
        squares = float(y @ y - self._unit_weights @ of_unit**2)
        return Sums(products[:, None], np.array([squares]))

    @cached_property
    def noises(self) -> tuple[Noise, ...]:
        """Noises that are considered, white noise first."""
        correlations = _CORRELATIONS if self.values > self.sessions else _CORRELATIONS[1:]
        return (Noise(0.0, 0.0), *(Noise(ratio, r) for ratio in _RATIOS for r in correlations))

    def covariance(self, noise: Noise) -> FloatArray:
        """Covariance of the sessions, in units of the variance of the noise."""
        at = np.arange(self.sessions)
        same = self.station[:, None] == self.station[None, :]
        apart = np.abs(at[:, None] - at[None, :])
        return np.where(same, noise.correlation**apart, 0.0) * (noise.ratio / self.mean_size)

    def _root(self, noise: Noise) -> FloatArray:
        """L with L L' the covariance, L lower triangular: an autoregression written out."""
        root = np.zeros((self.sessions, self.sessions))
        row = np.zeros(self.sessions)
        for at in range(self.sessions):
            is_first = at == 0 or self.station[at] != self.station[at - 1]
            row = np.zeros(self.sessions) if is_first else noise.correlation * row
            row[at] = 1.0 if is_first else np.sqrt(1 - noise.correlation**2)
            root[at] = row
        return np.asarray(root * np.sqrt(noise.ratio / self.mean_size), np.float64)

    @cached_property
    def whitened(self) -> tuple[Whitened, ...]:
        """Of each of the noises."""
        return tuple(self._whitened(noise) for noise in self.noises)

    def _whitened(self, noise: Noise) -> Whitened:
        n = self.sessions
        if not noise.ratio:
            return Whitened(noise, self.gram, np.eye(n), np.zeros((n, n)), 0.0)
        root = self._root(noise)
        factor = cho_factor(np.eye(n) + root.T @ self.gram @ root, lower=True)
        inner = root @ cho_solve(factor, root.T)
        turn = np.eye(n) - self.gram @ inner
        log_det = 2 * float(np.log(np.diag(factor[0])).sum())
        return Whitened(noise, turn @ self.gram, turn, inner, log_det)

    def simulated(self, noise: Noise, series: int, rng: np.random.Generator) -> Sums:
        """Sums of series of noise alone, its variance 1."""
        # Z'A y = G^(1/2) white + G session; what is orthogonal to the sessions is chi-square
        root = np.linalg.cholesky(self.gram)
        white = rng.standard_normal((self.sessions, series))
        effects = self._root(noise) @ rng.standard_normal((self.sessions, series))
        inside = white + root.T @ effects
        freedom = self.values - self.sessions
        rest = rng.chisquare(freedom, series) if freedom else np.zeros(series)
        return Sums(root @ inside, np.sum(inside**2, axis=0) + rest)


def unit_ratio(y: FloatArray, unit: IntArray, station: IntArray) -> float:
    """Variance from unit to unit over that of the noise, by restricted likelihood; 0 where no unit has two values."""
    fixed = (station[:, None] == np.unique(station)[None, :]).astype(np.float64)
    model = MixedModel(y, fixed, unit)
    if not model.has_repeats or y.size <= fixed.shape[1] + 2:
        return 0.0
    return float(model.variance_ratio)
