"""Lines of a text table: their dialect (comments, header, delimiter, decimal mark, time stamps), and one by one.

Reading them one by one is slow, and exact about which cell of which line is wrong.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, islice

import numpy as np

from ingest.tables.columns import Columns, TimeColumn
from ingest.tables.rows import CellBlock, NumberCells, Sieve, TextCells
from ingest.tables.text.csv_header import DELIMITERS, BadCell, cells_of, header_place, is_row, split_line, with_units
from ingest.tables.times import NUMBER, match_stamp, ns_from_stamp, ns_from_text
from ingest.tables.timing.dated_clocks import joined
from stream.batch import FloatArray
from stream.errors import BadInput

COMMENT = re.compile(rb"(?m)^#[^\n]*")

# names the delimiter, for Excel
_NAMED_DELIMITER = re.compile(r'"?sep=([\t;,])"?', re.IGNORECASE)
_BLANKS = re.compile(rb"[ \t]+")
_MARGINS = re.compile(rb"(?m)^ | (?=\r?$)")
_BLANK_TITLE = re.compile(r"[^\s\[(]+(?:\s*(?:\[[^\]]*\]|\([^)]*\)))?")
_BLANK = " \t"
_SAMPLE_CELLS = 40
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2}[.,][0-9]{3}")
_HUNDREDS = re.compile(r"[+-]?[1-9][0-9]{2}")
_RANGE = "a time within 146 years of 1970 (or of the run's start)"


@dataclass(frozen=True)
class Dialect:
    """How a table is written."""

    titles: tuple[str, ...]
    delimiter: str
    first_line: int  # of the rows, counted from 1
    first_byte: int
    comments: int  # comment lines before that place, a header among them excepted
    is_header_comment: bool
    sample: tuple[str, ...]  # the first rows
    preamble: tuple[str, ...] = ()  # lines before the header that belong to no table
    has_unit_line: bool = False  # below the titles
    blank_titles: frozenset[str] = frozenset()  # of the last columns, which have no title and no cells

    @property
    def has_rows(self) -> bool:
        """Whether one of the first rows can be taken apart into cells."""
        return any(self._sample_cells())

    @property
    def stamp_titles(self) -> frozenset[str]:
        """Titles of the columns whose first cell is a time stamp."""
        first = next(self._sample_cells(), ())
        return frozenset(title for title, cell in zip(self.titles, first, strict=False) if match_stamp(cell))

    @property
    def first_cells(self) -> dict[str, str]:
        """Cells of the first row by title."""
        return dict(zip(self.titles, next(self._sample_cells(), ()), strict=False))

    def sample_cells(self, title: str) -> list[str]:
        """First cells of a column."""
        at = self.titles.index(title)
        return [cells[at] for cells in islice(self._sample_cells(), _SAMPLE_CELLS) if len(cells) > at]

    def has_zone(self, time: TimeColumn) -> bool | None:
        """Whether the first time stamp of the column names a zone; None if there is none."""
        rows = (dict(zip(self.titles, cells, strict=False)) for cells in self._sample_cells())
        stamps = (_stamp_text(time, row) for row in rows)
        first = next((found for each in stamps if (found := match_stamp(each)) is not None), None)
        return None if first is None else first["zone"] is not None

    def decimal_mark(self, titles: Sequence[str]) -> str:
        """Decimal mark of the columns: that of the first number among them that has one."""
        if self.delimiter == ",":
            return "."
        columns = [self.titles.index(title) for title in titles]
        for cells in self._sample_cells():
            for column in columns:
                mark = re.search("[.,]", cells[column]) if len(cells) > column else None
                if mark and NUMBER.fullmatch(cells[column].replace(",", ".")):
                    return mark[0]
        return "."

    def thousands(self, titles: Sequence[str], mark: str) -> tuple[str, str] | None:
        """A column whose mark may separate thousands, and such a cell: beside whole numbers all have three digits.

        >>> found = find_dialect([("raw[count];t[s]", 16), ("998;0.5", 24), ("1.001;0.6", 34)])
        >>> found.thousands(["raw[count]", "t[s]"], ".")
        ('raw[count]', '1.001')
        """
        if self.delimiter == ",":
            return None
        rows = list(self._sample_cells())
        for title in titles:
            column = self.titles.index(title)
            cells = [cells[column] for cells in rows if len(cells) > column and cells[column]]
            marked = [cell for cell in cells if mark in cell]
            whole = [cell for cell in cells if mark not in cell]
            if marked and all(_THOUSANDS.fullmatch(cell) for cell in marked) and any(map(_HUNDREDS.fullmatch, whole)):
                return title, marked[0]
        return None

    def is_cut(self, line: str) -> bool | None:
        """Whether a last line without an end lacks digits of its last cell; None if that cannot be seen.

        It can where all numbers of the column have as many decimals.

        >>> found = find_dialect([("t[s],rate", 9), ("0.0,1.25", 18), ("0.1,1.50", 27)])
        >>> found.is_cut("0.2,1.7"), found.is_cut("0.2,1.75")
        (True, False)
        """
        cells = cells_of(line, self.delimiter)
        if len(cells) != len(self.titles):
            return False  # refused as any such line
        sample = self.sample[:-1] if self.sample[-1:] == (line,) else self.sample
        rows = (cells_of(each, self.delimiter) for each in sample)
        above = {_decimals(row[-1]) for row in rows if len(row) == len(cells)}
        if len(above) != 1 or above <= {None, 0}:
            return None if NUMBER.fullmatch(cells[-1].replace(",", ".")) else False
        return _decimals(cells[-1]) != above.pop()

    def _sample_cells(self) -> Iterator[tuple[str, ...]]:
        """Cells of the first rows, each taken apart when it is asked for: most questions end with the first."""
        return filter(None, (cells_of(text, self.delimiter) for text in self.sample))


def find_dialect(lines: Sequence[tuple[str, int]]) -> Dialect:
    """Find the dialect from the first lines of a file, each with the place in the file behind it.

    A header in a comment, as NumPy writes it, is taken if the first line that is none consists of numbers. A first line
    like ``sep=;`` names the delimiter.

    >>> found = find_dialect([("# bench 3", 10), ("Time (s);Rate (deg/s)", 32), ("0,5;1", 38)])
    >>> found.titles, found.delimiter, found.comments, found.first_line, found.decimal_mark(["Time (s)"])
    (('Time (s)', 'Rate (deg/s)'), ';', 1, 3, ',')
    """
    named = _NAMED_DELIMITER.fullmatch(lines[0][0]) if any(text.strip() for text, _ in lines[1:]) else None
    if named:
        lines = [("", lines[0][1]), *lines[1:]]
    written = [i for i, (text, _) in enumerate(lines) if text[:1] != "#" and text.strip()]
    header_at, units_at = header_place(lines, written)
    header = lines[header_at][0]
    preamble = tuple(lines[i][0].strip() for i in written if i < header_at)
    comments = [i for i in range(header_at) if lines[i][0].startswith("#")]
    rows_at, is_header_comment = (header_at if units_at is None else units_at) + 1, False
    if comments and is_row(header):
        title_line = lines[comments[-1]][0].lstrip("# \t")
        if title_line and not is_row(title_line):
            header, rows_at, is_header_comment = title_line, header_at, True
            comments.pop()
    rows = tuple(lines[i][0] for i in written if i >= rows_at)
    delimiter = named[1] if named else max(DELIMITERS, key=header.count)
    wide = next((mark for mark in "，；、" if mark in header and rows and mark in rows[0]), None)
    if delimiter not in header and wide is not None:
        raise BadInput(
            f"its cells stand between {wide!r}, a separator of texts: replace it by a comma, as in Excel's CSV"
        )
    titles = tuple(title.strip() for title in split_line(header, delimiter))
    if not any(mark in header for mark in DELIMITERS) and rows and len(rows[0].split()) > 1:
        by_blanks = tuple(title.strip() for title in _BLANK_TITLE.findall(header))
        if len(by_blanks) == len(rows[0].split()) and not any(mark in rows[0] for mark in "\t;"):
            delimiter, titles = " ", by_blanks
    if units_at is not None and len(units := split_line(lines[units_at][0], delimiter)) == len(titles):
        titles = with_units(titles, units)
    elif units_at is not None:  # it has other cells than titles: a row, which is not right
        rows_at = units_at
        units_at = None
    titles, blank = _with_named_blanks(titles, rows, delimiter)
    return Dialect(
        titles, delimiter, first_line=rows_at + 1, first_byte=lines[rows_at - 1][1] if rows_at else 0,
        comments=len(comments), is_header_comment=is_header_comment, sample=rows,
        preamble=preamble, has_unit_line=units_at is not None, blank_titles=blank,
    )  # fmt: skip


def _with_named_blanks(
    titles: tuple[str, ...], rows: Sequence[str], delimiter: str
) -> tuple[tuple[str, ...], frozenset[str]]:
    """Titles, where the last are empty and their cells too with names in their place, and these names."""
    if titles[-1] or not rows:
        return titles, frozenset()
    first = next((at for at in range(len(titles), 0, -1) if titles[at - 1]), 0)
    cells = list(filter(None, (cells_of(row, delimiter) for row in rows[:_SAMPLE_CELLS])))
    if not first or any("".join(row[first:]) for row in cells):
        return titles, frozenset()
    if all(len(row) == first for row in cells):  # the header alone has them
        return titles[:first], frozenset()
    named = tuple(f"(column {number})" for number in range(first + 1, len(titles) + 1))
    return titles[:first] + named, frozenset(named)


def usual_lines(begin: bytes, rows: int, *, is_whole: bool) -> list[tuple[str, int]]:
    r"""The first lines of a file up to so many rows, each with the place behind it, if all of them are in ASCII.

    Nothing, for lines that are to be read one by one, if they are not, if a carriage return ends no line, or if the
    beginning of the file, unless it is the whole, has fewer rows.

    >>> usual_lines(b"# bench 3\r\nt,rate\r\n0,1.5", 9, is_whole=True)
    [('# bench 3', 11), ('t,rate', 19), ('0,1.5', 24)]
    >>> usual_lines(b"t,rate\n0,1.5\n0.1", 9, is_whole=False)
    []
    """
    if not begin.isascii() or begin.count(b"\r") != begin.count(b"\r\n"):
        return []
    texts = begin.decode().split("\n")
    if not is_whole or not texts[-1]:
        texts.pop()
    ends = [min(end, len(begin)) for end in accumulate(len(text) + 1 for text in texts)]
    if b"\r" in begin:
        texts = [text.rstrip("\r") for text in texts]
    found = [i for i, text in enumerate(texts) if text[:1] != "#" and text.strip()]
    if len(found) < rows and not is_whole:
        return []
    most = found[rows - 1] + 1 if len(found) >= rows else len(texts)
    return list(zip(texts[:most], ends[:most], strict=True))


def is_gb18030(text: bytes) -> bool:
    """Whether text is likely Chinese in GB18030 or GBK: most of its characters are common ones, those of GB 2312.

    >>> is_gb18030("角速率(°/h)".encode("gbk")), is_gb18030("Temp (°C), µT".encode("latin-1"))
    (True, False)
    """
    try:
        characters = [each.encode("gb18030") for each in text.decode("gb18030") if not each.isascii()]
    except UnicodeDecodeError:
        return False
    common = sum(len(each) == 2 and min(each) >= 0xA1 for each in characters)
    return 2 * common > len(characters)


def without_blanks(block: bytes) -> bytes:
    """Lines whose cells are separated by one blank each, and have none at their ends."""
    return _MARGINS.sub(b"", _BLANKS.sub(b" ", block))


def _decimals(cell: str) -> int | None:
    """Digits behind the decimal mark of a number; None where it has an exponent or is none."""
    found = re.fullmatch(r"[+-]?[0-9]+(?:[.,]([0-9]*))?", cell)
    return None if found is None else len(found[1] or "")


class LineReader:
    """Reads single lines of a file with known columns; `time_zone` is that of time stamps that name none."""

    def __init__(
        self, titles: Sequence[str], columns: Columns, delimiter: str, decimal_mark: str = ".", time_zone: str = "UTC"
    ) -> None:
        self._titles, self._columns, self._delimiter = titles, columns, delimiter
        self._decimal_mark, self._time_zone = decimal_mark, time_zone
        self.has_zone: bool | None = None  # whether the time stamps name one; of the first row
        self._signals = {column.title: column.name for column in columns.signals}
        self._texts, self._blank = frozenset(columns.text_titles), frozenset(columns.blank)
        self._time_title = None if columns.time is None else columns.time.title

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
            except BadCell as bad:
                sieve.refuse_one(row, bad.in_line(number))
            for title, cell in cells.items():
                try:
                    if title in words:
                        words[title][row] = cell
                    elif title == self._time_title:
                        times_ns[row] = self._time_ns(title, cell.strip(_BLANK), cells)
                    elif title in values and cell.strip(_BLANK):
                        values[title][row] = self._finite(title, cell.strip(_BLANK))
                    elif title in self._blank and cell.strip(_BLANK):
                        raise BadCell(title, cell, "no cell in a column without a title")
                except BadCell as bad:
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
            if len(cells) == len(self._titles) + 1 and not cells[-1].strip(_BLANK):
                hint = " (a delimiter at the end of the line? remove it, or give the header one)"
            noun = "cell" if len(cells) == 1 else "cells"
            raise BadCell("", f"{len(cells)} {noun}", f"{len(self._titles)} as in the header{hint}")
        return cells

    def _time_ns(self, title: str, text: str, cells: Mapping[str, str]) -> int:
        time = self._columns.time
        assert time is not None
        if time.is_stamp:
            text = _stamp_text(time, cells)
            if time.date_title is not None and not cells.get(time.date_title, "").strip(_BLANK):
                raise BadCell(time.date_title, "", "a date in each row, like 2026-11-21")
            stamp = match_stamp(text)
            if stamp is not None and self.has_zone not in (None, stamp["zone"] is not None):
                which = "with a zone" if self.has_zone else "without a zone"
                raise BadCell(title, text, f"a time stamp {which}, as in the first row")
            if stamp is None:
                raise BadCell(title, text, "a time stamp, like 2026-11-21T18:00:00.5Z")
            found, expected = ns_from_stamp(text, self._time_zone), "a moment that exists, within 146 years of 1970"
        else:
            found, expected = ns_from_text(self._number(title, text, "a time"), time.ns_per_unit), _RANGE
        if found is None:
            raise BadCell(title, text, expected)
        return found

    def _number(self, title: str, text: str, what: str) -> str:
        """The text of a number, with a decimal point."""
        mark, other = (",", ".") if self._decimal_mark == "," else (".", ",")
        if NUMBER.fullmatch(text.replace(mark, ".")) and (mark == "." or "." not in text):
            return text.replace(mark, ".")
        if NUMBER.fullmatch(text.replace(other, ".", 1)):
            names = ("comma", "point, as in the first rows") if mark == "," else ("point", "comma")
            raise BadCell(title, text, f"{what} with a decimal {names[0]}, not a {names[1]}")
        raise BadCell(title, text, f"{what}, as a number")

    def _finite(self, title: str, text: str) -> float:
        if text.lower().lstrip("+-") in {"nan", "inf", "infinity"}:
            raise BadCell(title, text, "a finite number (leave the cell empty for no sample)")
        value = float(self._number(title, text, "a value"))
        if not math.isfinite(value):
            raise BadCell(title, text, "a number below 1.8e308")
        return value


def _stamp_text(time: TimeColumn, row: Mapping[str, str]) -> str:
    """The time stamp in a row, of one column or two."""
    text = row.get(time.title, "").strip(_BLANK)
    return text if time.date_title is None else joined(row.get(time.date_title, "").strip(_BLANK), text)


def _number_cells(values: FloatArray) -> NumberCells:
    valid = ~np.isnan(values)
    return NumberCells(values, None) if valid.all() else NumberCells(np.where(valid, values, 0.0), valid)


def _text_cells(cells: list[str]) -> TextCells:
    known: dict[str, int] = {}
    codes = [known.setdefault(cell, len(known)) if cell else -1 for cell in cells]
    return TextCells(np.array(codes, np.int32), list(known))
