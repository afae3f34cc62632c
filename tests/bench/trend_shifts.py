"""How often shifts of stations are found, and found where there are none: ``python -m tests.bench.trend_shifts``.

Units are measured several times on each of some stations, in weekly sessions, in a few rounds of all units, or one by
one; one station shifts after the seventh week. Asked is, each with the one-sided 99.9 % binomial bound corrected for
the number of checks: in independent noise at most 1 % of series show anything; where stations wander from session to
session at most 1 % show a plain shift. Of the shifts that are found at least 93 % are covered by their intervals; where
stations wander 80 %, since what is found there is the larger part of what is.
"""

import argparse
import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from analytics.trends.levels.level_shifts import LevelShifts, level_shifts
from analytics.trends.series import MetricSeries, Variant

START_NS = 1_767_600_000 * 10**9  # Monday 2026-01-05 08:00 UTC
DAY_NS = 86_400 * 10**9
SHIFT_DAY = 49
STATION = "C1"


class Plan(NamedTuple):
    """What is measured and what is true of it; deg/h.

    Parameters
    ----------
    units, stations, repeats, weeks : int
        How many; each unit is measured `repeats` times on each station.
    how : str
        ``weekly``: sessions of some units; ``rounds``: each session has all units; ``single``: each measurement a run.
    of_units, of_stations, noise : float
        Standard deviations.
    of_sessions, correlation : float
        Standard deviation of the sessions of a station, and correlation of neighbouring ones.
    shift : float
        Of station C1 after the seventh week.
    """

    units: int = 30
    stations: int = 3
    repeats: int = 4
    weeks: int = 14
    how: str = "weekly"
    of_units: float = 0.5
    of_stations: float = 0.2
    noise: float = 0.1
    of_sessions: float = 0.0
    correlation: float = 0.0
    shift: float = 0.0


CASES: Mapping[str, Plan] = {
    "independent": Plan(),
    "independent, 2 stations, 12 units": Plan(units=12, stations=2, repeats=3),
    "sessions 0.05": Plan(of_sessions=0.05),
    "sessions 0.05, correlation 0.6": Plan(of_sessions=0.05, correlation=0.6),
    "sessions 0.1, correlation 0.9": Plan(of_sessions=0.1, correlation=0.9),
    "shift 0.12": Plan(shift=0.12),
    "shift 0.12, noise 0.15": Plan(shift=0.12, noise=0.15),
    "shift 0.12, sessions 0.03": Plan(shift=0.12, of_sessions=0.03),
    "shift 0.25, sessions 0.05, correlation 0.5": Plan(shift=0.25, of_sessions=0.05, correlation=0.5),
}


def simulated(rng: np.random.Generator, plan: Plan) -> MetricSeries:
    """Values in order of time."""
    own, of_station = rng.normal(0, plan.of_units, plan.units), rng.normal(0, plan.of_stations, plan.stations)
    rows = []
    for unit in range(plan.units):
        for station in range(plan.stations):
            for repeat in range(plan.repeats):
                quarter = repeat + (0.5 if plan.how == "rounds" else rng.uniform())
                week = plan.weeks * quarter / plan.repeats
                day = 7 * week if plan.how == "single" else 7.0 * int(week) + station
                rows.append((day, unit, station))
    rows.sort()
    wander = [_wander(rng, 7 * plan.weeks + plan.stations, plan) for _ in range(plan.stations)]
    value = [
        own[unit] + of_station[station] + wander[station][int(day) // (1 if plan.how == "single" else 7)]
        + plan.shift * (f"C{station}" == STATION and day >= SHIFT_DAY) + rng.normal(0, plan.noise)
        for day, unit, station in rows
    ]  # fmt: skip
    n = len(rows)
    return MetricSeries(
        metric="bias",
        unit_of_measure="deg/h",
        value=np.array(value),
        uncertainty=np.full(n, 0.03),
        t_ns=START_NS + np.array([int(day * DAY_NS) for day, _, _ in rows]),
        unit=[f"U{unit:03}" for _, unit, _ in rows],
        run=[
            f"r{at}" if plan.how == "single" else f"r{day:g}-{row[2]}" for at, row in enumerate(rows) for day in row[:1]
        ],
        groups={
            "station": [f"C{station}" for _, _, station in rows],
            **{name: [name] * n for name in ("fixture", "lot", "product", "signal")},
        },
        variant=Variant("JJF2014", ()),
        others=(),
        without_value=0,
        dated=True,
    )


def _wander(rng: np.random.Generator, sessions: int, plan: Plan) -> np.ndarray:
    effects = rng.normal(0, plan.of_sessions, sessions)
    for at in range(1, sessions):
        effects[at] = plan.correlation * effects[at - 1] + np.sqrt(1 - plan.correlation**2) * effects[at]
    return effects


class Counted(NamedTuple):
    """Of so many series: how many show anything, a plain shift, and one of the shifted station, sized and dated."""

    series: int
    anything: int
    plain: int
    found: int
    covered: int
    dated: int
    elsewhere: int


def counted(plan: Plan, series: int, seed: int = 1) -> Counted:
    """Search for shifts in so many simulated series."""
    counts = np.zeros(6, int)
    for number in range(series):
        found = level_shifts(simulated(np.random.default_rng([seed, number]), plan))
        assert isinstance(found, LevelShifts)
        own = [each for each in found.shifts if each.station == STATION]
        counts += [
            bool(found.shifts) or found.unsteady is not None,
            any(each.is_plain for each in found.shifts),
            bool(own),
            bool(own) and own[0].lo <= plan.shift <= own[0].hi,
            bool(own) and _is_dated(own[0], plan, number, seed),
            len(own) < len(found.shifts),
        ]
    return Counted(series, *(int(each) for each in counts))


def _is_dated(shift: Any, plan: Plan, number: int, seed: int) -> bool:
    days = (simulated(np.random.default_rng([seed, number]), plan).t_ns - START_NS) / DAY_NS
    return bool(days[shift.first] < SHIFT_DAY + 1 and days[shift.last] >= SHIFT_DAY)


def is_outside(plan: Plan, found: Counted, checks: int) -> bool:
    """Whether the bounds exclude what is asked."""
    tail = 0.001 / checks
    if plan.shift:
        return bool(found.covered < stats.binom.ppf(tail, found.found, 0.8 if plan.of_sessions else 0.93))
    wrong = found.plain if plan.of_sessions else found.anything
    return bool(wrong > stats.binom.isf(tail, found.series, 0.01))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--series", type=int, default=300)
    parser.add_argument("--how", choices=["weekly", "rounds", "single"], default="weekly")
    options = parser.parse_args()
    failed = False
    for name, plan in CASES.items():
        planned = plan._replace(how=options.how)
        found = counted(planned, options.series)
        outside = is_outside(planned, found, len(CASES))
        failed |= outside
        reported = ", ".join(f"{key} {value}" for key, value in found._asdict().items())
        print(f"{name:44} {reported}{'  OUTSIDE' if outside else ''}", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
