"""Prefix sums of a whole record, built while its samples come, in bounded memory (``full_overlap``).

A record of N slots is kept as its prefix sums, N + 1 of them, in blocks of B: within a block relative to its first,
and the first of each block as the unevaluated sum of two numbers. What is subtracted from each other is therefore never
larger than what B samples add up to, however long the record is.
"""

import math
import tempfile
from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from stream.batch import FloatArray, IntArray, first_finite
from stream.compiled import kernel

BLOCK = 4096
MEMORY_SAMPLES = 1 << 22
_EMPTY, _FULL = 0, 1
_MEAN_BITS = 20


class PrefixSums(NamedTuple):
    """Prefix sums of a record, relative to a reference; slots without a sample add nothing.

    sums: shape (R, B); sums from the first slot of a block to each of its slots, that one excluded. counts: shape
    (C, B); how many samples they hold. rows: shape (blocks, 2); rows of `sums` and `counts` that belong to a block.
    before: shape (blocks,); samples before a block. high, low: shape (blocks,); sum before a block, `mean` subtracted
    from every sample, and its rounding error. mean: about that of the record over its reference; NaN if the sums are
    too large for a number. slots: N.
    """

    sums: FloatArray
    counts: npt.NDArray[np.uint16]
    rows: IntArray
    before: IntArray
    high: FloatArray
    low: FloatArray
    mean: float
    slots: int


@kernel
def _extend(sums: FloatArray, counts: IntArray, first: int, values: FloatArray, reference: float) -> None:
    """Add values behind slot `first` of a block, whose prefix sums and counts are known up to there."""
    for i in range(values.shape[0]):
        value = values[i]
        is_finite = value - value == 0.0
        sums[first + i + 1] = sums[first + i] + (value - reference if is_finite else 0.0)
        counts[first + i + 1] = counts[first + i] + (1 if is_finite else 0)


def _add(high: Any, low: Any, term: Any) -> tuple[Any, Any]:
    """Sums of high + low and `term`, with their rounding errors (D. E. Knuth, TAOCP 4.2.2 theorem B)."""
    total = high + term
    shadow = total - high
    return total, low + ((high - (total - shadow)) + (term - shadow))


class PrefixColumn:
    """One prefix number a slot, a row a block, in memory up to a bound and beyond it in an unnamed temporary file.

    `line`, shape (B + 1,), is the block being filled; `constants` are the first rows, which any number of blocks share.
    The file lies in `folder`, or the system's folder for temporary files; its room is free again when it is closed or
    the process ends.
    """

    def __init__(
        self, line: npt.NDArray[Any], dtype: type[np.generic], constants: Sequence[npt.NDArray[Any]],
        memory_rows: int, folder: Path | None = None,
    ) -> None:  # fmt: skip
        self.line = line
        self.rows = array("q")
        self.stored = 0
        self._memory_rows, self._folder = memory_rows, folder
        self._kept: npt.NDArray[Any] = np.empty((min(memory_rows, 1), len(line) - 1), dtype)
        self._file: IO[bytes] | None = None
        for row in constants:
            self._store(row)

    @property
    def file_bytes(self) -> int:
        """Size of the file, 0 while all is in memory."""
        return 0 if self._file is None else self.stored * self._row_bytes

    def end_block(self, constant: int | None) -> None:
        """End the block being filled: a row of its own, or that of a constant."""
        self.rows.append(self.stored if constant is None else constant)
        if constant is None:
            self._store(self.line[:-1])

    def table(self) -> npt.NDArray[Any]:
        """All rows and the block being filled behind them; valid until the next call of any method."""
        self._write(self.line[:-1])
        if self._file is None:
            return self._kept[: self.stored + 1]
        self._file.flush()
        # mapped for writing: numba takes read-only arrays for another type and would compile its code once more
        return np.asarray(np.memmap(self._file, self._kept.dtype, "r+", shape=(self.stored + 1, self._kept.shape[1])))

    def close(self) -> None:
        """Free the file and the memory."""
        if self._file is not None:
            self._file.close()
        self._file = None
        self.stored = 0
        self._kept = self._kept[:0].copy()

    @property
    def _row_bytes(self) -> int:
        return int(self._kept.shape[1] * self._kept.itemsize)

    def _store(self, row: npt.NDArray[Any]) -> None:
        self._write(row)
        self.stored += 1

    def _write(self, row: npt.NDArray[Any]) -> None:
        """Write a row behind the last one that is stored."""
        if self._file is None and self.stored >= self._memory_rows:
            self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115  close() closes it
            self._file.write(self._kept[: self.stored].tobytes())
            self._kept = self._kept[:0].copy()
        if self._file is not None:
            self._file.seek(self.stored * self._row_bytes)
            self._file.write(row.astype(self._kept.dtype).tobytes())
            return
        if self.stored == len(self._kept):
            grown = np.empty((min(2 * self.stored, self._memory_rows), self._kept.shape[1]), self._kept.dtype)
            grown[: self.stored] = self._kept
            self._kept = grown
        self._kept[self.stored] = row


