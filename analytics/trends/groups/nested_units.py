"""Levels in which units are nested: what differs between such levels scatters as units do, not as values do."""

import numpy as np

from analytics.trends.groups.contrasts import ContrastEstimate, estimate, less_block_means, ols_estimates
from analytics.trends.groups.mixed_model import MixedModel
from analytics.trends.series import MetricSeries
from stream.batch import BoolArray, FloatArray, IntArray

_DEPENDENT = 1e-9
_LEAST_FREEDOM = 3


def effects_of_levels(
    y: FloatArray, fixed: FloatArray, unit: IntArray, serial: IntArray, contrasts: FloatArray
) -> list[ContrastEstimate] | None:
    """Values of contrasts of levels with intervals that count the scatter between units.

    What units that were measured at several levels determine comes from the mixed model, with `unit` as a random
    effect. What they do not, as where each unit is of one level, comes from the mean of each `serial`, weighted by the
    components of variance: its scatter is that from unit to unit, with as many degrees of freedom as there are units
    beyond the columns. So a variance of units that few units estimate as 0 makes no interval short. Where means of
    units alone do not determine a contrast, the mixed model does, with no more degrees of freedom than that. None
    where no unit is left to show that scatter.
    """
    model = MixedModel(y, fixed, unit)
    is_within = _determined(less_block_means(fixed, serial), contrasts)
    if is_within.all():
        return model.effects(contrasts)
    counts = np.bincount(serial)
    means = np.array([np.bincount(serial, column) / counts for column in np.column_stack([fixed, y - y.mean()]).T]).T
    of_means = MixedModel(y, fixed, serial) if serial.max() < unit.max() else model
    ratio = of_means.variance_ratio() if counts.max() > 1 else 0.0
    weighted = means / np.sqrt(ratio + 1 / counts)[:, None]
    between = ols_estimates(weighted[:, -1], weighted[:, :-1], contrasts, blocks=0)
    freedom = counts.size - int(np.linalg.matrix_rank(weighted[:, :-1]))
    if freedom < 1:
        return None
    found = []
    for whole, of_units, is_own in zip(model.effects(contrasts), between, is_within, strict=True):
        capped = estimate(whole.value, whole.standard_uncertainty, min(whole.freedom, float(freedom)))
        found.append(whole if is_own else of_units or capped)
    return found


def _determined(columns: FloatArray, contrasts: FloatArray) -> BoolArray:
    """Which contrasts columns determine."""
    normal = columns.T @ columns
    back = contrasts @ np.linalg.pinv(normal, rcond=_DEPENDENT, hermitian=True) @ normal
    return np.asarray(np.isclose(back, contrasts, atol=1e-6).all(axis=1), np.bool_)


def units_of_levels(series: MetricSeries, group: str) -> dict[str, set[str]]:
    """Units that were measured at each level."""
    there: dict[str, set[str]] = {}
    for level, serial in zip(series.groups[group], series.serial, strict=True):
        there.setdefault(level, set()).add(serial)
    return there


def units_of_several(there: dict[str, set[str]]) -> set[str]:
    """Units that were measured at more than one level."""
    seen, several = set[str](), set[str]()
    for units in there.values():
        several |= seen & units
        seen |= units
    return several


def alone(series: MetricSeries, group: str) -> list[str]:
    """Levels that hold one unit, which was measured at no other: level and unit cannot be separated."""
    there = units_of_levels(series, group)
    several = units_of_several(there)
    return [level for level, units in sorted(there.items()) if len(units) == 1 and not units & several]


def coinciding(series: MetricSeries, groups: tuple[str, ...]) -> list[str]:
    """Groups with a level for each unit, or for all but a few: nothing separates them from the units."""
    found = []
    for name in groups:
        there = units_of_levels(series, name)
        units = set().union(*there.values())
        if len(there) > 1 and not units_of_several(there) and len(units) - len(there) < _LEAST_FREEDOM:
            found.append(name)
    return found
