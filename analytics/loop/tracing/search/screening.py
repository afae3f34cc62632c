"""Screening: a test of every candidate on the whitened residual, and the effective number of tests."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import special

from analytics.loop.effects.base import EffectKind
from analytics.loop.model.noise import ModelNoise
from analytics.loop.tracing.search.candidates import Candidate, Candidates
from analytics.loop.tracing.whitening.least_squares import Projected, project
from stream.batch import BoolArray, FloatArray, IntArray

DRAWS = 500
LEAST_LEFT = 1e-3
"""Least share of a column's squared norm that is orthogonal to the columns of the model."""


@dataclass(frozen=True)
class Screened:
    """The test of one candidate: chi-square of its columns, degrees of freedom and p-value."""

    candidate: Candidate
    statistic: float
    degrees: int
    p_value: float


@dataclass(frozen=True)
class Screen:
    """The tests of all candidates, and the effective number of independent tests."""

    results: tuple[Screened, ...]
    tests: float

    def by_effect(self) -> list[list[Screened]]:
        """Results by effect, best shape first, best effect first."""
        groups: dict[str, list[Screened]] = {}
        for each in sorted(self.results, key=lambda each: (each.p_value, -each.statistic)):
            groups.setdefault(each.candidate.effect.name, []).append(each)
        return list(groups.values())


def family_p_value(p_value: float, tests: float) -> float:
    """Probability that the smallest p-value of `tests` independent tests is at most this.

    Examples
    --------
    >>> round(family_p_value(0.01, 10.0), 4)
    0.0956
    """
    return float(-np.expm1(tests * np.log1p(-min(p_value, 1 - 1e-16))))


def screen(
    candidates: Candidates,
    designs: Sequence[FloatArray],
    noises: Sequence[ModelNoise],
    rng: np.random.Generator,
    without: Sequence[str] = (),
) -> Screen:
    """Test each candidate beside the current model with a given noise.

    Parameters
    ----------
    designs, noises: Columns of the current model and noise of each record.
    rng: For the draws that give the number of tests.
    without: Effects that the model has.
    """
    total = pooled(candidates, designs, noises)
    left = _left(total)
    null = _draws(total.normal, left, rng)
    results: list[Screened] = []
    best_null: dict[tuple[str, int], FloatArray] = {}
    for item in candidates.items:
        name = item.effect.name
        test = None if name in without else _test(item, total, left)
        if test is None:
            continue
        results.append(test.screened)
        chi_square = np.sum((test.whiten @ null[test.own]) ** 2, axis=0)
        family = name, test.screened.degrees
        best_null[family] = np.maximum(best_null.get(family, 0.0), chi_square)
    null_p = [special.gammaincc(degrees / 2, best / 2) for (_, degrees), best in best_null.items()]
    return Screen(tuple(results), _effective_tests(null_p))


def tests_of_kind(
    candidates: Candidates, designs: Sequence[FloatArray], noises: Sequence[ModelNoise], kind: EffectKind
) -> list[Screened]:
    """Test the candidates of one kind, without the effective number of tests."""
    total = pooled(candidates, designs, noises)
    left = _left(total)
    tests = [_test(item, total, left) for item in candidates.items if item.effect.kind is kind]
    return [each.screened for each in tests if each is not None]


class _Test(NamedTuple):
    """A test and its projection, for repeating it on drawn noise."""

    screened: Screened
    own: IntArray
    whiten: FloatArray


def _left(total: Projected) -> BoolArray:
    """Marks the columns that are not collinear with the model."""
    return np.asarray(np.diag(total.normal) > LEAST_LEFT * np.maximum(total.before, 1e-300))


def _test(item: Candidate, total: Projected, left: BoolArray) -> _Test | None:
    own = np.flatnonzero(left[item.columns]) + item.start
    if not own.size:
        return None
    whiten = own_whitening(total.normal[np.ix_(own, own)])
    degrees = whiten.shape[0]
    statistic = float(np.sum((whiten @ total.right[own]) ** 2))
    p_value = float(special.gammaincc(degrees / 2, statistic / 2))
    return _Test(Screened(item, statistic, degrees, p_value), own, whiten)


def pooled(candidates: Candidates, designs: Sequence[FloatArray], noises: Sequence[ModelNoise]) -> Projected:
    """Normal equations of all candidates beside the model, summed over records."""
    parts = []
    for number, (record, design, noise) in enumerate(zip(candidates.records, designs, noises, strict=True)):
        data = np.column_stack([record.value, design, candidates.columns(number)])
        whitened = record.whitener(noise)(data)
        parts.append(project(whitened.T @ whitened, design.shape[1]))
    return Projected(
        np.sum([each.normal for each in parts], axis=0),
        np.sum([each.right for each in parts], axis=0),
        np.sum([each.before for each in parts], axis=0),
    )


def _draws(normal: FloatArray, left: BoolArray, rng: np.random.Generator) -> FloatArray:
    """Products of the columns with white noise, drawn from their covariance, shape (columns, draws)."""
    scale = np.sqrt(np.diag(normal)[left])
    eigenvalues, vectors = np.linalg.eigh(normal[np.ix_(left, left)] / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    drawn = np.zeros((left.size, DRAWS))
    drawn[left] = scale[:, None] * (root @ rng.standard_normal((scale.size, DRAWS)))
    return drawn


def own_whitening(normal: FloatArray) -> FloatArray:
    """Matrix that decorrelates the products of a candidate's columns with white noise."""
    scale = np.sqrt(np.diag(normal))
    eigenvalues, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    kept = eigenvalues > LEAST_LEFT * eigenvalues[-1]
    return np.asarray((vectors[:, kept] / np.sqrt(eigenvalues[kept])).T / scale)


def _effective_tests(null_p: Sequence[FloatArray]) -> float:
    """Number of independent tests whose smallest p-value has the drawn median."""
    if not null_p:
        return 1.0
    median = float(np.median(np.min(null_p, axis=0)))
    return max(1.0, float(np.log(0.5) / np.log1p(-median)))
