"""Whether stations, fixtures or lots differ, by how much, and whether that can be told from what goes with them."""

from collections import defaultdict
from itertools import combinations
from typing import NamedTuple

import numpy as np

from analytics.trends.mixed_model import Effect, MixedModel, holm, paired_difference
from analytics.trends.series import GROUPS, Series
from analytics.trends.words import Refused, Words
from stream.batch import FloatArray, IntArray

LEAST_VALUES = 8
LEAST_PER_LEVEL = 2
LEAST_PAIRS = 3
_MOST_LEVELS = 200
_DEPENDENT = 1e-9


class Difference(NamedTuple):
    """By how much one level of a group lies from the others.

    Parameters
    ----------
    group, level, against: As ``station``, ``B``, ``A``; `against` is empty where it is the mean of all other levels.
    effect: level - against, in the unit of the values.
    adjusted: Probability of so large a difference by chance, adjusted for all differences looked at.
    confounded: Groups that cannot be told apart from this one.
    units: Units that were measured there.
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
    differences: Of all groups with more than one level.
    pairs: Of levels with units in common.
    left_out: Groups that were not compared, and why.
    """

    differences: tuple[Difference, ...]
    pairs: tuple[Pairs, ...]
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
    series: All values, repeated ones too: they tell the scatter of units from that of measurements.
    groups: Which groups; those with one level only are passed over.

    Notes
    -----
    One linear mixed model for all: value = level of station + of fixture + of lot + unit + residual. What several
    stations saw of one unit and what they saw of different units are both used, each with its weight. A group whose
    columns depend on those of others is compared without them, and said to be confounded with them. With two levels the
    second is compared with the first, with more each against the mean of the others.
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
    differences = []
    for group in found:
        confounded = _confounded(group, found)
        others = [each for each in found if each is not group and each.name not in confounded]
        fit = _Fit.of(series.value, [group, *others], unit)
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
    return Comparison(tuple(differences), tuple(pairs), tuple(left_out))


class _Fit(NamedTuple):
    """The model of one group, whose columns come first after the constant, beside others."""

    model: MixedModel

    @classmethod
    def of(cls, values: FloatArray, groups: list[_Group], unit: IntArray) -> "_Fit":
        fixed = np.column_stack([np.ones(values.size), *(group.columns for group in groups)])
        return cls(MixedModel(values, fixed[:, _independent(fixed)], unit))

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


def _independent(columns: FloatArray) -> list[int]:
    """Columns that do not depend on those before them, by Gauss elimination in their cross products."""
    products = columns.T @ columns
    own = np.maximum(np.diag(products).copy(), 1e-300)
    kept = []
    for at in range(columns.shape[1]):
        if products[at, at] > _DEPENDENT * own[at]:
            kept.append(at)
            products = products - np.outer(products[:, at], products[at]) / products[at, at]
    return kept


def _is_estimable(group: _Group, others: list[_Group]) -> bool:
    ones = np.ones((group.code.size, 1))
    columns = np.column_stack([ones, *(each.columns for each in others), group.columns])
    first = int(columns.shape[1] - group.columns.shape[1])
    return [at for at in _independent(columns) if at >= first] == list(range(first, columns.shape[1]))


def _confounded(group: _Group, groups: list[_Group]) -> tuple[str, ...]:
    """Which other groups must be left out for all levels of this one to be estimable."""
    others = [each for each in groups if each is not group]
    if _is_estimable(group, others):
        return ()
    alone = [each for each in others if not _is_estimable(group, [each])]
    rest = [each for each in others if each not in alone]
    left_out = alone if alone and _is_estimable(group, rest) else others
    return tuple(each.name for each in left_out)


def _differences(group: _Group, fit: _Fit, series: Series) -> list[Difference]:
    k = len(group.levels)
    contrasts = np.zeros((1 if k == 2 else k, fit.model.fixed.shape[1]))
    own = contrasts[:, 1:k]
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
