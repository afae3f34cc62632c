"""Prefix sums of a whole record, built while its samples come, in bounded memory."""

import math
from array import array
from pathlib import Path

import numpy as np

from stream.batch import FloatArray
from stream.estimators.base import first_finite
from stream.estimators.full_overlap.prefix_kernel import Record, add, extend, take_off
from stream.estimators.full_overlap.row_spill import RowSpill

BLOCK = 4096
MEMORY_SAMPLES = 1 << 22
_EMPTY, _FULL = 0, 1
_MEAN_BITS = 20


class PrefixRecord:
    """Sums and counts of the samples before every slot, relative to the first finite sample.

    Parameters
    ----------
    folder: Where they lie beyond 4 million samples, the system's folder for temporary files if none is named: 8 bytes a
        slot and 2 more in blocks of 4096 where one is missing. A block without any sample takes no room.

    Raises
    ------
    OSError: From `extend` and `record`, if the folder cannot be written or is full.

    Examples
    --------
    >>> with_gap = PrefixRecord()
    >>> with_gap.extend(0, np.array([1.0, 3.0]))
    >>> with_gap.extend(3, np.array([2.0]))
    >>> record = with_gap.record()
    >>> record.sums[record.rows[0, 0], :5].tolist(), record.counts[record.rows[0, 1], :5].tolist()
    ([0.0, 0.0, 2.0, 2.0, 3.0], [0, 1, 2, 2, 3])
    >>> with_gap.close()
    """

    def __init__(self, folder: Path | None = None) -> None:
        memory_rows = max(1, MEMORY_SAMPLES // BLOCK)
        self._block = BLOCK
        self._reference = math.nan
        self._filled = 0
        self._line = np.zeros(BLOCK + 1)
        self._line_counts = np.zeros(BLOCK + 1, np.int64)
        self._sums = RowSpill(BLOCK, np.float64, memory_rows, folder)
        self._counts = RowSpill(BLOCK, np.uint16, memory_rows, folder)
        # these rows stand for all blocks without a sample, and without a missing one
        self._sums.append(np.zeros(BLOCK))
        self._counts.append(np.zeros(BLOCK))
        self._counts.append(np.arange(BLOCK))
        self._rows = (array("q"), array("q"))
        self._before = array("q", [0])
        self._high, self._low = array("d", [0.0]), array("d", [0.0])

    @property
    def slots(self) -> int:
        """Slots up to the last sample."""
        return len(self._rows[0]) * self._block + self._filled

    @property
    def file_bytes(self) -> int:
        """What lies on disk, bytes."""
        return self._sums.file_bytes + self._counts.file_bytes

    def extend(self, first_slot: int, values: FloatArray) -> None:
        """Add values that lie on the slots from `first_slot` on; slots skipped before it, and NaN, are missing."""
        if math.isnan(self._reference):
            self._reference = first_finite(values)
        self._skip(first_slot - self.slots)
        start = 0
        while start < len(values):
            part = values[start : start + self._block - self._filled]
            extend(self._line, self._line_counts, self._filled, part, self._reference)
            start += len(part)
            self._advance(len(part))

    def record(self) -> Record:
        """What was added so far; valid until the next call of any method."""
        blocks = len(self._rows[0])
        rows = np.empty((blocks + 1, 2), np.int64)
        rows[:blocks, 0], rows[:blocks, 1] = self._rows
        rows[blocks] = len(self._sums), len(self._counts)
        high, low, before = np.array(self._high), np.array(self._low), np.array(self._before)
        count = int(before[-1] + self._line_counts[self._filled])
        mean = _rounded((float(high[-1]) + float(self._line[self._filled])) / max(1, count))
        take_off(high, low, before, mean)
        sums, counts = self._sums.array(self._line[:-1]), self._counts.array(self._line_counts[:-1])
        return Record(sums, counts, rows, before, high, low, mean, self.slots)

    def close(self) -> None:
        """Free the file and the memory."""
        self._sums.close()
        self._counts.close()

    def _skip(self, slots: int) -> None:
        """Leave slots without a sample."""
        part = min(slots, (self._block - self._filled) % self._block)
        self._leave(part)
        blocks, rest = divmod(slots - part, self._block)
        for column, numbers in zip((*self._rows, self._before), (_EMPTY, _EMPTY, self._before[-1]), strict=True):
            column.extend(array("q", [numbers]) * blocks)
        for sums in (self._high, self._low):
            sums.extend(array("d", [sums[-1]]) * blocks)
        self._leave(rest)

    def _leave(self, slots: int) -> None:
        for line in (self._line, self._line_counts):
            line[self._filled + 1 : self._filled + 1 + slots] = line[self._filled]
        self._advance(slots)

    def _advance(self, slots: int) -> None:
        """Count slots that were written into the block; put it away once it is complete."""
        self._filled += slots
        if self._filled < self._block:
            return
        count = int(self._line_counts[-1])
        self._rows[0].append(len(self._sums) if count else _EMPTY)
        if count:
            self._sums.append(self._line[:-1])
        partly = 0 < count < self._block
        self._rows[1].append(len(self._counts) if partly else (_FULL if count else _EMPTY))
        if partly:
            self._counts.append(self._line_counts[:-1])
        high, low = add(self._high[-1], self._low[-1], float(self._line[-1]))
        self._high.append(high)
        self._low.append(low)
        self._before.append(self._before[-1] + count)
        self._filled = 0


def _rounded(mean: float) -> float:
    """The mean, in so few bits that its product with a count is exact."""
    if not math.isfinite(mean):
        return math.nan
    fraction, exponent = math.frexp(mean)
    return math.ldexp(round(fraction * 2**_MEAN_BITS), exponent - _MEAN_BITS)
