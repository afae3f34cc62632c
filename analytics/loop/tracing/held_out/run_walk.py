"""Compare an effect that shifts whole runs with a bias that walks from run to run."""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import null_space

from analytics.loop.tracing.held_out.held_out_set import HeldOutSet
from analytics.loop.tracing.result.holdout import Holdout
from analytics.loop.tracing.search.between_runs import free_biases
from analytics.loop.tracing.search.effect_search import Search
from stream.batch import FloatArray

SEEN_WITHIN_RUNS = 5.0  # standard errors, with a free bias in each run, from which the runs themselves show an effect
ALONG = 0.9  # correlation of an effect's means with the order of the runs from which ageing looks like it
_WALK_SHARES = np.linspace(0.0, 1.0, 41)
_FEWEST_RUNS = 3


def against_walk(holdout: Holdout | None, boxes: Sequence[HeldOutSet], found: Search) -> Holdout | None:
    """The answers; an effect that a walk of the bias from run to run explains as well is not confirmed.

    A trend over days and a random walk over the same days look alike in few runs, and the held-out runs continue the
    walk where the others ended. Effects that the blocks within the runs show are not concerned.
    """
    if holdout is None:
        return None
    for number, each in enumerate(found.common):
        slope = holdout.slope(each.name)
        if slope is None or seen_within_runs(boxes, found, number):
            continue
        columns = found.common_columns(each)
        # all units share the coefficients, which are paid for once
        fitted = [columns.stop - columns.start, *[1] * (len(boxes) - 1)]
        odds = [log_odds(*of_runs(box, number), many) for box, many in zip(boxes, fitted, strict=True)]
        known = [one for one in odds if one is not None]
        if known:
            holdout = holdout.beside_walk(each.name, float(sum(known)))
    return holdout


def follow_order(box: HeldOutSet, found: Search) -> set[str]:
    """Names of effects that shift whole runs, and change along with the order of runs whose dates are not known.

    What ages from run to run looks like them; with dates, ageing is a candidate itself.
    """
    runs = box.record.stack.runs
    if len(runs) < _FEWEST_RUNS + 1 or all(run.is_date_known for run in runs):
        return set()
    names = set()
    for number, each in enumerate(found.common):
        _, mean, _ = of_runs(box, number)
        if np.ptp(mean) > 0 and not seen_within_runs([box], found, number):
            along = float(np.corrcoef(mean, np.arange(mean.size))[0, 1])
            if abs(along) > ALONG:
                names.add(each.name)
    return names


def log_odds(bias: FloatArray, effect: FloatArray, day: FloatArray, coefficients: int = 1) -> float | None:
    """Log likelihood of independent biases beside the effect, less that of a random walk of the bias without it.

    Likelihoods are of contrasts between runs, at the best size of the effect, variance and share of the walk. The walk
    proceeds with the days or with the number of runs, whichever fits better. Further coefficients of the effect cost as
    in the corrected criterion of Akaike (Hurvich and Tsai, doi:10.1093/biomet/76.2.297); with too many of them for so
    few runs nothing is compared, and the odds are even.

    Parameters
    ----------
    bias: Mean of each run, in the order of time.
    effect: Prediction of each run.
    day: Start of each run, days.
    coefficients: How many the effect has, fitted to these runs.

    Returns
    -------
    None if fewer than three runs, or the effect is alike in all.

    Examples
    --------
    >>> day = np.arange(15.0)
    >>> trend = 2 * day + np.array([3, -5, 1, 4, -2, -4, 5, 0, -3, 2, -4, 3, -2, 1, 1.0])
    >>> walk = np.array([-19, -12, -10, -8, -7, -1, 3, 16, 16, 24, 23, 21, 23, 23, 21.0])
    >>> round(log_odds(trend, day, day), 1), round(log_odds(walk, day, day), 1)
    (6.0, -1.9)
    """
    size = bias.size
    if size < _FEWEST_RUNS:
        return None
    contrasts = null_space(np.ones((1, size)))
    value, column = contrasts.T @ bias, contrasts.T @ effect
    strength = float(column @ column)
    if strength <= 1e-18 * max(1.0, float(effect @ effect)):
        return None
    left = value - column * (float(column @ value) / strength)
    least = 1e-12 * float(value @ value) / value.size  # an exact fit is no certainty
    independent = -0.5 * value.size * np.log(max(float(left @ left) / value.size, least, 1e-300))
    clocks = [np.arange(size, dtype=float), day - day[0]]
    walks = [_walk(value, contrasts, clock, least) for clock in clocks if np.ptp(clock) > 0]
    more = _cost(coefficients + 1, value.size) - _cost(2, value.size) if coefficients > 1 else 0.0
    return float(independent - max(walks) - more) if np.isfinite(more) else 0.0


def _cost(parameters: int, values: int) -> float:
    """Half of the penalty of the corrected criterion of Akaike; infinite with too few values."""
    left = values - parameters - 1
    return parameters + parameters * (parameters + 1) / left if left > 0 else np.inf


def _walk(value: FloatArray, contrasts: FloatArray, clock: FloatArray, least: float) -> float:
    """Largest log likelihood of a random walk along the clock and independent biases, over the share of the walk."""
    covariance = contrasts.T @ np.minimum.outer(clock, clock) @ contrasts
    powers, axes = np.linalg.eigh(covariance * value.size / np.trace(covariance))
    squared = (axes.T @ value) ** 2
    variances = (1 - _WALK_SHARES[:, None]) + _WALK_SHARES[:, None] * np.maximum(powers, 1e-12)
    scale = np.maximum((squared / variances).mean(axis=1), max(least, 1e-300))
    return float(np.max(-0.5 * value.size * np.log(scale) - 0.5 * np.log(variances).sum(axis=1)))


def seen_within_runs(boxes: Sequence[HeldOutSet], found: Search, number: int, size: float = 1.0) -> bool:
    """Whether the blocks show an effect of this size, relative to that predicted, about the bias of each run."""
    squared = 0.0
    for at, box in enumerate(boxes):
        whitened = box.record.whitener(free_biases(found.joint.noises[at]))(box.predictions[:, number : number + 1])
        squared += float((whitened**2).sum())
    return size**2 * squared >= SEEN_WITHIN_RUNS**2


def of_runs(box: HeldOutSet, number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean of the signal less all other effects, mean of the effect, and day, of each run of a unit."""
    stack = box.record.stack
    effect = box.predictions[:, number]
    others = box.predictions.sum(axis=1) - effect
    blocks = np.bincount(stack.run_number)
    bias, mean = (np.bincount(stack.run_number, each) / blocks for each in (box.before - others, effect))
    started_ns = np.array([run.t0_ns for run in stack.runs])
    return bias, mean, (started_ns - started_ns[0]) / 86_400e9
