"""Bounds of what a CAN log may make its reader do: memory that packed parts take, chains that never end."""

import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from stream.errors import BadInput

BLF_OBJECT = struct.Struct("<4sHHLL")
MF4_BLOCK = struct.Struct("<4s4xQQ")
_GROUP_HEAD = struct.Struct("<4s12xQQ48xQ")  # kind, number of links, next group; six links; records
_GROUP_LINKS = 6
_FARTHEST = 2**40
MOST_UNPACKED_BYTES = 256 << 20  # recorders write 128 KiB in a container of BLF, 4 MiB in a block of MF4

_HARMLESS_BYTES = MOST_UNPACKED_BYTES // 1032  # packed; zlib packs 1032 bytes into one at most
_BLF_CONTAINER, _BLF_CONTAINER_HEAD_BYTES, _MF4_ZIPPED_HEAD_BYTES = 10, 32, 48
_MF4_HEADER_AT = 64
# blocks whose first link is the next one of their kind (ASAM MDF 4.1)
_CHAINED = {b"##DG", b"##CG", b"##CN", b"##FH", b"##CH", b"##AT", b"##EV", b"##DL"}
_MOST_LINKS = 1 << 20


def check_bounds(path: Path) -> None:
    """Refuse, by a BadInput, a log whose reader would not come to an end, or fill the memory."""
    _check_unpacked(path)
    if path.suffix.lower() == ".mf4":
        with path.open("rb") as file:
            if (problem := _mf4_problem(file)) is not None:
                raise BadInput(f"{path}: {problem}; the log is damaged, export it again")


def _check_unpacked(path: Path) -> None:
    parts = {".blf": _blf_containers, ".mf4": _mf4_zipped}.get(path.suffix.lower())
    if parts is None or path.stat().st_size <= _HARMLESS_BYTES:
        return
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        for begin, length in parts(file):
            if length <= _HARMLESS_BYTES or begin >= size:
                continue
            file.seek(begin)
            unpacker, unpacked = zlib.decompressobj(), 0
            try:
                piece = file.read(length)
                while piece and unpacked <= MOST_UNPACKED_BYTES:
                    unpacked += len(unpacker.decompress(piece, 1 << 20))
                    piece = unpacker.unconsumed_tail
            except zlib.error:
                continue
            if unpacked > MOST_UNPACKED_BYTES:
                raise BadInput(
                    f"{path}: the part at byte {begin:,} unpacks to more than {MOST_UNPACKED_BYTES >> 20} MiB; no "
                    "recorder writes such a log, record or export it again"
                )


def _blf_containers(file: BinaryIO) -> Iterator[tuple[int, int]]:
    """Begin and length of what is packed in each container."""
    place = int.from_bytes(file.read(8)[4:8], "little")
    while True:
        file.seek(place)
        base = file.read(BLF_OBJECT.size)
        if len(base) < BLF_OBJECT.size:
            return
        signature, _, _, size, kind = BLF_OBJECT.unpack(base)
        if signature != b"LOBJ" or size < BLF_OBJECT.size:
            return
        if kind == _BLF_CONTAINER:
            yield place + _BLF_CONTAINER_HEAD_BYTES, size - _BLF_CONTAINER_HEAD_BYTES
        place += size + size % 4


def _mf4_zipped(file: BinaryIO) -> Iterator[tuple[int, int]]:
    """Begin and length of what is packed in each compressed block."""
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        place = content.find(b"##DZ")
        while place >= 0:
            length = int.from_bytes(content[place + 8 : place + 16], "little") - _MF4_ZIPPED_HEAD_BYTES
            yield place + _MF4_ZIPPED_HEAD_BYTES, min(length, len(content))
            place = content.find(b"##DZ", place + 4)


