"""Candidate effects, each with every shape, and the screening: a test of every candidate on the whitened residual."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy import special

from analytics.loop.bilingual import Bilingual
from analytics.loop.effects.base import Effect, EffectKind, Shape
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.processors import of_records
from analytics.loop.tracing.whitening.joint_fit import Recomputed
from analytics.loop.tracing.whitening.least_squares import Projected, project
from analytics.loop.tracing.whitening.stack import Stack, UnitRecord
from stream.batch import BoolArray, FloatArray, IntArray

# columns of 125 units with 20,000 blocks each, where there is the memory; they are the same whether kept or not
_CACHE_BYTES = min(2_500_000_000, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4)
FLAT = 1e-9  # relative variation below which a column is constant
LEAST_MOVED = 1e-9  # spread of a column in natural units below which it varies by rounding only
NO_SHAPE = Bilingual("it has no shape to test here", "此处没有可检验的形状")
DRAWS = 500
LEAST_LEFT = 1e-3  # least share of a column's squared norm that is orthogonal to the columns of the model


@dataclass(frozen=True)
class Candidate:
    """One effect with one shape; `start` and `width` locate its columns among all."""

    effect: Effect
    shape: Shape
    start: int
    width: int

    @property
    def columns(self) -> slice:
        """Its columns among all."""
        return slice(self.start, self.start + self.width)


@dataclass(frozen=True)
class Candidates:
    """All candidates."""

    records: tuple[UnitRecord, ...]
    items: tuple[Candidate, ...]  # every effect with every shape, grouped by effect
    scale: FloatArray  # shape (columns,); divisor that gives each column a spread of about one
    not_tested: Mapping[str, Bilingual]  # effects that could not be tested, and why
    terms: tuple[str, ...] = ()  # names of the columns of the declared model
    _cache: dict[int, FloatArray] = field(default_factory=dict)

    def columns(self, number: int) -> FloatArray:
        """Columns of all candidates on one record, shape (n, columns)."""
        if number in self._cache:
            return self._cache[number]
        stack = self.records[number].stack
        return self.keep(number, [effect_columns(stack, item.effect, item.shape) for item in self.items])

    def keep(self, number: int, each: Sequence[FloatArray]) -> FloatArray:
        """The columns of one record, from those of each candidate; kept for the next call if there is room."""
        columns = np.column_stack(each or [np.empty((len(self.records[number]), 0))]) / self.scale
        if sum(each.nbytes for each in list(self._cache.values())) + columns.nbytes <= _CACHE_BYTES:
            self._cache[number] = columns
        return columns

    def of(self, candidate: Candidate, number: int) -> FloatArray:
        """Columns of one candidate on one record, in natural units."""
        if number in self._cache:
            return self._cache[number][:, candidate.columns] * self.scale[candidate.columns]
        return effect_columns(self.records[number].stack, candidate.effect, candidate.shape)

    def of_all(self, candidate: Candidate) -> Sequence[FloatArray]:
        """Columns of one candidate on each record, in natural units."""
        return self._for_each(partial(self.of, candidate))

    def at(self, effect: Effect, shape: Shape) -> Sequence[FloatArray]:
        """Columns of an effect at any shape on each record, in natural units."""
        return self._for_each(lambda number: effect_columns(self.records[number].stack, effect, shape))

    def _for_each(self, make: Callable[[int], FloatArray]) -> Sequence[FloatArray]:
        return (make(0),) if len(self.records) == 1 else Recomputed(make, len(self.records))


def effect_columns(stack: Stack, effect: Effect, shape: Shape) -> FloatArray:
    """Columns of an effect on the blocks of a unit, in natural units."""
    return stack.column(lambda run: effect.regressors(run, shape))


def candidates_for(
    records: Sequence[UnitRecord],
    effects: Mapping[str, Effect],
    model: ErrorModel,
    kinds: Sequence[EffectKind],
    lost_channels: Mapping[str, Bilingual],
) -> Candidates:
    """Candidates of given kinds that the declared model lacks, among `effects` whose channels are recorded.

    There is one record for each unit; `lost_channels` are not used, with the reason of each.
    """
    not_tested: dict[str, Bilingual] = {}
    items: list[Candidate] = []
    scales: list[FloatArray] = []
    last: list[FloatArray] = []  # columns of a single record
    runs = [run for record in records for run in record.stack.runs]
    for name, effect in effects.items():
        if effect.kind not in kinds or name in model.effects:
            continue
        if lost := [channel for channel in effect.needs if channel in lost_channels]:
            why = lost_channels[lost[0]]
            not_tested[name] = Bilingual(f"channel {lost[0]}: {why}", f"通道{lost[0]}：{why.zh}")
            continue
        tried = [(shape, _spread(records, effect, shape)) for shape in effect.shapes(runs)]
        usable = [(shape, spread) for shape, spread in tried if isinstance(spread, _Spread)]
        if not usable:
            not_tested[name] = next((why for _, why in tried if isinstance(why, Bilingual)), NO_SHAPE)
            continue
        for shape, spread in usable:
            items.append(Candidate(effect, shape, sum(map(len, scales)), len(spread.scale)))
            scales.append(spread.scale)
            if len(records) == 1:
                last.append(spread.last)
    scale = np.concatenate(scales) if scales else np.empty(0)
    found = Candidates(tuple(records), tuple(items), scale, not_tested, model.labels())
    if len(records) == 1:
        found.keep(0, last)
    return found


class _Spread(NamedTuple):
    """Spread of each column of an effect over all records, and its columns if there is one record."""

    scale: FloatArray
    last: FloatArray


class _Sums(NamedTuple):
    """Sums of the columns of an effect on one record and of their squares, blocks without a value, the columns."""

    bad: int
    total: FloatArray
    squares: FloatArray
    columns: FloatArray


def _spread(records: Sequence[UnitRecord], effect: Effect, shape: Shape) -> _Spread | Bilingual:
    """Spread of each column over all records, or why the effect cannot be tested."""

    def of(number: int) -> _Sums:
        columns = effect_columns(records[number].stack, effect, shape)
        if bad := int(np.count_nonzero(~np.isfinite(columns).all(axis=1))):
            return _Sums(bad, np.empty(0), np.empty(0), columns[:0])
        kept = columns if len(records) == 1 else columns[:0]
        return _Sums(0, columns.sum(axis=0), (columns**2).sum(axis=0), kept)

    parts = of_records(of, len(records))
    for record, part in zip(records, parts, strict=True):
        if part.bad:
            return Bilingual(
                f"no value in {part.bad} of {len(record)} blocks of unit {record.unit}",
                f"产品{record.unit}的{len(record)}个数据块中有{part.bad}个无值",
            )
    n = sum(map(len, records))
    mean_square = np.asarray(np.sum([part.squares for part in parts], axis=0) / n)
    mean = np.asarray(np.sum([part.total for part in parts], axis=0) / n)
    spread = np.sqrt(np.maximum(mean_square - mean**2, 0.0))
    varies = spread > FLAT * np.sqrt(mean_square)
    if not varies.any():
        return Bilingual(
            f"{' and '.join(effect.needs) or 'it'} does not vary in these runs as it needs",
            f"{'、'.join(effect.needs) or '该效应'}在这些试验中没有它所需的变化",
        )
    if float(spread.max()) < LEAST_MOVED:
        size = f"{float(spread.max()):.2g}"
        return Bilingual(
            f"it varies by {size} in these runs, too little to test it", f"在这些试验中其变化仅为{size}，过小而无法检验"
        )
    size = np.where(varies, spread, np.maximum(np.sqrt(mean_square), 1e-300))
    # a power of two leaves all digits of the columns: kept or computed again, they are the same
    return _Spread(np.exp2(np.round(np.log2(size))), parts[-1].columns)


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
    """Test each candidate that the model is `without`, beside the model's columns `designs`, with a given noise."""
    total = pooled(candidates, designs, noises)
    left = _left(total)
    null = _draws(total.normal, left, rng)
    results: list[Screened] = []
    best_null: dict[int, FloatArray] = {}
    for item in candidates.items:
        name = item.effect.name
        test = None if name in without else _test(item, total, left)
        if test is None:
            continue
        results.append(test.screened)
        chi_square = np.sum((test.whiten @ null[test.own]) ** 2, axis=0)
        degrees = test.screened.degrees  # of two with the same degrees, the larger has the smaller p-value
        best_null[degrees] = np.maximum(best_null.get(degrees, 0.0), chi_square)
    null_p = [special.gammaincc(degrees / 2, best / 2) for degrees, best in best_null.items()]
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

    def of(number: int) -> Projected:
        record, design = candidates.records[number], designs[number]
        data = np.column_stack([record.value, design, candidates.columns(number)])
        if np.any(np.ptp(design, axis=0) == 0):  # the model has the bias: what varies counts, not 0.3 V beside 28 V
            of_candidates = data[:, 1 + design.shape[1] :]
            of_candidates -= of_candidates.mean(axis=0)
        whitened = record.whitener(noises[number])(data)
        return project(whitened.T @ whitened, design.shape[1])

    parts = of_records(of, len(candidates.records))
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
    if normal.shape == (1, 1):
        return np.asarray(1 / np.sqrt(normal))
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
