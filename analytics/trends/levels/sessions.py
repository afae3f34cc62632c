"""Sessions of stations in a series: their layout, possible level steps between them, and the model of their values.

y = levels + unit + session + noise. All fixed effects are constant within a session, so that every result is a function
of J sums over the sessions and of one sum of squares, however many values there are.
"""

from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from analytics.trends.groups.mixed_model import MixedModel
from analytics.trends.series import NS_PER_DAY, MetricSeries
from stream.batch import FloatArray, IntArray

LEAST_SEGMENT = 4
LEAST_UNITS = 3
_MOST_SESSIONS = 150


class LevelStep(NamedTuple):
    """A possible step of the level of a station, -1 for all together, from one of its sessions on; its indicator."""

    station: int
    session: int
    column: FloatArray


class Layout(NamedTuple):
    """Session, unit and serial of each value; the axes of one device are units of one serial."""

    session: IntArray  # shape (n,), as the unit; of each value, from 0
    unit: IntArray
    serial: IntArray
    station: IntArray  # shape (sessions,); of each session, increasing
    time: FloatArray  # shape (sessions,); mean moment of each, increasing within a station
    names: list[str]  # of the stations
    values: list[IntArray]  # indices of the values of each session


def layout_of(series: MetricSeries) -> Layout:
    """Sessions: the values of one run at one station on one day; neighbours are merged where they are too many."""
    names, station = np.unique(np.array(series.groups["station"]), return_inverse=True)
    moments = series.t_ns if series.dated else np.arange(series.value.size)
    days = series.t_ns // NS_PER_DAY if series.dated else np.zeros(series.value.size, np.int64)
    keys: defaultdict[tuple[int, str, int], list[int]] = defaultdict(list)
    for at, key in enumerate(zip(station.tolist(), series.run, days.tolist(), strict=True)):
        keys[key].append(at)
    groups = sorted((key[0], float(np.mean(moments[at])), at) for key, at in keys.items())
    share = min(1.0, _MOST_SESSIONS / len(groups))
    rank: Counter[int] = Counter()
    merged: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
    for of, _, inside in groups:
        merged[of, int(rank[of] * share)] += inside
        rank[of] += 1
    values = [np.array(sorted(at), np.int64) for at in merged.values()]
    session = np.empty(series.value.size, np.int64)
    for number, inside_session in enumerate(values):
        session[inside_session] = number
    unit, serial = (
        np.unique(np.array(names), return_inverse=True)[1].astype(np.int64) for names in (series.unit, series.serial)
    )
    time = np.array([float(np.mean(moments[at])) for at in values])
    stations = np.array([of for of, _ in merged])
    return Layout(session, unit, serial, stations, time, [str(each) for each in names], values)


def station_columns(station: IntArray) -> FloatArray:
    """Indicators of the stations, one column each."""
    return np.asarray(station[:, None] == np.unique(station)[None, :], np.float64)


def steps_of(layout: Layout) -> list[LevelStep]:
    """All steps with enough values on either side; of all stations together where enough units cross them."""
    sizes = np.array([each.size for each in layout.values])
    found = []
    stations = np.unique(layout.station)
    for number in stations:
        own = np.flatnonzero(layout.station == number)
        for session in own[1:]:
            column = np.zeros(layout.station.size)
            column[own[own >= session]] = 1.0
            if sizes[own[own < session]].sum() >= LEAST_SEGMENT <= sizes[own[own >= session]].sum():
                found.append(LevelStep(int(number), int(session), column))
    if stations.size < 2:
        return found
    order = np.argsort(layout.time, kind="stable")
    for rank in range(1, order.size):
        column = np.zeros(layout.station.size)
        column[order[rank:]] = 1.0
        step = LevelStep(-1, int(order[rank]), column)
        few = min(sizes[order[:rank]].sum(), sizes[order[rank:]].sum()) < LEAST_SEGMENT
        if not few and units_across(layout, step) >= LEAST_UNITS:
            found.append(step)
    return found


def sides(layout: Layout, step: LevelStep) -> tuple[IntArray, IntArray]:
    """Indices of the values before and after a step, at its station."""
    own = [at for at in range(layout.station.size) if step.station in {-1, layout.station[at]}]
    before = [layout.values[at] for at in own if not step.column[at]]
    after = [layout.values[at] for at in own if step.column[at]]
    return np.sort(np.concatenate(before)), np.sort(np.concatenate(after))


def units_across(layout: Layout, step: LevelStep) -> int:
    """How many units were measured there before and after."""
    before, after = sides(layout, step)
    return int(np.intersect1d(layout.serial[before], layout.serial[after]).size)


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

    @property
    def sessions(self) -> int:
        """Number of sessions."""
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
        return self.session.size / self.sessions

    def sums(self, y: FloatArray) -> Sums:
        """Sums of one series, of shape (n,)."""
        of_unit = np.bincount(self.unit, y, self._unit_weights.size)
        products = np.bincount(self.session, y, self.sessions) - self._counts.T @ (self._unit_weights * of_unit)
        squares = float(y @ y - self._unit_weights @ of_unit**2)
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


def unit_ratio(y: FloatArray, unit: IntArray, station: IntArray) -> float:
    """Variance from unit to unit over that of the noise, by restricted likelihood; 0 where no unit has two values."""
    fixed = station_columns(station)
    model = MixedModel(y, fixed, unit)
    if not model.has_repeats or y.size <= fixed.shape[1] + 2:
        return 0.0
    return model.variance_ratio()
