"""The effects that are tried on a set of records, each with every shape, as scaled columns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from analytics.loop.effects.base import Effect, Kind, Shape
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.recomputed import Recomputed
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.stack import Stack
from stream.batch import FloatArray

_CACHE_BYTES = 100_000_000
FLAT = 1e-9  # a column that varies by less than this part of its size is constant
LEAST_MOVED = 1e-9
"""Spread of a column in its natural units below which nothing but rounding moves it, or it died away long before."""


@dataclass(frozen=True)
class Candidate:
    """One effect with one shape, and where its columns are.

    Parameters
    ----------
    effect: The effect.
    shape: Values of its shape parameters.
    start, width: Its columns among all.
    """

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
    """All that is tried.

    Parameters
    ----------
    records: On which it is tried.
    items: Every effect with every shape; those of one effect stand together.
    scale: shape (columns,); by which columns are divided, so that each has a spread of one.
    not_tested: Effects that could not be tried, and why.
    """

    records: tuple[Record, ...]
    items: tuple[Candidate, ...]
    scale: FloatArray
    not_tested: Mapping[str, str]
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
        """Columns of one candidate on each record, in natural units; of several they are made when asked for."""
        if len(self.records) == 1:
            return (self.of(candidate, 0),)
        return Recomputed(partial(self.of, candidate), len(self.records))


def effect_columns(stack: Stack, effect: Effect, shape: Shape) -> FloatArray:
    """Columns of an effect on the blocks of a unit, in natural units."""
    return stack.column(lambda run: effect.regressors(run, shape))


def candidates_for(
    records: Sequence[Record],
    effects: Mapping[str, Effect],
    model: ErrorModel,
    kinds: Sequence[Kind],
    lost_channels: Mapping[str, str],
) -> Candidates:
    """Return what of these effects can be tried on these records.

    Parameters
    ----------
    records: One for each unit.
    effects: Effects by name, all of which find their channels.
    model: The declared model: what it has is not tried.
    kinds: Which kinds to try.
    lost_channels: Channels that cannot take part, and why.
    """
    not_tested: dict[str, str] = {}
    items: list[Candidate] = []
    scales: list[FloatArray] = []
    runs = [run for record in records for run in record.stack.runs]
    for name, effect in effects.items():
        if effect.kind not in kinds or name in model.effects:
            continue
        if lost := [channel for channel in effect.needs if channel in lost_channels]:
            not_tested[name] = f"channel {lost[0]}: {lost_channels[lost[0]]}"
            continue
        tried = [(shape, _spread(records, effect, shape)) for shape in effect.shapes(runs)]
        usable = [(shape, spread) for shape, spread in tried if isinstance(spread, np.ndarray)]
        if not usable:
            not_tested[name] = next((why for _, why in tried if isinstance(why, str)), "it has no shape to try here")
            continue
        for shape, spread in usable:
            items.append(Candidate(effect, shape, sum(map(len, scales)), len(spread)))
            scales.append(spread)
    scale = np.concatenate(scales) if scales else np.empty(0)
    return Candidates(tuple(records), tuple(items), scale, not_tested)


def _spread(records: Sequence[Record], effect: Effect, shape: Shape) -> FloatArray | str:
    """Spread of each column over all records, or why the effect cannot be tried."""
    n, total, squares = 0, 0.0, 0.0
    for record in records:
        columns = effect_columns(record.stack, effect, shape)
        if not np.isfinite(columns).all():
            bad = int(np.count_nonzero(~np.isfinite(columns).all(axis=1)))
            return f"no value in {bad} of {len(record)} blocks of unit {record.unit}"
        n += len(record)
        total = total + columns.sum(axis=0)
        squares = squares + (columns**2).sum(axis=0)
    mean_square = np.asarray(squares / n)
    spread = np.sqrt(np.maximum(mean_square - np.asarray(total / n) ** 2, 0.0))
    varies = spread > FLAT * np.sqrt(mean_square)
    if not varies.any():
        return f"{' and '.join(effect.needs) or 'it'} does not vary in these runs"
    if float(spread.max()) < LEAST_MOVED:
        return f"it moves by {float(spread.max()):.2g} in these runs, too little to look for it"
    return np.asarray(np.where(varies, spread, np.maximum(np.sqrt(mean_square), 1e-300)))


def _columns(record: Record, items: Sequence[Candidate]) -> FloatArray:
    if not items:
        return np.empty((len(record), 0))
    return np.column_stack([effect_columns(record.stack, each.effect, each.shape) for each in items])
