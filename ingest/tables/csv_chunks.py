"""Delimited text files, block by block: parsed at speed where good, line by line where not."""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from ingest.tables.columns import Columns
from ingest.tables.csv_lines import LineReader, split_line
from ingest.tables.rows import CellBlock, NumberCells, Sieve, TextCells
from ingest.tables.times import decimal_places, ns_from_decimals, ns_from_floats
from stream.batch import IntArray
from stream.errors import BadInput

BLOCK_BYTES = 4 << 20
LONGEST_LINE_BYTES = 8 << 20
# A block in which something is wrong is cut in parts; one of this size is read line by line.
_LINEWISE_BYTES = 64 << 10
_PARTS = 8
_SPARE_DIGITS = 15
_ARROW_BLOCK_BYTES = 1 << 20
_BOM = b"\xef\xbb\xbf"
_DELIMITERS = "\t;,"


class CsvTable:
    """A CSV file (comma, semicolon or tab, found from the header) as blocks of rows.

    Parameters
    ----------
    path: The file.
    block_bytes: How much is read at a time.

    Raises
    ------
    BadInput: If it is empty, not UTF-8, or holds nothing but a header.
    """

    def __init__(self, path: Path, block_bytes: int = BLOCK_BYTES) -> None:
        self._path = path
        self._block_bytes = block_bytes
        self._size = max(path.stat().st_size, 1)
        with path.open("rb") as file:
            header = self._read_header(file)
            self._first_byte = file.tell()
            if not any(line.strip() for line in iter(lambda: file.readline(LONGEST_LINE_BYTES), b"")):
                raise BadInput(f"{path}: a header and no rows; nothing to import")
        self._delimiter = max(_DELIMITERS, key=header.count)
        self._titles = tuple(title.strip() for title in self._split_header(header))
        # Digits after the point that times need beyond whole nanoseconds: none until the first that has them.
        self._spare_digits = 0

    @property
    def titles(self) -> tuple[str, ...]:
        """Titles of the columns."""
        return self._titles

    @property
    def integer_titles(self) -> frozenset[str]:
        """No column of a text file has a type."""
        return frozenset()

    def bind(self, columns: Columns) -> None:
        """Take what the columns mean."""
        self._columns = columns
        self._lines = LineReader(self._titles, columns, self._delimiter)
        self._places = None if columns.time is None else decimal_places(columns.time.ns_per_unit)

    def blocks(self) -> Iterator[CellBlock]:
        """Read the rows from the beginning."""
        line = self._header_line + 1
        with self._path.open("rb") as file:
            file.seek(self._first_byte)
            for block in self._whole_lines(file, line):
                self._check_text(block, line)
                yield from self._parse(block, line, file.tell() / self._size)
                line += _lines(block)

    def _read_header(self, file: BinaryIO) -> str:
        self._header_line = 0
        while raw := file.readline(LONGEST_LINE_BYTES):
            self._header_line += 1
            if self._header_line == 1:
                raw = raw.removeprefix(_BOM)
            if raw[:2] in {b"\xff\xfe", b"\xfe\xff"}:
                raise BadInput(f"{self._path}: UTF-16 text; save it as UTF-8")
            self._check_text(raw, self._header_line)
            if raw.strip():
                text = raw.decode().rstrip("\r\n")
                if "\r" in text:
                    raise BadInput(f"{self._path}: lines end with a carriage return alone; save it with line feeds")
                return text
        raise BadInput(f"{self._path}: the file is empty; expected a header like 'time[s],rate[deg/s]'")

    def _split_header(self, header: str) -> list[str]:
        try:
            return split_line(header, self._delimiter)
        except BadInput as error:
            raise BadInput(f"{self._path}, line {self._header_line}: {error}") from error

    def _check_text(self, block: bytes, line: int) -> None:
        if block.isascii():
            return
        try:
            block.decode()
        except UnicodeDecodeError as error:
            at = line + block.count(b"\n", 0, error.start)
            raise BadInput(f"{self._path}, line {at}: not UTF-8 text; save the file as UTF-8") from error

    def _whole_lines(self, file: BinaryIO, line: int) -> Iterator[bytes]:
        rest = b""
        while data := file.read(self._block_bytes):
            cut = data.rfind(b"\n") + 1
            if cut:
                block = rest + data[:cut]
                yield block
                line += _lines(block)
                rest = data[cut:]
            else:
                rest += data
            if len(rest) > LONGEST_LINE_BYTES:
                raise BadInput(f"{self._path}, line {line}: longer than 8 MiB; this is no table of rows")
        if rest:
            yield rest + b"\n"

    def _parse(self, block: bytes, line: int, done: float) -> Iterator[CellBlock]:
        parsed = self._parse_fast(block, line, done)
        if parsed is not None:
            yield parsed
        elif len(block) <= _LINEWISE_BYTES:
            yield self._lines.read(block, line, done)
        else:
            part = len(block) // _PARTS
            begin = 0
            while begin < len(block):
                end = block.find(b"\n", begin + part) + 1 or len(block)
                yield from self._parse(block[begin:end], line, done)
                line += block.count(b"\n", begin, end)
                begin = end

    def _parse_fast(self, block: bytes, line: int, done: float) -> CellBlock | None:
        """Parse a block in which nothing is wrong; None where something may be."""
        if b"\r" in block and block.count(b"\r") != block.count(b"\r\n"):
            return None
        if not _quotes_enclose_cells(block, self._delimiter):
            return None
        table = self._read_typed(block)
        if table is None:
            return None
        numbers = _line_numbers(block, line, table.num_rows)
        if len(numbers) != table.num_rows:
            return None
        times_ns = None
        if self._columns.time is not None:
            times_ns = self._times(table.column(self._columns.time.title))
            if times_ns is None:
                return None
        signals = {signal.name: _numbers(table.column(signal.title)) for signal in self._columns.signals}
        if not all(np.isfinite(cells.values).all() for cells in signals.values()):
            return None
        texts = {title: _texts(table.column(title)) for title in self._columns.text_titles}
        return CellBlock("line", numbers, times_ns, signals, texts, Sieve(len(numbers)), done)

    def _read_typed(self, block: bytes) -> pa.Table | None:
        for spare in sorted({self._spare_digits, _SPARE_DIGITS}):
            try:
                table = arrow_csv.read_csv(
                    pa.BufferReader(block),
                    read_options=arrow_csv.ReadOptions(column_names=self._titles, block_size=_ARROW_BLOCK_BYTES),
                    parse_options=arrow_csv.ParseOptions(delimiter=self._delimiter),
                    convert_options=arrow_csv.ConvertOptions(
                        column_types=self._types(spare), null_values=[""], strings_can_be_null=True, check_utf8=False
                    ),
                )
            except pa.ArrowInvalid:
                continue
            self._spare_digits = spare
            return table
        return None

    def _types(self, spare_digits: int) -> dict[str, pa.DataType]:
        types = dict.fromkeys(self._columns.text_titles, pa.dictionary(pa.int32(), pa.string()))
        types |= {signal.title: pa.float64() for signal in self._columns.signals}
        if self._columns.time is not None:
            exact = None if self._places is None else pa.decimal128(38, self._places + spare_digits)
            types[self._columns.time.title] = exact or pa.float64()
        return types

    def _times(self, column: pa.ChunkedArray) -> IntArray | None:
        array = column.combine_chunks()
        if array.null_count:
            return None
        if self._places is not None:
            times_ns, wrong = ns_from_decimals(array, self._places)
        else:
            assert self._columns.time is not None
            times_ns, wrong = ns_from_floats(array.to_numpy(), self._columns.time.ns_per_unit)
        return None if wrong.any() else times_ns


def _numbers(column: pa.ChunkedArray) -> NumberCells:
    array = column.combine_chunks()
    if array.null_count == 0:
        return NumberCells(array.to_numpy(), None)
    return NumberCells(array.fill_null(0.0).to_numpy(), array.is_valid().to_numpy(zero_copy_only=False))


def _texts(column: pa.ChunkedArray) -> TextCells:
    array = column.unify_dictionaries().combine_chunks()
    return TextCells(array.indices.fill_null(-1).to_numpy(), array.dictionary.to_pylist())


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
