"""Lines of a delimited text file, one by one: slow, and exact about which cell of which line is wrong."""

import csv
import math
from collections.abc import Iterable, Sequence

import numpy as np

from ingest.tables.columns import Columns
from ingest.tables.rows import BadRow, CellBlock, NumberCells, Sieve, TextCells
from ingest.tables.times import NUMBER, STAMP, ns_from_stamp, ns_from_text
from stream.batch import IntArray
from stream.errors import BadInput

_BLANK = " \t"
_RANGE = "a time within 146 years of 1970 (or of the run's start)"


class LineReader:
    """Reads single lines of a file with known columns; `time_zone` is that of time stamps that name none."""

    def __init__(
        self, titles: Sequence[str], columns: Columns, delimiter: str, decimal_mark: str = ".", time_zone: str = "UTC"
    ) -> None:
        self._titles, self._columns, self._delimiter = titles, columns, delimiter
        self._decimal_mark, self._time_zone = decimal_mark, time_zone
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
                reason = BadRow("line", number, bad.column, bad.found, bad.expected)
                rows.sieve.refuse_one(row, reason)
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
                rows.put_number(self._signals[title], row, self._finite(title, text))
            return
        rows.times_ns[row] = self._time_ns(title, text)

    def _time_ns(self, title: str, text: str) -> int:
        time = self._columns.time
        assert time is not None
        if time.is_stamp:
            if STAMP.fullmatch(text) is None:
                raise _BadCell(title, text, "an ISO 8601 time stamp, like 2026-11-21T18:00:00.5Z")
            found, expected = ns_from_stamp(text, self._time_zone), "a moment that exists, within 146 years of 1970"
        else:
            found, expected = ns_from_text(self._number(title, text, "a time"), time.ns_per_unit), _RANGE
        if found is None:
            raise _BadCell(title, text, expected)
        return found

    def _number(self, title: str, text: str, what: str) -> str:
        """The text of a number, with a decimal point."""
        mark, other = (",", ".") if self._decimal_mark == "," else (".", ",")
        if NUMBER.fullmatch(text.replace(mark, ".")) and (mark == "." or "." not in text):
            return text.replace(mark, ".")
        if NUMBER.fullmatch(text.replace(other, ".", 1)):
            names = ("comma", "point, as in the first rows") if mark == "," else ("point", "comma")
            raise _BadCell(title, text, f"{what} with a decimal {names[0]}, not a {names[1]}")
        raise _BadCell(title, text, f"{what}, as a number")

    def _finite(self, title: str, text: str) -> float:
        if text.lower().lstrip("+-") in {"nan", "inf", "infinity"}:
            raise _BadCell(title, text, "a finite number (leave the cell empty for no sample)")
        value = float(self._number(title, text, "a value"))
        if not math.isfinite(value):
            raise _BadCell(title, text, "a number below 1.8e308")
        return value


def split_line(line: str, delimiter: str) -> list[str]:
    """Take a line apart into cells.

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
        self.column, self.found, self.expected = column, found, expected


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
