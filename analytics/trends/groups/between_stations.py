"""Differences between stations, fixtures and lots and what they are confounded with."""

from typing import NamedTuple

import numpy as np

from analytics.specifications.verdicts import UNGIVEN
from analytics.trends.groups.contrasts import ContrastEstimate, do_not_scatter, holm, paired_difference
from analytics.trends.groups.nested_units import alone, effects_of_levels, units_of_levels, units_of_several
from analytics.trends.series import GROUPS, MetricSeries
from analytics.trends.words import NotComputed, Words, group_name, listed, not_computed, words
from stream.batch import FloatArray, IntArray

LEAST_VALUES = 8
LEAST_PER_LEVEL = 2
LEAST_PAIRS = 3
_MOST_LEVELS = 200
_DEPENDENT = 1e-9


class Difference(NamedTuple):
    """Difference of one level of a group from the others."""

    # group, level, against: as ``station``, ``B``, ``A``; `against` is empty for the weighted mean of other levels
    group: str
    level: str
    against: str
    effect: ContrastEstimate  # level - against, in the unit of the values
    adjusted: float  # probability of such a difference by chance, adjusted for all that were tested
    confounded: tuple[str, ...]  # groups whose effects cannot be separated from this one
    units: int  # units that were measured there
    on_both: int  # of these, units that were also measured at what it is compared with
    elsewhere: int  # units that were measured at what it is compared with


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
    levels: list[str]  # that are compared
    at: IntArray  # values there, by their indices in the series
    # shape (levels, levels); weight of each other level in what a level is compared with: its units of common products
    weights: FloatArray


def compare_groups(
    series: MetricSeries, groups: tuple[str, ...] = GROUPS, *, beside: FloatArray | None = None
) -> GroupComparison | NotComputed:
    """Compare the levels of groups within each product, units being a random effect.

    Repeated values separate the scatter of units from that of measurements; groups with one level are skipped.
    One linear mixed model for all: value = product + level of station + of fixture + of lot + unit + residual.
    Measurements of one unit on several stations and of different units are both used, each with its weight. A group
    whose columns depend on those of others is compared without them, and reported as confounded with them. A level is
    compared with the mean, weighted by units, of the other levels that have values of a product of its own; of two
    levels the second with the first. Levels without a name, with a single value of a product, with one unit that was
    measured at no other, or of a product that no other level has, are not compared, and their values are no part of
    the model. Intervals count the scatter between units where these are of one level each. `beside`: columns of shape
    (n, columns) of what else is known to act, as a fixture that drifts.
    """
    if series.value.size < LEAST_VALUES:
        return not_computed("groups_short", values=series.value.size, least=LEAST_VALUES)
    few = [name for name in groups if len(set(series.groups[name])) <= _MOST_LEVELS]
    every = np.column_stack([product_columns(series), *(_columns(series, name) for name in few)])
    if do_not_scatter(series.value, every, codes(series.unit)[1]):
        return not_computed("groups_exact")
    found, left_out = _groups(series, groups)
    differences = []
    for group in found:
        own = series.where(group.at)
        others = {each.name: _columns(own, each.name) for each in found if each is not group}
        contrasts = _contrasts(group.weights)
        always = [_columns(own, group.name), product_columns(own)]
        confounded = _confounded(contrasts, always, others)
        known = [] if beside is None else [beside[group.at]]
        columns = [*always, *(each for name, each in others.items() if name not in confounded), *known]
        fixed = np.column_stack([np.ones(own.value.size), *columns])
        fixed, unit, serial = fixed[:, independent(fixed)], codes(own.unit)[1], codes(own.serial)[1]
        if own.value.size - fixed.shape[1] < 3 or unit.max() < 1:
            left_out.append(words("group_short", group=group_name(group.name), levels=len(group.levels)))
            continue
        coefficients = np.zeros((len(contrasts), fixed.shape[1]))
        coefficients[:, 1 : len(group.levels)] = contrasts[:, 1:]  # the first level has no column
        effects = effects_of_levels(own.value, fixed, unit, serial, coefficients)
        if effects is None:
            left_out.append(words("group_units_short", group=group_name(group.name)))
            continue
        differences += _differences(group, contrasts, effects, own, confounded)
    adjusted = holm([each.effect.chance for each in differences])
    differences = [each._replace(adjusted=p) for each, p in zip(differences, adjusted, strict=True)]
    pairs = [pair for group in found for pair in _pairs(group, series)]
    return GroupComparison(tuple(differences), tuple(pairs), tuple(left_out))


def product_columns(series: MetricSeries) -> FloatArray:
    """Indicators of all products but the first, of shape (values, products - 1)."""
    return _columns(series, "product")


def _columns(series: MetricSeries, group: str) -> FloatArray:
    levels, code = codes(series.groups[group])
    return np.asarray(code[:, None] == np.arange(1, len(levels)), np.float64)


def codes(levels: list[str]) -> tuple[list[str], IntArray]:
    """Names of levels in order, and which of them each is."""
    names, code = np.unique(np.array(levels), return_inverse=True)
    return [str(each) for each in names], code.astype(np.int64)


