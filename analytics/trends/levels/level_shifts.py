"""Level shifts of single stations, from all of their measurements, repeated ones included."""

from typing import NamedTuple

import numpy as np

from analytics.trends.levels import sessions
from analytics.trends.levels.change_points import clipped
from analytics.trends.levels.session_model import SessionModel, Sums, variance_ratios
from analytics.trends.levels.step_search import BestStep, StepSearch
from analytics.trends.series import MetricSeries
from analytics.trends.words import NotComputed, not_computed
from stream.batch import FloatArray, IntArray

LEAST_VALUES = 12
MOST_SHIFTS = 6
PLAIN = 0.01
LIKELY = 0.2


class LevelShift(NamedTuple):
    """A change of the level of a station."""

    station: str  # empty where all stations change together
    at: int  # first value of the series at the new level there
    # first, last: values between which the change lies with 95 % confidence: the last one before, the first one after
    first: int
    last: int
    size: float  # change of the level with 95 % bounds, in the unit of the values
    lo: float
    hi: float
    chance: float  # probability that independent measurements show such a change anywhere
    wander: float  # probability that levels which wander from session to session do
    units: int  # units that were measured there before and after

    @property
    def is_certain(self) -> bool:
        """Whether its bounds exclude no change."""
        return not self.lo <= 0.0 <= self.hi

    @property
    def is_plain(self) -> bool:
        """Whether a slow wander of the station does not explain it."""
        return self.wander <= PLAIN


class Unsteady(NamedTuple):
    """Levels that differ from session to session by more than measurements scatter."""

    deviation: float  # standard deviation of the sessions' levels, in the unit of the values
    chance: float  # probability that noise alone shows as much
    largest: LevelShift | None  # the largest change of level, which cannot be separated from that scatter


class LevelShifts(NamedTuple):
    """The level shifts of the stations of a series."""

    shifts: tuple[LevelShift, ...]  # in order of time
    unsteady: Unsteady | None  # none where sessions differ no more than by chance
    # shape (n,); of each value: the level of its station then, by the shifts that are certain, plus the deviation from
    # the value expected of its unit and station, scaled to the noise of one measurement
    points: FloatArray


def level_shifts(series: MetricSeries, *, false_alarm: float = 0.01) -> LevelShifts | NotComputed:
    """Search for changes of level of each station, and of all together.

    Units measured more than once separate units from stations. `false_alarm`: probability that noise alone shows a
    change, over all stations.

    value = level of station + lot + unit + session + noise. Lots, units and sessions (a run at a station on a day) are
    random: what lots alone explain, each in sessions of its own, is neither a change nor a wander of a station.
    Neighbouring sessions of a station may be correlated. The best step of one station is compared with none by their
    likelihoods, each with its most likely noise of the sessions; the probability is that of such a ratio in series
    simulated with the noise that fits best without a step, and with the slowest plausible one. A step that is found is
    added to the model, until no more are found. Outliers are clipped to 5 standard deviations first. Moment and size
    are averaged over all moments and noises by their likelihoods.
    """
    layout = sessions.layout_of(series)
    station_of_value = layout.station[layout.session]
    repeated = np.unique(layout.serial[(np.bincount(layout.unit) > 1)[layout.unit]]).size
    if series.value.size < LEAST_VALUES or repeated < sessions.LEAST_UNITS:
        counts = {"values": series.value.size, "repeated": repeated}
        return not_computed("shifts_short", **counts, least=LEAST_VALUES, units=sessions.LEAST_UNITS)
    middle, scale = float(np.median(series.value)), float(series.value.std())
    if not scale > 1e-12 * abs(middle):
        return not_computed("shifts_constant")
    y = (series.value - middle) / scale
    of_unit, of_lot = variance_ratios(y, layout)
    model = SessionModel(layout.session, layout.unit, layout.station, of_unit, layout.lot, of_lot)
    search = StepSearch(model, sessions.steps_of(layout), sessions.station_columns(layout.station))
    for _ in range(2):
        # levels first from the raw values, then from the clipped ones
        expected, spread = search.residuals(y)
        tame = expected + spread * _tame((y - expected) / spread, station_of_value)
    sums = model.sums(tame)
    found: list[BestStep] = []
    while len(found) < MOST_SHIFTS and (best := search.best(sums)) is not None:
        if best.seen > false_alarm / 2 or best.wander > LIKELY:
            break
        found.append(best)
        search = search.with_step(best.step)
    shifts = [_located(search.without(each.step), sums, each, layout, scale) for each in found]
    unsteady = None
    if (scatter := search.unsteady(sums, false_alarm / 2)) is not None:
        deviation, chance = scatter
        best = search.best(sums)
        largest = None if best is None else _located(search, sums, best, layout, scale)
        unsteady = Unsteady(deviation * scale, chance, largest)
    for each, shift in zip(found, shifts, strict=True):
        if not shift.is_certain:  # in the points it would look like a drift, or a change, that is certain
            search = search.without(each.step)
    expected, spread = search.residuals(y)
    level = search.levels(model.sums(y))[model.session]
    points = middle + scale * (level + (y - expected) / spread)
    return LevelShifts(tuple(sorted(shifts, key=lambda each: each.at)), unsteady, points)


def _tame(residuals: FloatArray, station: IntArray) -> FloatArray:
    """Outlying residuals clipped, each by its neighbours at its station."""
    found = residuals.copy()
    for number in np.unique(station):
        own = station == number
        if own.sum() >= sessions.LEAST_SEGMENT:
            found[own] = clipped(residuals[own])
    return found


def _located(search: StepSearch, sums: Sums, found: BestStep, layout: sessions.Layout, scale: float) -> LevelShift:
    """A step with its bounds; it is no column of the search."""
    step, moments = found.step, search.moments(sums, found.step)
    size, lo, hi = (each * scale for each in moments.size())
    ends = [sessions.sides(layout, each) for each in moments.likely()]
    return LevelShift(
        station="" if step.station < 0 else layout.names[step.station], at=int(sessions.sides(layout, step)[1][0]),
        first=min(int(before[-1]) for before, _ in ends), last=max(int(after[0]) for _, after in ends), size=size,
        lo=lo, hi=hi, chance=found.seen, wander=found.wander, units=sessions.units_across(layout, step),
    )  # fmt: skip
