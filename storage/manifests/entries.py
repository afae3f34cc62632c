"""Entries of the log's manifest by the names of their segments: those of older segments packed in blocks.

A million entries as objects take more than a gigabyte; packed they take what is new in them. They are
read block by block when somebody asks.
"""

from bisect import bisect_right
from collections.abc import Iterator, MutableMapping
from itertools import islice

import msgspec
import zstandard

from stream.decoding import json_decoder

SPAN = 4096  # entries of a block
_MOST_BYTES = 1 << 28


class SegmentEntry(msgspec.Struct, frozen=True, omit_defaults=True):
    """A sealed segment: name, bytes and SHA-256 of its file, and what it holds.

    Arrivals are by the recorder's clock. `runs` are those that it has samples or documents of, `stations` the station
    of each whose samples or start came first here, empty where neither did, `ended` those whose end it has. `origin` is
    recorded, recovered (was left open), salvaged (readable part of a damaged one), found (sealed, without a line), or
    lost (documented in the log).
    """

    segment: str
    size: int
    sha256: str
    messages: int
    samples: int
    arrival_first_ns: int
    arrival_last_ns: int
    runs: tuple[str, ...] = ()
    stations: tuple[str, ...] = ()
    ended: tuple[str, ...] = ()
    origin: str = "recorded"


class PackedEntries(msgspec.Struct, frozen=True):
    """Entries of ascending names, compressed."""

    first: str
    last: str
    count: int
    content: bytes


class EntriesState(msgspec.Struct, frozen=True):
    """Everything that `SegmentEntries` hold, to be kept in a file."""

    packed: list[PackedEntries]
    removed: list[str]
    own: list[SegmentEntry]


_decoder = json_decoder(list[SegmentEntry])


class SegmentEntries(MutableMapping[str, SegmentEntry]):
    """A mapping as a dict is one; older entries, in ascending order of their names, are packed by themselves.

    >>> entries = SegmentEntries()
    >>> for i in range(10_000):
    ...     entries[f"{i:08d}.mcap"] = SegmentEntry(f"{i:08d}.mcap", i, "0" * 64, 1, 1, 1, 1)
    >>> len(entries), entries["00000007.mcap"].size, len(entries.state().packed)
    (10000, 7, 1)
    """

    def __init__(self, state: EntriesState | None = None) -> None:
        self._packed: list[PackedEntries] = [] if state is None else list(state.packed)
        self._removed: set[str] = set() if state is None else set(state.removed)  # of the packed ones
        self._own = {} if state is None else {entry.segment: entry for entry in state.own}
        self._firsts = [each.first for each in self._packed]
        self._read: tuple[int, dict[str, SegmentEntry]] = (-1, {})

    def state(self) -> EntriesState:
        """What it holds."""
        return EntriesState(self._packed, sorted(self._removed), list(self._own.values()))

    def __getitem__(self, name: str) -> SegmentEntry:
        if name in self._own:
            return self._own[name]
        found = None if name in self._removed else self._block_of(name).get(name)
        if found is None:
            raise KeyError(name)
        return found

    def __setitem__(self, name: str, entry: SegmentEntry) -> None:
        if name not in self._own and name in self._block_of(name):
            self._removed.add(name)
        self._own[name] = entry
        if len(self._own) >= 2 * SPAN:
            self._pack()

    def __delitem__(self, name: str) -> None:
        if name in self._own:
            del self._own[name]
        elif name not in self._removed and name in self._block_of(name):
            self._removed.add(name)
        else:
            raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        for number in range(len(self._packed)):
            yield from (name for name in self._block(number) if name not in self._removed)
        yield from list(self._own)

    def __len__(self) -> int:
        return sum(each.count for each in self._packed) - len(self._removed) + len(self._own)

    def _block_of(self, name: str) -> dict[str, SegmentEntry]:
        """Entries of the block that may have a name."""
        number = bisect_right(self._firsts, name) - 1
        return self._block(number) if number >= 0 and name <= self._packed[number].last else {}

    def _block(self, number: int) -> dict[str, SegmentEntry]:
        if self._read[0] != number:
            content = zstandard.ZstdDecompressor().decompress(self._packed[number].content, max_output_size=_MOST_BYTES)
            self._read = number, {entry.segment: entry for entry in _decoder.decode(content)}
        return self._read[1]

    def _pack(self) -> None:
        """Pack the oldest entries, if their names are in order and after those that are packed."""
        names = list(islice(self._own, SPAN))
        before = self._packed[-1].last if self._packed else ""
        if names != sorted(names) or names[0] <= before:
            return
        content = msgspec.json.encode([self._own[name] for name in names])
        packed = zstandard.ZstdCompressor(level=3).compress(content)
        self._packed.append(PackedEntries(names[0], names[-1], len(names), packed))
        self._firsts.append(names[0])
        for name in names:
            del self._own[name]
