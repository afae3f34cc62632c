"""Channels beside a signal: put into their standard units and joined to its blocks by time."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from analytics.loop.blocks.means import CALM, FAR, SECOND_NS, Blocks, Grid
from analytics.loop.blocks.run_blocks import Channel
from stream.batch import BoolArray, FloatArray, IntArray
from stream.errors import UnknownUnit
from stream.quantities import conversion, is_angular_rate

_DIMENSIONLESS = frozenset({"1", "count", "LSB", "percent"})
_STANDARD_UNITS = (
    (("temperature", "setpoint"), "degC"),
    (("rate",), "deg/s"),
    (("acceleration",), "deg/s^2"),
    (("gravity", "vibration"), "g_0"),
    (("voltage",), "V"),
    (("current",), "A"),
    (("angle",), "deg"),
    (("time_since_power_on",), "s"),
)


class Readings(NamedTuple):
    """Readings of a channel of one run, in the order of time."""

    t_s: FloatArray
    value: FloatArray


def is_far_outside(value: FloatArray) -> BoolArray:
    """Mark readings that leave those before and after by more than a hundred times what they usually do.

    One among readings that move as well, three on either side, is motion.

    Examples
    --------
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


def standard_unit(name: str, unit_of_measure: str) -> tuple[str, float, float]:
    """Unit in which a channel takes part, with factor and offset to it; its own where that cannot be converted.

    Examples
    --------
    >>> standard_unit("case_temperature", "kelvin"), standard_unit("temperature", "count")
    (('degC', 1.0, -273.15), ('count', 1.0, 0.0))
    """
    target = next((unit for words, unit in _STANDARD_UNITS if any(word in name for word in words)), None)
    if target is None or unit_of_measure in _DIMENSIONLESS:
        return unit_of_measure, 1.0, 0.0
    if target == "deg/s" and not is_angular_rate(unit_of_measure):
        return unit_of_measure, 1.0, 0.0
    try:
        return (target, *conversion(unit_of_measure, target))
    except UnknownUnit:
        return unit_of_measure, 1.0, 0.0


def interpolated(at_s: FloatArray, readings: Readings, tolerance_s: float) -> FloatArray:
    """Values at moments between readings: on the line between two that are at most twice the tolerance apart.

    Else the value of a reading within the tolerance; else NaN.

    Examples
    --------
    >>> readings = Readings(np.array([0.0, 10.0, 100.0]), np.array([0.0, 1.0, 7.0]))
    >>> interpolated(np.array([5.0, 14.0, 50.0, 104.0]), readings, 5.0).tolist()
    [0.5, 1.0, nan, 7.0]
    """
    t_s, value = readings
    if len(t_s) == 0:
        return np.full(len(at_s), np.nan)
    after = np.clip(np.searchsorted(t_s, at_s), 1, max(1, len(t_s) - 1))
    before = after - 1
    after = np.minimum(after, len(t_s) - 1)
    nearest = np.where(np.abs(at_s - t_s[before]) <= np.abs(t_s[after] - at_s), before, after)
    joined = np.where(np.abs(at_s - t_s[nearest]) <= tolerance_s, value[nearest], np.nan)
    is_between = (t_s[before] <= at_s) & (at_s <= t_s[after]) & (t_s[after] - t_s[before] <= 2.0 * tolerance_s)
    return np.where(is_between, np.interp(at_s, t_s, value), joined)


def joined_blocks(
    slot: IntArray, centre_s: FloatArray, found: Blocks, unit: tuple[str, float, float], tolerance_s: float
) -> Channel:
    """A channel with several readings in each block: means of the same blocks; where there is none, interpolated."""
    name, factor, offset = unit
    at = np.clip(np.searchsorted(found.slot, slot), 0, len(found.slot) - 1)
    is_same = found.slot[at] == slot
    mean = np.where(is_same, found.mean[at], np.nan)
    spread = np.where(is_same, found.spread[at], 0.0)
    if not is_same.all():
        between = interpolated(centre_s, Readings(found.centre_s, found.mean), tolerance_s)
        mean = np.where(is_same, mean, between)
    return Channel(mean * factor + offset, spread * abs(factor), name)


def joined_readings(
    centre_s: FloatArray, readings: Readings, unit: tuple[str, float, float], tolerance_s: float
) -> Channel:
    """A channel that is read less often: interpolated at the middle of each block's samples."""
    name, factor, offset = unit
    mean = interpolated(centre_s, readings, tolerance_s) * factor + offset
    return Channel(mean, np.zeros(len(mean)), name)


def slope(slot: IntArray, block_s: float, mean: FloatArray) -> FloatArray:
    """Rate of change of a channel, per second: from the blocks on both sides, at a gap from the one that is there.

    Examples
    --------
    >>> slope(np.array([0, 1, 2, 9]), 10.0, np.array([0.0, 10.0, 40.0, 0.0])).tolist()
    [1.0, 2.0, 3.0, nan]
    """
    rises = np.diff(mean) / (np.diff(slot) * block_s)
    rises = np.where(np.diff(slot) == 1, rises, np.nan)
    sides = np.array([np.concatenate([[np.nan], rises]), np.concatenate([rises, [np.nan]])])
    count = np.isfinite(sides).sum(axis=0)
    return np.where(count > 0, np.nansum(sides, axis=0) / np.maximum(count, 1), np.nan)


def ranges(slot: IntArray, block_s: float, t_s: FloatArray, lo: FloatArray, hi: FloatArray) -> FloatArray:
    """By how much a channel changes from the last reading before each block to the first after it.

    Readings come as seconds from `t_s` on, with the least and the greatest value of each.

    Examples
    --------
    >>> t_s, value = np.array([0.0, 5.0, 10.0, 15.0, 20.0]), np.array([0.0, 0.0, 0.0, 7.0, 7.0])
    >>> ranges(np.array([0, 1, 2]), 5.0, t_s, value, value).tolist()
    [0.0, 0.0, 7.0]
    """
    if len(t_s) == 0:
        return np.full(len(slot), np.nan)
    first = np.maximum(np.searchsorted(t_s + 1.0, slot * block_s, side="right") - 1, 0)
    beyond = np.searchsorted(t_s, (slot + 1) * block_s, side="left") + 1
    edges = np.column_stack([first, np.minimum(np.maximum(beyond, first + 1), len(t_s))]).ravel()
    # one more at the end, since reduceat wants every index below the length
    least = np.minimum.reduceat(np.append(lo, np.inf), edges)[::2]
    most = np.maximum.reduceat(np.append(hi, -np.inf), edges)[::2]
    return np.asarray(most - least, dtype=np.float64)


def readings_of(batches: Iterable[pa.RecordBatch], grid: Grid) -> Readings:
    """Times from the grid's beginning, and values."""
    parts = [(batch.column("t_ns").to_numpy(), batch.column("value").to_numpy()) for batch in batches]
    if not parts:
        return Readings(np.empty(0), np.empty(0))
    t_ns, value = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Readings((t_ns - grid.t0_ns) / SECOND_NS, value)
