"""Channels beside a signal: in standard units, joined to its blocks by time; angles, which may wrap, as phasors."""

import math
from typing import NamedTuple

import numpy as np

from analytics.loop.blocks.inside import Inside
from analytics.loop.blocks.piece_slopes import ORDERS
from analytics.loop.blocks.pieces import Grid
from analytics.loop.blocks.run_blocks import HARMONICS, Channel, ComplexArray
from analytics.loop.blocks.signal_blocks import SignalBlocks
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
_ONE_TIME_S = 1e-5  # times this near are one: grids of samples are rounded to ns
_HALF_TURN_DEG = 180.0
_TURNING_DEG, _TRUSTED_DEG = 10.0, 15.0
"""Angle between two readings above which a rate is compared with them, and the largest accepted difference."""


class Readings(NamedTuple):
    """Readings of a channel of one run, in the order of time; seconds from the start of slot 0."""

    t_s: FloatArray
    value: FloatArray


_BELOW_ABSOLUTE_ZERO_DEG_C = -273.2


class StandardUnit(NamedTuple):
    """Unit in which a channel takes part, and the conversion of stored values to it."""

    name: str
    factor: float = 1.0
    offset: float = 0.0

    def channel(
        self, mean: FloatArray, spread: FloatArray, inside: Inside | None = None, slope_per_s: FloatArray | None = None
    ) -> Channel:
        """A channel of stored values."""
        moved = None if inside is None else inside.scaled(self.factor, self.offset)
        slope = None if slope_per_s is None else slope_per_s * self.factor
        value, scatter = mean * self.factor + self.offset, spread * abs(self.factor)
        return Channel(value, scatter, self.name, inside=moved, slope_per_s=slope)

    def is_impossible(self, value: FloatArray) -> BoolArray:
        """Whether stored values are temperatures below absolute zero, such as the fill value -999."""
        if self.name != "degC":
            return np.zeros(value.shape, np.bool_)
        return np.asarray(value * self.factor + self.offset < _BELOW_ABSOLUTE_ZERO_DEG_C)


def standard_unit(name: str, unit_of_measure: str) -> StandardUnit:
    """Standard unit of a channel; its own unit where that cannot be converted.

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
    """A channel with several readings a block at the blocks of a signal: its means, interpolated where it has none.

    Readings of another rate have another mean time in a block; the means are moved to that of the signal. A block at
    the end of a record of fast swings, which does not say how they go on, then has no mean.
    """
    at = np.clip(np.searchsorted(found.slot, signal.slot), 0, len(found.slot) - 1)
    is_same = found.slot[at] == signal.slot
    later_s = np.where(is_same, signal.centre_s - found.centre_s[at], 0.0)
    factors = _taylor(later_s, found.interval_s[at], signal.interval_s)
    is_one = (np.abs(factors[:, :2]) < _ONE_TIME_S).all(axis=1)
    factors[is_one] = 0.0
    moved = found.mean[at] + factors[:, 0] * found.slope_per_s[at] + (factors[:, 1:] * found.further[at]).sum(axis=1)
    mean = np.where(is_same & ~(found.is_open[at] & ~is_one), moved, np.nan)
    spread = np.where(is_same, found.spread[at], 0.0)
    if not is_same.all():
        between = interpolated(signal.centre_s, Readings(found.centre_s, found.mean), tolerance_s)
        mean = np.where(is_same, mean, between)
    inside = found.inside
    if inside is not None:
        rows = np.full(len(found.slot), -1)
        rows[at[is_same]] = np.flatnonzero(is_same)
        inside = inside.at(rows).later(factors)
    slope = found.slope_per_s[at] + (factors[:, :-1] * found.further[at]).sum(axis=1)
    return unit.channel(mean, spread, inside, np.where(is_same & found.is_smooth[at], slope, np.nan))


def _taylor(later_s: FloatArray, from_s: FloatArray, to_s: FloatArray) -> FloatArray:
    """Factors of the mean derivatives, from the first on, that move a mean of samples to later ones of other intervals.

    A mean of samples dt apart is that of the time they stand for over sinh(x)/x, x = dt/2 times the derivative.

    >>> _taylor(np.array([0.5]), np.array([1.0]), np.array([1.0])).round(5).tolist()
    [[0.5, 0.125, 0.02083, 0.0026, 0.00026]]
    """
    second = (from_s**2 - to_s**2) / 24.0
    fourth = from_s**4 / 1920.0 - to_s**4 / 1920.0 - to_s**2 / 24.0 * second
    one, power = np.ones_like(later_s), [later_s**order / math.factorial(order) for order in range(ORDERS + 1)]
    own = (one, np.zeros_like(one), second, np.zeros_like(one), fourth)
    return np.column_stack(
        [sum(power[order - at] * each for at, each in enumerate(own) if at <= order) for order in range(1, ORDERS + 1)]
    )


def joined_readings(signal: SignalBlocks, readings: Readings, unit: StandardUnit, tolerance_s: float) -> Channel:
    """A channel with fewer readings: interpolated at the mean time of each block's samples."""
    mean = interpolated(signal.centre_s, readings, tolerance_s)
    return unit.channel(mean, np.zeros(len(mean)))


