"""The longest gap of a signal: whether its missing samples are one stretch, or scattered."""

import numpy as np

from stream.batch import SampleBatch


class LongestGap:
    """Follows a signal and finds the longest run of samples that were never sent, or are NaN.

    `samples` is its number of sample intervals, rounded; before the first sample there is none.

    >>> from uuid import UUID
    >>> def batch(t0_ns, values):
    ...     return SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, t0_ns, 10, "deg/s", values=np.array(values))
    >>> gap = LongestGap()
    >>> for each in (batch(0, [1.0, np.nan, np.nan, 2.0]), batch(40, [np.nan, 3.0]), batch(100, [1.0])):
    ...     gap.follow(each)
    >>> gap.samples
    4
    """

    def __init__(self) -> None:
        self.samples = 0
        self._last_ns: int | None = None

    def follow(self, batch: SampleBatch) -> None:
        """Take in the next samples."""
        if batch.times_ns is None and batch.finite == len(batch):  # nearly all are
            first_ns, widest_ns = batch.t0_ns, batch.dt_ns
            last_ns = batch.t0_ns + (len(batch) - 1) * batch.dt_ns
        else:
            times_ns = batch.time_array[np.isfinite(batch.value_array)]
            if not len(times_ns):
                return
            first_ns, last_ns = int(times_ns[0]), int(times_ns[-1])
            widest_ns = int(np.diff(times_ns).max(initial=0))
        if self._last_ns is not None:
            widest_ns = max(widest_ns, first_ns - self._last_ns)
        self.samples = max(self.samples, round(widest_ns / batch.dt_ns) - 1)
        self._last_ns = last_ns
