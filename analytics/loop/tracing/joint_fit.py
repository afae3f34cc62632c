"""A hypothesis fitted to the records of one or several units: common coefficients, and the noise of each unit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.least_squares import Solution, project, solve
from analytics.loop.tracing.noise_fit import fit_noise
from analytics.loop.tracing.recomputed import joined
from analytics.loop.tracing.record import Record
from stream.batch import FloatArray

_ALTERNATIONS = 3


@dataclass(frozen=True)
class Hypothesis:
    """What the records are thought to be made of.

    Parameters
    ----------
    own: For each record: columns whose coefficients are its own; the declared model, lines and jumps.
    common: For each record: columns whose coefficients all units share.
    """

    own: Sequence[FloatArray]
    common: Sequence[FloatArray]

    def with_common(self, columns: Sequence[FloatArray]) -> "Hypothesis":
        """One more effect that all units share."""
        return Hypothesis(self.own, joined(self.common, columns))

    def with_own(self, columns: Sequence[FloatArray]) -> "Hypothesis":
        """More columns of each record alone."""
        return Hypothesis(joined(self.own, columns), self.common)

    @property
    def designs(self) -> Sequence[FloatArray]:
        """All columns of each record."""
        return joined(self.own, self.common)


def nothing_more(records: Sequence[Record]) -> Hypothesis:
    """Return the declared model alone."""
    return Hypothesis(
        tuple(record.design for record in records), tuple(np.empty((len(record), 0)) for record in records)
    )


@dataclass(frozen=True)
class JointFit:
    """A hypothesis fitted.

    Parameters
    ----------
    records: To which.
    hypothesis: Which.
    noises: Of each record.
    log_likelihood: Of all records, with the priors of the noise.
    common: Coefficients that all units share.
    own: Coefficients of each unit, given the common ones.
    """

    records: tuple[Record, ...]
    hypothesis: Hypothesis
    noises: tuple[NoiseCoefficients, ...]
    log_likelihood: float
    common: Solution
    own: tuple[Solution, ...]

    @cached_property
    def whitened(self) -> tuple[FloatArray, ...]:
        """For each record: value, own and common columns, whitened by its noise."""
        return tuple(_whitened(self.records, self.hypothesis, self.noises))

    def light(self) -> "JointFit":
        """Return it without what can be computed again: of a fleet there are many fits, and one is chosen."""
        return replace(self) if len(self.records) > 1 else self

    @property
    def residuals(self) -> tuple[FloatArray, ...]:
        """Whitened residual of each record."""
        return tuple(
            whitened[:, 0] - whitened[:, 1:] @ np.concatenate([own.coefficients, self.common.coefficients])
            for whitened, own in zip(self.whitened, self.own, strict=True)
        )


def fit_jointly(
    records: Sequence[Record],
    hypothesis: Hypothesis,
    start: Sequence[NoiseCoefficients | None] | None = None,
    *,
    restricted: bool = False,
) -> JointFit:
    """Fit a hypothesis: the common coefficients to all records, the rest to each.

    Parameters
    ----------
    records: One for each unit.
    hypothesis: What is fitted.
    start: Where the noise of each record starts.
    restricted: By restricted likelihood: for the numbers that are given out, not for comparing hypotheses.
    """
    begin: Sequence[NoiseCoefficients | None] = [None] * len(records) if start is None else start
    if len(records) == 1:
        one = fit_noise(records[0], hypothesis.designs[0], begin[0], restricted=restricted)
        return _joined(records, hypothesis, [one.noise], one.log_likelihood, [one.whitened])
    noises = [record.prior.center if noise is None else noise for record, noise in zip(records, begin, strict=True)]
    has_common = hypothesis.common[0].shape[1] > 0
    for _ in range(_ALTERNATIONS if has_common else 1):
        theta = _common(_whitened(records, hypothesis, noises), hypothesis).coefficients
        fits = [
            fit_noise(record.less(columns @ theta), own, noise, restricted=restricted)
            for record, columns, own, noise in zip(records, hypothesis.common, hypothesis.own, noises, strict=True)
        ]
        noises = [each.noise for each in fits]
    whitened = _whitened(records, hypothesis, noises)
    return _joined(records, hypothesis, noises, sum(each.log_likelihood for each in fits), whitened)


def _whitened(
    records: Sequence[Record], hypothesis: Hypothesis, noises: Sequence[NoiseCoefficients]
) -> list[FloatArray]:
    return [
        record.whitener(noise)(np.column_stack([record.value, design]))
        for record, design, noise in zip(records, hypothesis.designs, noises, strict=True)
    ]


def _common(whitened: Sequence[FloatArray], hypothesis: Hypothesis) -> Solution:
    parts = [project(each.T @ each, own.shape[1]) for each, own in zip(whitened, hypothesis.own, strict=True)]
    return solve(np.sum([each.normal for each in parts], axis=0), np.sum([each.right for each in parts], axis=0))


def _joined(
    records: Sequence[Record],
    hypothesis: Hypothesis,
    noises: Sequence[NoiseCoefficients],
    log_likelihood: float,
    whitened: Sequence[FloatArray],
) -> JointFit:
    common = _common(whitened, hypothesis)
    own = []
    for each, columns in zip(whitened, hypothesis.own, strict=True):
        width = 1 + columns.shape[1]
        residual = each[:, 0] - each[:, width:] @ common.coefficients
        own.append(solve(each[:, 1:width].T @ each[:, 1:width], each[:, 1:width].T @ residual))
    fit = JointFit(tuple(records), hypothesis, tuple(noises), log_likelihood, common, tuple(own))
    fit.__dict__["whitened"] = tuple(whitened)  # it is there already
    return fit