def check_objects(container: bytes) -> None:
    """Refuse, by a ValueError, what is in a container of BLF if an object in it is shorter than its head."""
    place = 0
    while (place := container.find(b"LOBJ", place, place + 8)) >= 0 and place + BLF_OBJECT.size <= len(container):
        _, _, _, size, _ = BLF_OBJECT.unpack_from(container, place)
        if size < BLF_OBJECT.size:
            raise ValueError(f"an object states {size} bytes, its head has {BLF_OBJECT.size}")
        place += size


def _lacks_records(file: BinaryIO, group: int, data: int) -> bool:
    """Whether the only group of channels of some data counts 0 records: asammdf reads for ever."""
    file.seek(min(group, _FARTHEST))
    head = file.read(_GROUP_HEAD.size)
    if len(head) < _GROUP_HEAD.size:
        return False
    kind, links, following, cycles = _GROUP_HEAD.unpack(head)
    if kind != b"##CG" or links != _GROUP_LINKS or following or cycles:
        return False
    return _has_data(file, data)


def _has_data(file: BinaryIO, first: int) -> bool:
    """Whether a block of data, or a list of such, has any."""
    seen: set[int] = set()
    waiting = [first]
    while waiting:
        at = waiting.pop()
        file.seek(min(at, _FARTHEST))
        head = file.read(MF4_BLOCK.size)
        if not at or at in seen or len(head) < MF4_BLOCK.size:
            continue
        seen.add(at)
        kind, length, count = MF4_BLOCK.unpack(head)
        if kind == b"##DZ" or (kind == b"##DT" and length > MF4_BLOCK.size):
            return True
        if kind in {b"##HL", b"##DL"}:
            links = file.read(8 * min(count, _MOST_LINKS))
            waiting += struct.unpack(f"<{len(links) // 8}Q", links[: len(links) // 8 * 8])
    return False


def _mf4_problem(file: BinaryIO) -> str | None:
    """Why a reader of an MF4 would not end: a chain leads back to itself, or data have no records."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    is_finished = file.read(4) == b"MDF "
    following: dict[int, int] = {}
    kinds: dict[int, bytes] = {}
    waiting = [_MF4_HEADER_AT]
    while waiting:
        at = waiting.pop()
        if at in kinds or at + MF4_BLOCK.size > size:
            continue
        file.seek(at)
        head = file.read(MF4_BLOCK.size)
        kinds[at], _, count = MF4_BLOCK.unpack(head)
        links = file.read(8 * min(count, _MOST_LINKS)) if kinds[at].startswith(b"##") else b""
        found = struct.unpack(f"<{len(links) // 8}Q", links[: len(links) // 8 * 8])
        waiting += filter(None, found)
        if kinds[at] == b"##DG" and len(found) > 2 and is_finished and _lacks_records(file, found[1], found[2]):
            return f"its group at byte {at:,} states no records, and has data"
        if kinds[at] in _CHAINED and found:
            following[at] = found[0]
    if (kind := _endless_groups(file, size)) is not None:
        return f"its chain of {kind} blocks leads back to itself"
    ended: set[int] = set()
    for begin in following:
        at, seen = begin, set[int]()
        while at in following and at not in ended:
            if at in seen:
                return f"its chain of {kinds[at].decode(errors='replace')} blocks leads back to itself"
            seen.add(at)
            at = following[at]
        ended |= seen
    return None


def _endless_groups(file: BinaryIO, size: int) -> str | None:
    """Which chain of groups never ends; asammdf counts them by their places, whatever kind of block is there."""

    def link(at: int) -> int:
        file.seek(at)
        content = file.read(8)
        return int.from_bytes(content, "little") if len(content) == 8 else size

    def is_endless(at: int, chain: list[int]) -> bool:
        seen: set[int] = set()
        while 0 < at < size and at not in seen:
            seen.add(at)
            chain.append(at)
            at = link(at + MF4_BLOCK.size)
        return at in seen

    groups: list[int] = []
    if is_endless(link(_MF4_HEADER_AT + MF4_BLOCK.size), groups):
        return "##DG"
    return "##CG" if any(is_endless(link(each + MF4_BLOCK.size + 8), []) for each in groups) else None
