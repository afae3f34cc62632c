"""The outer structure of CAN log files, which tells whether one was cut short or not closed by its recorder."""

import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ingest.can.logs.bounds import BLF_OBJECT, MF4_BLOCK, MOST_UNPACKED_BYTES

_BLF_HEADER = struct.Struct("<4sLBBBBBBBBQQLL")
_MF4_UNFINISHED = b"UnFinMF "
MAGIC: dict[str, tuple[bytes, ...]] = {".blf": (b"LOGG",), ".mf4": (b"MDF ", _MF4_UNFINISHED)}
LEAST_BYTES = {".blf": 144, ".mf4": 8}

_FLAGS_AT, _HEADER_AT = 60, 64
_COUNTERS_STALE, _LAST_LENGTH_STALE, _LISTS_STALE = 1, 4, 16
_VARIABLE_LENGTH = 1


def find_damage(path: Path) -> tuple[str, str]:
    """What the structure of a log says is wrong with it, and what is peculiar without harm; empty for nothing."""
    suffix = path.suffix.lower()
    if suffix == ".blf":
        return _blf_damage(path), ""
    with path.open("rb") as file:
        if suffix == ".mf4":
            if file.read(8) != _MF4_UNFINISHED:
                return "", ""
            try:
                if _has_whole_records(file):
                    return "", "was not finished by its recorder; all records in it are complete"
            except (struct.error, ValueError, OSError, LookupError, OverflowError, MemoryError, zlib.error):
                pass
            return "was not finished by its recorder; its last frames may be missing", ""
        file.seek(-1, os.SEEK_END)
        return "" if file.read(1) in b"\r\n" else "cut short: it ends inside a line", ""


def _blf_damage(path: Path) -> str:
    """Walk the containers of a BLF: each states its length, and the head of the file that of the whole."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_BLF_HEADER.size)
        if len(head) < _BLF_HEADER.size:
            return "cut short inside its header"
        _, header_size, *_, stated_size, _, _, _ = _BLF_HEADER.unpack(head)
        place = header_size
        while place < size:
            file.seek(place)
            base = file.read(BLF_OBJECT.size)
            if not base.strip(b"\0"):
                break
            if len(base) < BLF_OBJECT.size:
                return f"cut short at byte {size}, inside the head of a container"
            signature, _, _, object_size, _ = BLF_OBJECT.unpack(base)
            if signature != b"LOBJ" or object_size < BLF_OBJECT.size:
                return f"damaged at byte {place}: no container begins there"
            if place + object_size > size:
                return f"cut short at byte {size}, inside a container of {object_size} bytes"
            place += object_size + object_size % 4
    if stated_size <= header_size < size:
        return "was not closed by its recorder; its last frames may be missing"
    if stated_size > size:
        return f"cut short: its header says {stated_size} bytes, there are {size}"
    return ""


def _has_whole_records(file: BinaryIO) -> bool:
    """Whether the data of an unfinished MF4 (ASAM MDF 4.1) end behind a record, and have all that are counted."""
    file.seek(_FLAGS_AT)
    (flags,) = struct.unpack("<H", file.read(2))
    if flags & _LISTS_STALE:
        return False  # data blocks may be there that no list has
    links, _ = _block(file, _HEADER_AT)
    return all(_is_whole(file, group, flags) for group in _chain(file, links[0]))


def _is_whole(file: BinaryIO, group: tuple[list[int], bytes], flags: int) -> bool:
    links, content = group
    id_bytes = content[0]
    sizes: dict[int, tuple[int, bool]] = {}
    counted: dict[int, int] = {}
    for _, channels in _chain(file, links[1]):
        record, cycles, kind = struct.unpack_from("<QQH", channels)
        octets, invalid = struct.unpack_from("<LL", channels, 24)
        sizes[record] = octets + invalid, bool(kind & _VARIABLE_LENGTH)
        counted[record] = 0 if flags & _COUNTERS_STALE else cycles
    data = b"".join(_data(file, links[2], is_last_open=bool(flags & _LAST_LENGTH_STALE)))
    found = dict.fromkeys(counted, 0)
    place = 0
    if not id_bytes and len(sizes) == 1:
        ((record, (size, _)),) = sizes.items()
        found[record], rest = divmod(len(data), size) if size else (counted[record], len(data))
        place = len(data) - rest
    while id_bytes and place + id_bytes <= len(data):
        record = int.from_bytes(data[place : place + id_bytes], "little")
        size, is_variable = sizes[record]
        place += id_bytes
        if is_variable:
            size = 4 + struct.unpack_from("<L", data, place)[0]
        place += size
        found[record] += 1
    return place == len(data) and all(found[record] >= count for record, count in counted.items())


def _block(file: BinaryIO, at: int) -> tuple[list[int], bytes]:
    file.seek(at)
    _, length, count = MF4_BLOCK.unpack(file.read(MF4_BLOCK.size))
    links = list(struct.unpack(f"<{count}Q", file.read(8 * count)))
    return links, file.read(max(0, length - MF4_BLOCK.size - 8 * count))


def _chain(file: BinaryIO, at: int) -> Iterator[tuple[list[int], bytes]]:
    """Blocks whose first link is the next one."""
    seen = set()
    while at and at not in seen:
        seen.add(at)
        block = _block(file, at)
        yield block
        at = block[0][0]


def _data(file: BinaryIO, at: int, *, is_last_open: bool) -> Iterator[bytes]:
    """Bytes of a data block or a list of such; raises ValueError if one ends beyond the file."""
    if not at:
        return
    file.seek(at)
    kind, length, _ = MF4_BLOCK.unpack(file.read(MF4_BLOCK.size))
    if kind == b"##HL":
        yield from _data(file, _block(file, at)[0][0], is_last_open=is_last_open)
    elif kind == b"##DL":
        parts = [part for links, _ in _chain(file, at) for part in links[1:] if part]
        for part in parts:
            yield from _data(file, part, is_last_open=is_last_open and part == parts[-1])
    elif kind == b"##DZ":
        zip_type, parameter, size, zipped = struct.unpack("<2xBxLQQ", file.read(24))
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(file.read(zipped), min(size, MOST_UNPACKED_BYTES) + 1)
        if len(data) != size or zip_type not in {0, 1} or (zip_type and not parameter):
            raise ValueError("a compressed block is damaged")
        if zip_type:  # it was transposed before it was compressed
            rows = len(data) // parameter
            whole = rows * parameter
            data = b"".join(data[i:whole:rows] for i in range(rows)) + data[whole:]
        yield data
    elif kind == b"##DT":
        data = file.read() if is_last_open and length <= MF4_BLOCK.size else file.read(length - MF4_BLOCK.size)
        if not is_last_open and len(data) < length - MF4_BLOCK.size:
            raise ValueError("a block is cut short")
        yield data
    else:
        raise ValueError(f"unknown kind of data block {kind!r}")
