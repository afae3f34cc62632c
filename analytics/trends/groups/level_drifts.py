"""Levels of a group that drift against each other, as one fixture of three that wears."""

from typing import NamedTuple

import numpy as np

from analytics.trends.groups.contrasts import ContrastEstimate, holm, less_block_means, ols_estimates
from analytics.trends.series import NS_PER_DAY, MetricSeries
from stream.batch import FloatArray

PLACES = ("station", "fixture")
LEAST_BLOCKS = 4
LEAST_FREEDOM = 8
_MOST_LEVELS = 60
_FALSE_ALARM = 0.01


class LevelDrift(NamedTuple):
    """Slope of one level of a group against the mean of the others."""

    group: str
    level: str
    effect: ContrastEstimate  # in the unit of the values per day
    adjusted: float  # probability of such a slope by chance, adjusted for all that were tested
    blocks: int  # days with units of one lot there and elsewhere
    units: int  # units that were measured there on these days


def level_drifts(series: MetricSeries, *, false_alarm: float = _FALSE_ALARM) -> tuple[LevelDrift, ...]:
    """Stations and fixtures that drift against the others; empty where nothing drifts, or nothing tells.

    value = block + level + slope of the level * time + noise, of the first value of each unit. A block has the units of
    one product and lot on one day: what changes with the lots, or with the days, is in it, and does not look like a
    fixture. `false_alarm`: probability that noise alone shows a slope, over all stations and fixtures.
    """
    if not series.dated:
        return ()
    first = series.first_of_units()
    found = [each for group in PLACES for each in _slopes(first, group)]
    adjusted = holm([each.effect.chance for each in found])
    tested = [each._replace(adjusted=p) for each, p in zip(found, adjusted, strict=True)]
    return tuple(each for each in tested if each.adjusted <= false_alarm and _leads(each, tested))


def drift_columns(series: MetricSeries, drifts: tuple[LevelDrift, ...]) -> FloatArray:
    """Time at the levels that drift, a column for each, of shape (values, drifts)."""
    time = (series.t_ns - series.t_ns.mean()) / NS_PER_DAY
    columns = [time * (np.array(series.groups[each.group]) == each.level) for each in drifts]
    return np.array(columns, np.float64).reshape(len(columns), series.value.size).T


def _leads(drift: LevelDrift, others: list[LevelDrift]) -> bool:
    """Whether no other level of the group drifts more plainly: against one that drifts, all others do."""
    return all(
        drift.effect.chance < each.effect.chance or each is drift or each.adjusted > _FALSE_ALARM
        for each in others
        if each.group == drift.group and each.effect.value * drift.effect.value < 0
    )


def _slopes(series: MetricSeries, group: str) -> list[LevelDrift]:
    levels, code = np.unique(np.array(series.groups[group]), return_inverse=True)
    days = series.t_ns // NS_PER_DAY
    keys = list(zip(series.groups["product"], series.groups["lot"], days.tolist(), strict=True))
    names = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    block = np.array([names[key] for key in keys])
    several = np.array([np.ptp(code[block == number]) > 0 for number in range(len(names))])
    inside = several[block]
    if not 2 <= levels.size <= _MOST_LEVELS or not inside.any():
        return []
    code, block = code[inside], np.unique(block[inside], return_inverse=True)[1]
    # levels that were there at too few times have no slope: their offset alone is fitted
    blocks = np.array([np.unique(block[code == number]).size for number in range(levels.size)])
    sloping = np.flatnonzero(blocks >= LEAST_BLOCKS)
    if sloping.size < 2:
        return []
    y = series.value[inside]
    time = (series.t_ns[inside] - series.t_ns[inside].mean()) / NS_PER_DAY
    offsets = (code[:, None] == np.arange(1, levels.size)).astype(np.float64)
    indicator = (code[:, None] == sloping).astype(np.float64)
    slopes = (indicator[:, 1:] - indicator[:, :1]) * time[:, None]  # they add up to zero
    columns = np.column_stack([offsets, slopes])
    k = sloping.size
    contrasts = np.zeros((1 if k == 2 else k, columns.shape[1]))
    own = contrasts[:, offsets.shape[1] :]
    if k == 2:
        own[0, 0] = 2.0  # one against the other
    else:
        own[0] = -k / (k - 1)
        own[np.arange(1, k), np.arange(k - 1)] = k / (k - 1)
    effects = ols_estimates(
        less_block_means(y, block), less_block_means(columns, block), contrasts, blocks=int(block.max()) + 1
    )
    order = sloping[1:] if k == 2 else sloping
    return [
        LevelDrift(group, str(levels[number]), effect, 1.0, int(blocks[number]), int((code == number).sum()))
        for number, effect in zip(order, effects, strict=True)
        if effect is not None and effect.freedom >= LEAST_FREEDOM
    ]
