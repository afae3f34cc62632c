"""Components of variance: the scatter of units, of measurements, and between the levels of groups."""

import numpy as np

from analytics.trends.groups.between_stations import LEAST_VALUES, codes, independent, product_columns
from analytics.trends.groups.contrasts import do_not_scatter
from analytics.trends.groups.mixed_model import ComponentDeviation, MixedModel
from analytics.trends.groups.nested_units import coinciding
from analytics.trends.series import MetricSeries

_MOST_LEVELS = 60
_MOST_FIXED_LEVELS = 200
_LEAST_FREEDOM = 3


def components(series: MetricSeries, groups: tuple[str, ...]) -> dict[str, ComponentDeviation]:
    """Standard deviations of all parts of a series, with 95 % bounds by their profile likelihoods.

    One model of all: value = product + unit + a random effect for each group with two levels or more + residual. So no
    part has what another one does. `unit`: between units; `residual`: between measurements of a unit, the groups
    removed; and each group: between its levels. A group of 61 to 200 levels is removed as well, and has no part. Where
    no unit was measured twice `residual` is that and `unit` in one. A group with a level for each unit has no part:
    that of units has it. Parts that the values do not separate, as of a lot
    and a station that always go together, have bounds down to 0; those without an upper bound, as of stations each with
    a product of its own, are left out. Empty where there are too few values or units, or where measurements scatter by
    less than a thousandth of what groups do to them, which cannot be computed beside it.
    """
    unit = codes(series.unit)[1]
    if series.value.size < LEAST_VALUES or unit.max() < 1:
        return {}
    columns = [np.ones((series.value.size, 1)), product_columns(series)]
    random, same = {}, coinciding(series, groups)
    for name in groups:
        if name in same:
            continue
        levels, code = codes(series.groups[name])
        if not 1 < len(levels) <= _MOST_FIXED_LEVELS:
            continue
        indicators = np.eye(len(levels))[code]
        if len(levels) <= _MOST_LEVELS:
            random[name] = indicators
        else:
            columns.append(indicators)
    fixed = np.column_stack(columns)
    fixed = fixed[:, independent(fixed)]
    is_short = series.value.size - fixed.shape[1] < _LEAST_FREEDOM
    if is_short or do_not_scatter(series.value, np.column_stack([fixed, *random.values()]), unit, nearly=True):
        return {}
    found = MixedModel(series.value, fixed, unit, random).deviations()
    return {name: each for name, each in found.items() if np.isfinite(each.hi)}
