"""How far off a clock would have to be to look like an effect, and how far clocks are off."""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.result import ConfoundedEffect, FoundEffect

_CONFIDENCE = 1.96


class _Bound(NamedTuple):
    """A clock's error: the declared term whose coefficient it is seen through, and the most it is, in which unit."""

    term: str
    most: float
    unit_of_measure: str


_BOUNDS = {
    "temperature_time_offset": _Bound("temperature", 120.0, "s"),
    "rate_time_offset": _Bound("scale_factor", 120.0, "s"),
    "temperature_clock_rate": _Bound("temperature", 3.6, "s/h"),
    "rate_clock_rate": _Bound("scale_factor", 3.6, "s/h"),
}
"""A clock that nobody has set for months is two minutes off; a poor quartz gains 0.1 %."""


def with_bounds(found: Sequence[FoundEffect], declared: ErrorModel) -> tuple[FoundEffect, ...]:
    """Return findings whose confounded clock errors say how large they would be; those that can be come first."""
    bounded = []
    for each in found:
        others = [_bounded(other, declared) for other in each.confounded]
        others.sort(key=lambda other: not other.is_plausible)
        bounded.append(msgspec.structs.replace(each, confounded=tuple(others)))
    return tuple(bounded)


def _bounded(other: ConfoundedEffect, declared: ErrorModel) -> ConfoundedEffect:
    bound, labels = _BOUNDS.get(other.name), declared.labels()
    if bound is None or other.coefficient is None or bound.term not in labels:
        return other
    at = labels.index(bound.term)
    error = float(np.sqrt(declared.covariance[at][at])) if declared.covariance else 0.0
    sensitivity = abs(declared.coefficients[at]) + _CONFIDENCE * error
    if sensitivity == 0.0:
        return other
    return msgspec.structs.replace(
        other, implied=abs(other.coefficient) / sensitivity, most=bound.most, implied_unit=bound.unit_of_measure
    )
