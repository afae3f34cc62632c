"""The model of the values of sessions.

y = levels + lot + unit + session + noise. All fixed effects are constant within a session, so that every result is a
function of J sums over the sessions and of one sum of squares, however many values there are.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from analytics.trends.groups.mixed_model import MixedModel
from analytics.trends.levels.sessions import Layout, station_columns
from stream.batch import FloatArray, IntArray

_MOST_LOTS = 60
_MOST_RATIO = 1e6
# variance of the sessions over that of the noise of a session's mean, and correlation of neighbouring sessions
_RATIOS = (0.3, 1.0, 3.0, 10.0, 30.0)
_CORRELATIONS = (0.0, 0.3, 0.6, 0.8, 0.9, 0.97)


class SessionNoise(NamedTuple):
    """Noise of the sessions."""

    ratio: float  # variance of a session's effect over that of the noise of a session's mean; 0: none
    correlation: float  # of neighbouring sessions of a station

    @property
    def slow(self) -> float:
        """Variance of a mean over many sessions, in units of that of one session's white noise."""
        return self.ratio * (1 + self.correlation) / (1 - self.correlation)


class Sums(NamedTuple):
    """Of one or more series on the same sessions."""

    products: FloatArray  # shape (sessions, series); sums over sessions of the values, whitened of their units
    squares: FloatArray  # shape (series,); sums of squares, likewise


class Whitened(NamedTuple):
    """The sessions under one noise: Z'V^-1 Z, the map from Z'A y to Z'V^-1 y, and what it subtracts from y'A y."""

    noise: SessionNoise
    weight: FloatArray
    turn: FloatArray
    inner: FloatArray
    log_det: float


