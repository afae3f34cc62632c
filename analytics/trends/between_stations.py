"""Whether stations, fixtures or lots differ, by how much, and whether that can be told from what goes with them."""

from collections import defaultdict
from itertools import combinations
from typing import NamedTuple

import numpy as np

from analytics.trends.mixed_model import Deviation, Effect, MixedModel, holm, paired_difference
from analytics.trends.series import GROUPS, Series
from analytics.trends.words import Refused, Words
from stream.batch import FloatArray, IntArray

LEAST_VALUES = 8
LEAST_PER_LEVEL = 2
LEAST_PAIRS = 3
_MOST_LEVELS = 200


class Difference(NamedTuple):
    """By how much one level of a group lies from the others.

    Parameters
    ----------
    group, level, against : str
        As ``station``, ``B``, ``A``; `against` is empty where it is the mean of all other levels.
    effect : Effect
        level - against, in the unit of the values.
    adjusted : float
        Probability of so large a difference by chance, adjusted for all differences looked at.
    confounded : tuple of str
        Groups that cannot be told apart from this one.
    units : int
        Units that were measured there.
    """

    group: str
    level: str
    against: str
    effect: Effect
    adjusted: float
    confounded: tuple[str, ...]
    units: int


class Pairs(NamedTuple):
    """The difference of two levels on the units that were measured on both."""

    group: str
    level: str
    against: str
    units: int
    effect: Effect


class Comparison(NamedTuple):
    """How groups compare.

    Parameters
    ----------
    differences : tuple of Difference
        Of all groups with more than one level.
    pairs : tuple of Pairs
        Of levels with units in common.
    components : dict of Deviation
        Standard deviations: `unit` from unit to unit, `residual` from one measurement of a unit to the next, and of
        each group from level to level. Where no unit was measured twice `residual` is both.
    left_out : tuple of Words
        Groups that were not compared, and why.
    """

    differences: tuple[Difference, ...]
    pairs: tuple[Pairs, ...]
    components: dict[str, Deviation]
    left_out: tuple[Words, ...]


class _Group(NamedTuple):
    name: str
    levels: list[str]
    code: IntArray
    columns: FloatArray
    """Indicators of all levels but the first."""


def compare_groups(series: Series, groups: tuple[str, ...] = GROUPS) -> Comparison | Refused:
    """Compare the levels of groups, units being a random effect.

    Parameters
    ----------
    series : Series
        All values, repeated ones too: they tell the scatter of units from that of measurements.
    groups : tuple of str
        Which groups; those with one level only are passed over.

    Notes
    -----
    One linear mixed model for all: value = level of station + of fixture + of lot + unit + residual. What several
    stations saw of one unit and what they saw of different units are both used, each with its weight. A group whose
    columns depend on those of others is compared without them, and said to be confounded with them. With two levels the
    second is held against the first, with more each against the mean of the others.
    """
    if series.value.size < LEAST_VALUES:
        return Refused(
            Words(
                f"{series.value.size} values; groups are compared from {LEAST_VALUES} on",
                f"仅有 {series.value.size} 个数值，分组比较至少需要 {LEAST_VALUES} 个",
            )
        )
    found, left_out = _groups(series, groups)
    unit = _codes(series.unit)[1]
    differences, models = [], {}
    for group in found:
        confounded = _confounded(group, found)
        others = [each for each in found if each is not group and each.name not in confounded]
        names = (group.name, *sorted(each.name for each in others))
        key = frozenset(names)
        if key not in models:
            models[key] = _Fit.of(series.value, [group, *others], unit)
        fit = models[key]
        if not fit.has_freedom:
            left_out.append(
                Words(
                    f"{group.name}: too few values for its {len(group.levels)} levels", f"{_zh(group.name)}：数据不足"
                )
            )
            continue
        differences += [each._replace(confounded=confounded) for each in _differences(group, fit, series)]
    adjusted = holm([each.effect.chance for each in differences])
    differences = [each._replace(adjusted=p) for each, p in zip(differences, adjusted, strict=True)]
    pairs = [pair for group in found for pair in _pairs(group, series)]
    return Comparison(tuple(differences), tuple(pairs), _components(series.value, found, unit), tuple(left_out))


class _Fit(NamedTuple):
    model: MixedModel
    first: dict[str, int]
    """At which column each group begins."""

    @classmethod
    def of(cls, values: FloatArray, groups: list[_Group], unit: IntArray) -> "_Fit":
        first, at = {}, 1
        for group in groups:
            first[group.name] = at
            at += group.columns.shape[1]
        fixed = np.column_stack([np.ones(values.size), *(group.columns for group in groups)])
        return cls(MixedModel(values, fixed, unit), first)

    @property
    def has_freedom(self) -> bool:
        n, columns = self.model.fixed.shape
        return bool(n - columns >= 3 and int(self.model.unit.max()) + 1 >= 2)


