"""Channels beside a signal: put into their standard units and joined to its blocks by time."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from analytics.loop.blocks.run_blocks import SECOND_NS, Channel
from analytics.loop.blocks.signal_blocks import Grid, SignalBlocks
from stream.batch import FloatArray, IntArray
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
    """Readings of a channel of one run, in the order of time; seconds from the start of slot 0."""

    t_s: FloatArray
    value: FloatArray


class StandardUnit(NamedTuple):
    """Unit in which a channel takes part, and the conversion of stored values to it."""

    name: str
    factor: float = 1.0
    offset: float = 0.0

    def channel(self, mean: FloatArray, spread: FloatArray) -> Channel:
        """A channel of stored values."""
        return Channel(mean * self.factor + self.offset, spread * abs(self.factor), self.name)


def standard_unit(name: str, unit_of_measure: str) -> StandardUnit:
    """Standard unit of a channel; its own unit where that cannot be converted.

    Examples
    --------
    >>> tuple(standard_unit("case_temperature", "kelvin")), standard_unit("temperature", "count").name
    (('degC', 1.0, -273.15), 'count')
    """
    target = next((unit for words, unit in _STANDARD_UNITS if any(word in name for word in words)), None)
    if target is None or unit_of_measure in _DIMENSIONLESS:
        return StandardUnit(unit_of_measure)
    if target == "deg/s" and not is_angular_rate(unit_of_measure):
        return StandardUnit(unit_of_measure)
    try:
        return StandardUnit(target, *conversion(unit_of_measure, target))
    except UnknownUnit:
        return StandardUnit(unit_of_measure)


def interpolated(at_s: FloatArray, readings: Readings, tolerance_s: float) -> FloatArray:
    """Values at given times: interpolated between two readings that are at most twice the tolerance apart.

    Else the value of the nearest reading within the tolerance; else NaN.

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


def joined_blocks(signal: SignalBlocks, found: SignalBlocks, unit: StandardUnit, tolerance_s: float) -> Channel:
    """A channel with several readings a block at the blocks of a signal: its means, interpolated where it has none."""
    at = np.clip(np.searchsorted(found.slot, signal.slot), 0, len(found.slot) - 1)
    is_same = found.slot[at] == signal.slot
    mean = np.where(is_same, found.mean[at], np.nan)
    spread = np.where(is_same, found.spread[at], 0.0)
    if not is_same.all():
        between = interpolated(signal.centre_s, Readings(found.centre_s, found.mean), tolerance_s)
        mean = np.where(is_same, mean, between)
    return unit.channel(mean, spread)


def joined_readings(signal: SignalBlocks, readings: Readings, unit: StandardUnit, tolerance_s: float) -> Channel:
    """A channel with fewer readings: interpolated at the mean time of each block's samples."""
    mean = interpolated(signal.centre_s, readings, tolerance_s)
    return unit.channel(mean, np.zeros(len(mean)))


def ranges(slot: IntArray, block_s: float, t_s: FloatArray, lo: FloatArray, hi: FloatArray) -> FloatArray:
    """Range of a channel from the last reading before each block to the first after it.

    Readings come as seconds that begin at `t_s`, with the least and the greatest value of each.

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
    # one more at the end, since reduceat requires every index below the length
    least = np.minimum.reduceat(np.append(lo, np.inf), edges)[::2]
    most = np.maximum.reduceat(np.append(hi, -np.inf), edges)[::2]
    return np.asarray(most - least, dtype=np.float64)


def readings_of(batches: Iterable[pa.RecordBatch], grid: Grid) -> Readings:
    """Readings from stored batches."""
    parts = [(batch.column("t_ns").to_numpy(), batch.column("value").to_numpy()) for batch in batches]
    if not parts:
        return Readings(np.empty(0), np.empty(0))
    t_ns, value = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Readings((t_ns - grid.t0_ns) / SECOND_NS, value)
