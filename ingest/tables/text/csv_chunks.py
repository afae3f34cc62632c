"""Delimited text files, block by block: parsed at speed if good, line by line if not."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from ingest.tables.columns import Columns
from ingest.tables.encodings import how_to_convert, utf16_of
from ingest.tables.rows import CellBlock, NumberCells, Sieve, TextCells
from ingest.tables.text.csv_lines import (
    COMMENT,
    Dialect,
    LineReader,
    find_dialect,
    is_gb18030,
    usual_lines,
    without_blanks,
)
from ingest.tables.text.number_cells import WIDE_MARKS, narrow_numbers, no_number
from ingest.tables.times import decimal_places, match_stamp, ns_from_decimals, ns_from_floats, ns_from_stamps, numpy_of
from ingest.tables.timing.dated_clocks import joined_cells
from stream.batch import IntArray
from stream.errors import BadInput

BLOCK_BYTES = 4 << 20
LONGEST_LINE_BYTES = 8 << 20
# A block in which something is wrong is cut in parts; one of this size is read line by line.
_LINEWISE_BYTES = 64 << 10
_BLANK_LINE = re.compile(rb"(?m)^[ \t\r]*\n")
_PARTS = 8
_SPARE_DIGITS = 15
_ARROW_BLOCK_BYTES = 1 << 20
_BOM = b"\xef\xbb\xbf"
_BEGIN_BYTES, _ENCODING_BYTES = 256 << 10, 4096
_SAMPLE_LINES = 1000


class CsvTable:
    """A text file of cells between commas, semicolons, tabs or blanks; lines that begin with ``#`` are comments."""

    def __init__(self, path: Path, block_bytes: int = BLOCK_BYTES) -> None:
        self._path, self._block_bytes = path, block_bytes
        self._size = max(path.stat().st_size, 1)
        self._is_gb18030 = self._has_wide_numbers = False
        self._dialect = self._find_dialect()
        self.titles, self.stamp_titles = self._dialect.titles, self._dialect.stamp_titles
        self.first_cells, self.sample_cells = self._dialect.first_cells, self._dialect.sample_cells
        self.integer_titles: frozenset[str] = frozenset()  # no column of a text file has a type
        self.duration_units: dict[str, str] = {}
        cells, mark = self.first_cells.items(), self._dialect.delimiter
        self.unsuited = {title: held for title, cell in cells if (held := no_number(cell, mark))}
        self.blank_titles = self._dialect.blank_titles
        # Digits after the point that times need beyond whole nanoseconds: none until the first that has them.
        self._spare_digits = 0
        self._comments = self._blank_line = 0
        self._last_line: tuple[int, bool] | None = None  # one without an end, and whether it is left out
        self._time_zone = "UTC"
        self._has_stamps_without_zone = False
        self._thousands: tuple[str, str] | None = None

    @property
    def local_zone(self) -> str | None:
        """Zone of time stamps that name none; None if there are none."""
        return self._time_zone if self._has_stamps_without_zone else None

    @property
    def remarks(self) -> list[str]:
        """What was interpreted, once the rows are read."""
        found = []
        if self._comments:
            found.append(f"{self._comments:,} comment line{'s' * (self._comments > 1)} (beginning with #) skipped")
        if preamble := self._dialect.preamble:
            shown = ", ".join(repr(each[:40]) for each in preamble[:3])
            more = f" and {len(preamble) - 3} more" if len(preamble) > 3 else ""
            lines = "1 line" if len(preamble) == 1 else f"{len(preamble)} lines"
            found.append(f"{lines} before the header left out: {shown}{more}")
        if self._dialect.has_unit_line:
            found.append("units of measure are taken from the line below the titles")
        if self._dialect.is_header_comment:
            found.append("the header is the last comment before the rows")
        if self._decimal_mark == ",":
            found.append("numbers are read with a decimal comma")
        if self._thousands is not None:
            title, cell = self._thousands
            found.append(
                f"warning: column {title!r}: {cell} is read as {float(cell.replace(',', '.')):g}, and whole numbers "
                "stand beside it; if the mark separates thousands, write the file without it"
            )
        if self._last_line is not None:
            line, is_cut = self._last_line
            found.append(
                f"warning: the last line, {line:,}, has no end (line feed) and its last number has fewer digits than "
                "those above: it is left out; import the file again when it is complete"
                if is_cut
                else f"warning: the last line, {line:,}, has no end (line feed): if the file was still being written, "
                "its last number may lack digits"
            )
        if self._is_gb18030:
            found.append("its text is read as GB18030 (GBK)")
        if self._has_wide_numbers:
            found.append("full-width digits and minus signs of numbers are read as usual ones")
        if self._has_stamps_without_zone:
            found.append(f"time stamps without a zone are taken as {self._time_zone}")
        return found

    def bind(self, columns: Columns, time_zone: str = "UTC") -> None:
        """Set the meaning of the columns."""
        self._columns, self._time_zone = columns, time_zone
        self._decimal_mark = self._dialect.decimal_mark(columns.numeric_titles)
        self._thousands = self._dialect.thousands([each.title for each in columns.signals], self._decimal_mark)
        columns.words = [replace(word, decimal_mark=self._decimal_mark) for word in columns.words]
        self._lines = LineReader(self.titles, columns, self._dialect.delimiter, self._decimal_mark, time_zone)
        self._places = None if columns.time is None else decimal_places(columns.time.ns_per_unit)
        if columns.time is not None and columns.time.is_stamp:
            self._lines.has_zone = self._dialect.has_zone(columns.time)
            self._has_stamps_without_zone = self._lines.has_zone is False

    def blocks(self) -> Iterator[CellBlock]:
        """Read the rows from the beginning."""
        line = self._dialect.first_line
        self._comments = self._dialect.comments
        with self._path.open("rb") as file:
            file.seek(self._dialect.first_byte)
            self._blank_line = 0
            for block in self._whole_lines(file, line):
                block = self._as_utf8(block, line)
                if self._columns.time is None and len(self.titles) == 1:
                    self._check_blank_lines(block, line)
                if b"#" in block:  # a comment becomes a blank line, so that lines keep their numbers
                    block, comments = COMMENT.subn(b"", block)
                    self._comments += comments
                if self._dialect.delimiter == " ":
                    block = without_blanks(block)
                yield from self._parse(block, line, file.tell() / self._size)
                line += _lines(block)

    def _check_blank_lines(self, block: bytes, line: int) -> None:
        """Refuse a blank line before a row of one column without times: it may be a sample that is missing."""
        if not self._blank_line and _BLANK_LINE.search(block) is None:
            return
        for number, text in enumerate(block.split(b"\n")[:-1], line):
            if not text.strip():
                self._blank_line = self._blank_line or number
            elif self._blank_line and not text.lstrip().startswith(b"#"):
                raise BadInput(
                    f"{self._path}, line {self._blank_line}: a blank line between the rows of one column: where a "
                    'sample is missing, write ""; remove other blank lines'
                )

    def _find_dialect(self) -> Dialect:
        with self._path.open("rb") as file:
            begin = file.read(_BEGIN_BYTES)
            if (encoding := utf16_of(begin[:_ENCODING_BYTES])) is not None:
                raise BadInput(f"{self._path}: {encoding} text; {how_to_convert(self._path, encoding)}")
            lines = usual_lines(begin, _SAMPLE_LINES + 1, is_whole=len(begin) == self._size)
            file.seek(lines[-1][1] if lines else 0)
            if not lines:
                lines = self._lines_one_by_one(file)
            has_more = bool(file.read(1))
        rows = any(text.strip() and not text.startswith("#") for text, _ in lines)
        if not rows:
            raise BadInput(f"{self._path}: the file is empty; expected a header like 'time[s],rate[deg/s]'")
        try:
            dialect = find_dialect(lines)
        except BadInput as error:
            header = next(i for i, (text, _) in enumerate(lines, 1) if text.strip() and not text.startswith("#"))
            raise BadInput(f"{self._path}, line {header}: {error}") from error
        if not dialect.has_rows and not has_more:
            raise BadInput(f"{self._path}: a header and no rows; nothing to import")
        return dialect

    def _lines_one_by_one(self, file: BinaryIO) -> list[tuple[str, int]]:
        """The first lines, each with the place in the file behind it."""
        lines: list[tuple[str, int]] = []
        rows = end = 0
        while rows <= _SAMPLE_LINES and (raw := file.readline(LONGEST_LINE_BYTES)):
            end += len(raw)
            if not lines:
                raw = raw.removeprefix(_BOM)
            if rows and len(raw) == LONGEST_LINE_BYTES:
                break  # found with its line when the rows are read
            try:
                text = self._as_utf8(raw, len(lines) + 1).decode().rstrip("\r\n")
            except BadInput:
                if rows:
                    break  # likewise
                raise
            rows += not text.startswith("#") and bool(text.strip())
            if rows == 1 and "\r" in text:
                raise BadInput(f"{self._path}: lines end with a carriage return alone; save it with line feeds")
            lines.append((text, end))
        return lines

    def _as_utf8(self, block: bytes, line: int) -> bytes:
        """Lines as UTF-8: those of a file in the encoding of Chinese programs are written again."""
        if block.isascii():
            return block
        if not self._is_gb18030:
            try:
                block.decode()
            except UnicodeDecodeError as error:
                if not is_gb18030(block):
                    raise self._not_text(line + block.count(b"\n", 0, error.start)) from error
                self._is_gb18030 = True
            else:
                return self._narrow(block)
        try:
            return self._narrow(block.decode("gb18030").encode())
        except UnicodeDecodeError as error:
            raise self._not_text(line + block.count(b"\n", 0, error.start)) from error

    def _narrow(self, block: bytes) -> bytes:
        """Full-width digits and minus signs of numbers in ASCII."""
        if not any(mark in block for mark in WIDE_MARKS):
            return block
        narrow = narrow_numbers(block.decode())
        self._has_wide_numbers |= (written := narrow.encode()) != block
        return written

    def _not_text(self, line: int) -> BadInput:
        advice = f"{how_to_convert(self._path, 'CP1252')} (CP1252 is that of Western Windows)"
        return BadInput(f"{self._path}, line {line}: not UTF-8 (nor GB18030) text; {advice}")

    def _whole_lines(self, file: BinaryIO, line: int) -> Iterator[bytes]:
        rest = b""
        while data := file.read(self._block_bytes):
            cut = data.rfind(b"\n") + 1
            if cut:
                yield rest + data[:cut]
                line += _lines(rest) + _lines(data[:cut])
                rest = b""
            rest += data[cut:]
            if len(rest) > LONGEST_LINE_BYTES:
                raise BadInput(f"{self._path}, line {line}: longer than 8 MiB; this is no table of rows")
        if rest:
            is_cut = False if rest.startswith(b"#") else self._dialect.is_cut(self._as_utf8(rest, line).decode())
            self._last_line = None if is_cut is False else (line, bool(is_cut))
            if not is_cut:
                yield rest + b"\n"

    def _parse(self, block: bytes, line: int, done: float) -> Iterator[CellBlock]:
        parsed = self._parse_fast(block, line, done)
        if parsed is not None:
            yield parsed
            return
        part = len(block) // _PARTS
        # one line may be longer than all others together, and is in no part
        if len(block) <= _LINEWISE_BYTES or block.find(b"\n", part) + 1 in (0, len(block)):
            yield self._lines.read(block, line, done)
            return
        begin = 0
        while begin < len(block):
            end = block.find(b"\n", begin + part) + 1 or len(block)
            yield from self._parse(block[begin:end], line, done)
            line += block.count(b"\n", begin, end)
            begin = end

    def _parse_fast(self, block: bytes, line: int, done: float) -> CellBlock | None:
        """Parse a block in which nothing is wrong; None if something may be."""
        if b"\r" in block and block.count(b"\r") != block.count(b"\r\n"):
            return None
        if not _quotes_enclose_cells(block, self._dialect.delimiter):
            return None
        table = self._read_typed(block)
        numbers = None if table is None else _line_numbers(block, line, table.num_rows)
        if table is None or numbers is None or len(numbers) != table.num_rows:
            return None
        times_ns = None
        if self._columns.time is not None:
            times_ns = self._times(table)
            if times_ns is None:
                return None
        columns = {signal.name: table.column(signal.title) for signal in self._columns.signals}
        signals = {name: NumberCells.of(column.combine_chunks()) for name, column in columns.items()}
        if not all(np.isfinite(cells.values).all() for cells in signals.values()):
            return None
        texts = {title: _texts(table.column(title)) for title in self._columns.text_titles}
        return CellBlock("line", numbers, times_ns, signals, texts, Sieve(len(numbers)), done)

    def _read_typed(self, block: bytes) -> pa.Table | None:
        read = arrow_csv.ReadOptions(
            column_names=self.titles, block_size=_ARROW_BLOCK_BYTES,
            use_threads=self._decimal_mark == ".",  # Arrow's threads share one buffer for decimals with a comma
        )  # fmt: skip
        parse = arrow_csv.ParseOptions(delimiter=self._dialect.delimiter)
        for spare in sorted({self._spare_digits, _SPARE_DIGITS}):
            convert = arrow_csv.ConvertOptions(
                column_types=self._types(spare), null_values=[""], strings_can_be_null=True, check_utf8=False,
                decimal_point=self._decimal_mark,
            )  # fmt: skip
            try:
                table = arrow_csv.read_csv(pa.BufferReader(block), read, parse, convert)
            except pa.ArrowInvalid:
                continue
            self._spare_digits = spare
            return table
        return None

    def _types(self, spare_digits: int) -> dict[str, pa.DataType]:
        types = dict.fromkeys(self._columns.text_titles, pa.dictionary(pa.int32(), pa.string()))
        types |= {signal.title: pa.float64() for signal in self._columns.signals}
        types |= dict.fromkeys(self._columns.blank, pa.null())
        if (time := self._columns.time) is not None:
            exact = None if self._places is None else pa.decimal128(38, self._places + spare_digits)
            types[time.title] = pa.string() if time.is_stamp else exact or pa.float64()
            if time.date_title is not None:
                types[time.date_title] = pa.string()
        return types

    def _times(self, table: pa.Table) -> IntArray | None:
        time = self._columns.time
        assert time is not None
        array = table.column(time.title).combine_chunks()
        if array.null_count:
            return None
        if time.date_title is not None:
            dates = table.column(time.date_title).combine_chunks()
            if dates.null_count:
                return None
            array = joined_cells(dates, array)
        if time.is_stamp:
            first = match_stamp(array[0].as_py() or "") if len(array) else None
            if first is not None and self._lines.has_zone not in (None, first["zone"] is not None):
                return None  # some cells name a zone, and others do not
            return ns_from_stamps(array, self._time_zone)
        if self._places is not None:
            times_ns, wrong = ns_from_decimals(array, self._places)
        else:
            times_ns, wrong = ns_from_floats(numpy_of(array), time.ns_per_unit)
        return None if wrong.any() else times_ns