def _groups(series: MetricSeries, names: tuple[str, ...]) -> tuple[list[_Group], list[Words]]:
    found, left_out = [], []
    for name in names:
        levels, code = codes(series.groups[name])
        if len(levels) < 2:
            continue
        if len(levels) > _MOST_LEVELS:
            left_out.append(words("group_many", group=group_name(name), levels=len(levels), most=_MOST_LEVELS))
            continue
        weights = _weights(series, name)
        compared = np.flatnonzero(weights.any(axis=1))
        single = [each for each in alone(series, name) if each != UNGIVEN]
        if len(single) == len(levels):
            left_out.append(words("group_of_units", group=group_name(name)))
            continue
        if single:
            left_out.append(words("levels_of_units", group=group_name(name), names=listed(single)))
        if not compared.size:
            few = int((np.bincount(code) < LEAST_PER_LEVEL).sum())
            left_out.append(words("group_single", group=group_name(name), levels=len(levels), few=few))
            continue
        at = np.flatnonzero(np.isin(code, compared))
        found.append(_Group(name, [levels[each] for each in compared], at, weights[np.ix_(compared, compared)]))
        if others := [each for number, each in enumerate(levels) if number not in compared and each not in single]:
            left_out.append(words("levels_left_out", group=group_name(name), names=listed(others)))
    return found, left_out


def _weights(series: MetricSeries, group: str) -> FloatArray:
    """Of each level in the mean with which another is compared, of shape (levels, levels); 0 where they are not."""
    levels, code = codes(series.groups[group])
    products, product = codes(series.groups["product"])
    values, units, shared = np.zeros((3, len(products), len(levels)))
    np.add.at(values, (product, code), 1.0)
    several = units_of_several(units_of_levels(series, group))
    for of_product, of_level, serial in set(zip(product.tolist(), code.tolist(), series.serial, strict=True)):
        units[of_product, of_level] += 1.0
        shared[of_product, of_level] += serial in several
    is_enough = (values >= LEAST_PER_LEVEL) & (np.array(levels) != UNGIVEN) & ((units > 1) | (shared > 0))
    weights = is_enough.T.astype(np.float64) @ (is_enough * units)
    np.fill_diagonal(weights, 0.0)
    return np.asarray(weights, np.float64)


def _contrasts(weights: FloatArray) -> FloatArray:
    """Each level less the mean of those it is compared with; of two that are compared with each other alone, one."""
    linked = weights > 0
    only = [int(others.argmax()) if others.sum() == 1 else -1 for others in linked]
    kept = [at for at, other in enumerate(only) if not (other > at and only[other] == at)]
    return np.asarray((np.eye(len(weights)) - weights / weights.sum(axis=1)[:, None])[kept], np.float64)


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


def _is_estimable(contrasts: FloatArray, columns: list[FloatArray]) -> bool:
    """Whether differences of levels, whose columns are the first, are determined beside all other columns."""
    whole = np.column_stack([np.ones(len(columns[0])), *columns])
    wanted = np.zeros((len(contrasts), whole.shape[1]))
    wanted[:, 1 : contrasts.shape[1]] = contrasts[:, 1:]
    size = np.sqrt((whole**2).sum(axis=0))
    values, vectors = np.linalg.eigh((whole / size).T @ (whole / size))
    free = vectors[:, values < _DEPENDENT * values[-1]]
    return bool(np.allclose(wanted / size @ free, 0.0, atol=1e-6 / size[1 : contrasts.shape[1]].max()))


def _confounded(contrasts: FloatArray, always: list[FloatArray], groups: dict[str, FloatArray]) -> tuple[str, ...]:
    """Other groups that must be left out for all differences to be determined."""
    if _is_estimable(contrasts, [*always, *groups.values()]):
        return ()
    alone = [name for name, each in groups.items() if not _is_estimable(contrasts, [*always, each])]
    rest = [each for name, each in groups.items() if name not in alone]
    return tuple(alone if alone and _is_estimable(contrasts, [*always, *rest]) else groups)


def _differences(
    group: _Group, contrasts: FloatArray, effects: list[ContrastEstimate], series: MetricSeries, beside: tuple[str, ...]
) -> list[Difference]:
    there = units_of_levels(series, group.name)
    found = []
    for contrast, effect in zip(contrasts, effects, strict=True):
        level = group.levels[int(contrast.argmax())]
        others = [group.levels[at] for at in np.flatnonzero(contrast < 0)]
        elsewhere = set[str]().union(*(there[each] for each in others))
        against, counts = others[0] if len(others) == 1 else "", (len(there[level] & elsewhere), len(elsewhere))
        found.append(Difference(group.name, level, against, effect, 1.0, beside, len(there[level]), *counts))
    return found


def _pairs(group: _Group, series: MetricSeries) -> list[Pairs]:
    """Differences of each two levels over the units measured on both, each by its mean there.

    Several signals of a unit, as its axes, count once: by the mean of their differences.
    """
    import polars as pl

    names = {"level": series.groups[group.name], "serial": series.serial, "unit": series.unit}
    frame = pl.DataFrame(names | {"value": series.value})
    means = frame.group_by("level", "serial", "unit", maintain_order=True).agg(pl.col("value").mean())
    means = means.filter(pl.col("level").is_in(group.levels))
    found = []
    for one in group.levels:
        both = means.filter(level=one).join(
            means.filter(pl.col("level") > one), on=("serial", "unit"), suffix="_two", maintain_order="left_right"
        )
        difference = (pl.col("value_two") - pl.col("value")).mean()
        both = both.group_by("level_two", "serial", maintain_order=True).agg(difference).sort("level_two", "serial")
        for (two,), those in both.group_by("level_two", maintain_order=True):
            if those.height >= LEAST_PAIRS:
                differences = those["value_two"].to_numpy()
                found.append(Pairs(group.name, str(two), one, those.height, paired_difference(differences)))
    return found
