"""By how much the squared error falls, with an interval over runs (Diebold and Mariano, clustered by run)."""

import numpy as np
from scipy import stats

from analytics.loop.tracing.error_result import ErrorGain
from stream.batch import FloatArray, IntArray

_CONFIDENCE = 0.975
"""Two-sided 95 %."""


def error_gain(before: FloatArray, after: FloatArray, run: IntArray) -> ErrorGain | None:
    """Share of the squared error that the model found takes away; None where there is no error.

    Parameters
    ----------
    before, after: shape (averages,); error of each average with the declared model and with the model found.
    run: shape (averages,); which run each average belongs to.

    Notes
    -----
    Averages of one run share its turn-on bias and its drift, so that the runs are the sample. The fraction is the ratio
    of two sums over runs, of before**2 - after**2 and of before**2; its standard error is that of a ratio estimate,
    with Student's t of (runs - 1) degrees of freedom.

    Examples
    --------
    >>> before, after = np.array([3.0, 3.0, 3.1, 2.9]), np.array([1.0, 1.1, 0.9, 1.0])
    >>> error_gain(before, after, np.array([0, 0, 1, 1])).is_significant
    True
    """
    squares = float(np.sum(before**2))
    if squares == 0:
        return None
    numbers, of_run = np.unique(run, return_inverse=True)
    won = np.bincount(of_run, before**2 - after**2)
    fraction = float(won.sum()) / squares
    count = numbers.size
    if count < 2:
        return ErrorGain(fraction, None, None, count)
    left = won - fraction * np.bincount(of_run, before**2)
    se = float(np.sqrt(count / (count - 1) * np.sum(left**2))) / squares
    half = float(stats.t.ppf(_CONFIDENCE, count - 1)) * se
    return ErrorGain(fraction, fraction - half, fraction + half, count)


def less_run_means(values: FloatArray, run: IntArray) -> FloatArray:
    """Values less the mean of their run.

    Examples
    --------
    >>> less_run_means(np.array([1.0, 3.0, 5.0]), np.array([0, 0, 7])).tolist()
    [-1.0, 1.0, 0.0]
    """
    _, of_run = np.unique(run, return_inverse=True)
    return np.asarray(values - (np.bincount(of_run, values) / np.bincount(of_run))[of_run])
