"""The sessions of stations in a series, and the steps of level that may lie between them."""

from collections import defaultdict
from typing import NamedTuple

import numpy as np

from analytics.trends.series import Series
from stream.batch import FloatArray, IntArray

LEAST_SEGMENT = 4
LEAST_UNITS = 3
_MOST_SESSIONS = 150
_NS_PER_DAY = 86_400 * 10**9


class Step(NamedTuple):
    """A step that may be: of which station, from which of its sessions on; before and after it so many values."""

    station: int
    session: int
    column: FloatArray


class Layout(NamedTuple):
    """Which session and unit each value is of.

    Parameters
    ----------
    session, unit: shape (n,); of each value, from 0.
    station: shape (sessions,); of each session, rising.
    time: shape (sessions,); mean moment of each, rising within a station.
    names: Of the stations.
    values: Numbers of the values of each session.
    """

    session: IntArray
    unit: IntArray
    station: IntArray
    time: FloatArray
    names: list[str]
    values: list[IntArray]


def layout_of(series: Series) -> Layout:
    """Sessions: what was measured in one run at one station on one day; neighbours in one where they are too many."""
    names, station = np.unique(np.array(series.groups["station"]), return_inverse=True)
    moments = series.t_ns if series.dated else np.arange(series.value.size)
    days = series.t_ns // _NS_PER_DAY if series.dated else np.zeros(series.value.size, np.int64)
    keys: defaultdict[tuple[int, str, int], list[int]] = defaultdict(list)
    for at, key in enumerate(zip(station.tolist(), series.run, days.tolist(), strict=True)):
        keys[key].append(at)
    groups = sorted(
        ((key[0], float(np.mean(moments[at])), at) for key, at in keys.items()),
        key=lambda each: (each[0], each[1], each[2]),
    )
    merged: list[tuple[int, list[int]]] = []
    share = min(1.0, _MOST_SESSIONS / len(groups))
    rank: defaultdict[int, int] = defaultdict(int)
    place: dict[tuple[int, int], int] = {}
    for of, _, inside in groups:
        slot = (of, int(rank[of] * share))
        rank[of] += 1
        if slot not in place:
            place[slot] = len(merged)
            merged.append((of, []))
        merged[place[slot]][1].extend(inside)
    session = np.empty(series.value.size, np.int64)
    for number, (_, inside) in enumerate(merged):
        session[inside] = number
    unit = np.unique(np.array(series.unit), return_inverse=True)[1].astype(np.int64)
    values = [np.array(sorted(at), np.int64) for _, at in merged]
    time = np.array([float(np.mean(moments[at])) for at in values])
    return Layout(
        session, unit, np.array([of for of, _ in merged], np.int64), time, [str(each) for each in names], values
    )


def station_columns(station: IntArray) -> FloatArray:
    """Indicators of the stations, one column each."""
    return np.asarray(station[:, None] == np.unique(station)[None, :], np.float64)


def steps_of(layout: Layout) -> list[Step]:
    """All steps with enough values on either side; of all stations together where units tell them from stations."""
    sizes = np.array([each.size for each in layout.values])
    found = []
    stations = np.unique(layout.station)
    for number in stations:
        own = np.flatnonzero(layout.station == number)
        for session in own[1:]:
            column = np.zeros(layout.station.size)
            column[own[own >= session]] = 1.0
            if sizes[own[own < session]].sum() >= LEAST_SEGMENT <= sizes[own[own >= session]].sum():
                found.append(Step(int(number), int(session), column))
    if stations.size < 2:
        return found
    order = np.argsort(layout.time, kind="stable")
    for rank in range(1, order.size):
        column = np.zeros(layout.station.size)
        column[order[rank:]] = 1.0
        step = Step(-1, int(order[rank]), column)
        few = min(sizes[order[:rank]].sum(), sizes[order[rank:]].sum()) < LEAST_SEGMENT
        if not few and units_across(layout, step) >= LEAST_UNITS:
            found.append(step)
    return found


def sides(layout: Layout, step: Step) -> tuple[IntArray, IntArray]:
    """Numbers of the values before and after a step, where it happens."""
    own = [at for at in range(layout.station.size) if step.station in {-1, layout.station[at]}]
    before = [layout.values[at] for at in own if not step.column[at]]
    after = [layout.values[at] for at in own if step.column[at]]
    return np.sort(np.concatenate(before)), np.sort(np.concatenate(after))


def units_across(layout: Layout, step: Step) -> int:
    """Units measured there before and after."""
    before, after = sides(layout, step)
    return int(np.intersect1d(layout.unit[before], layout.unit[after]).size)