@dataclass(frozen=True)
class SessionModel:
    """Sessions of stations, in order of station and time."""

    session: IntArray  # shape (n,), as the unit; of each value, from 0
    unit: IntArray
    station: IntArray  # shape (sessions,); of each session, increasing
    unit_ratio: float  # variance from unit to unit over that of the noise
    # units of a lot are alike: where each lot has sessions of its own, lots that differ are no wander of the sessions
    lot: IntArray | None = None  # shape (n,); of each value, from 0
    lot_ratio: float = 0.0  # variance from lot to lot, likewise

    @property
    def sessions(self) -> int:
        """Number of sessions."""
        return self.station.size

    @cached_property
    def _counts(self) -> FloatArray:
        """Values of each unit in each session."""
        return _cross_counts(self.unit, self.session)

    @cached_property
    def _unit_weights(self) -> FloatArray:
        return np.asarray(self.unit_ratio / (1 + self.unit_ratio * self._counts.sum(axis=1)), np.float64)

    @cached_property
    def _lots(self) -> "_Lots":
        lot = np.zeros(self.unit.size, np.int64) if self.lot is None or not self.lot_ratio else self.lot
        counts = _cross_counts(self.unit, lot)
        weighted = self._unit_weights[:, None] * counts
        sessions = _cross_counts(self.session, lot) - self._counts.T @ weighted
        if not self.lot_ratio:
            return _Lots(lot, weighted, sessions, np.zeros((1, 1)))
        own = np.diag(np.bincount(lot).astype(np.float64)) - counts.T @ weighted
        inner = np.asarray(np.linalg.inv(np.eye(len(own)) / self.lot_ratio + own), np.float64)
        return _Lots(lot, weighted, sessions, inner)

    @cached_property
    def gram(self) -> FloatArray:
        """Z'A Z, with Z the indicators of the sessions and A the inverse covariance of noise, units and lots."""
        counts, lots = self._counts, self._lots
        of_units = counts.T @ (self._unit_weights[:, None] * counts)
        of_lots = lots.sessions @ lots.inner @ lots.sessions.T
        return np.asarray(np.diag(counts.sum(axis=0)) - of_units - of_lots, np.float64)

    def residuals(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A y, what remains of values without that of their units and lots, and its deviation in that of the noise."""
        lots, weights = self._lots, self._unit_weights
        left = y - (weights * np.bincount(self.unit, y, weights.size))[self.unit]
        lot_sums = np.bincount(lots.lot, y, len(lots.inner)) - lots.weighted.T @ np.bincount(self.unit, y, weights.size)
        of_lot = lots.inner @ lot_sums
        left = left - of_lot[lots.lot] + (lots.weighted @ of_lot)[self.unit]
        pairs, place = np.unique(np.column_stack([self.unit, lots.lot]), axis=0, return_inverse=True)
        rows = np.eye(len(lots.inner))[pairs[:, 1]] - lots.weighted[pairs[:, 0]]
        of_lots = np.einsum("ij,jk,ik->i", rows, lots.inner, rows)
        return left, np.sqrt(1 - weights[self.unit] - of_lots[place.ravel()])

    @cached_property
    def mean_size(self) -> float:
        """Mean number of values in a session."""
        return self.session.size / self.sessions

    def sums(self, y: FloatArray) -> Sums:
        """Sums of one series, of shape (n,)."""
        of_unit, lots = np.bincount(self.unit, y, self._unit_weights.size), self._lots
        of_lot = np.bincount(lots.lot, y, len(lots.inner)) - lots.weighted.T @ of_unit
        products = np.bincount(self.session, y, self.sessions) - self._counts.T @ (self._unit_weights * of_unit)
        products = products - lots.sessions @ (lots.inner @ of_lot)
        squares = float(y @ y - self._unit_weights @ of_unit**2 - of_lot @ lots.inner @ of_lot)
        return Sums(products[:, None], np.array([squares]))

    @cached_property
    def noises(self) -> tuple[SessionNoise, ...]:
        """Candidate noises, white noise first."""
        correlations = _CORRELATIONS if self.session.size > self.sessions else _CORRELATIONS[1:]
        return (SessionNoise(0.0, 0.0), *(SessionNoise(ratio, r) for ratio in _RATIOS for r in correlations))

    def covariance(self, noise: SessionNoise) -> FloatArray:
        """Covariance of the sessions, in units of the variance of the noise."""
        at = np.arange(self.sessions)
        same = self.station[:, None] == self.station[None, :]
        apart = np.abs(at[:, None] - at[None, :])
        return np.where(same, noise.correlation**apart, 0.0) * (noise.ratio / self.mean_size)

    def _root(self, noise: SessionNoise) -> FloatArray:
        """L with L L' the covariance, L lower triangular: that of an autoregression."""
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
        """The sessions under each of the noises."""
        return tuple(self._whitened(noise) for noise in self.noises)

    def _whitened(self, noise: SessionNoise) -> Whitened:
        n = self.sessions
        if not noise.ratio:
            return Whitened(noise, self.gram, np.eye(n), np.zeros((n, n)), 0.0)
        root = self._root(noise)
        factor = cho_factor(np.eye(n) + root.T @ self.gram @ root, lower=True)
        inner = root @ cho_solve(factor, root.T)
        turn = np.eye(n) - self.gram @ inner
        log_det = 2 * float(np.log(np.diag(factor[0])).sum())
        return Whitened(noise, turn @ self.gram, turn, inner, log_det)

    def simulated(self, noise: SessionNoise, series: int, rng: np.random.Generator) -> Sums:
        """Sums of series of noise alone, its variance 1."""
        # Z'A y = G^(1/2) white + G session; what is orthogonal to the sessions is chi-square
        root = np.linalg.cholesky(self.gram)
        white = rng.standard_normal((self.sessions, series))
        effects = self._root(noise) @ rng.standard_normal((self.sessions, series))
        inside = white + root.T @ effects
        freedom = self.session.size - self.sessions
        rest = rng.chisquare(freedom, series) if freedom else np.zeros(series)
        return Sums(root @ inside, np.sum(inside**2, axis=0) + rest)


class _Lots(NamedTuple):
    """Lots beside units: A = B - B L inner L'B, with B the inverse covariance of noise and units alone."""

    lot: IntArray
    weighted: FloatArray  # shape (units, lots); values of each, times the weight of the unit
    sessions: FloatArray  # Z'B L
    inner: FloatArray  # shape (lots, lots)


def _cross_counts(rows: IntArray, columns: IntArray) -> FloatArray:
    counts = np.zeros((int(rows.max()) + 1, int(columns.max()) + 1))
    np.add.at(counts, (rows, columns), 1.0)
    return counts


def variance_ratios(y: FloatArray, layout: Layout) -> tuple[float, float]:
    """Variances from unit to unit and from lot to lot over that of the noise, by restricted likelihood.

    0 where no unit has two values, and where there is one lot. Of many lots the first say how they differ.
    """
    inside = np.flatnonzero(layout.lot < _MOST_LOTS)
    station = layout.station[layout.session[inside]]
    unit = np.unique(layout.unit[inside], return_inverse=True)[1]
    lot = layout.lot[inside]
    random = {"lot": np.asarray(lot[:, None] == np.unique(lot), np.float64)} if np.ptp(lot) else {}
    fixed = station_columns(station)
    model = MixedModel(y[inside], fixed, unit, random)
    if not model.has_repeats or inside.size <= fixed.shape[1] + 2:
        return 0.0, 0.0
    return min(model.variance_ratio(), _MOST_RATIO), min(model.variance_ratio("lot"), _MOST_RATIO)
