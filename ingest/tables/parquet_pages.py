"""Sizes of the pages of a Parquet file, checked before a decoder takes the memory that a page claims."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from stream.errors import BadInput

if TYPE_CHECKING:
    from pyarrow.parquet import FileMetaData

MAX_PAGE_BYTES = 1 << 28  # writers make pages of about a megabyte
_HEADER_BYTES, _LONG_HEADER_BYTES = 256, 1 << 20  # a header may hold the least and greatest text of its page
_STOP, _I8, _I64, _DOUBLE, _BINARY, _LIST, _SET, _STRUCT = 0, 3, 6, 7, 8, 9, 10, 12
_UNPACKED, _PACKED = 2, 3  # fields of a page's header
_MOST_NESTED = 8


def check_pages(path: Path, metadata: "FileMetaData") -> None:
    """Raise BadInput if a page claims more memory than any writer's.

    What cannot be read as a page is left to the decoder.
    """
    with path.open("rb") as file:
        for group in range(metadata.num_row_groups):
            columns = metadata.row_group(group)
            for place in range(columns.num_columns):
                column = columns.column(place)
                begin = column.data_page_offset
                if column.has_dictionary_page and 0 < (column.dictionary_page_offset or 0) < begin:
                    begin = column.dictionary_page_offset
                for size in _page_sizes(file, begin, begin + column.total_compressed_size):
                    if not 0 <= size <= MAX_PAGE_BYTES:
                        raise BadInput(
                            f"{path}: a page of column {column.path_in_schema!r} claims {size:,} bytes, at most "
                            f"{MAX_PAGE_BYTES:,} are read: the file is damaged, or write it with smaller pages"
                        )


def _page_sizes(file: BinaryIO, at: int, end: int) -> Iterator[int]:
    """Size of each page of a column, the larger of packed and unpacked."""
    while 0 < at < end:
        for most in (_HEADER_BYTES, _LONG_HEADER_BYTES):
            file.seek(at)
            content = file.read(most)
            try:
                fields, length = _struct(content, 0, 0)
                break
            except (IndexError, ValueError):
                continue
        else:
            return
        unpacked, packed = fields.get(_UNPACKED), fields.get(_PACKED)
        if unpacked is None or packed is None:
            return
        yield min(unpacked, packed) if min(unpacked, packed) < 0 else max(unpacked, packed)
        at += length + packed


def _struct(content: bytes, at: int, depth: int) -> tuple[dict[int, int], int]:
    """Whole numbers of a structure of Thrift's compact protocol by their field, and the place behind it.

    >>> _struct(bytes([0x15, 0, 0x15, 0x80, 2, 0x15, 20, 0]), 0, 0)
    ({1: 0, 2: 128, 3: 10}, 8)
    """
    if depth > _MOST_NESTED:
        raise ValueError("nested too deeply")
    found: dict[int, int] = {}
    number = 0
    while True:
        head = content[at]
        at += 1
        kind = head & 15
        if kind == _STOP:
            return found, at
        if head >> 4:
            number += head >> 4
        else:
            number, at = _signed(content, at)
        if _I8 < kind <= _I64:
            found[number], at = _signed(content, at)
        else:
            at = _behind(content, at, kind, depth)


def _behind(content: bytes, at: int, kind: int, depth: int, *, in_list: bool = False) -> int:
    """The place behind a value; IndexError beyond the content."""
    if kind < _I8:  # a truth value: of a field it stands in the head
        return at + in_list
    if kind == _I8:
        return at + 1
    if kind <= _I64:
        return _varint(content, at)[1]
    if kind == _DOUBLE:
        return at + 8
    if kind == _BINARY:
        length, at = _varint(content, at)
        return at + length
    if kind in {_LIST, _SET}:
        count, of = content[at] >> 4, content[at] & 15
        at += 1
        if count == 15:
            count, at = _varint(content, at)
        if count > len(content):
            raise IndexError(count)
        for _ in range(count):
            at = _behind(content, at, of, depth + 1, in_list=True)
        return at
    if kind == _STRUCT:
        return _struct(content, at, depth + 1)[1]
    raise ValueError(f"no page header has a value of kind {kind}")


def _signed(content: bytes, at: int) -> tuple[int, int]:
    found, at = _varint(content, at)
    return found >> 1 ^ -(found & 1), at


def _varint(content: bytes, at: int) -> tuple[int, int]:
    found = shift = 0
    while True:
        found |= (content[at] & 127) << shift
        at += 1
        if content[at - 1] < 128:
            return found, at
        shift += 7
        if shift > 63:
            raise ValueError("no whole number")
