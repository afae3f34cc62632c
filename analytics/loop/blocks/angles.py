"""Block means of an angle that may wrap: unwrapped, and as phasors."""

import numpy as np

from analytics.loop.blocks.channels import Readings
from analytics.loop.blocks.run_blocks import HARMONICS, Channel, ComplexArray
from analytics.loop.blocks.signal_blocks import Grid
from stream.batch import FloatArray, IntArray

_HALF_TURN_DEG = 180.0
_TURNING_DEG, _TRUSTED_DEG = 10.0, 15.0
"""Angle between two readings above which a rate is compared with them, and the largest accepted difference."""


class AngleBlocks:
    """Block means of an angle that is read piece by piece and may wrap; `factor_deg` converts it to degrees.

    Examples
    --------
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
    """An angle that is read once or a few times in a block, with a rate that continues it from there.

    A reading is of one moment, the rate a mean over an interval: the interval that begins with the reading, ends with
    it or is centred on it, whichever makes the readings consistent. The mean of exp(1j*k*angle) over an interval is
    then known for any number of revolutions in it. None where the rate is not that of the angle.

    Parameters
    ----------
    readings: The angle in degrees; it may wrap.
    rate_deg_per_s: shape (readings,); mean rate about each reading; NaN where it is unknown.

    Examples
    --------
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
