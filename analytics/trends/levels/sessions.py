"""Sessions of stations in a series: their layout, and possible level steps between them."""

from collections import Counter, defaultdict
from typing import NamedTuple

import numpy as np

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
    lot: IntArray  # shape (n,); lot of a product of each value, from 0


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
    lots: dict[tuple[str, str], int] = {}
    of_lot = zip(*(series.groups.get(name, series.unit) for name in ("product", "lot")), strict=True)
    lot = np.array([lots.setdefault(each, len(lots)) for each in of_lot], np.int64)
    time = np.array([float(np.mean(moments[at])) for at in values])
    stations = np.array([of for of, _ in merged])
    return Layout(session, unit, serial, stations, time, [str(each) for each in names], values, lot)


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
