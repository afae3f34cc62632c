"""The error before and after at several averaging times, the noise floor, and the gain with its bounds over runs."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.held_out.held_out_set import (
    SAME_SIZE,
    HeldOutSet,
    fit_with_training,
    fitted_error,
    information,
)
from analytics.loop.tracing.result.holdout import REFERENCE_S, ErrorAt, ErrorGain, ErrorTable, ExpectedGain
from analytics.loop.tracing.search.effect_search import Search
from analytics.loop.tracing.whitening.noise_variance import (
    Averages,
    averages_of,
    expected_variance,
    squares_spread,
    within_run_variance,
)
from analytics.methods.distributions import f_quantile, normal_isf, student_quantile
from stream.batch import FloatArray, IntArray

AVERAGING_S = (300.0, 1800.0, 3600.0)
MOST_BY_CHANCE = 0.999
FAR_ABOVE_FLOOR = 1.5  # ratio to the floor, which is limited to the noise expected once in 1000 sets of runs
LEAST_TO_GAIN = 0.02  # excess of the squared error over the floor, relative to it, below which nothing can be gained
LEAST_SPANNED = 0.9  # share of an averaging time that the longest run must span: a run may begin within a block
EXCITED = 0.25  # an average excites the effect if the prediction exceeds this part of its maximum
_CONFIDENCE = 0.975  # two-sided 95 %
_NORMAL = normal_isf(1 - _CONFIDENCE)


class _Squares(NamedTuple):
    """Squared averages before and after, and the noise variance of each."""

    before: FloatArray
    after: FloatArray
    floor: FloatArray


def error_table(box: HeldOutSet, found: Search, names: Sequence[str], *, is_held_out: bool) -> ErrorTable:
    """Errors on the blocks of a held-out set, the runs `names`.

    The floor is the noise in these runs, including the error of the declared coefficients: the residual less the likely
    error of the sizes of the effects, as noise model and training separate the two. If it exceeds the noise model by
    more than chance, each run counted once, structure is left, and the floor is the largest value expected by chance.
    """
    record = box.record
    rows = np.flatnonzero(box.held_out)
    noise = found.joint.noises[0]
    left, error = _noise_alone(box, found)
    trained = np.unique(record.stack.run_number[~box.held_out]).size if is_held_out else 1
    runs = np.unique(record.stack.run_number[rows]).size, trained
    has_effect = bool(box.predictions.any())
    table, fractions = [], {}
    averages_at = dict(_averages(box))
    for seconds, averages in averages_at.items():
        allowed = expected_variance(record, noise, averages)
        raw = averages.of(box.before_alone), averages.of(box.after)
        squares = _Squares(raw[0] ** 2, raw[1] ** 2, _floor(averages, left, error, box, allowed, runs))
        driven = np.abs(averages.of(box.predictions.sum(axis=1)))
        excited = driven > EXCITED * driven.max(initial=0.0)
        rms = [float(np.sqrt(each.mean())) for each in squares]
        on = [float(np.sqrt(each[excited].mean())) if excited.any() else None for each in squares]
        run = record.stack.run_number[averages.first]
        within = less_run_means(raw[0], run), less_run_means(raw[1], run)
        row = ErrorAt(
            averaging_s=seconds,
            before=rms[0],
            after=rms[1],
            floor=rms[2],
            averages=run.size,
            allowed=float(np.hypot(FAR_ABOVE_FLOOR * rms[2], SAME_SIZE * _size_error(averages, box, found))),
            excited_before=on[0],
            excited_after=on[1],
            excited_floor=on[2],
            before_within=float(np.sqrt(np.mean(within[0] ** 2))),
            after_within=float(np.sqrt(np.mean(within[1] ** 2))),
            floor_within=float(np.sqrt(within_run_variance(record, noise, averages))),
            gain=error_gain(*raw, run) if has_effect else None,
            gain_within=error_gain(*within, run) if has_effect else None,
        )
        table.append(row)
        fractions[seconds] = _fraction(squares), _fraction(_Squares(*(each[excited] for each in squares)))
    whole, on_excited = fractions.get(REFERENCE_S, (None, None)) if has_effect else (None, None)
    unit_of_measure = record.stack.runs[0].unit_of_measure
    gain = expected_gain(box, averages_at, noise) if has_effect else None
    return ErrorTable(tuple(names), is_held_out, unit_of_measure, tuple(table), whole, on_excited, gain)


def expected_gain(box: HeldOutSet, averages_at: Mapping[float, Averages], noise: ModelNoise) -> ExpectedGain | None:
    """Relative decrease of the mean squared error about the mean of each run, expected of new runs like these.

    It is that at the averaging time, up to 1800 s, at which the predictions exceed the noise model most: an effect of
    seconds takes nothing away from averages of half an hour. The signal of the held-out runs does not choose it.

    The systematic error is Z u with the declared model alone and Z v with the effects; Z are the averages, about the
    mean of each run, of the predictions and of the declared columns. Generalised least squares in the held-out runs
    finds u and v, the errors of the declared coefficients having their covariance of the training. With the squares N
    of what is left, the gain is (u'Z'Z u - v'Z'Z v) / (u'Z'Z u + N); the bounds propagate the covariance and the
    scatter of N under the noise model. As each frequency is weighted by its noise, they are far closer than those of a
    difference of squared errors, which drift dominates (`error_gain`). None where the effects predict nothing within
    runs.
    """
    strength = {
        seconds: _strength(box, averages, noise) for seconds, averages in averages_at.items() if seconds <= REFERENCE_S
    }
    seconds = max(strength, key=lambda each: (strength[each], each), default=None)
    if seconds is None or not strength[seconds] > 0:
        return None
    averages = averages_at[seconds]
    run = box.record.stack.run_number[averages.first]
    columns = np.column_stack([box.predictions, box.record.design])
    within = np.column_stack([less_run_means(each, run) for each in averages.of(columns).T])
    width = box.predictions.shape[1]
    power, fitted = within.T @ within, fitted_error(box)
    left = less_run_means(averages.of(box.before), run) - within @ fitted.coefficients
    alone = fitted.coefficients + np.concatenate([np.zeros(width), box.declared - box.declared_alone.coefficients])
    effects = fitted.coefficients - np.concatenate([np.ones(width), np.zeros(box.declared.size)])
    before = float(alone @ power @ alone + left @ left)
    gain = float(alone @ power @ alone - effects @ power @ effects) / before
    by_size = 2 * power @ (alone - effects - gain * alone) / before
    by_noise = gain * float(left @ left) / before * squares_spread(box.record, noise, averages)
    half = _NORMAL * float(np.sqrt(by_size @ fitted.covariance @ by_size + by_noise**2))
    return ExpectedGain(gain, gain - half, min(1.0, gain + half), np.unique(run).size, averaging_s=seconds)


def _strength(box: HeldOutSet, averages: Averages, noise: ModelNoise) -> float:
    """Mean square of the predictions about the mean of each run over the variance of the noise."""
    predicted = averages.of(box.predictions.sum(axis=1))
    within = less_run_means(predicted, box.record.stack.run_number[averages.first])
    variance = within_run_variance(box.record, noise, averages)
    return float(np.mean(within**2)) / variance if variance > 0 else 0.0


def error_shares(box: HeldOutSet, found: Search) -> dict[str, float]:
    """Share of the squared error about the mean of each run that each common effect takes away.

    (2 sum(b * p) - sum(s * p)) / sum(b**2) with the prediction p of the effect, the sum s of all predictions, and the
    error b before, of averages over the longest time up to 1800 s of which the runs have several. The shares add up to
    the decrease of the error, which is at most 1; an effect that makes predictions worse has a negative share.
    """
    for _, averages in reversed([each for each in _averages(box) if each[0] <= REFERENCE_S]):
        run = box.record.stack.run_number[averages.first]
        before = less_run_means(averages.of(box.before), run)
        whole = float(before @ before)
        if run.size == np.unique(run).size or not whole > 0:
            continue
        predictions = averages.of(box.predictions)
        predictions = np.column_stack(
            [less_run_means(each, run) for each in predictions.T] or [np.empty((run.size, 0))]
        )
        shares = predictions.T @ (2.0 * before - predictions.sum(axis=1)) / whole
        return {each.name: float(share) for each, share in zip(found.common, shares, strict=True)}
    return {}


def _averages(box: HeldOutSet) -> list[tuple[float, Averages]]:
    """The averages of the held-out blocks at each averaging time that the runs are long enough for."""
    record, rows = box.record, np.flatnonzero(box.held_out)
    block_s = record.noise_model.block_s
    number, slot = record.stack.run_number[rows], record.stack.slot[rows]
    longest_s = max(np.ptp(slot[number == run]) + 1 for run in np.unique(number)) * block_s
    times = [block_s, *(each for each in AVERAGING_S if each > block_s and LEAST_SPANNED * each <= longest_s)]
    found = [(seconds, averages_of(record, max(1, round(seconds / block_s)), rows)) for seconds in times]
    return [(seconds, averages) for seconds, averages in found if averages.rows]


def _noise_alone(box: HeldOutSet, found: Search) -> tuple[FloatArray, FloatArray]:
    """Residual less the likely error of the sizes of the effects, and the covariance of the remaining size error."""
    width = box.predictions.shape[1]
    known = np.array([information(found, each) for each in found.common])
    solution = fit_with_training(box, box.whitened_after, known)
    return box.after - box.predictions @ solution.coefficients[:width], solution.covariance[:width, :width]


def _size_error(averages: Averages, box: HeldOutSet, found: Search) -> float:
    """RMS of the averages by the standard errors of the sizes of the effects in the training."""
    sizes = np.array([1.0 / max(information(found, each), 1e-12) for each in found.common])
    return float(np.sqrt(np.mean(averages.of(box.predictions) ** 2 @ sizes)))


def _floor(
    averages: Averages, left: FloatArray, error: FloatArray, box: HeldOutSet, allowed: FloatArray, runs: tuple[int, int]
) -> FloatArray:
    predictions = averages.of(box.predictions)
    present = averages.of(left) ** 2 + np.einsum("ij,jk,ik->i", predictions, error, predictions)
    most = f_quantile(MOST_BY_CHANCE, *runs)
    return np.asarray(present * min(1.0, most * allowed.sum() / max(float(present.sum()), 1e-300)))


def _fraction(squares: _Squares) -> float | None:
    """Share of the achievable gain; None if the error was at the floor before."""
    could = float(squares.before.sum() - squares.floor.sum())
    if could <= LEAST_TO_GAIN * float(squares.floor.sum()):
        return None
    return float(squares.before.sum() - squares.after.sum()) / could


def error_gain(before: FloatArray, after: FloatArray, run: IntArray) -> ErrorGain | None:
    """Relative decrease of the squared error of averages, with bounds over runs; None without an error.

    Averages of one run share its turn-on bias and drift, so that the runs are the sample (Diebold and Mariano,
    clustered by run). The fraction is the ratio of the sums over runs of before**2 - after**2 and of before**2; its
    standard error is that of a ratio estimate, with Student's t of (runs - 1) degrees of freedom.

    >>> before, after = np.array([3.0, 3.0, 3.1, 2.9]), np.array([1.0, 1.1, 0.9, 1.0])
    >>> error_gain(before, after, np.array([0, 0, 1, 1])).is_significant
    True
    """
    squares = float(np.sum(before**2))
    if squares == 0:
        return None
    numbers, of_run = np.unique(run, return_inverse=True)
    gained = np.bincount(of_run, before**2 - after**2)
    fraction = float(gained.sum()) / squares
    count = numbers.size
    if count < 2:
        return ErrorGain(fraction, None, None, count)
    left = gained - fraction * np.bincount(of_run, before**2)
    se = float(np.sqrt(count / (count - 1) * np.sum(left**2))) / squares
    half = float(student_quantile(_CONFIDENCE, count - 1)) * se
    return ErrorGain(fraction, fraction - half, min(1.0, fraction + half), count)


def less_run_means(values: FloatArray, run: IntArray) -> FloatArray:
    """Values less the mean of their run.

    >>> less_run_means(np.array([1.0, 3.0, 5.0]), np.array([0, 0, 7])).tolist()
    [-1.0, 1.0, 0.0]
    """
    _, of_run = np.unique(run, return_inverse=True)
    return np.asarray(values - (np.bincount(of_run, values) / np.bincount(of_run))[of_run])