class AngleBlocks:
    """Block means of an angle that is read piece by piece and may wrap; `factor_deg` converts it to degrees.

    >>> angle = AngleBlocks(Grid(0, 0, 10**12), 2 * 10**9, 1.0)
    >>> angle.update(np.array([0, 1, 2, 3]) * 10**9, np.array([350.0, 0.0, 10.0, 20.0]))
    >>> angle.channel(np.array([0, 1])).mean.tolist()
    [355.0, 375.0]
    """

    def __init__(self, grid: Grid, block_ns: int, factor_deg: float) -> None:
        self._t0_ns, self._block_ns, self._factor = grid.t0_ns, block_ns, factor_deg
        self._last_deg: float | None = None
        self._slots: list[IntArray] = []
        self._sums: list[ComplexArray] = []

    def update(self, t_ns: IntArray, value: FloatArray) -> None:
        """Add readings in the order of time."""
        if len(t_ns) == 0:
            return
        wrapped = value * self._factor
        before = wrapped[0] if self._last_deg is None else self._last_deg
        degrees = before + np.cumsum(_wrapped(np.diff(wrapped, prepend=before)))
        self._last_deg = float(degrees[-1])
        slots = (t_ns - self._t0_ns) // self._block_ns
        starts = np.flatnonzero(np.diff(slots, prepend=slots[0] - 1))
        turn = np.exp(1j * np.radians(degrees))
        columns = [np.ones_like(turn), degrees, degrees**2, *(turn**k for k in range(1, HARMONICS + 1))]
        self._slots.append(slots[starts])
        self._sums.append(np.array([np.add.reduceat(column, starts) for column in columns]).T)

    def channel(self, slot: IntArray) -> Channel:
        """The channel at these blocks; NaN where it has no readings."""
        if not self._slots:
            empty = np.full(len(slot), np.nan)
            return Channel(empty, np.zeros(len(slot)), "deg", np.full((HARMONICS, len(slot)), np.nan + 0j))
        return _channel(slot, np.concatenate(self._slots), np.concatenate(self._sums))


def _channel(slot: IntArray, of: IntArray, terms: ComplexArray) -> Channel:
    """An angle at some blocks from columns of weight, angle, its square and its phasors, each of the block `of`."""
    slots, row = np.unique(of, return_inverse=True)
    sums = np.zeros((len(slots), 3 + HARMONICS), np.complex128)
    np.add.at(sums, row, terms)
    means = sums[:, 1:] / sums[:, :1]
    mean = means[:, 0].real
    spread = np.sqrt(np.maximum(means[:, 1].real - mean**2, 0.0))
    at = np.clip(np.searchsorted(slots, slot), 0, len(slots) - 1)
    is_read = slots[at] == slot
    return Channel(
        np.where(is_read, mean[at], np.nan),
        np.where(is_read, spread[at], 0.0),
        "deg",
        np.where(is_read, means[at, 2:].T, np.nan),
    )


