"""Limits of quantities that are the better the nearer they are to 0, whatever their sign."""

import msgspec

from analytics.metric_registry.registry import metrics
from storage.specifications.specification import SpecificationLimit


def is_nearer_zero(metric: str) -> bool:
    """Whether values of a metric have either sign and are the better the nearer they are to 0.

    >>> is_nearer_zero("bias_acceleration_sensitivity"), is_nearer_zero("angle_random_walk")
    (True, False)
    """
    return metric in metrics() and metrics()[metric].header.better == "nearer_zero"


def as_judged(limit: SpecificationLimit) -> SpecificationLimit:
    """A limit as values are judged by it: `upper` alone limits the magnitude of what is best at 0.

    >>> limit = SpecificationLimit(metric="bias_acceleration_sensitivity", upper=1.0, unit_of_measure="deg/h/g")
    >>> as_judged(limit).lower, as_judged(limit).upper
    (-1.0, 1.0)
    """
    if limit.upper is None or limit.lower is not None or not is_nearer_zero(limit.metric):
        return limit
    return msgspec.structs.replace(limit, lower=0.0 - abs(limit.upper))