def _texts(column: pa.ChunkedArray) -> TextCells:
    array = column.unify_dictionaries().combine_chunks()
    return TextCells(numpy_of(array.indices.fill_null(-1)), array.dictionary.to_pylist())


def _lines(block: bytes) -> int:
    # many times as fast as bytes.count of one character
    return int(np.count_nonzero(np.frombuffer(block, np.uint8) == ord("\n")))


def _line_numbers(block: bytes, first_line: int, rows: int) -> IntArray:
    """Numbers of the lines that are not blank; `rows` is how many a parser found."""
    lines = _lines(block)
    if rows == lines:
        return np.arange(first_line, first_line + lines, dtype=np.int64)
    data = np.frombuffer(block, np.uint8)
    ends = np.flatnonzero(data == ord("\n"))
    lengths = np.diff(ends, prepend=-1) - 1
    blank = (lengths == 0) | ((lengths == 1) & (data[np.maximum(ends - 1, 0)] == ord("\r")))
    return first_line + np.flatnonzero(~blank).astype(np.int64)


def _quotes_enclose_cells(block: bytes, delimiter: str) -> bool:
    """Whether every quote opens or closes a whole cell of one line, as any parser understands it."""
    if b'"' not in block:
        return True
    data = np.frombuffer(b"\n" + block, np.uint8)
    quotes = np.flatnonzero(data == ord('"'))
    if len(quotes) % 2:
        return False
    opening, closing = quotes[::2], quotes[1::2]
    ends = np.flatnonzero(data == ord("\n"))
    return bool(
        np.isin(data[opening - 1], [ord(delimiter), ord("\n")]).all()
        and np.isin(data[closing + 1], [ord(delimiter), ord("\r"), ord("\n")]).all()
        and (np.searchsorted(ends, opening) == np.searchsorted(ends, closing)).all()
    )
