"""Screening: every candidate against the whitened residual, and how many independent tests that makes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import special

from analytics.loop.effects.base import Kind
from analytics.loop.model.noise import NoiseCoefficients
from analytics.loop.tracing.candidates import Candidate, Candidates
from analytics.loop.tracing.least_squares import Projected, project
from stream.batch import BoolArray, FloatArray, IntArray

DRAWS = 500
LEAST_LEFT = 1e-3
"""Part of a column's squared length that must be left beside the columns of the model; else it cannot be told apart."""


@dataclass(frozen=True)
class Screened:
    """How one candidate did.

    Parameters
    ----------
    candidate: Which.
    statistic: Chi-square of its columns.
    degrees: Of freedom.
    p_value: Of this test alone.
    """

    candidate: Candidate
    statistic: float
    degrees: int
    p_value: float


@dataclass(frozen=True)
class Screen:
    """How all candidates did.

    Parameters
    ----------
    results: Those that can be told from the model.
    tests: Effective number of independent tests.
    blind: Effects no shape of which can be told from the model.
    """

    results: tuple[Screened, ...]
    tests: float
    blind: tuple[str, ...]

    def family_p_value(self, p_value: float) -> float:
        """Chance that the best of all tests is at least as good."""
        return family_p_value(p_value, self.tests)

    def by_effect(self) -> list[list[Screened]]:
        """Results of each effect, best shape first; the effect with the best shape first."""
        groups: dict[str, list[Screened]] = {}
        for each in sorted(self.results, key=lambda each: (each.p_value, -each.statistic)):
            groups.setdefault(each.candidate.effect.name, []).append(each)
        return list(groups.values())


def family_p_value(p_value: float, tests: float) -> float:
    """Chance that the best of so many independent tests has at most this p-value.

    Examples
    --------
    >>> round(family_p_value(0.01, 10.0), 4)
    0.0956
    """
    return float(-np.expm1(tests * np.log1p(-min(p_value, 1 - 1e-16))))


def screen(
    candidates: Candidates,
    designs: Sequence[FloatArray],
    noises: Sequence[NoiseCoefficients],
    rng: np.random.Generator,
    without: Sequence[str] = (),
) -> Screen:
    """Test each candidate beside a design at a given noise.

    Parameters
    ----------
    candidates: What is tried.
    designs: Columns of the model so far, one array for each record.
    noises: Noise of each record.
    rng: For the draws that give the number of tests.
    without: Effects that are in the model already.
    """
    total = pooled(candidates, designs, noises)
    left = _left(total)
    null = _draws(total.normal, left, rng)
    results: list[Screened] = []
    best_null: dict[tuple[str, int], FloatArray] = {}
    seen: dict[str, bool] = {}
    for item in candidates.items:
        name = item.effect.name
        if name in without:
            continue
        test = _test(item, total, left)
        seen[name] = seen.get(name, False) or test is not None
        if test is None:
            continue
        results.append(test.screened)
        chi_square = np.sum((test.whiten @ null[test.own]) ** 2, axis=0)
        family = name, test.screened.degrees
        best_null[family] = np.maximum(best_null.get(family, 0.0), chi_square)
    blind = tuple(name for name, told in seen.items() if not told)
    null_p = [special.gammaincc(degrees / 2, best / 2) for (_, degrees), best in best_null.items()]
    return Screen(tuple(results), _effective_tests(null_p), blind)


def tests_of_kind(
    candidates: Candidates, designs: Sequence[FloatArray], noises: Sequence[NoiseCoefficients], kind: Kind
) -> list[Screened]:
    """Test the candidates of one kind beside a design, without the count of tests."""
    total = pooled(candidates, designs, noises)
    left = _left(total)
    tests = [_test(item, total, left) for item in candidates.items if item.effect.kind is kind]
    return [each.screened for each in tests if each is not None]


class _Test(NamedTuple):
    """The test of one candidate, and how to repeat it on drawn noise."""

    screened: Screened
    own: IntArray
    whiten: FloatArray


def _left(total: Projected) -> BoolArray:
    """Columns of which enough is left beside the design."""
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


def pooled(candidates: Candidates, designs: Sequence[FloatArray], noises: Sequence[NoiseCoefficients]) -> Projected:
    """Normal equations of all candidates beside the designs, summed over records."""
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
    """Products of the columns that are left with white noise, drawn from their covariance, shape (columns, draws)."""
    scale = np.sqrt(np.diag(normal)[left])
    eigenvalues, vectors = np.linalg.eigh(normal[np.ix_(left, left)] / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    drawn = np.zeros((left.size, DRAWS))
    drawn[left] = scale[:, None] * (root @ rng.standard_normal((scale.size, DRAWS)))
    return drawn


def own_whitening(normal: FloatArray) -> FloatArray:
    """Matrix that turns products of a candidate's columns with white noise into independent ones of unit variance."""
    scale = np.sqrt(np.diag(normal))
    eigenvalues, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    kept = eigenvalues > LEAST_LEFT * eigenvalues[-1]
    return np.asarray((vectors[:, kept] / np.sqrt(eigenvalues[kept])).T / scale)


def _effective_tests(null_p: Sequence[FloatArray]) -> float:
    """Number of independent tests whose best p-value has the median that was drawn."""
    if not null_p:
        return 1.0
    median = float(np.median(np.min(null_p, axis=0)))
    return max(1.0, float(np.log(0.5) / np.log1p(-median)))
