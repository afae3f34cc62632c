"""Separation of rival effects by a test: the probability that the true one is left as the single name.

Rivals k explain the data y as X_k theta beside the declared model. After a test, the residual sum of squares of each,
whitened by the unit's fitted noise, follows from normal equations; the evidence and the lead that it needs are those
of the search. The data so far are kept as they are; coefficients are drawn from their posterior, the noise of the
test anew. Box and Hill, Technometrics 9(1), 1967, 57-71; Atkinson and Fedorov, Biometrika 62(1), 1975, 57-70
(T-optimality).
"""

from collections.abc import Sequence
from dataclasses import dataclass

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
_RIDGE = 1e-12
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
    """

    power: float
    by_truth: dict[str, float]
    least: float


class RivalFit:
    """Rivals fitted to the runs so far, ready for the runs of a test.

    Parameters
    ----------
    stack: The runs that the search is given, their used blocks.
    others: Effects found beside the rivals, which every rival is fitted with.
    """

    def __init__(
        self,
        stack: Stack,
        model: ErrorModel,
        noise: ModelNoise,
        white: FloatArray,
        rivals: Sequence[Rival],
        others: Sequence[tuple[Effect, Shape]],
        seed: int = 0,
    ) -> None:
        self._model, self._noise, self.rivals, self._others = model, noise, tuple(rivals), tuple(others)
        self._noise_model = stack.noise_model
        self._seed = seed
        columns = stack.column(self._columns)
        whitener = Whitener.of(self._noise_model, noise, stack.steps, white)
        whole = whitener(np.column_stack([stack.value, columns]))
        self._scale = np.maximum(np.linalg.norm(whole[:, 1:], axis=0), 1e-300)
        scaled = whole[:, 1:] / self._scale
        self._gram, self._right = scaled.T @ scaled, scaled.T @ whole[:, 0]
        self._places = self._located()
        weights = np.array(
            [0.5 * self._evidence(each, self._gram, self._right[:, None])[0] for each in range(len(self.rivals))]
        )
        weights = np.exp(weights - weights.max())
        self.weights: FloatArray = weights / weights.sum()

    @property
    def _known(self) -> int:
        return len(self._model.labels()) + sum(len(one.columns(shape)) for one, shape in self._others)

    def _columns(self, run: RunBlocks) -> FloatArray:
        parts = [self._model.columns(run)]
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
        factor = np.linalg.cholesky(own + _RIDGE * np.trace(own) * np.eye(at.size))
        return np.asarray(np.sum(np.linalg.solve(factor, right[at]) ** 2, axis=0))

    def _evidence(self, number: int, gram: FloatArray, right: FloatArray) -> FloatArray:
        rival = self.rivals[number]
        without = self._explained(np.arange(self._known), gram, right)
        best = np.max([self._explained(at, gram, right) for at in self._places[number]], axis=0)
        return one_degree(best - without, rival.degrees) - penalty(rival.effect)

    def whitened(self, run: RunBlocks) -> FloatArray | None:
        """The columns of a test, for `separation`; None if a channel has no value in it."""
        columns = self._columns(run)
        if not np.isfinite(columns).all():
            return None
        steps = np.diff(run.slot, prepend=run.slot[0])
        whitener = Whitener.of(self._noise_model, self._noise, steps, np.ones(len(run)))
        return np.asarray(whitener(columns) / self._scale)

    def separation(self, white: FloatArray, repeats: int) -> Separation:
        """What `repeats` runs with these whitened columns would decide."""
        gram = self._gram + repeats * (white.T @ white)
        powers, least = {}, np.inf
        rng = np.random.default_rng(self._seed)
        noise = white.T @ rng.standard_normal((repeats, len(white), DRAWS)).sum(axis=0)
        for number, rival in enumerate(self.rivals):
            at, draws = self._posterior(number, rng)
            right = self._right[:, None] + repeats * (white.T @ (white[:, at] @ draws)) + noise
            evidences = np.array([self._evidence(each, gram, right) for each in range(len(self.rivals))])
            powers[rival.effect.name] = float(np.mean(self._is_single(number, evidences)))
            apart = evidences[number] - np.delete(evidences, number, axis=0)
            least = min(least, float(apart.mean(axis=1).min()))
        power = float(np.dot(self.weights, list(powers.values())))
        return Separation(power, powers, least)

    def _posterior(self, number: int, rng: np.random.Generator) -> tuple[IntArray, FloatArray]:
        """The columns of the best shape of a rival, and draws of their coefficients; shape (columns, draws)."""
        places = self._places[number]
        at = max(places, key=lambda each: float(self._explained(each, self._gram, self._right[:, None])[0]))
        own = self._gram[np.ix_(at, at)]
        own = own + _RIDGE * np.trace(own) * np.eye(at.size)
        factor = np.linalg.cholesky(own)
        mean = np.linalg.solve(own, self._right[at])
        return at, mean[:, None] + np.linalg.solve(factor.T, rng.standard_normal((at.size, DRAWS)))

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
    """By rival: others with the same columns whatever is run, such as an effect of a slope and a sensor's clock."""
    columns = {name: _direction(name, runs) for name in names}
    found: dict[str, tuple[str, ...]] = {}
    for name, own in columns.items():
        first = next((each for each in found if _is_same(columns[each], own)), None)
        if first is None:
            found[name] = ()
        else:
            found[first] = (*found[first], name)
    return found


def _direction(name: str, runs: Sequence[RunBlocks]) -> FloatArray | None:
    """The one column of a rival without parameters, of length one."""
    shapes = effect(name).shapes(runs)
    if len(shapes) != 1 or len(effect(name).columns(shapes[0])) != 1:
        return None
    column = np.concatenate([effect(name).regressors(run, shapes[0])[:, 0] for run in runs])
    column = column[np.isfinite(column)]
    return np.asarray(column / max(float(np.linalg.norm(column)), 1e-300))


def _is_same(one: FloatArray | None, other: FloatArray | None) -> bool:
    return one is not None and other is not None and one.size == other.size and abs(float(one @ other)) > _SAME
