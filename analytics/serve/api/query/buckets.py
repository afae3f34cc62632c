"""Buckets of a stretch of a signal, from rows of rollups or samples: number, mean, least and greatest value."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray, IntArray


class Buckets(NamedTuple):
    """Buckets in the order of time, one of each slot; all of shape (buckets,)."""

    slot: IntArray
    n: IntArray
    mean: FloatArray
    lo: FloatArray
    hi: FloatArray

    @classmethod
    def of_rows(cls, slot: IntArray, n: IntArray, mean: FloatArray, lo: FloatArray, hi: FloatArray) -> "Buckets":
        """Rows of the same slot become one bucket.

        >>> of = Buckets.of_rows(*np.array([[8, 0, 8], [1, 1, 3]]), *np.array([[2.0, 5.0, 6.0]] * 3))
        >>> of.slot.tolist(), of.n.tolist(), of.mean.tolist(), of.hi.tolist()
        ([0, 8], [1, 4], [5.0, 5.0], [5.0, 6.0])
        """
        if not slot.size:
            return NO_BUCKETS
        if np.any(slot[1:] < slot[:-1]):
            order = np.argsort(slot, kind="stable")
            slot, n, mean, lo, hi = slot[order], n[order], mean[order], lo[order], hi[order]
        starts = np.flatnonzero(np.concatenate([[True], slot[1:] != slot[:-1]]))
        if starts.size == slot.size:
            return cls(slot, n, mean, lo, hi)
        counts = np.add.reduceat(n, starts)
        lengths = np.diff(starts, append=slot.size)
        # shares instead of sums, which are infinite where values are beyond 1e308 together
        means = np.add.reduceat(n / np.repeat(counts, lengths) * mean, starts)
        return cls(slot[starts], counts, means, np.minimum.reduceat(lo, starts), np.maximum.reduceat(hi, starts))

    @classmethod
    def of_samples(cls, t_ns: IntArray, values: FloatArray, width_ns: int) -> "Buckets":
        """Buckets of a length, of the samples that are numbers.

        >>> Buckets.of_samples(np.array([1, 9, 12]), np.array([2.0, np.nan, 4.0]), 10).n.tolist()
        [1, 1]
        """
        known = np.isfinite(values)
        if not known.all():
            t_ns, values = t_ns[known], values[known]
        return cls.of_rows(t_ns // width_ns * width_ns, np.ones(t_ns.size, np.int64), values, values, values)

    @classmethod
    def together(cls, buckets: "Iterable[Buckets]") -> "Buckets":
        """Buckets of several sources."""
        found = [each for each in buckets if each.slot.size]
        if len(found) == 1:
            return found[0]
        return cls.of_rows(*(np.concatenate(columns) for columns in zip(*found, strict=True))) if found else NO_BUCKETS

    def between(self, first: int, stop: int) -> "Buckets":
        """Those whose slot is in a half-open range."""
        inside = (self.slot >= first) & (self.slot < stop)
        slot, n, mean, lo, hi = self
        return Buckets(slot[inside], n[inside], mean[inside], lo[inside], hi[inside])


NO_BUCKETS = Buckets(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0))


def samples_in_order(found: Sequence[tuple[IntArray, FloatArray]]) -> tuple[IntArray, FloatArray]:
    """Times and values of samples of several sources in the order of time, without those that are no numbers."""
    t_ns = np.concatenate([NO_BUCKETS.slot, *(times for times, _ in found)])
    values = np.concatenate([NO_BUCKETS.mean, *(values for _, values in found)])
    known = np.isfinite(values)
    if not known.all():
        t_ns, values = t_ns[known], values[known]
    if (t_ns[1:] >= t_ns[:-1]).all():  # as nearly always: sorting, even of what is sorted, takes ten times as long
        return t_ns, values
    order = np.argsort(t_ns, kind="stable")
    return t_ns[order], values[order]
