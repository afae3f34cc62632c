"""Block means of an angle that may wrap: unwrapped, and as phasors."""

import numpy as np

from analytics.block_means import Grid
from analytics.run_blocks import HARMONICS, Channel
from stream.batch import FloatArray, IntArray

_HALF_TURN_DEG = 180.0


class AngleBlocks:
    """Block means of an angle that may wrap, as it is read piece by piece: unwrapped, and its phasors.

    Parameters
    ----------
    grid : Grid
        Where the blocks lie.
    block_ns : int
        Length of a block, ns.
    factor_deg : float
        Degrees in the angle's own unit.

    Examples
    --------
    >>> angle = AngleBlocks(Grid(0, 0, 10**12), 2 * 10**9, 1.0)
    >>> angle.take(np.array([0, 1, 2, 3]) * 10**9, np.array([350.0, 0.0, 10.0, 20.0]))
    >>> angle.channel(np.array([0, 1])).mean.tolist()
    [355.0, 375.0]
    """

    def __init__(self, grid: Grid, block_ns: int, factor_deg: float) -> None:
        self._t0_ns, self._block_ns, self._factor = grid.t0_ns, block_ns, factor_deg
        self._last_deg: float | None = None
        self._slots: list[IntArray] = []
        self._sums: list[np.ndarray[tuple[int, ...], np.dtype[np.complex128]]] = []

    def take(self, t_ns: IntArray, value: FloatArray) -> None:
        """Take in readings in the order of time."""
        if len(t_ns) == 0:
            return
        wrapped = value * self._factor
        before = wrapped[0] if self._last_deg is None else self._last_deg
        steps = np.diff(wrapped, prepend=before)
        steps -= 360.0 * np.round(steps / 360.0)
        degrees = before + np.cumsum(steps)
        self._last_deg = float(degrees[-1])
        slots = (t_ns - self._t0_ns) // self._block_ns
        starts = np.flatnonzero(np.diff(slots, prepend=slots[0] - 1))
        turn = np.exp(1j * np.radians(degrees))
        columns = [np.ones_like(turn), degrees, degrees**2, *(turn**k for k in range(1, HARMONICS + 1))]
        self._slots.append(slots[starts])
        self._sums.append(np.array([np.add.reduceat(column, starts) for column in columns]).T)

    def channel(self, slot: IntArray) -> Channel:
        """The channel at these blocks; NaN where it was not read."""
        if not self._slots:
            empty = np.full(len(slot), np.nan)
            return Channel(empty, np.zeros(len(slot)), "deg", np.full((HARMONICS, len(slot)), np.nan + 0j))
        slots, row = np.unique(np.concatenate(self._slots), return_inverse=True)
        sums = np.zeros((len(slots), 3 + HARMONICS), np.complex128)
        np.add.at(sums, row, np.concatenate(self._sums))
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


def without_aliases(angle: Channel, rate_deg_per_s: FloatArray, interval_s: float) -> Channel:
    """An angle as far as its readings show it: half a turn between two of them and more says nothing.

    Where k times the angle turns that fast, phasor k is 0, as of whole turns; where the angle does, its mean is NaN.
    """
    if angle.phasors is None:
        return angle
    turned = np.abs(np.nan_to_num(rate_deg_per_s)) * interval_s
    phasors = angle.phasors.copy()
    for k in range(1, HARMONICS + 1):
        phasors[k - 1, turned * k >= _HALF_TURN_DEG] = 0.0
    mean = np.where(turned >= _HALF_TURN_DEG, np.nan, angle.mean)
    return Channel(mean, angle.spread, angle.unit_of_measure, phasors)