def _codes(levels: list[str]) -> tuple[list[str], IntArray]:
    names, code = np.unique(np.array(levels), return_inverse=True)
    return [str(each) for each in names], code.astype(np.int64)


def _groups(series: Series, names: tuple[str, ...]) -> tuple[list[_Group], list[Words]]:
    found, left_out = [], []
    for name in names:
        levels, code = _codes(series.groups[name])
        counts = np.bincount(code)
        few = [level for level, count in zip(levels, counts, strict=True) if count < LEAST_PER_LEVEL]
        if len(levels) < 2:
            continue
        if len(levels) - len(few) < 2 or len(levels) > _MOST_LEVELS:
            left_out.append(
                Words(
                    f"{name}: {len(levels)} levels, {len(few)} of them with a single value",
                    f"{_zh(name)}：{len(levels)} 个水平，其中 {len(few)} 个仅有 1 个数值",
                )
            )
            continue
        found.append(_Group(name, levels, code, (code[:, None] == np.arange(1, len(levels))).astype(np.float64)))
    return found, left_out


def _zh(name: str) -> str:
    return {"station": "测试站", "fixture": "夹具", "lot": "批次"}.get(name, name)


def _rank(groups: list[_Group], values: int) -> int:
    columns = [np.ones((values, 1)), *(group.columns for group in groups)]
    joined = np.column_stack(columns)
    return int(np.linalg.matrix_rank(joined.T @ joined))


def _confounded(group: _Group, groups: list[_Group]) -> tuple[str, ...]:
    """Which other groups must be left out for all levels of this one to be estimable."""
    others = [each for each in groups if each is not group]
    n = group.code.size
    own = len(group.levels) - 1
    alone = [each for each in others if _rank([each, group], n) < len(each.levels) + own]
    rest = [each for each in others if each not in alone] if alone else others
    if _rank([*rest, group], n) - _rank(rest, n) == own and _rank(rest, n) == 1 + sum(len(e.levels) - 1 for e in rest):
        return tuple(each.name for each in others if each not in rest)
    return tuple(each.name for each in others)


def _differences(group: _Group, fit: _Fit, series: Series) -> list[Difference]:
    k = len(group.levels)
    first = fit.first[group.name]
    contrasts = np.zeros((1 if k == 2 else k, fit.model.fixed.shape[1]))
    own = contrasts[:, first : first + k - 1]
    if k == 2:
        own[0, 0] = 1.0
    else:
        # the first level has no column: its own contrast is minus the mean of the others
        own[:] = -1 / (k - 1)
        own[np.arange(1, k), np.arange(k - 1)] = 1.0
    units: defaultdict[str, set[str]] = defaultdict(set)
    for level, unit in zip(series.groups[group.name], series.unit, strict=True):
        units[level].add(unit)
    levels = group.levels[1:] if k == 2 else group.levels
    against = group.levels[0] if k == 2 else ""
    return [
        Difference(group.name, level, against, effect, 1.0, (), len(units[level]))
        for level, effect in zip(levels, fit.model.effects(contrasts), strict=True)
    ]


def _pairs(group: _Group, series: Series) -> list[Pairs]:
    """Of each two levels, over the units measured on both; units count once, with their means there."""
    sums: defaultdict[tuple[str, str], list[float]] = defaultdict(list)
    for level, unit, value in zip(series.groups[group.name], series.unit, series.value, strict=True):
        sums[level, unit].append(float(value))
    by_level: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for (level, unit), values in sums.items():
        by_level[level][unit] = float(np.mean(values))
    found = []
    for one, two in combinations(group.levels, 2):
        both = sorted(by_level[one].keys() & by_level[two].keys())
        if len(both) >= LEAST_PAIRS:
            differences = np.array([by_level[two][unit] - by_level[one][unit] for unit in both])
            found.append(Pairs(group.name, two, one, len(both), paired_difference(differences)))
    return found


def _components(values: FloatArray, groups: list[_Group], unit: IntArray) -> dict[str, Deviation]:
    """Of units and measurements beside all groups as they are; of each group as a random effect by itself."""
    model = MixedModel(values, np.ones((values.size, 1)), unit)
    found = {}
    for group in groups:
        random = (group.code[:, None] == np.arange(len(group.levels))).astype(np.float64)
        parts = MixedModel(values, np.ones((values.size, 1)), unit, random).deviations()
        found[group.name] = parts["random"]
        if group is groups[0]:
            found |= {name: each for name, each in parts.items() if name != "random"}
    return found if groups else model.deviations()
