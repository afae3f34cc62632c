"""The dialect of a text table, found from its first lines: comments, header, delimiter, decimal mark, time stamps."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ingest.tables.csv_lines import split_line
from ingest.tables.times import NUMBER, STAMP
from stream.errors import BadInput

COMMENT = re.compile(rb"(?m)^#[^\n]*")

_DELIMITERS = "\t;,"
_BLANKS = re.compile(rb"[ \t]+")
_MARGINS = re.compile(rb"(?m)^ | (?=\r?$)")
_BLANK_TITLE = re.compile(r"[^\s\[(]+(?:\s*(?:\[[^\]]*\]|\([^)]*\)))?")


@dataclass(frozen=True)
class Dialect:
    """How a table is written."""

    titles: tuple[str, ...]
    delimiter: str
    first_line: int  # of the rows, counted from 1
    first_byte: int
    comments: int  # comment lines before that place, a header among them excepted
    is_header_comment: bool
    sample: tuple[tuple[str, ...], ...]  # cells of the first rows

    @property
    def stamp_titles(self) -> frozenset[str]:
        """Titles of the columns whose first cell is an ISO 8601 time stamp."""
        first = self.sample[0] if self.sample else ()
        return frozenset(title for title, cell in zip(self.titles, first, strict=False) if STAMP.fullmatch(cell))

    def lacks_zone(self, title: str) -> bool:
        """Whether a time stamp of the column names no zone."""
        column = self.titles.index(title)
        matches = [STAMP.fullmatch(cells[column]) for cells in self.sample if len(cells) > column]
        return any(match is not None and match["zone"] is None for match in matches)

    def decimal_mark(self, titles: Sequence[str]) -> str:
        """Decimal mark of the columns: that of the first number among them that has one."""
        if self.delimiter == ",":
            return "."
        columns = [self.titles.index(title) for title in titles]
        for cells in self.sample:
            for column in columns:
                mark = re.search("[.,]", cells[column]) if len(cells) > column else None
                if mark and NUMBER.fullmatch(cells[column].replace(",", ".")):
                    return mark[0]
        return "."


def find_dialect(lines: Sequence[tuple[str, int]]) -> Dialect:
    """Find the dialect from the first lines of a file, each with the place in the file behind it.

    A header in a comment, as NumPy writes it, is taken if the first line that is none consists of numbers.

    >>> found = find_dialect([("# bench 3", 10), ("Time (s);Rate (deg/s)", 32), ("0,5;1", 38)])
    >>> found.titles, found.delimiter, found.comments, found.first_line, found.decimal_mark(["Time (s)"])
    (('Time (s)', 'Rate (deg/s)'), ';', 1, 3, ',')
    """
    header_at = next(i for i, (text, _) in enumerate(lines) if text.strip() and not text.startswith("#"))
    header = lines[header_at][0]
    comments = [i for i in range(header_at) if lines[i][0].startswith("#")]
    rows_at, is_header_comment = header_at + 1, False
    if comments and _is_row(header):
        title_line = lines[comments[-1]][0].lstrip("# \t")
        if title_line and not _is_row(title_line):
            header, rows_at, is_header_comment = title_line, header_at, True
            comments.pop()
    rows = [text for text, _ in lines[rows_at:] if text.strip() and not text.startswith("#")]
    delimiter = max(_DELIMITERS, key=header.count)
    titles = tuple(title.strip() for title in split_line(header, delimiter))
    if not any(mark in header for mark in _DELIMITERS) and rows and len(rows[0].split()) > 1:
        by_blanks = tuple(title.strip() for title in _BLANK_TITLE.findall(header))
        if len(by_blanks) == len(rows[0].split()) and not any(mark in rows[0] for mark in "\t;"):
            delimiter, titles = " ", by_blanks
    return Dialect(
        titles, delimiter, first_line=rows_at + 1, first_byte=lines[rows_at - 1][1] if rows_at else 0,
        comments=len(comments), is_header_comment=is_header_comment,
        sample=tuple(filter(None, (_cells(text, delimiter) for text in rows))),
    )  # fmt: skip


def without_blanks(block: bytes) -> bytes:
    """Lines whose cells are separated by one blank each, and have none at their ends."""
    return _MARGINS.sub(b"", _BLANKS.sub(b" ", block))


def _is_row(line: str) -> bool:
    cells = [cell.strip(' "') for cell in re.split("[\t;]|,(?![0-9])| (?=[-+0-9.]*$)", line) if cell.strip(' "')]
    cells = [part for cell in cells for part in ([cell] if STAMP.fullmatch(cell) else re.split("[, ]+", cell))]
    return bool(cells) and all(STAMP.fullmatch(cell) or NUMBER.fullmatch(cell) for cell in cells)


def _cells(line: str, delimiter: str) -> tuple[str, ...]:
    try:
        cells = line.split() if delimiter == " " else split_line(line, delimiter)
    except BadInput:
        return ()
    return tuple(cell.strip(" \t") for cell in cells)