class PrefixRecord:
    """Sums and counts of the samples before every slot, relative to the first finite sample.

    Beyond 4 million samples they lie in `folder`, or the system's folder for temporary files: 8 bytes a slot and 2 more
    in blocks of 4096 where one is missing. A block without any sample takes no room. `extend` and `record` raise an
    OSError if the folder cannot be written or is full.

    >>> with_gap = PrefixRecord()
    >>> with_gap.extend(0, np.array([1.0, 3.0]))
    >>> with_gap.extend(3, np.array([2.0]))
    >>> record = with_gap.record()
    >>> record.sums[record.rows[0, 0], :5].tolist(), record.counts[record.rows[0, 1], :5].tolist()
    ([0.0, 0.0, 2.0, 2.0, 3.0], [0, 1, 2, 2, 3])
    >>> with_gap.close()
    """

    def __init__(self, folder: Path | None = None) -> None:
        rows = max(1, MEMORY_SAMPLES // BLOCK)
        empty = np.zeros(BLOCK)
        self._block = BLOCK
        self._reference = math.nan
        self._filled = 0
        self._sums = PrefixColumn(np.zeros(BLOCK + 1), np.float64, [empty], rows, folder)
        counts = [empty, np.arange(BLOCK)]  # of blocks without a sample, and of those without a missing one
        self._counts = PrefixColumn(np.zeros(BLOCK + 1, np.int64), np.uint16, counts, rows, folder)
        self._before = array("q", [0])
        self._high, self._low = array("d", [0.0]), array("d", [0.0])

    @property
    def slots(self) -> int:
        """Slots up to the last sample."""
        return len(self._sums.rows) * self._block + self._filled

    @property
    def file_bytes(self) -> int:
        """Size of the files, bytes."""
        return self._sums.file_bytes + self._counts.file_bytes

    def extend(self, first_slot: int, values: FloatArray) -> None:
        """Add values that lie on the slots from `first_slot` on; slots skipped before it, and NaN, are missing."""
        if math.isnan(self._reference):
            self._reference = first_finite(values)
        self._skip(first_slot - self.slots)
        start = 0
        while start < len(values):
            part = values[start : start + self._block - self._filled]
            _extend(self._sums.line, self._counts.line, self._filled, part, self._reference)
            start += len(part)
            self._advance(len(part))

    def record(self) -> PrefixSums:
        """What was added so far; valid until the next call of any method."""
        rows = np.empty((len(self._sums.rows) + 1, 2), np.int64)
        for i, column in enumerate((self._sums, self._counts)):
            rows[:-1, i], rows[-1, i] = column.rows, column.stored
        high, low, before = np.array(self._high), np.array(self._low), np.array(self._before)
        count = int(before[-1] + self._counts.line[self._filled])
        mean = _rounded((float(high[-1]) + float(self._sums.line[self._filled])) / max(1, count))
        with np.errstate(over="ignore", invalid="ignore"):
            high, low = _add(high, low, -mean * before)  # exact products: a mean of 20 bits
        return PrefixSums(self._sums.table(), self._counts.table(), rows, before, high, low, mean, self.slots)

    def close(self) -> None:
        """Free the file and the memory."""
        self._sums.close()
        self._counts.close()

    def _skip(self, slots: int) -> None:
        """Leave slots without a sample."""
        part = min(slots, (self._block - self._filled) % self._block)
        self._leave(part)
        blocks, rest = divmod(slots - part, self._block)
        for rows in (self._sums.rows, self._counts.rows):
            rows.extend(array("q", [_EMPTY]) * blocks)
        self._before.extend(self._before[-1:] * blocks)
        for sums in (self._high, self._low):
            sums.extend(sums[-1:] * blocks)
        self._leave(rest)

    def _leave(self, slots: int) -> None:
        for line in (self._sums.line, self._counts.line):
            line[self._filled + 1 : self._filled + 1 + slots] = line[self._filled]  # they add nothing
        self._advance(slots)

    def _advance(self, slots: int) -> None:
        """Count slots that were written into the block, and end it once it is complete."""
        self._filled += slots
        if self._filled < self._block:
            return
        count = int(self._counts.line[-1])
        self._sums.end_block(None if count else _EMPTY)
        self._counts.end_block(None if 0 < count < self._block else _FULL if count else _EMPTY)
        high, low = _add(self._high[-1], self._low[-1], float(self._sums.line[-1]))
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
