"""What differs from run to run: turn-on scatter, or a cause that differs between the runs as well."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy import stats

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Kind, Role
from analytics.loop.effects.registry import effects
from analytics.loop.effects.turn_on import TURN_ON, TurnOnScatter
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.evidence import PRICE, one_degree
from analytics.loop.tracing.least_squares import fit
from analytics.loop.tracing.noise_floor import correlated_variance
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.result import Coefficient, ConfoundedEffect, FoundEffect
from stream.batch import FloatArray

FAR = 10.0
"""Scatter of the runs over what the noise within them leaves in their means, from which it is a finding."""
MOST_RUNS = 4
"""With more runs the search itself tells a cause from turn-on scatter."""
_EXPLAINED = 1 / 3
"""Part of the scatter that may be left where a cause explains it."""
_P_VALUE = 1e-3
_UNRECORDED = (
    ("temperature", ("temperature", "case_temperature")),
    ("gravity_i", ("gravity_i", "gravity_o", "gravity_s")),
)
"""Causes that differ between runs unless somebody held them, and the channels of which one would have told."""


@dataclass(frozen=True)
class RunScatter:
    """Means of the runs beside the declared model.

    Parameters
    ----------
    means: shape (runs,); mean residual of each run.
    within: shape (runs,); standard deviation that the noise within the runs, without turn-on scatter, gives to each.
    """

    means: FloatArray
    within: FloatArray

    @property
    def scatter(self) -> float:
        """Standard deviation of the runs; 0 of one."""
        return float(np.std(self.means, ddof=1)) if self.means.size > 1 else 0.0

    @property
    def ratio(self) -> float:
        """Scatter over the noise of a mean."""
        return self.scatter / max(float(np.sqrt(np.mean(self.within**2))), 1e-300)

    def limits(self) -> tuple[float, float]:
        """95 % limits of the scatter."""
        degrees = self.means.size - 1
        squares = degrees * self.scatter**2
        return math.sqrt(squares / stats.chi2.isf(0.025, degrees)), math.sqrt(squares / stats.chi2.isf(0.975, degrees))

    def disagrees_with(self, turn_on: float) -> bool:
        """Whether a declared turn-on scatter does not lead to such means: chance of 1 in 1000 on either side."""
        degrees = self.means.size - 1
        if degrees < 1:
            return False
        expected = turn_on**2 + float(np.mean(self.within**2))
        chi_square = degrees * self.scatter**2 / max(expected, 1e-300)
        p_value = min(float(stats.chi2.sf(chi_square, degrees)), float(stats.chi2.cdf(chi_square, degrees)))
        return p_value < _P_VALUE / 2


def run_scatter(record: Record, noise: NoiseCoefficients) -> RunScatter:
    """Return the means of a unit's runs.

    Parameters
    ----------
    record: All blocks of the unit.
    noise: As fitted.
    """
    quiet = msgspec.structs.replace(noise, turn_on=0.0)
    white = record.noise_model.space(quiet).white
    number = record.stack.run_number
    residual = record.value - record.design @ fit(record.design, record.value).coefficients
    means, within = [], []
    for run in range(len(record.stack.runs)):
        of_run = number == run
        weights = of_run / np.count_nonzero(of_run)
        means.append(float(residual[of_run].mean()))
        variance = correlated_variance(record, quiet, of_run, weights)
        within.append(math.sqrt(variance + white * float(np.sum(np.median(record.white[of_run]) * weights**2))))
    return RunScatter(np.array(means), np.array(within))


def scatter_finding(
    record: Record, scatter: RunScatter, declared: Collection[str], available: Mapping[str, Effect]
) -> FoundEffect | None:
    """Return turn-on scatter with what could be meant instead; None where the runs do not differ or can tell.

    Parameters
    ----------
    record: All blocks of the unit.
    scatter: Its runs.
    declared: Effects of the declared model.
    available: Effects whose channels these runs have.
    """
    runs = record.stack.runs
    if not 2 <= len(runs) <= MOST_RUNS or scatter.ratio < FAR:
        return None
    others = _recorded(runs, scatter, declared, available) + _unrecorded(runs, declared)
    if not others:
        return None
    unit = runs[0].unit_of_measure
    chi_square = float(np.sum(((scatter.means - scatter.means.mean()) / scatter.within) ** 2))
    equivalent = one_degree(chi_square, len(runs) - 1)
    low, high = scatter.limits()
    return FoundEffect(
        name=TURN_ON,
        parameters={},
        coefficients=(Coefficient("", scatter.scatter, low, high, unit),),
        significance=math.sqrt(equivalent),
        evidence=equivalent - PRICE,
        roles={},
        confounded=tuple(others),
        by_run={
            run.run: (float(mean), float(se)) for run, mean, se in zip(runs, scatter.means, scatter.within, strict=True)
        },
    )


def _recorded(
    runs: Sequence[RunBlocks], scatter: RunScatter, declared: Collection[str], available: Mapping[str, Effect]
) -> list[ConfoundedEffect]:
    """Causes, one for each channel, that differ between the runs and explain most of the scatter."""
    found: dict[str, ConfoundedEffect] = {}
    for name, each in available.items():
        is_linear = each.kind is Kind.LIBRARY and each.role is Role.CAUSE and not each.parameters
        if not is_linear or len(each.needs) != 1 or name in declared or each.needs[0] in found:
            continue
        columns = [each.regressors(run, {}) for run in runs]
        if columns[0].shape[1] != 1 or not all(np.isfinite(column).all() for column in columns):
            continue
        means = np.array([float(column.mean()) for column in columns])
        inside = float(np.sqrt(np.mean([np.var(column) for column in columns])))
        differs = np.std(means, ddof=1) > max(inside, 1e-9 * float(np.abs(means).max()))
        if differs and _left(means, scatter) < _EXPLAINED * scatter.scatter:
            found[each.needs[0]] = _alternative(each, recorded=True)
    return [found[channel] for channel in sorted(found)]


def _left(driver: FloatArray, scatter: RunScatter) -> float:
    """Scatter of the runs that a line in a driver leaves."""
    if driver.size == 2:
        return 0.0
    design = np.column_stack([np.ones_like(driver), driver])
    left = scatter.means - design @ fit(design, scatter.means).coefficients
    return float(np.sqrt(left @ left / (driver.size - 2)))


def _unrecorded(runs: Sequence[RunBlocks], declared: Collection[str]) -> list[ConfoundedEffect]:
    known = set.union(*(set(run.channels) for run in runs))
    return [
        _alternative(effects()[name], recorded=False)
        for name, channels in _UNRECORDED
        if name not in declared and not known.intersection((*channels, "position"))
    ]


def _alternative(each: Effect, *, recorded: bool) -> ConfoundedEffect:
    return ConfoundedEffect(
        name=each.name,
        parameters={},
        evidence_behind=0.0 if recorded else None,
        role=each.role.value,
        separating_test=each.separating_test,
        separating_test_zh=each.separating_test_zh,
        recorded=recorded,
    )


def scatter_limit(finding: FoundEffect, scatter: RunScatter, runs: int) -> str:
    """Say by how much the runs differ, and what differs between them."""
    named = [f"{each.name}{'' if each.recorded else ' (not recorded)'}" for each in finding.confounded]
    unit = finding.coefficients[0].unit_of_measure
    return (
        f"the runs differ by {scatter.scatter:.4g} {unit} (one standard deviation), {scatter.ratio:.3g} times the "
        f"noise within them: {', '.join([*named, TurnOnScatter.name])} differ between them, and {runs} runs cannot "
        "tell which it is"
    )


def undeclared_scatter_limit(scatter: RunScatter, unit_of_measure: str) -> str:
    """Say that turn-on scatter, which nobody declared, is far above the noise within the runs."""
    return (
        f"the runs differ by {scatter.scatter:.4g} {unit_of_measure} (one standard deviation), {scatter.ratio:.3g} "
        "times the noise within them: it was taken for turn-on scatter, which was not declared, so that what differs "
        "between runs alone can hide in it"
    )
