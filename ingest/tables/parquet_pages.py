"""Sizes of the pages of a Parquet file, checked before a decoder takes the memory that a page claims.

The file's own lists are read here (Thrift's compact protocol): pyarrow ends the process where the entry of a column is
damaged in some ways.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from stream.errors import BadInput

MAX_PAGE_BYTES = 1 << 28  # writers make pages of about a megabyte
MAX_FOOTER_BYTES = 1 << 24
_HEADER_BYTES, _LONG_HEADER_BYTES = 256, 1 << 20  # a header may hold the least and greatest text of its page
_I8, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT, _UUID = 3, 6, 7, 8, 9, 10, 11, 12, 13
_MOST_NESTED = 16
# fields of a footer, a row group, a column, its description, and the header of a page
_GROUPS, _COLUMNS, _ABOUT = 4, 1, 3
_PATH, _CHUNK_BYTES, _DATA_AT, _DICTIONARY_AT = 3, 7, 9, 11
_UNPACKED, _PACKED = 2, 3


def check_pages(path: Path) -> None:
    """Raise BadInput if a page claims more memory than any writer's, or the list of columns cannot be read.

    What cannot be read as a page is left to the decoder.
    """
    with path.open("rb") as file:
        try:
            columns = [each[_ABOUT] for group in _footer(file)[_GROUPS] for each in group[_COLUMNS] if _ABOUT in each]
            chunks = [_chunk(each) for each in columns]
        except (IndexError, KeyError, TypeError, ValueError) as error:
            raise BadInput(
                f"{path}: not a Parquet file, or a damaged one (its list of columns); write it again"
            ) from error
        for name, begin, end in chunks:
            for size in _page_sizes(file, begin, end):
                if not 0 <= size <= MAX_PAGE_BYTES:
                    raise BadInput(
                        f"{path}: a page of column {name!r} claims {size:,} bytes, at most {MAX_PAGE_BYTES:,} are "
                        "read: the file is damaged, or write it with smaller pages"
                    )


def _footer(file: BinaryIO) -> Any:
    end = file.seek(0, 2)
    file.seek(max(0, end - 8))
    tail = file.read(8)
    length = int.from_bytes(tail[:4], "little")
    if tail[4:] != b"PAR1" or length > min(end - 8, MAX_FOOTER_BYTES):
        raise ValueError("no footer")
    file.seek(end - 8 - length)
    return _struct(file.read(length), 0, 0)[0]


def _chunk(about: Any) -> tuple[str, int, int]:
    """Name of a column, and where its pages begin and end."""
    begin = about[_DATA_AT]
    if 0 < about.get(_DICTIONARY_AT, 0) < begin:
        begin = about[_DICTIONARY_AT]
    return b".".join(about[_PATH]).decode(errors="replace"), begin, begin + about[_CHUNK_BYTES]


def _page_sizes(file: BinaryIO, at: int, end: int) -> Iterator[int]:
    """Size of each page of a column, the larger of packed and unpacked."""
    while 0 < at < end:
        for most in (_HEADER_BYTES, _LONG_HEADER_BYTES):
            file.seek(at)
            try:
                fields, length = _struct(file.read(most), 0, 0)
                unpacked, packed = fields[_UNPACKED] + 0, fields[_PACKED] + 0
                break
            except IndexError:
                continue
            except (KeyError, TypeError, ValueError):
                return
        else:
            return
        yield min(unpacked, packed) if min(unpacked, packed) < 0 else max(unpacked, packed)
        at += length + packed


def _struct(content: bytes, at: int, depth: int) -> tuple[dict[int, Any], int]:
    """Values of a structure by their field, and the place behind it; IndexError beyond the content.

    >>> _struct(bytes([0x15, 0, 0x15, 0x80, 2, 0x18, 2, 97, 98, 0]), 0, 0)
    ({1: 0, 2: 128, 3: b'ab'}, 10)
    """
    if depth > _MOST_NESTED:
        raise ValueError("nested too deeply")
    found: dict[int, Any] = {}
    number = 0
    while True:
        head = content[at]
        at += 1
        kind = head & 15
        if kind == 0:
            return found, at
        if head >> 4:
            number += head >> 4
        else:
            number, at = _signed(content, at)
        # a truth value stands in the head
        found[number], at = (kind == 1, at) if kind < _I8 else _value(content, at, kind, depth)


def _value(content: bytes, at: int, kind: int, depth: int) -> tuple[Any, int]:
    if kind <= _I8:
        return content[at], at + 1
    if kind <= _I64:
        return _signed(content, at)
    if kind in {_DOUBLE, _UUID}:
        return None, at + (8 if kind == _DOUBLE else 16)
    if kind == _BINARY:
        length, at = _varint(content, at)
        if at + length > len(content):
            raise IndexError(at + length)
        return content[at : at + length], at + length
    if kind in {_LIST, _SET}:
        count, of = content[at] >> 4, content[at] & 15
        at += 1
        if count == 15:
            count, at = _varint(content, at)
        return _values(content, at, [of] * min(count, len(content) - at + 1), depth + 1)
    if kind == _MAP:
        count, at = _varint(content, at)
        kinds = (content[at] >> 4, content[at] & 15) if count else (0, 0)
        return _values(content, at + (count > 0), [*kinds] * min(count, len(content) - at + 1), depth + 1)
    if kind == _STRUCT:
        return _struct(content, at, depth + 1)
    raise ValueError(f"no value is of kind {kind}")


def _values(content: bytes, at: int, kinds: list[int], depth: int) -> tuple[list[Any], int]:
    if depth > _MOST_NESTED:
        raise ValueError("nested too deeply")
    found = []
    for kind in kinds:
        value, at = _value(content, at, kind, depth)
        found.append(value)
    return found, at


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
