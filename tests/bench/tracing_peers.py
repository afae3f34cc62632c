"""Ordinary ways to choose effects, on the very same candidates: what is usually done with block means in a notebook.

All of them take the noise for white. Stepwise least squares stops at a p-value, plain or divided by the number of
candidates, at a p-value with Newey-West errors, or at the Bayesian information criterion; LassoCV keeps what has a
coefficient larger than a tenth of the largest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import stats

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effects_for
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.diagnosis import FIRST_TIER
from analytics.loop.tracing.search.screening import candidates_for
from stream.batch import BoolArray, FloatArray, IntArray

PEERS = ("stepwise p<0.01", "stepwise Bonferroni", "Newey-West p<0.01", "BIC", "LassoCV")
_MOST_TERMS = 10
_ALPHA = 0.01
_FOLDS, _PENALTIES, _SMALLEST_PENALTY = 5, 30, 1e-3
_LEAST_LEFT = 1e-2


@dataclass(frozen=True)
class Ordinary:
    """Training blocks as ordinary least squares sees them: a constant for each run and the declared model taken out.

    Parameters
    ----------
    value : array of shape (n,)
    columns : array of shape (n, k)
        Of unit length; zero where nothing is left.
    names : sequence of str
        Effect of each column.
    run : array of int, shape (n,)
        Number of the run of each block.
    """

    value: FloatArray
    columns: FloatArray
    names: Sequence[str]
    run: IntArray


def peers(runs: Sequence[RunBlocks], model: ErrorModel, rng: np.random.Generator) -> dict[str, list[str]]:
    """Names of the effects that each of `PEERS` chooses on the training runs."""
    data = ordinary(runs, model)
    size, tried = data.value.size, len(set(data.names))
    rules: dict[str, tuple[Callable[[float, float], bool], bool]] = {
        "stepwise p<0.01": (lambda p, gain: p > _ALPHA, False),
        "stepwise Bonferroni": (lambda p, gain: p * tried > _ALPHA, False),
        "Newey-West p<0.01": (lambda p, gain: p > _ALPHA, True),
        "BIC": (lambda p, gain: gain < np.log(size), False),
    }
    chosen = {name: stepwise(data, stops, robust=robust) for name, (stops, robust) in rules.items()}
    return {**chosen, "LassoCV": lasso(data, rng)}


def ordinary(runs: Sequence[RunBlocks], model: ErrorModel) -> Ordinary:
    """The training runs of a campaign with every candidate that the trace tries first."""
    case = case_of(runs, model, None)
    record = case.training
    candidates = candidates_for([record], effects_for(case.stack.runs), model.shaped(runs), FIRST_TIER, {})
    number = record.stack.run_number
    known = np.column_stack([np.equal.outer(number, np.unique(number)), record.design])
    basis, _ = np.linalg.qr(known / np.linalg.norm(known, axis=0))
    columns = candidates.columns(0)
    left = columns - basis @ (basis.T @ columns)
    length = np.linalg.norm(left, axis=0)
    reported = length > _LEAST_LEFT * np.linalg.norm(columns, axis=0)
    names = [item.effect.name for item in candidates.items for _ in range(item.width)]
    return Ordinary(
        value=record.value - basis @ (basis.T @ record.value),
        columns=np.where(reported, left / np.where(reported, length, 1.0), 0.0),
        names=names,
        run=number,
    )


def stepwise(data: Ordinary, stops: Callable[[float, float], bool], *, robust: bool) -> list[str]:
    """Forward selection until `stops(p_value, n*log(ratio of squares))`.

    Parameters
    ----------
    robust : bool
        Whether the p-value is that of Newey and West instead of white noise.
    """
    residual, columns, chosen = data.value.copy(), data.columns.copy(), list[str]()
    freedom = data.value.size - data.run.max() - 4
    while len(chosen) < _MOST_TERMS:
        length = np.linalg.norm(columns, axis=0)
        reported: BoolArray = length > _LEAST_LEFT
        along = np.where(reported, columns.T @ residual / np.where(reported, length, 1.0), 0.0)
        best = int(np.argmax(np.abs(along)))
        squares, won = float(residual @ residual), float(along[best] ** 2)
        unit = columns[:, best] / length[best]
        if robust:
            variance = _newey_west(unit * (residual - unit * along[best]), data.run)
        else:
            variance = (squares - won) / (freedom - len(chosen) - 1)
        p_value = float(stats.chi2.sf(won / variance, 1))
        if stops(p_value, data.value.size * float(np.log(squares / (squares - won)))):
            break
        residual = residual - unit * along[best]
        columns = columns - np.outer(unit, unit @ columns)
        chosen.append(data.names[best])
    return list(dict.fromkeys(chosen))


def _newey_west(score: FloatArray, run: IntArray) -> float:
    """Variance of a sum of scores, with the usual bandwidth 4 (n/100)^(2/9)."""
    total = 0.0
    for number in np.unique(run):
        own = score[run == number]
        width = int(4.0 * (own.size / 100.0) ** (2.0 / 9.0))
        total += float(own @ own)
        total += sum(2.0 * (1.0 - lag / (width + 1.0)) * float(own[lag:] @ own[:-lag]) for lag in range(1, width + 1))
    return max(total, 1e-300)


def lasso(data: Ordinary, rng: np.random.Generator) -> list[str]:
    """Effects with a coefficient larger than a tenth of the largest, the penalty chosen by five random folds."""
    fold = rng.permutation(np.arange(data.value.size) % _FOLDS)
    gram, right = data.columns.T @ data.columns, data.columns.T @ data.value
    penalties = float(np.abs(right).max()) * np.geomspace(1.0, _SMALLEST_PENALTY, _PENALTIES)
    error = np.zeros(_PENALTIES)
    for number in range(_FOLDS):
        out = fold == number
        held_columns, held_value = data.columns[out], data.value[out]
        paths = _path(gram - held_columns.T @ held_columns, right - held_columns.T @ held_value, penalties * 0.8)
        error += np.sum((held_value[:, None] - held_columns @ paths.T) ** 2, axis=0)
    size = np.abs(_path(gram, right, penalties)[int(np.argmin(error))])
    kept = np.flatnonzero(size > max(0.1 * float(size.max()), 1e-12))
    return list(dict.fromkeys(data.names[int(each)] for each in kept))


@njit(cache=True)
def _path(gram, right, penalties):  # type: ignore[no-untyped-def]
    """Coefficients at falling penalties by coordinate descent."""
    width = right.size
    paths = np.zeros((penalties.size, width))
    now = np.zeros(width)
    left = right.copy()
    for which in range(penalties.size):
        for _ in range(400):
            moved = 0.0
            for each in range(width):
                if gram[each, each] <= 1e-9:
                    continue
                along = left[each] + gram[each, each] * now[each]
                fresh = np.sign(along) * max(abs(along) - penalties[which], 0.0) / gram[each, each]
                step = fresh - now[each]
                if step != 0.0:
                    left -= step * gram[:, each]
                    now[each] = fresh
                    moved = max(moved, abs(step))
            if moved < 1e-3 * penalties[0]:
                break
        paths[which] = now
    return paths