def polled_angle(slot: IntArray, block_s: float, readings: Readings, rate_deg_per_s: FloatArray) -> Channel | None:
    """An angle in degrees that is read once or a few times in a block, with a rate that continues it from there.

    A reading is of one moment, the rate a mean over an interval: the interval that begins with the reading, ends with
    it or is centred on it, whichever makes the readings consistent. The mean of exp(1j*k*angle) over an interval is
    then known for any number of revolutions in it. None where the rate is not that of the angle. `rate_deg_per_s` is
    the mean rate about each reading, NaN where it is unknown.

    >>> t_s = np.arange(0.0, 300.0, 30.0)
    >>> found = polled_angle(np.arange(10), 30.0, Readings(t_s, 20.0 * t_s % 360.0), np.full(10, 20.0))
    >>> bool(np.abs(found.phasors).max() < 0.2)
    True
    """
    t_s, degrees = readings
    if len(t_s) < 2:
        return None
    interval_s = float(np.median(np.diff(t_s)))
    rate = np.nan_to_num(rate_deg_per_s)
    is_next = np.abs(np.diff(t_s) - interval_s) < 0.1 * interval_s
    before, after = rate[:-1], rate[1:]
    turned = {0.5: before, -0.5: after, 0.0: 0.5 * (before + after)}
    moved = np.diff(degrees)
    missed = {at: _wrapped(moved - each * interval_s) for at, each in turned.items()}
    is_informative = is_next & (np.abs(after - before) * interval_s > _TURNING_DEG)
    if not is_informative.any():
        is_informative = is_next
    middle = min(
        missed, key=lambda at: float(np.abs(missed[at])[is_informative].mean()) if is_informative.any() else 0.0
    )
    is_turning = is_next & (np.abs(turned[middle]) * interval_s > _TURNING_DEG)
    if is_turning.any() and float(np.median(np.abs(missed[middle][is_turning]))) > _TRUSTED_DEG:
        return None
    unwrapped = degrees[0] + np.concatenate([[0.0], np.cumsum(turned[middle] * interval_s + missed[middle])])
    centre = unwrapped + middle * rate * interval_s
    order = np.arange(1, HARMONICS + 1)[:, None]
    phasors = np.exp(1j * np.radians(order * centre)) * np.sinc(order * rate * interval_s / 360.0)
    width = np.abs(rate) * interval_s / np.sqrt(12.0)
    terms = np.column_stack([np.ones_like(centre), centre, centre**2 + width**2, phasors.T])
    return _channel(slot, np.floor(t_s / block_s).astype(np.int64), terms)


def _wrapped(degrees: FloatArray) -> FloatArray:
    return np.asarray(degrees - 360.0 * np.round(degrees / 360.0))


def without_aliases(angle: Channel, rate_deg_per_s: FloatArray, interval_s: float) -> Channel:
    """An angle where its readings resolve it: phasor k is 0 where k times the angle turns by half a revolution or more
    between two of them, as of whole revolutions; the mean is NaN where the angle does.
    """
    if angle.phasors is None:
        return angle
    turned = np.abs(np.nan_to_num(rate_deg_per_s)) * interval_s
    phasors = angle.phasors.copy()
    for k in range(1, HARMONICS + 1):
        phasors[k - 1, turned * k >= _HALF_TURN_DEG] = 0.0
    mean = np.where(turned >= _HALF_TURN_DEG, np.nan, angle.mean)
    return Channel(mean, angle.spread, angle.unit_of_measure, phasors)
