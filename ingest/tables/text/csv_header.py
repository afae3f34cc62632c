"""Where the header of a text table stands: lines before it, and a line with the units below it."""

import csv
import re
from collections.abc import Sequence

from ingest.tables.rows import BadRow
from ingest.tables.times import NUMBER, match_stamp
from ingest.tables.timing.dated_clocks import is_clock, is_date
from ingest.tables.units import is_same_unit, is_unit
from stream.errors import BadInput

DELIMITERS = "\t;,"
_MOST_BEFORE_ROWS = 100  # lines that may stand before the first row of numbers
_UNIT = re.compile(r"[^\s(\[（][ \t]*[(\[（][^()\[\]（）]+[)\]）]")  # of a title
_ALIKE = 4  # lines with numbers and words in the same columns are rows


def header_place(lines: Sequence[tuple[str, int]], written: Sequence[int]) -> tuple[int, int | None]:
    """Place of the header, and of a line with the units below it, among the lines that are no comments.

    It is the first of them, but where the first row of numbers has other cells than that: then the last before the
    row that has as many.

    >>> header_place([("Logger 7", 9), ("", 10), ("t,rate", 17), ("s,deg/s", 25), ("0,1.5", 31)], [0, 2, 3, 4])
    (2, 3)
    """
    texts = [lines[i][0] for i in written]
    first = _first_row(texts)
    if first < 2:
        return written[0], None
    row = lines[written[first]][0]
    # a comma may be that of decimals, the others are in no number
    delimiter = next((mark for mark in DELIMITERS if mark != "," and mark in row), ",")
    if delimiter not in row:
        return written[0], None
    of_row = cells_of(row, delimiter)
    above = cells_of(lines[written[first - 1]][0], delimiter)
    may_be_units = len(above) == len(of_row) and any(above) and all(map(_is_unit_cell, above))
    alike = [at for at in range(first) if _is_as_wide(cells_of(lines[written[at]][0], delimiter), of_row)]
    alike += [first - 1] if may_be_units and first - 1 not in alike else []  # the last columns may have no unit
    if not alike or alike[-1] != first - 1:
        return written[0], None
    has_units = may_be_units and len(alike) > 1 and alike[-2] == first - 2
    header = first - 1 - has_units
    titles = _without_empty_end(cells_of(lines[written[header]][0], delimiter))
    if header and ("[" in lines[written[0]][0] or any(is_row(cell) or not cell for cell in titles)):
        return written[0], None  # the first line has titles, and rows below it are not right
    if alike[0] < header or _has_rows(texts[:header]):
        return written[0], None
    return written[header], written[first - 1] if has_units else None


def _is_as_wide(cells: Sequence[str], of_row: Sequence[str]) -> bool:
    """Whether a line has as many cells as a row, and no more empty ones at its end: Excel writes short lines so."""
    return len(cells) == len(of_row) and len(_without_empty_end(cells)) >= len(_without_empty_end(of_row))


def _without_empty_end(cells: Sequence[str]) -> Sequence[str]:
    return cells[: next((at for at in range(len(cells), 0, -1) if cells[at - 1]), 0)]


def _first_row(texts: Sequence[str]) -> int:
    """Place of the first line of numbers; without one, of the first of four with numbers, and words in other columns.

    0 if there is no row.

    >>> _first_row(["Logger;7", "t;step", "0,0;rest", ";rest", "0,2;rest", "0,3;turn"])
    2
    >>> _first_row(["Logger,7,", "t,rate,note", "0.0,1.5,begun", "0.1,1.6,"])
    2
    """
    texts = texts[: _MOST_BEFORE_ROWS + _ALIKE]
    kinds = [_kinds(text) for text in texts]
    if (first := next((at for at, text in enumerate(texts[:_MOST_BEFORE_ROWS]) if is_row(text)), None)) is not None:
        while first and _has_numbers_of(kinds[first], kinds[first - 1]):  # a row with a remark
            first -= 1
        return first
    for at in range(len(texts) - _ALIKE + 1):
        together = kinds[at : at + _ALIKE]
        if len({len(each) for each in together}) == 1:
            columns = [{kind for kind in column if kind is not None} for column in zip(*together, strict=True)]
            if all(len(each) <= 1 for each in columns) and {True} in columns and {False} in columns:
                return at
    return 0


