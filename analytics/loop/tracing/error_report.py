"""The error before and after, and the floor that noise sets, at several averaging times."""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from scipy import stats

from analytics.loop.tracing.error_gain import error_gain, less_run_means
from analytics.loop.tracing.error_result import ErrorAt, ErrorTable
from analytics.loop.tracing.held_out_set import HeldOutSet
from analytics.loop.tracing.least_squares import solve
from analytics.loop.tracing.noise_floor import Averages, averages_of, expected_variance, within_run_variance
from analytics.loop.tracing.record import Record
from analytics.loop.tracing.selection import Search
from stream.batch import BoolArray, FloatArray, IntArray

AVERAGING_S = (300.0, 1800.0, 3600.0)
REFERENCE_S = 1800.0
MOST_BY_CHANCE = 0.999
LEAST_TO_WIN = 0.02
"""Part of the floor by which the squared error must exceed it for anything to be there to be won."""
LEAST_SPANNED = 0.9
"""Part of an averaging time that the longest run must span: a run may begin or end in the middle of a block."""
EXCITED = 0.25
"""An effect is excited where it reaches this part of its largest average."""


class _Squares(NamedTuple):
    """Squared averages before and after, and the variance that noise leaves in each."""

    before: FloatArray
    after: FloatArray
    floor: FloatArray


def error_table(box: HeldOutSet, found: Search, names: Sequence[str], *, is_held_out: bool) -> ErrorTable:
    """Return the table on the blocks of a held-out set.

    The floor is what the noise leaves in these very runs, the error of the declared coefficients included: the residual
    less what is likely an error in the sizes of the effects, as the noise model and the training tell the two apart.
    Where that is more than the noise model allows by chance, each run counted once, structure is left, and the floor is
    the most that it allows.
    """
    record = box.record
    rows = np.flatnonzero(box.held_out)
    noise = found.joint.noises[0]
    block_s = record.noise_model.block_s
    left, error = _noise_alone(box, found)
    trained = np.unique(record.stack.run_number[~box.held_out]).size if is_held_out else 1
    runs = np.unique(record.stack.run_number[rows]).size, trained
    longest_s = max(np.ptp(record.stack.slot[rows][of_run]) + 1 for of_run in _by_run(record, rows)) * block_s
    times = [block_s, *(each for each in AVERAGING_S if each > block_s and LEAST_SPANNED * each <= longest_s)]
    table, fractions = [], {}
    for seconds in times:
        averages = averages_of(record, max(1, round(seconds / block_s)), rows)
        if not averages.rows:
            continue
        allowed = expected_variance(record, noise, averages)
        squares = _Squares(
            averages.of(box.before_alone) ** 2,
            averages.of(box.after) ** 2,
            _floor(averages, left, error, box, allowed, runs),
        )
        driven = np.abs(averages.of(box.predictions.sum(axis=1)))
        excited = driven > EXCITED * driven.max(initial=0.0)
        row = _row(seconds, squares, excited)
        table.append(_within_runs(row, box, averages, within_run_variance(record, noise, averages)))
        fractions[seconds] = _fraction(squares), _fraction(_Squares(*(each[excited] for each in squares)))
    whole, on_excited = fractions.get(REFERENCE_S, (None, None)) if box.predictions.any() else (None, None)
    return ErrorTable(tuple(names), is_held_out, record.stack.runs[0].unit_of_measure, tuple(table), whole, on_excited)


def _by_run(record: Record, rows: IntArray) -> list[BoolArray]:
    number = record.stack.run_number[rows]
    return [number == run for run in np.unique(number)]


def _noise_alone(box: HeldOutSet, found: Search) -> tuple[FloatArray, FloatArray]:
    """Residual less the likely error of the sizes of the effects, and the covariance of what is left of that error."""
    width = box.predictions.shape[1]
    whitened = box.whitened[:, 1:]
    residual = box.whitened[:, 0] - whitened[:, :width].sum(axis=1)
    known = np.zeros((whitened.shape[1], whitened.shape[1]))
    known[width:, width:] = np.linalg.pinv(box.covariance)
    for number, each in enumerate([each for each in found.selected if each.is_common]):
        at = found.common_columns(each)
        theta, covariance = found.joint.common.coefficients[at], found.joint.common.covariance[at, at]
        known[number, number] = float(theta @ np.linalg.pinv(covariance) @ theta)
    solution = solve(known + whitened.T @ whitened, whitened.T @ residual)
    return box.after - box.predictions @ solution.coefficients[:width], solution.covariance[:width, :width]


def _floor(
    averages: Averages, left: FloatArray, error: FloatArray, box: HeldOutSet, allowed: FloatArray, runs: tuple[int, int]
) -> FloatArray:
    predictions = averages.of(box.predictions)
    there = averages.of(left) ** 2 + np.einsum("ij,jk,ik->i", predictions, error, predictions)
    most = float(stats.f.ppf(MOST_BY_CHANCE, *runs))
    return np.asarray(there * min(1.0, most * allowed.sum() / max(float(there.sum()), 1e-300)))


def _row(seconds: float, squares: _Squares, excited: FloatArray) -> ErrorAt:
    rms = [float(np.sqrt(each.mean())) for each in squares]
    on = [float(np.sqrt(each[excited].mean())) if excited.any() else None for each in squares]
    return ErrorAt(
        averaging_s=seconds,
        before=rms[0],
        after=rms[1],
        floor=rms[2],
        averages=squares.before.size,
        excited_before=on[0],
        excited_after=on[1],
        excited_floor=on[2],
    )


def _within_runs(row: ErrorAt, box: HeldOutSet, averages: Averages, variance: float) -> ErrorAt:
    """Return the row with the errors about the mean of each run, and how much the errors fall."""
    run = np.array([box.record.stack.run_number[rows[0]] for rows in averages.rows])
    raw = averages.of(box.before_alone), averages.of(box.after)
    within = less_run_means(raw[0], run), less_run_means(raw[1], run)
    has_effect = bool(box.predictions.any())
    return msgspec.structs.replace(
        row,
        before_within=float(np.sqrt(np.mean(within[0] ** 2))),
        after_within=float(np.sqrt(np.mean(within[1] ** 2))),
        floor_within=float(np.sqrt(variance)),
        gain=error_gain(*raw, run) if has_effect else None,
        gain_within=error_gain(*within, run) if has_effect else None,
    )


def _fraction(squares: _Squares) -> float | None:
    """Part of what could be won that was won; None where the error was at the floor already."""
    could = float(squares.before.sum() - squares.floor.sum())
    if could <= LEAST_TO_WIN * float(squares.floor.sum()):
        return None
    return float(squares.before.sum() - squares.after.sum()) / could
