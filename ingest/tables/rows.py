"""Blocks of rows as arrays, as a table reader gives them, and the rows that do not keep the contract."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from ingest.tables.times import numpy_of
from stream.batch import BoolArray, FloatArray, IntArray
from stream.errors import BadInput

BAD_ROWS_KEPT = 1000
BAD_ROWS_SHOWN, BAD_ROWS_OF_A_CAUSE = 20, 3
_FOUND_CHARACTERS = 60


@dataclass(frozen=True)
class BadRow:
    """A row that does not keep the import contract."""

    place: str  # what `number` counts from 1: ``line`` of a text file as in an editor, or ``row`` of a Parquet file
    number: int
    column: str  # title of the column, or '' for the row as a whole
    found: str
    expected: str

    def __str__(self) -> str:
        where = f"{self.place} {self.number}" + (f", column {self.column}" if self.column else "")
        found = self.found if len(self.found) <= _FOUND_CHARACTERS else self.found[:_FOUND_CHARACTERS] + "..."
        return f"{where}: found {found!r}, expected {self.expected}"


class BadRows(BadInput):
    """A file with `count` rows that do not keep the contract; `bad` holds the first 1000.

    `cause`: what most of them have in common and what to do about it; else they are to be corrected or left out.
    """

    def __init__(self, path: Path, bad: tuple[BadRow, ...], count: int, cause: str = "") -> None:
        shown = [f"  {row}" for row in bad[: BAD_ROWS_OF_A_CAUSE if cause else BAD_ROWS_SHOWN]]
        if count > len(shown):
            shown.append(f"  ... and {count - len(shown)} more")
        noun = "row does" if count == 1 else "rows do"
        advice = "correct the file, or leave them out with --skip-bad"
        head = f"{path}: {count} {noun} not keep the import contract; {cause or advice}"
        super().__init__("\n".join([head, *shown]))
        self.bad, self.count = bad, count


class Sieve:
    """Which rows of a block are bad, and why the first of them are.

    >>> sieve = Sieve(3)
    >>> sieve.refuse(np.array([1]), lambda row: BadRow("row", row + 1, "rate[deg/s]", "NaN", "a number"))
    >>> sieve.bad.tolist(), len(sieve.reasons())
    ([False, True, False], 1)
    """

    def __init__(self, rows: int) -> None:
        self.bad: BoolArray = np.zeros(rows, np.bool_)
        self._reasons: dict[int, BadRow] = {}

    def refuse(self, rows: npt.NDArray[np.intp], why: Callable[[int], BadRow]) -> None:
        """Mark `rows` (indices within the block) as bad; a row that is bad already keeps its first reason."""
        fresh = rows[~self.bad[rows]]
        self.bad[fresh] = True
        for row in fresh[:BAD_ROWS_KEPT].tolist():
            self._reasons[row] = why(row)

    def refuse_one(self, row: int, reason: BadRow) -> None:
        """Mark one row as bad."""
        self.refuse(np.array([row]), lambda _: reason)

    def reasons(self) -> list[BadRow]:
        """Why rows are bad, in the order of the rows; of many only the first."""
        return [self._reasons[row] for row in sorted(self._reasons)]


@dataclass(frozen=True)
class TextCells:
    """Cells of one text column: its distinct `values`, and the code of each row (-1: empty)."""

    codes: npt.NDArray[np.int32]
    values: list[object]


@dataclass(frozen=True)
class NumberCells:
    """Cells of one signal: `values`, and which of them are not empty (None: all)."""

    values: FloatArray
    valid: BoolArray | None

    @classmethod
    def of(cls, array: pa.Array) -> "NumberCells":
        """Cells of an array of float64, which are empty where it has nulls."""
        if array.null_count == 0:
            return cls(numpy_of(array), None)
        return cls(numpy_of(array.fill_null(0.0)), array.is_valid().to_numpy(zero_copy_only=False))

    def at(self, rows: npt.NDArray[np.intp] | slice) -> "NumberCells":
        """Cells of some rows."""
        return NumberCells(self.values[rows], None if self.valid is None else self.valid[rows])


@dataclass(frozen=True)
class CellBlock:
    """A block of n rows of the file."""

    place: str  # ``line`` or ``row``
    numbers: IntArray  # shape (n,); line or row number of every row
    times_ns: IntArray | None  # shape (n,); times as written, in nanoseconds; None without a time column
    signals: dict[str, NumberCells]  # by name of the signal
    texts: dict[str, TextCells]  # by title of the column: unit, run and the step words
    sieve: Sieve  # rows that are bad already; their cells have no meaning
    done: float  # fraction of the file that is read, 0 to 1

    @property
    def bytes(self) -> int:
        """Memory of its numbers."""
        cells = [each for own in self.signals.values() for each in (own.values, own.valid)]
        codes = [each.codes for each in self.texts.values()]
        return sum(each.nbytes for each in (self.numbers, self.times_ns, *cells, *codes) if each is not None)


class Room:
    """Memory, bytes, for blocks of small files between the two passes; all files of a command share one.

    >>> room = Room(100)
    >>> room.take(60), room.take(60)
    (True, False)
    """

    def __init__(self, most_bytes: int = 32 << 20) -> None:
        self._left = most_bytes

    def take(self, size: int) -> bool:
        """Take so much if there is as much."""
        has_room = size <= self._left
        self._left -= size if has_room else 0
        return has_room

    def give(self, size: int) -> None:
        """Give it back."""
        self._left += size
