"""Candidate effects of a set of records, each with every shape, as scaled columns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.effects.base import Effect, EffectKind, Shape
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.whitening.joint_fit import Recomputed
from analytics.loop.tracing.whitening.stack import Stack
from analytics.loop.tracing.whitening.unit_record import UnitRecord
from stream.batch import FloatArray

_CACHE_BYTES = 100_000_000
FLAT = 1e-9  # relative variation below which a column is constant
LEAST_MOVED = 1e-9
NO_SHAPE = Bilingual("it has no shape to test here", "此处没有可检验的形状")
"""Spread of a column in natural units below which it varies by rounding only."""


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
    """All candidates.

    Parameters
    ----------
    items: Every effect with every shape, grouped by effect.
    scale: shape (columns,); divisor that gives each column a spread of one.
    not_tested: Effects that could not be tested, and why.
    """

    records: tuple[UnitRecord, ...]
    items: tuple[Candidate, ...]
    scale: FloatArray
    not_tested: Mapping[str, Bilingual]
    _cache: dict[int, FloatArray] = field(default_factory=dict)

    def columns(self, number: int) -> FloatArray:
        """Columns of all candidates on one record, shape (n, columns)."""
        if number in self._cache:
            return self._cache[number]
        columns = _columns(self.records[number], self.items) / self.scale
        if sum(each.nbytes for each in self._cache.values()) + columns.nbytes <= _CACHE_BYTES:
            self._cache[number] = columns
        return columns

    def of(self, candidate: Candidate, number: int) -> FloatArray:
        """Columns of one candidate on one record, in natural units."""
        if number in self._cache:
            return self._cache[number][:, candidate.columns] * self.scale[candidate.columns]
        return effect_columns(self.records[number].stack, candidate.effect, candidate.shape)

    def of_all(self, candidate: Candidate) -> Sequence[FloatArray]:
        """Columns of one candidate on each record, in natural units."""
        if len(self.records) == 1:
            return (self.of(candidate, 0),)
        return Recomputed(partial(self.of, candidate), len(self.records))


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
    """Candidates of given kinds that the declared model lacks.

    Parameters
    ----------
    records: One for each unit.
    effects: Effects by name whose channels are recorded.
    lost_channels: Channels that are not used, and why.
    """
    not_tested: dict[str, Bilingual] = {}
    items: list[Candidate] = []
    scales: list[FloatArray] = []
    runs = [run for record in records for run in record.stack.runs]
    for name, effect in effects.items():
        if effect.kind not in kinds or name in model.effects:
            continue
        if lost := [channel for channel in effect.needs if channel in lost_channels]:
            why = lost_channels[lost[0]]
            not_tested[name] = Bilingual(f"channel {lost[0]}: {why}", f"通道{lost[0]}：{why.zh}")
            continue
        tried = [(shape, _spread(records, effect, shape)) for shape in effect.shapes(runs)]
        usable = [(shape, spread) for shape, spread in tried if isinstance(spread, np.ndarray)]
        if not usable:
            not_tested[name] = next((why for _, why in tried if isinstance(why, Bilingual)), NO_SHAPE)
            continue
        for shape, spread in usable:
            items.append(Candidate(effect, shape, sum(map(len, scales)), len(spread)))
            scales.append(spread)
    scale = np.concatenate(scales) if scales else np.empty(0)
    return Candidates(tuple(records), tuple(items), scale, not_tested)


def _spread(records: Sequence[UnitRecord], effect: Effect, shape: Shape) -> FloatArray | Bilingual:
    """Spread of each column over all records, or why the effect cannot be tested."""
    n, total, squares = 0, 0.0, 0.0
    for record in records:
        columns = effect_columns(record.stack, effect, shape)
        if not np.isfinite(columns).all():
            bad = int(np.count_nonzero(~np.isfinite(columns).all(axis=1)))
            return Bilingual(
                f"no value in {bad} of {len(record)} blocks of unit {record.unit}",
                f"产品{record.unit}的{len(record)}个数据块中有{bad}个无值",
            )
        n += len(record)
        total = total + columns.sum(axis=0)
        squares = squares + (columns**2).sum(axis=0)
    mean_square = np.asarray(squares / n)
    spread = np.sqrt(np.maximum(mean_square - np.asarray(total / n) ** 2, 0.0))
    varies = spread > FLAT * np.sqrt(mean_square)
    if not varies.any():
        return Bilingual(
            f"{' and '.join(effect.needs) or 'it'} does not vary in these runs",
            f"{'、'.join(effect.needs) or '该效应'}在这些试验中不变化",
        )
    if float(spread.max()) < LEAST_MOVED:
        size = f"{float(spread.max()):.2g}"
        return Bilingual(
            f"it varies by {size} in these runs, too little to test it", f"在这些试验中其变化仅为{size}，过小而无法检验"
        )
    return np.asarray(np.where(varies, spread, np.maximum(np.sqrt(mean_square), 1e-300)))


def _columns(record: UnitRecord, items: Sequence[Candidate]) -> FloatArray:
    if not items:
        return np.empty((len(record), 0))
    return np.column_stack([effect_columns(record.stack, each.effect, each.shape) for each in items])
