"""Differences between stations, fixtures and lots and what they are confounded with."""

from collections import defaultdict
from itertools import combinations
from typing import NamedTuple

import numpy as np

from analytics.trends.groups.contrasts import ContrastEstimate, holm, paired_difference
from analytics.trends.groups.mixed_model import MixedModel
from analytics.trends.series import GROUPS, MetricSeries
from analytics.trends.words import NotComputed, Words, group_name, not_computed, words
from stream.batch import FloatArray, IntArray

LEAST_VALUES = 8
LEAST_PER_LEVEL = 2
LEAST_PAIRS = 3
_MOST_LEVELS = 200
_DEPENDENT = 1e-9


class Difference(NamedTuple):
    """Difference of one level of a group from the others."""

    # group, level, against: as ``station``, ``B``, ``A``; `against` is empty for the mean of all other levels
    group: str
    level: str
    against: str
    effect: ContrastEstimate  # level - against, in the unit of the values
    adjusted: float  # probability of such a difference by chance, adjusted for all that were tested
    confounded: tuple[str, ...]  # groups whose effects cannot be separated from this one
    units: int  # units that were measured there
    on_both: int  # of these, units that were also measured at what it is compared with


class Pairs(NamedTuple):
    """The difference of two levels on the units that were measured on both."""

    group: str
    level: str
    against: str
    units: int
    effect: ContrastEstimate


class GroupComparison(NamedTuple):
    """Differences of all groups with more than one level, pairs of levels with common units, and groups left out."""

    differences: tuple[Difference, ...]
    pairs: tuple[Pairs, ...]
    left_out: tuple[Words, ...]


class _Group(NamedTuple):
    name: str
    levels: list[str]
    code: IntArray
    columns: FloatArray  # indicators of all levels but the first


def compare_groups(
    series: MetricSeries, groups: tuple[str, ...] = GROUPS, *, beside: FloatArray | None = None
) -> GroupComparison | NotComputed:
    """Compare the levels of groups, units being a random effect.

    Repeated values separate the scatter of units from that of measurements; groups with one level are skipped.
    One linear mixed model for all: value = level of station + of fixture + of lot + unit + residual. Measurements of
    one unit on several stations and of different units are both used, each with its weight. A group whose columns
    depend on those of others is compared without them, and reported as confounded with them. With two levels the second
    is compared with the first, with more each against the mean of the others. `beside`: columns of shape (n, columns)
    of what else is known to act, as a fixture that drifts.
    """
    if series.value.size < LEAST_VALUES:
        return not_computed("groups_short", values=series.value.size, least=LEAST_VALUES)
    found, left_out = _groups(series, groups)
    unit = codes(series.unit)[1]
    differences = []
    for group in found:
        confounded = _confounded(group, found)
        others = [each for each in found if each is not group and each.name not in confounded]
        known = [] if beside is None else [beside]
        columns = [np.ones(series.value.size), *(each.columns for each in (group, *others)), *known]
        fixed = np.column_stack(columns)
        model = MixedModel(series.value, fixed[:, independent(fixed)], unit)
        if model.y.size - model.fixed.shape[1] < 3 or unit.max() < 1:
            left_out.append(words("group_short", group=group_name(group.name), levels=len(group.levels)))
            continue
        differences += _differences(group, model, series, confounded)
    adjusted = holm([each.effect.chance for each in differences])
    differences = [each._replace(adjusted=p) for each, p in zip(differences, adjusted, strict=True)]
    pairs = [pair for group in found for pair in _pairs(group, series)]
    return GroupComparison(tuple(differences), tuple(pairs), tuple(left_out))


def product_columns(series: MetricSeries) -> FloatArray:
    """Indicators of all products but the first, of shape (values, products - 1)."""
    levels, code = codes(series.groups["product"])
    return np.asarray(code[:, None] == np.arange(1, len(levels)), np.float64)


def codes(levels: list[str]) -> tuple[list[str], IntArray]:
    """Names of levels in order, and which of them each is."""
    names, code = np.unique(np.array(levels), return_inverse=True)
    return [str(each) for each in names], code.astype(np.int64)


def _groups(series: MetricSeries, names: tuple[str, ...]) -> tuple[list[_Group], list[Words]]:
    found, left_out = [], []
    for name in names:
        levels, code = codes(series.groups[name])
        few = int((np.bincount(code) < LEAST_PER_LEVEL).sum())
        if len(levels) < 2:
            continue
        if len(levels) - few < 2 or len(levels) > _MOST_LEVELS:
            left_out.append(words("group_single", group=group_name(name), levels=len(levels), few=few))
            continue
        found.append(_Group(name, levels, code, (code[:, None] == np.arange(1, len(levels))).astype(np.float64)))
    return found, left_out


def independent(columns: FloatArray) -> list[int]:
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
    return [at for at in independent(columns) if at >= first] == list(range(first, columns.shape[1]))


def _confounded(group: _Group, groups: list[_Group]) -> tuple[str, ...]:
    """Other groups that must be left out for all levels of this one to be estimable."""
    others = [each for each in groups if each is not group]
    if _is_estimable(group, others):
        return ()
    alone = [each for each in others if not _is_estimable(group, [each])]
    rest = [each for each in others if each not in alone]
    left_out = alone if alone and _is_estimable(group, rest) else others
    return tuple(each.name for each in left_out)


def _differences(group: _Group, model: MixedModel, series: MetricSeries, beside: tuple[str, ...]) -> list[Difference]:
    k = len(group.levels)
    contrasts = np.zeros((1 if k == 2 else k, model.fixed.shape[1]))
    own = contrasts[:, 1:k]
    if k == 2:
        own[0, 0] = 1.0
    else:
        # the first level has no column: its own contrast is minus the mean of the others
        own[:] = -1 / (k - 1)
        own[np.arange(1, k), np.arange(k - 1)] = 1.0
    there: defaultdict[str, set[str]] = defaultdict(set)
    for level, serial in zip(series.groups[group.name], series.serial, strict=True):
        there[level].add(serial)
    levels, against = (group.levels[1:], group.levels[0]) if k == 2 else (group.levels, "")
    return [
        Difference(
            group.name, level, against, effect, 1.0, beside, len(there[level]),
            len(there[level] & set().union(*(units for other, units in there.items() if other != level))),
        )
        for level, effect in zip(levels, model.effects(contrasts), strict=True)
    ]  # fmt: skip


def _pairs(group: _Group, series: MetricSeries) -> list[Pairs]:
    """Differences of each two levels over the units measured on both, each by its mean there.

    Several signals of a unit, as its axes, count once: by the mean of their differences.
    """
    import polars as pl

    names = {"level": series.groups[group.name], "serial": series.serial, "unit": series.unit}
    frame = pl.DataFrame(names | {"value": series.value})
    means = frame.group_by("level", "serial", "unit", maintain_order=True).agg(pl.col("value").mean())
    found = []
    for one, two in combinations(group.levels, 2):
        of_one, of_two = (means.filter(level=level).select("serial", "unit", "value") for level in (one, two))
        both = of_one.join(of_two, on=("serial", "unit"), suffix="_two")
        both = both.group_by("serial").agg((pl.col("value_two") - pl.col("value")).mean()).sort("serial")
        if both.height >= LEAST_PAIRS:
            differences = both["value_two"].to_numpy()
            found.append(Pairs(group.name, two, one, both.height, paired_difference(differences)))
    return found
