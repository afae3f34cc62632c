"""The slow change of a signal: a cubic spline through its samples."""

from collections.abc import Iterator

import numpy as np
import scipy.linalg

from stream.batch import FloatArray, first_finite

_PIECES = 4  # of the spline, from which on there is one
_STIFF = 1e-9
# cubic B-splines on 0 .. 1 by powers of the place
_BASIS = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6.0


class SlowChange:
    """A cubic spline through a signal, fitted by least squares, with a knot every `spacing` slots.

    It follows what is slower than half a period in `spacing` slots: with knots as far apart as segments are long, half
    a bin of their spectrum. Bins from 2 on hardly see that it is taken off: of white noise in records of 7 segment
    lengths the density of bin 2 becomes 1.5 % less, of the others nothing.

    >>> slow = SlowChange(1000)
    >>> slow.take(0, 30.0 * np.exp(-np.arange(8000) / 3000.0))
    >>> slow.fit(8000)
    >>> bool(abs(slow.at(0, 8000) - 30.0 * np.exp(-np.arange(8000) / 3000.0)).max() < 0.01)
    True
    """

    def __init__(self, spacing: int) -> None:
        self.spacing = spacing
        self.span = 0.0  # between the largest and the least value of the spline
        self._reference = np.nan
        self._products: FloatArray = np.zeros((0, 7))
        self._moments: FloatArray = np.zeros((0, 4))
        self._powers: FloatArray = np.zeros((0, 4))

    def take(self, first_slot: int, values: FloatArray) -> None:
        """Take in values on the slots from `first_slot` on; NaN is missing."""
        if np.isnan(self._reference):
            self._reference = first_finite(values)
        for piece, place, part in self._parts(first_slot, values):
            more = piece + 1 - len(self._moments)
            if more > 0:
                self._products = np.vstack([self._products, np.zeros((max(more, len(self._moments)), 7))])
                self._moments = np.vstack([self._moments, np.zeros((max(more, len(self._moments)), 4))])
            known = np.isfinite(part)
            powers = np.vander(place[known], 7, increasing=True)
            self._products[piece] += powers.sum(axis=0)
            self._moments[piece] += powers[:, :4].T @ (part[known] - self._reference)

    def fit(self, slots: int) -> None:
        """Fit the spline to what was taken in, of a record of so many slots; none to less than four pieces."""
        pieces = int(np.flatnonzero(self._products[:, 0]).max(initial=-1)) + 1
        if pieces < _PIECES or not np.isfinite(self._moments).all():
            return
        size = pieces + 3
        banded, right = np.zeros((4, size)), np.zeros(size)
        pairs = np.add.outer(np.arange(4), np.arange(4))
        bend = np.array([1.0, -2.0, 1.0])
        for piece in range(pieces):
            square = _BASIS.T @ self._products[piece][pairs] @ _BASIS
            square[:3, :3] += _STIFF * self.spacing * np.outer(bend, bend)
            square[1:, 1:] += _STIFF * self.spacing * np.outer(bend, bend)
            for lag in range(4):
                banded[lag, piece : piece + 4 - lag] += np.diagonal(square, -lag)
            right[piece : piece + 4] += _BASIS.T @ self._moments[piece]
        if not np.isfinite(right).all():
            return
        weights = scipy.linalg.solveh_banded(banded, right, lower=True)
        self._powers = np.lib.stride_tricks.sliding_window_view(weights, 4) @ _BASIS.T
        looked = [*range(0, slots, self.spacing // 4), slots - 1]
        self.span = float(np.ptp([self.at(slot, 1)[0] for slot in looked]))

    def at(self, first_slot: int, n: int) -> FloatArray:
        """The spline on n slots; 0 where none was fitted."""
        out = np.zeros(n)
        if len(self._powers):
            for piece, place, part in self._parts(first_slot, out):
                part[:] = self._reference + np.polynomial.polynomial.polyval(
                    place, self._powers[min(piece, len(self._powers) - 1)]
                )
        return out

    def _parts(self, first_slot: int, values: FloatArray) -> Iterator[tuple[int, FloatArray, FloatArray]]:
        """The values by pieces of the spline: number of the piece, places in it from 0 to 1, values."""
        done = 0
        while done < len(values):
            piece, begin = divmod(first_slot + done, self.spacing)
            part = values[done : done + self.spacing - begin]
            yield piece, (begin + np.arange(len(part)) + 0.5) / self.spacing, part
            done += len(part)
