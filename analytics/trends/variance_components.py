"""How far values scatter from unit to unit, from station to station, and from one measurement of a unit to the next."""

import numpy as np

from analytics.trends.mixed_model import Deviation, MixedModel
from analytics.trends.series import Series

LEAST_VALUES = 8
_MOST_LEVELS = 60


def components(series: Series, groups: tuple[str, ...]) -> dict[str, Deviation]:
    """Standard deviations of all parts of a series, with 95 % limits by their profile likelihoods.

    Parameters
    ----------
    series: All values, repeated ones too.
    groups: Groups with two levels or more are a random effect each, one at a time.

    Returns
    -------
    dict
        `unit`: from unit to unit; `residual`: from one measurement of a unit to the next, the first group taken out;
        and each group: from level to level. Where no unit was measured twice `residual` is that and `unit` in one.
        Empty where there are too few values or units.
    """
    unit = np.unique(np.array(series.unit), return_inverse=True)[1].astype(np.int64)
    if series.value.size < LEAST_VALUES or unit.max() < 1 or not np.ptp(series.value) > 0:
        return {}
    ones = np.ones((series.value.size, 1))
    found: dict[str, Deviation] = {}
    for name in groups:
        levels, code = np.unique(np.array(series.groups[name]), return_inverse=True)
        if not 1 < levels.size <= _MOST_LEVELS:
            continue
        model = MixedModel(series.value, ones, unit, np.eye(levels.size)[code])
        if not found:
            parts = model.deviations()
            found |= {part: each for part, each in parts.items() if part != "random"} | {name: parts["random"]}
        else:
            found[name] = model.deviation("random")
    return found or MixedModel(series.value, ones, unit).deviations()
