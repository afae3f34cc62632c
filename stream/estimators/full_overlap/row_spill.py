"""Rows of numbers that outgrow memory: appended one by one, read as one array, gone when closed."""

import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt


class RowSpill:
    """Rows of one width and type, in memory up to a bound and beyond it in an unnamed temporary file.

    Parameters
    ----------
    width: Numbers in a row.
    dtype: Their type.
    memory_rows: So many rows stay in memory.
    folder: Where the file lies, the system's folder for temporary files if none is named. The file has no name there
        and its room is free again when it is closed or the process ends, however it ends.

    Raises
    ------
    OSError: From `append` and `array`, if the folder cannot be written or is full.

    Examples
    --------
    >>> spill = RowSpill(2, np.int64, memory_rows=1)
    >>> for row in ([1, 2], [3, 4]):
    ...     spill.append(np.array(row))
    >>> len(spill), spill.file_bytes, spill.array(np.array([5, 6])).tolist()
    (2, 32, [[1, 2], [3, 4], [5, 6]])
    >>> spill.close()
    """

    def __init__(self, width: int, dtype: type[np.generic], memory_rows: int, folder: Path | None = None) -> None:
        self._rows = 0
        self._memory_rows = memory_rows
        self._folder = folder
        self._kept: npt.NDArray[Any] = np.empty((min(memory_rows, 1), width), dtype)
        self._file: IO[bytes] | None = None

    def __len__(self) -> int:
        return self._rows

    @property
    def file_bytes(self) -> int:
        """Size of what lies in the file, 0 while all is in memory."""
        return 0 if self._file is None else self._rows * self._row_bytes

    def append(self, row: npt.NDArray[Any]) -> None:
        """Add one row at the end."""
        self._put(row)
        self._rows += 1

    def array(self, tail: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """All rows and `tail` behind them, shape (rows + 1, width); valid until the next call of any method."""
        self._put(tail)
        if self._file is None:
            return self._kept[: self._rows + 1]
        self._file.flush()
        # mapped for writing: numba takes read-only arrays for another type and would compile its code once more
        mapped = np.memmap(self._file, self._kept.dtype, "r+", shape=(self._rows + 1, self._kept.shape[1]))
        return np.asarray(mapped)

    def close(self) -> None:
        """Free the file and the memory."""
        if self._file is not None:
            self._file.close()
        self._file = None
        self._rows = 0
        self._kept = self._kept[:0].copy()

    @property
    def _row_bytes(self) -> int:
        return int(self._kept.shape[1] * self._kept.itemsize)

    def _put(self, row: npt.NDArray[Any]) -> None:
        """Write a row behind the last one, over a tail that lies there."""
        if self._file is None and self._rows >= self._memory_rows:
            self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115  close() closes it
            self._file.write(self._kept[: self._rows].tobytes())
            self._kept = self._kept[:0].copy()
        if self._file is not None:
            self._file.seek(self._rows * self._row_bytes)
            self._file.write(row.astype(self._kept.dtype).tobytes())
            return
        if self._rows == len(self._kept):
            grown = np.empty((min(2 * self._rows, self._memory_rows), self._kept.shape[1]), self._kept.dtype)
            grown[: self._rows] = self._kept
            self._kept = grown
        self._kept[self._rows] = row
