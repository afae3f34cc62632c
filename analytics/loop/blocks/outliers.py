"""Outliers: readings far outside of those beside them, and short motion that other rates show as well."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from analytics.loop.blocks.signal_blocks import CALM, FAR
from stream.batch import BoolArray, FloatArray

_ALIKE = 3.0  # largest ratio of two rates that sense the same motion about different axes
_LEAST_SENTINEL = 99.0  # two rates that suddenly read the same number, at least this large, read a fill value
_SAME = 1e-12


def is_far_outside(value: FloatArray) -> BoolArray:
    """Mark readings that leave those before and after by more than a hundred times the usual difference.

    A reading among three on either side that move as well is motion.

    >>> is_far_outside(np.array([20.0, 20.1, 20.0, -9999.0, 20.1, 20.2, 20.1])).nonzero()[0].tolist()
    [3]
    """
    moves = np.abs(np.diff(value))
    if not (moves > 0).any():
        return np.zeros(len(value), dtype=np.bool_)
    usual = float(np.median(moves)) or float(np.median(moves[moves > 0]))
    before, after = np.concatenate([value[1:2], value[:-1]]), np.concatenate([value[1:], value[-2:-1]])
    above, below = value - np.maximum(before, after), np.minimum(before, after) - value
    beyond = np.maximum(above, below)
    return np.asarray((beyond > FAR * usual) & (_unrest(value) <= CALM * beyond))


def _unrest(value: FloatArray) -> FloatArray:
    """Range of the three readings before and the three after each."""
    padded = np.concatenate([np.full(3, np.nan), value, np.full(3, np.nan)])
    beside = np.stack([padded[at : at + value.size] for at in (0, 1, 2, 4, 5, 6)])
    return np.asarray(np.nanmax(beside, axis=0) - np.nanmin(beside, axis=0))


class RateSeries(NamedTuple):
    """One angular rate in the blocks of a run, deg/s, outliers included; blocks with an outlier; and that outlier."""

    value: FloatArray
    is_far: BoolArray
    reading: FloatArray  # in the unit in which it was stored; NaN where there is no outlier


def moves(value: FloatArray) -> BoolArray:
    """Mark blocks in which a rate differs from the block before or after by far more than usual.

    >>> moves(np.array([0.0, 0.1, 0.0, 50.0, 0.0, 0.1, 0.0, 0.1, 0.0, 0.1])).nonzero()[0].tolist()
    [2, 3, 4]
    """
    steps = np.abs(np.diff(value))
    known = steps[np.isfinite(steps)]
    usual = float(np.median(known)) if known.size else 0.0
    far = np.nan_to_num(steps) > FAR * usual
    return np.asarray(np.concatenate([far, [False]]) | np.concatenate([[False], far]))


def motion(series: Mapping[str, RateSeries]) -> dict[str, BoolArray]:
    """Mark, for each rate, the outliers that are motion: another rate shows it in the same block.

    Two rates confirm each other where both leave their neighbours in one block by amounts within a factor of three. A
    fill value occurs in one column only, or in several as the same number.

    >>> still, turned = np.array([0.0, 0, 0, 5, 0, 0]), np.array([0.0, 0, 0, 4.9, 0, 0])
    >>> far = np.arange(6) == 3
    >>> read = [np.where(far, each, np.nan) for each in (still, turned)]
    >>> found = motion({"rate": RateSeries(still, far, read[0]), "table_rate": RateSeries(turned, far, read[1])})
    >>> found["rate"].nonzero()[0].tolist()
    [3]
    >>> fill = {name: RateSeries(1e4 * still, far, 1e4 * read[0]) for name in ("rate", "table_rate")}
    >>> motion(fill)["rate"].any()
    np.False_
    """
    departure = {name: _departure(each.value) for name, each in series.items()}
    moving = {name: moves(each.value) for name, each in series.items()}
    confirmed = {name: moving[name] & ~each.is_far for name, each in series.items()}
    names = list(series)
    for name in names:
        for other in names:
            if other == name:
                continue
            one, two = series[name].reading, series[other].reading
            same = (np.abs(one - two) <= _SAME * np.abs(one)) & (np.abs(one) >= _LEAST_SENTINEL)
            alike = (departure[name] <= _ALIKE * departure[other]) & (departure[other] <= _ALIKE * departure[name])
            confirmed[name] = confirmed[name] | (series[name].is_far & moving[other] & alike & ~same)
    found = {}
    for name in names:
        shown = np.zeros_like(series[name].is_far)
        for other in names:
            shown |= confirmed[other] & (departure[name] <= _ALIKE * departure[other])
        found[name] = np.asarray(series[name].is_far & shown)
    return found


def _departure(value: FloatArray) -> FloatArray:
    """Distance of each block from the median of the two before and the two after it; 0 where it is unknown."""
    padded = np.concatenate([np.full(2, np.nan), value, np.full(2, np.nan)])
    beside = np.stack([padded[at : at + value.size] for at in (0, 1, 3, 4)])
    known = np.isfinite(beside)
    filled = np.sort(np.where(known, beside, np.inf), axis=0)
    count = known.sum(axis=0)
    columns = np.arange(value.size)
    low, high = np.maximum((count - 1) // 2, 0), np.minimum(count // 2, 3)
    middle = 0.5 * (filled[low, columns] + filled[high, columns])
    departure = np.where(count > 0, np.abs(value - np.where(count > 0, middle, 0.0)), 0.0)
    return np.asarray(np.nan_to_num(departure))
