"""Lines of a delimited text file, one by one: slow, and exact about which cell of which line is wrong."""

import csv
import math
from collections.abc import Sequence

import numpy as np

from ingest.tables.columns import Columns
from ingest.tables.rows import BadRow, CellBlock, NumberCells, Sieve, TextCells
from ingest.tables.times import NUMBER, STAMP, ns_from_stamp, ns_from_text
from stream.batch import FloatArray
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
        texts = [raw.decode().removesuffix("\r") for raw in block.split(b"\n")[:-1]]
        lines = [
            (number, text)
            for number, text in enumerate(texts, first_line)
            if text.strip(_BLANK) or self._delimiter in text
        ]
        n = len(lines)
        sieve, times_ns = Sieve(n), np.zeros(n, np.int64)
        values = {title: np.full(n, np.nan) for title in self._signals}
        words = {title: [""] * n for title in self._texts}
        for row, (number, text) in enumerate(lines):
            cells: dict[str, str] = {}
            try:
                cells = dict(zip(self._titles, self._cells(text), strict=True))
            except _BadCell as bad:
                sieve.refuse_one(row, bad.in_line(number))
            for title, cell in cells.items():
                try:
                    if title in words:
                        words[title][row] = cell
                    elif title not in values:
                        times_ns[row] = self._time_ns(title, cell.strip(_BLANK))
                    elif cell.strip(_BLANK):
                        values[title][row] = self._finite(title, cell.strip(_BLANK))
                except _BadCell as bad:
                    sieve.refuse_one(row, bad.in_line(number))
        numbers = np.array([number for number, _ in lines], np.int64)
        written_ns = None if self._columns.time is None else times_ns
        signals = {self._signals[title]: _number_cells(column) for title, column in values.items()}
        return CellBlock(
            "line",
            numbers,
            written_ns,
            signals,
            {title: _text_cells(each) for title, each in words.items()},
            sieve,
            done,
        )

    def _cells(self, text: str) -> list[str]:
        cells = split_line(text, self._delimiter)
        if len(cells) != len(self._titles):
            hint = " (a decimal comma? write a point)" if self._delimiter == "," and len(cells) > 1 else ""
            noun = "cell" if len(cells) == 1 else "cells"
            raise _BadCell("", f"{len(cells)} {noun}", f"{len(self._titles)} as in the header{hint}")
        return cells

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
        self._cell = column, found, expected

    def in_line(self, number: int) -> BadRow:
        return BadRow("line", number, *self._cell)


def _number_cells(values: FloatArray) -> NumberCells:
    valid = ~np.isnan(values)
    return NumberCells(values, None) if valid.all() else NumberCells(np.where(valid, values, 0.0), valid)


def _text_cells(cells: list[str]) -> TextCells:
    known: dict[str, int] = {}
    codes = [known.setdefault(cell, len(known)) if cell else -1 for cell in cells]
    return TextCells(np.array(codes, np.int32), list(known))
