"""Alternatives of a finding: the causes that a proxy follows, and the size that a clock error would need."""

from collections.abc import Collection, Sequence

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Role
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.result.finding import ConfoundedEffect, FoundEffect

_CONFIDENCE = 1.96
_CLOCK_BOUNDS = {
    "temperature_time_offset": ("temperature", 120.0, "s"),
    "rate_time_offset": ("scale_factor", 120.0, "s"),
    "temperature_clock_rate": ("temperature", 3.6, "s/h"),
    "rate_clock_rate": ("scale_factor", 3.6, "s/h"),
}
"""By clock error: the declared term that it acts through, and its largest plausible size.

A clock not set for months is two minutes off; a poor quartz gains 0.1 %."""


def unfitted(cause: Effect, *, recorded: bool, evidence_behind: float | None = None) -> ConfoundedEffect:
    """A cause that was not fitted, as an alternative."""
    return ConfoundedEffect(
        name=cause.name,
        parameters={},
        evidence_behind=evidence_behind,
        role=cause.role.value,
        separating_test=cause.separating_test,
        separating_test_zh=cause.separating_test_zh,
        recorded=recorded,
    )


def with_causes(found: FoundEffect, runs: Sequence[RunBlocks], declared: Collection[str]) -> FoundEffect:
    """A finding; that of a proxy with the causes that it follows and that the model does not declare."""
    own = effect(found.name)
    if own.role is not Role.PROXY:
        return found
    known = {found.name, *(each.name for each in found.confounded), *declared}
    causes = [effect(name) for name in own.follows if name not in known]
    added = (
        unfitted(each, recorded=all(channel in run.channels for channel in each.needs for run in runs))
        for each in causes
    )
    return msgspec.structs.replace(found, confounded=(*found.confounded, *added))


def with_clock_bounds(found: FoundEffect, declared: ErrorModel) -> FoundEffect:
    """A finding with the size that confounded clock errors would need; the plausible alternatives first."""
    others = [_bounded(other, declared) for other in found.confounded]
    return msgspec.structs.replace(found, confounded=tuple(sorted(others, key=lambda other: not other.is_plausible)))


def _bounded(other: ConfoundedEffect, declared: ErrorModel) -> ConfoundedEffect:
    if other.name not in _CLOCK_BOUNDS or other.coefficient is None:
        return other
    term, most, unit = _CLOCK_BOUNDS[other.name]
    labels = declared.labels()
    if term not in labels:
        return other
    at = labels.index(term)
    error = float(np.sqrt(declared.covariance[at][at])) if declared.covariance else 0.0
    sensitivity = abs(declared.coefficients[at]) + _CONFIDENCE * error
    if sensitivity == 0.0:
        return other
    return msgspec.structs.replace(other, implied=abs(other.coefficient) / sensitivity, most=most, implied_unit=unit)
