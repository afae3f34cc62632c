"""Lines of a delimited text file, one by one: slow, and exact about which cell of which line is wrong."""

import csv
import math
from collections.abc import Iterable, Sequence

import numpy as np

from ingest.tables.columns import Columns
from ingest.tables.rows import BadRow, CellBlock, NumberCells, Sieve, TextCells
from ingest.tables.times import NUMBER, ns_from_text
from stream.batch import IntArray
from stream.errors import BadInput

_BLANK = " \t"


class LineReader:
    """Reads single lines of a file whose columns are known.

    Parameters
    ----------
    titles: Titles of the columns, in order.
    columns: What they are.
    delimiter: Character between cells.
    """

    def __init__(self, titles: Sequence[str], columns: Columns, delimiter: str) -> None:
        self._titles = titles
        self._columns = columns
        self._delimiter = delimiter
        self._signals = {column.title: column.name for column in columns.signals}
        self._texts = frozenset(columns.text_titles)

    def read(self, block: bytes, first_line: int, done: float) -> CellBlock:
        """Read the lines of `block`, which ends with a line feed; blank ones are left out."""
        lines = [
            (number, text)
            for number, raw in enumerate(block.split(b"\n")[:-1], first_line)
            if not self._is_blank(text := raw.decode().removesuffix("\r"))
        ]
        rows = _Rows(len(lines), self._signals.values(), self._texts)
        for row, (number, text) in enumerate(lines):
            try:
                self._read_cells(rows, row, split_line(text, self._delimiter))
            except _BadCell as bad:
                rows.sieve.refuse_row(row, BadRow("line", number, bad.column, bad.found, bad.expected))
        numbers = np.array([number for number, _ in lines], np.int64)
        return rows.block(numbers, self._columns.time is not None, done)

    def _is_blank(self, line: str) -> bool:
        return not line.strip(_BLANK) and self._delimiter not in line

    def _read_cells(self, rows: "_Rows", row: int, cells: list[str]) -> None:
        if len(cells) != len(self._titles):
            hint = " (a decimal comma? write a point)" if self._delimiter == "," and len(cells) > 1 else ""
            noun = "cell" if len(cells) == 1 else "cells"
            raise _BadCell("", f"{len(cells)} {noun}", f"{len(self._titles)} as in the header{hint}")
        wrong: _BadCell | None = None
        for title, cell in zip(self._titles, cells, strict=True):
            try:
                self._read_cell(rows, row, title, cell)
            except _BadCell as bad:
                wrong = wrong or bad
        if wrong is not None:
            raise wrong

    def _read_cell(self, rows: "_Rows", row: int, title: str, cell: str) -> None:
        if title in self._texts:
            rows.put_text(title, row, cell)
            return
        text = cell.strip(_BLANK)
        if title in self._signals:
            if text:
                rows.put_number(self._signals[title], row, _finite(title, text))
            return
        assert self._columns.time is not None
        _check_number(title, text, "a time")
        time_ns = ns_from_text(text, self._columns.time.ns_per_unit)
        if time_ns is None:
            raise _BadCell(title, text, "a time within 146 years of 1970 (or of the run's start)")
        rows.times_ns[row] = time_ns


def split_line(line: str, delimiter: str) -> list[str]:
    """Take a line apart into cells.

    Raises
    ------
    BadInput: If quotes do not match or a carriage return stands within the line; the text says what was expected.

    Examples
    --------
    >>> split_line('1.5;"FOG;1"', ";")
    ['1.5', 'FOG;1']
    """
    if "\r" in line:
        raise _BadCell("", line, "no carriage return within a line")
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise _BadCell("", line, "cells whose quotes match within the line") from error


class _BadCell(BadInput):
    def __init__(self, column: str, found: str, expected: str) -> None:
        super().__init__(f"found {found!r}, expected {expected}")
        self.column = column
        self.found = found
        self.expected = expected


def _check_number(title: str, text: str, what: str) -> None:
    if NUMBER.fullmatch(text):
        return
    if NUMBER.fullmatch(text.replace(",", ".", 1)):
        raise _BadCell(title, text, f"{what} with a decimal point, not a comma")
    raise _BadCell(title, text, f"{what}, as a number")


def _finite(title: str, text: str) -> float:
    if text.lower().lstrip("+-") in {"nan", "inf", "infinity"}:
        raise _BadCell(title, text, "a finite number (leave the cell empty for no sample)")
    _check_number(title, text, "a value")
    value = float(text)
    if not math.isfinite(value):
        raise _BadCell(title, text, "a number below 1.8e308")
    return value


class _Rows:
    """Cells of some lines, column by column, while they are filled in."""

    def __init__(self, n: int, signals: Iterable[str], texts: frozenset[str]) -> None:
        self.sieve = Sieve(n)
        self.times_ns = np.zeros(n, np.int64)
        self._values = {name: np.zeros(n) for name in signals}
        self._valid = {name: np.zeros(n, np.bool_) for name in self._values}
        self._codes = {title: np.full(n, -1, np.int32) for title in texts}
        self._known: dict[str, dict[str, int]] = {title: {} for title in texts}

    def put_number(self, name: str, row: int, value: float) -> None:
        self._values[name][row] = value
        self._valid[name][row] = True

    def put_text(self, title: str, row: int, cell: str) -> None:
        if cell:
            known = self._known[title]
            self._codes[title][row] = known.setdefault(cell, len(known))

    def block(self, numbers: IntArray, has_times: bool, done: float) -> CellBlock:
        signals = {
            name: NumberCells(values, None if self._valid[name].all() else self._valid[name])
            for name, values in self._values.items()
        }
        texts = {title: TextCells(codes, list(self._known[title])) for title, codes in self._codes.items()}
        return CellBlock("line", numbers, self.times_ns if has_times else None, signals, texts, self.sieve, done)