def _has_numbers_of(row: Sequence[bool | None], line: Sequence[bool | None]) -> bool:
    """Whether a line has numbers in all cells in which a row has them."""
    return len(line) == len(row) > 0 and all(has for has, is_number in zip(line, row, strict=True) if is_number)


def _kinds(text: str) -> tuple[bool | None, ...]:
    """Which cells of a line are numbers or time stamps; None for empty ones."""
    delimiter = next((mark for mark in DELIMITERS if mark in text), "")
    return tuple(is_row(cell) if cell else None for cell in cells_of(text, delimiter)) if delimiter else ()


def _has_rows(texts: Sequence[str]) -> bool:
    """Whether some lines are a table: titles with a unit, and below them two lines with numbers in the same columns."""
    kinds = [_kinds(text) for text in texts]
    return any(
        _UNIT.search(texts[at]) is not None and len(kinds[at]) == len(kinds[at + 1]) == len(kinds[at + 2])
        and any(a is b is True for a, b in zip(kinds[at + 1], kinds[at + 2], strict=True))
        for at in range(len(texts) - 2)
    )  # fmt: skip


def _is_unit_cell(cell: str) -> bool:
    return not cell or is_unit(_bare_unit(cell))


def _bare_unit(cell: str) -> str:
    return cell.strip(" \t").strip("[]()（）").strip()


def with_units(titles: Sequence[str], units: Sequence[str]) -> tuple[str, ...]:
    """Titles with the unit below them, where they have none themselves; BadInput where both have one, and another."""
    for title, unit in zip(titles, units, strict=True):
        own = re.search(r"[(\[（]([^()\[\]（）]*)[)\]）]$", title)
        below = _bare_unit(unit)
        if own is not None and below and is_unit(own[1]) and not is_same_unit(own[1], below):
            raise BadInput(f"title {title!r} and the line below it, {unit!r}, name two units; keep the right one")
    return tuple(
        title if not _bare_unit(unit) or title.endswith((")", "]", "）")) else f"{title} ({_bare_unit(unit)})"
        for title, unit in zip(titles, units, strict=True)
    )


def is_row(line: str) -> bool:
    """Whether a line consists of numbers, time stamps, and times of day beside a date."""
    cells = [cell.strip(' "') for cell in re.split("[\t;]|,(?![0-9])| (?=[-+0-9.]*$)", line) if cell.strip(' "')]
    cells = [
        part for cell in cells for part in ([cell] if match_stamp(cell) or is_clock(cell) else re.split("[, ]+", cell))
    ]
    has_date = any(map(is_date, cells))  # without one a time of day stands in the lines before a header
    return bool(cells) and all(
        match_stamp(cell) or NUMBER.fullmatch(cell) or (has_date and is_clock(cell)) for cell in cells
    )


def cells_of(line: str, delimiter: str) -> tuple[str, ...]:
    """Cells of a line; none if its quotes do not match."""
    try:
        cells = line.split() if delimiter == " " else split_line(line, delimiter)
    except BadInput:
        return ()
    return tuple(cell.strip(" \t") for cell in cells)


def split_line(line: str, delimiter: str) -> list[str]:
    """Take a line apart into cells.

    >>> split_line('1.5;"FOG;1"', ";")
    ['1.5', 'FOG;1']
    """
    if "\r" in line:
        raise BadCell("", line, "no carriage return within a line")
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise BadCell("", line, "cells whose quotes match within the line") from error


class BadCell(BadInput):
    """A cell that keeps no contract: its column, what was found, and what was expected."""

    def __init__(self, column: str, found: str, expected: str) -> None:
        super().__init__(f"found {found!r}, expected {expected}")
        self._cell = column, found, expected

    def in_line(self, number: int) -> BadRow:
        """The row with its number."""
        return BadRow("line", number, *self._cell)
