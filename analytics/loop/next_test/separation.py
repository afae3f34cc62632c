"""Separation of rival effects by a test: the probability that the true one is left as the single name.

Rivals k explain the data y as X_k theta beside the declared model. After a test, the residual sum of squares of each,
whitened by the unit's fitted noise, follows from normal equations; the evidence and the lead that it needs are those
of the search. The data so far are kept as they are; coefficients are drawn from their posterior, the noise of the
test again. Box and Hill, Technometrics 9(1), 1967, 57-71; Atkinson and Fedorov, Biometrika 62(1), 1975, 57-70
(T-optimality).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Shape
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.search.evidence import leads, one_degree, penalty
from analytics.loop.tracing.whitening.stack import Stack
from analytics.loop.tracing.whitening.whitener import Whitener
from stream.batch import BoolArray, FloatArray, IntArray

DRAWS = 400
LIKELY = 0.05
"""Least posterior weight of a rival whose power counts."""
_RIDGE = 1e-12
_FREE = 1e4  # size of a column in a test relative to that in the runs so far
_SAME = 1.0 - 1e-9  # cosine of columns that are one


@dataclass(frozen=True)
class Rival:
    """An effect that may be the true one, with every shape that it may have."""

    effect: Effect
    shapes: tuple[Shape, ...]

    @property
    def degrees(self) -> int:
        """Degrees of freedom that the search counts."""
        return len(self.effect.columns(self.shapes[0])) + (len(self.shapes) > 1)

    def columns(self, run: RunBlocks) -> list[FloatArray]:
        """Columns of each shape in a run."""
        return [self.effect.regressors(run, shape) for shape in self.shapes]


@dataclass(frozen=True)
class Separation:
    """What a test would decide.

    Parameters
    ----------
    power: Probability that the true rival is left as the single name, over the rivals by their posterior weights.
    by_truth: The same if each rival is the true one.
    least: Least expected difference of evidence between a true rival and another, chi-square.
    assured: The least power over the rivals that the data so far leave likely.
    """

    power: float
    by_truth: dict[str, float]
    least: float
    assured: float


@dataclass(frozen=True)
class FittedRecord:
    """The runs of a unit that the search is given, with its fitted noise and the relative white variance of blocks."""

    stack: Stack
    noise: ModelNoise
    white: FloatArray


class RivalFit:
    """Rivals fitted to the runs so far, ready for the runs of a test.

    Parameters
    ----------
    records: Of one unit, or of several, which share the rivals and have a declared model each.
    others: Effects found beside the rivals, which every rival is fitted with.
    """

    def __init__(
        self,
        records: Sequence[FittedRecord],
        model: ErrorModel,
        rivals: Sequence[Rival],
        others: Sequence[tuple[Effect, Shape]] = (),
        seed: int = 0,
    ) -> None:
        self._records, self._model, self.rivals, self._others = tuple(records), model, tuple(rivals), tuple(others)
        self._seed = seed
        parts = []
        for number, each in enumerate(self._records):
            columns = each.stack.column(partial(self._columns, record=number))
            whitener = Whitener.of(each.stack.noise_model, each.noise, each.stack.steps, each.white)
            parts.append(whitener(np.column_stack([each.stack.value, columns])))
        whole = np.concatenate(parts)
        norms = np.linalg.norm(whole[:, 1:], axis=0)
        self._scale = np.where(norms > 0.0, norms, 1.0)
        scaled = whole[:, 1:] / self._scale
        # what the declared terms explain is taken off: beside the turn of the table an effect is lost in the rounding
        known = scaled[:, : self._known]
        value = whole[:, 0] - known @ np.linalg.lstsq(known, whole[:, 0], rcond=None)[0]
        self._gram, self._right = scaled.T @ scaled, scaled.T @ value
        self._places = self._located()
        weights = np.array(
            [0.5 * self._evidence(each, self._gram, self._right[:, None])[0] for each in range(len(self.rivals))]
        )
        weights = np.exp(weights - weights.max())
        self.weights: FloatArray = weights / weights.sum()

    @property
    def _known(self) -> int:
        own = len(self._model.labels()) * len(self._records)
        return own + sum(len(one.columns(shape)) for one, shape in self._others)

    def _columns(self, run: RunBlocks, record: int) -> FloatArray:
        own = self._model.columns(run)
        none = np.zeros_like(own)
        parts = [own if number == record else none for number in range(len(self._records))]
        parts += [one.regressors(run, shape) for one, shape in self._others]
        for rival in self.rivals:
            parts += rival.columns(run)
        return np.column_stack(parts)

    def _located(self) -> list[list[IntArray]]:
        """Of each shape of each rival: the columns of its fit."""
        at, known = self._known, np.arange(self._known)
        found = []
        for rival in self.rivals:
            width = len(rival.effect.columns(rival.shapes[0]))
            found.append([np.concatenate([known, at + width * k + np.arange(width)]) for k in range(len(rival.shapes))])
            at += width * len(rival.shapes)
        return found

    def _explained(self, at: IntArray, gram: FloatArray, right: FloatArray) -> FloatArray:
        """Sum of squares that columns explain, for each draw."""
        own = gram[np.ix_(at, at)]
        scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
        factor = np.linalg.cholesky(own / np.outer(scale, scale) + _RIDGE * at.size * np.eye(at.size))
        return np.asarray(np.sum(np.linalg.solve(factor, right[at] / scale[:, None]) ** 2, axis=0))

    def _evidence(self, number: int, gram: FloatArray, right: FloatArray) -> FloatArray:
        rival = self.rivals[number]
        without = self._explained(np.arange(self._known), gram, right)
        best = np.max([self._explained(at, gram, right) for at in self._places[number]], axis=0)
        return one_degree(best - without, rival.degrees) - penalty(rival.effect)

    def whitened(self, runs: Sequence[RunBlocks]) -> FloatArray | None:
        """The columns of a test of every unit, for `separation`; None if a channel has no value in it."""
        parts = []
        for number, each in enumerate(self._records):
            for run in runs:
                columns = self._columns(run, number)
                if not np.isfinite(columns).all():
                    return None
                steps = np.diff(run.slot, prepend=run.slot[0])
                whitener = Whitener.of(each.stack.noise_model, each.noise, steps, np.ones(len(run)))
                parts.append(whitener(columns) / self._scale)
        return np.concatenate(parts)

    def separation(self, white: FloatArray, repeats: int, weights: FloatArray | None = None) -> Separation:
        """What `repeats` runs with these whitened columns would decide, over the rivals by `weights`."""
        gram = self._gram + repeats * (white.T @ white)
        powers, least = {}, np.inf
        rng = np.random.default_rng(self._seed)
        noise = white.T @ rng.standard_normal((repeats, len(white), DRAWS)).sum(axis=0)
        # a declared term that the runs so far hardly show is free in them, and large only by its rounding
        is_free = (np.linalg.norm(white, axis=0) > _FREE) & (np.arange(white.shape[1]) < self._known)
        for number, rival in enumerate(self.rivals):
            at, draws = self._posterior(number, rng)
            draws[is_free[at]] = 0.0
            right = self._right[:, None] + repeats * (white.T @ (white[:, at] @ draws)) + noise
            evidences = np.array([self._evidence(each, gram, right) for each in range(len(self.rivals))])
            powers[rival.effect.name] = float(np.mean(self._is_single(number, evidences)))
            apart = evidences[number] - np.delete(evidences, number, axis=0)
            least = min(least, float(apart.mean(axis=1).min()))
        shares = self.weights if weights is None else weights
        power = float(np.dot(shares, list(powers.values())))
        assured = min(each for each, share in zip(powers.values(), shares, strict=True) if share >= LIKELY)
        return Separation(power, powers, least, assured)

    def _posterior(self, number: int, rng: np.random.Generator) -> tuple[IntArray, FloatArray]:
        """The columns of the best shape of a rival, and draws of their coefficients; shape (columns, draws)."""
        places = self._places[number]
        at = max(places, key=lambda each: float(self._explained(each, self._gram, self._right[:, None])[0]))
        is_seen = np.diag(self._gram)[at] > 0.0
        seen = at[is_seen]
        own = self._gram[np.ix_(seen, seen)]
        own = own + _RIDGE * np.trace(own) * np.eye(seen.size)
        factor = np.linalg.cholesky(own)
        mean = np.linalg.solve(own, self._right[seen])
        draws = np.zeros((at.size, DRAWS))
        draws[is_seen] = mean[:, None] + np.linalg.solve(factor.T, rng.standard_normal((seen.size, DRAWS)))
        # an offset of a position that was never mounted is as large as the others
        sizes = (mean / self._scale[seen])[seen >= self._known]
        usual = float(np.sqrt(np.mean(sizes**2))) if sizes.size else 0.0
        draws[~is_seen] = usual * rng.standard_normal((np.count_nonzero(~is_seen), DRAWS))
        return at, draws

    def _is_single(self, number: int, evidences: FloatArray) -> BoolArray:
        """Whether a rival leads all others, by the rules of the search."""
        own, mine = evidences[number], self.rivals[number].effect
        others = [
            leads(own, mine, theirs, other.effect)
            for other, theirs in zip(self.rivals, evidences, strict=True)
            if other.effect.name != mine.name
        ]
        return np.asarray(np.all(others, axis=0) & (own > 0))


def rival(name: str, runs: Sequence[RunBlocks]) -> Rival:
    """A rival with every shape that the search tries on these runs."""
    found = effect(name)
    return Rival(found, tuple(found.shapes(runs)) or ({},))


def inseparable(names: Sequence[str], runs: Sequence[RunBlocks]) -> dict[str, tuple[str, ...]]:
    """By rival: others with the same column in all of these runs, such as an effect of a slope and a sensor's clock.

    Parameters
    ----------
    runs: Those of the unit and those of every test: alike in a few runs is not alike whatever is run.
    """
    shapes = {name: effect(name).shapes(runs) for name in names}
    single = [name for name in names if len(shapes[name]) == 1 and len(effect(name).columns(shapes[name][0])) == 1]
    columns = {
        name: np.concatenate([effect(name).regressors(run, shapes[name][0])[:, 0] for run in runs]) for name in single
    }
    found: dict[str, tuple[str, ...]] = {}
    for name in names:
        first = next((each for each in found if _is_same(columns.get(each), columns.get(name))), None)
        if first is None:
            found[name] = ()
        else:
            found[first] = (*found[first], name)
    return found


def _is_same(one: FloatArray | None, other: FloatArray | None) -> bool:
    if one is None or other is None:
        return False
    known = np.isfinite(one)
    if not np.array_equal(known, np.isfinite(other)):
        return False
    norms = float(np.linalg.norm(one[known]) * np.linalg.norm(other[known]))
    return abs(float(one[known] @ other[known])) > _SAME * norms > 0.0
