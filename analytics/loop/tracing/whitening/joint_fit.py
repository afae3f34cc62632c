"""A hypothesis fitted to the records of one or several units: common coefficients, and the noise of each unit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import overload

import numpy as np

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.processors import of_records
from analytics.loop.tracing.whitening.least_squares import Solution, project, solve
from analytics.loop.tracing.whitening.stack import UnitRecord
from analytics.loop.tracing.whitening.whitened_fit import ENOUGH, WhitenedFit, fit_noise
from stream.batch import FloatArray

_ALTERNATIONS = 3


@dataclass(frozen=True)
class Recomputed(Sequence[FloatArray]):
    """An array for each record, made from its number on each access to save memory in fits of a fleet.

    >>> [each.size for each in Recomputed(np.ones, 3)]
    [0, 1, 2]
    """

    make: Callable[[int], FloatArray]
    records: int

    def __len__(self) -> int:
        return self.records

    @overload
    def __getitem__(self, number: int) -> FloatArray: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[FloatArray]: ...

    def __getitem__(self, number: int | slice) -> FloatArray | Sequence[FloatArray]:
        numbers = range(self.records)[number]  # raises IndexError
        return self.make(numbers) if isinstance(numbers, int) else [self.make(each) for each in numbers]


def _side_by_side(before: Sequence[FloatArray], more: Sequence[FloatArray]) -> Sequence[FloatArray]:
    """For each record, the columns of both; recomputed on access if there are several records."""

    def of(number: int) -> FloatArray:
        return np.column_stack([before[number], more[number]])

    return (of(0),) if len(before) == 1 else Recomputed(of, len(before))


@dataclass(frozen=True)
class Hypothesis:
    """Columns of a regression, for each record."""

    own: Sequence[FloatArray]  # with coefficients of its own; the declared model, lines and jumps
    common: Sequence[FloatArray]  # with coefficients that all units share

    def with_common(self, columns: Sequence[FloatArray]) -> "Hypothesis":
        """Add an effect that all units share."""
        return Hypothesis(self.own, _side_by_side(self.common, columns))

    def with_own(self, columns: Sequence[FloatArray]) -> "Hypothesis":
        """Add columns with coefficients of each record."""
        return Hypothesis(_side_by_side(self.own, columns), self.common)

    @property
    def designs(self) -> Sequence[FloatArray]:
        """All columns of each record."""
        return _side_by_side(self.own, self.common)


def nothing_more(records: Sequence[UnitRecord]) -> Hypothesis:
    """The declared model alone."""
    return Hypothesis(
        tuple(record.design for record in records), tuple(np.empty((len(record), 0)) for record in records)
    )


@dataclass(frozen=True)
class JointFit:
    """A fitted hypothesis."""

    records: tuple[UnitRecord, ...]
    hypothesis: Hypothesis
    noises: tuple[ModelNoise, ...]
    log_likelihood: float  # of all records, including the priors of the noise
    common: Solution  # coefficients that all units share
    own: tuple[Solution, ...]  # coefficients of each unit, given the common ones

    @cached_property
    def whitened(self) -> tuple[FloatArray, ...]:
        """For each record: value, own and common columns, whitened by its noise."""
        return tuple(_whitened(self.records, self.hypothesis, self.noises))

    @property
    def residuals(self) -> tuple[FloatArray, ...]:
        """Whitened residual of each record."""
        return tuple(
            whitened[:, 0] - whitened[:, 1:] @ np.concatenate([own.coefficients, self.common.coefficients])
            for whitened, own in zip(self.whitened, self.own, strict=True)
        )


def fit_jointly(
    records: Sequence[UnitRecord],
    hypothesis: Hypothesis,
    start: Sequence[ModelNoise] | None = None,
    *,
    restricted: bool = False,
) -> JointFit:
    """Fit a hypothesis: the common coefficients to all records, the others to each.

    `start` are start values of the noise of each record. If `restricted`, the restricted likelihood (REML) is used: for
    results, not for comparing hypotheses.
    """
    noises = [record.prior.center for record in records] if start is None else list(start)
    if len(records) == 1:
        one = fit_noise(records[0], hypothesis.designs[0], noises[0], restricted=restricted)
        common = solve(*_normal_equations([one.whitened], hypothesis))
        return _joined(records, hypothesis, [one.noise], one.log_likelihood, [one.whitened], common)
    theta = solve(*_normal_equations(_whitened(records, hypothesis, noises), hypothesis)).coefficients
    for _ in range(_ALTERNATIONS):
        fits = _fits(records, hypothesis, theta, noises, restricted=restricted)
        noises = [each.noise for each in fits]
        whitened = _whitened(records, hypothesis, noises)
        normal, right = _normal_equations(whitened, hypothesis)
        common = solve(normal, right)
        # with this noise the likelihood is quadratic in the common coefficients: what their best values gain
        step = common.coefficients - theta
        gain = 0.5 * float(step @ normal @ step)
        if gain < ENOUGH:
            break
        theta = common.coefficients
    log_likelihood = gain + sum(each.log_likelihood for each in fits)
    return _joined(records, hypothesis, noises, log_likelihood, whitened, common)


def _fits(
    records: Sequence[UnitRecord],
    hypothesis: Hypothesis,
    theta: FloatArray,
    noises: Sequence[ModelNoise],
    *,
    restricted: bool,
) -> list[WhitenedFit]:
    """The noise of each record, and its own coefficients, with given common coefficients."""

    def of(number: int) -> WhitenedFit:
        value = records[number].value - hypothesis.common[number] @ theta
        record = replace(records[number], value=value)
        return fit_noise(record, hypothesis.own[number], noises[number], restricted=restricted)

    return of_records(of, len(records))


def _whitened(records: Sequence[UnitRecord], hypothesis: Hypothesis, noises: Sequence[ModelNoise]) -> list[FloatArray]:
    designs = hypothesis.designs

    def of(number: int) -> FloatArray:
        return records[number].whitener(noises[number])(np.column_stack([records[number].value, designs[number]]))

    return of_records(of, len(records))


def normal_equations(joint: JointFit, hypothesis: Hypothesis) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and right side of the common columns of a hypothesis, with the noise of a fit."""
    return _normal_equations(_whitened(joint.records, hypothesis, joint.noises), hypothesis)


def _normal_equations(whitened: Sequence[FloatArray], hypothesis: Hypothesis) -> tuple[FloatArray, FloatArray]:
    """Normal matrix and right side of the common coefficients, beside those of each record."""
    parts = [project(each.T @ each, own.shape[1]) for each, own in zip(whitened, hypothesis.own, strict=True)]
    return np.sum([each.normal for each in parts], axis=0), np.sum([each.right for each in parts], axis=0)


def _joined(
    records: Sequence[UnitRecord],
    hypothesis: Hypothesis,
    noises: Sequence[ModelNoise],
    log_likelihood: float,
    whitened: Sequence[FloatArray],
    common: Solution,
) -> JointFit:
    own = []
    for each, columns in zip(whitened, hypothesis.own, strict=True):
        width = 1 + columns.shape[1]
        residual = each[:, 0] - each[:, width:] @ common.coefficients
        own.append(solve(each[:, 1:width].T @ each[:, 1:width], each[:, 1:width].T @ residual))
    fit = JointFit(tuple(records), hypothesis, tuple(noises), log_likelihood, common, tuple(own))
    fit.__dict__["whitened"] = tuple(whitened)  # fills the cache
    return fit
