"""A plant whose history is in a bucket of an object store."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import TypeVar

import msgspec

from storage.carried_names import is_carried
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import FIRST, LOST
from storage.object_lake.bucket import Bucket
from storage.plant import Plant
from storage.replication.plant_list import checked_line
from storage.replication.sources.plant_bucket import FILES, SEGMENTS, BucketList, file_key, read_claim, segment_key
from storage.replication.sources.source import CarriedFile, SegmentMissing, SourceGone, is_segment
from stream.closing import Closing
from stream.decoding import json_decoder
from stream.errors import BadInput, StoreError

T = TypeVar("T")
_AHEAD_BYTES = 8 << 20  # a request takes tens of milliseconds, whatever its length
_file = json_decoder(CarriedFile)


class BucketSource(Closing):
    """The history of a plant below an address such as ``s3://bucket/plants/hangzhou``, which nothing here changes.

    BadInput if it is of another plant than `name`.
    """

    def __init__(self, bucket: Bucket, name: str | None = None) -> None:
        self._bucket, self._name = bucket, name
        self.where = bucket.url
        self._segments, self._files = BucketList(bucket, SEGMENTS), BucketList(bucket, FILES)
        self._sizes: dict[str, int] = {}
        self._ahead = ("", 0, b"")  # key, place and bytes of the last range

    def plant(self) -> Plant:
        """Identity of the plant; SourceGone as long as the bucket is of none."""
        found = self._asked(lambda: read_claim(self._bucket))
        if found is None:
            raise SourceGone(
                f"nothing of a plant is there; is the address right? `gyrofleet replicate --to {self.where}` uploads"
            )
        if self._name not in (None, found.name):
            raise BadInput(f"{self.where} has the history of plant {found.name}, not of {self._name}")
        return found

    def segments(self, after: int) -> Iterator[bytes]:
        """Lines of the list beyond the first `after`."""
        self._asked(self._segments.update)
        if self._segments.is_empty:
            raise SourceGone(f"{self.where} has no list of segments: the plant has not uploaded yet, or it was deleted")
        yield from self._lines(self._segments, after)

    def originals(self) -> Iterator[SegmentEntry]:
        """Segments that are kept as first listed, though the plant has listed a part or the loss of them since."""
        self._asked(self._segments.update)
        first, changed = dict[str, SegmentEntry](), set[str]()
        for lines in self._asked(lambda: [*self._segments.earlier(), list(self._segments.lines())]):
            last = FIRST
            for raw in lines:
                line = checked_line(raw, last)
                last, entry = line.chained, line.entry
                if entry.origin == LOST or first.setdefault(entry.segment, entry).sha256 != entry.sha256:
                    changed.add(entry.segment)
        for name in sorted(changed & first.keys()):
            with suppress(SegmentMissing):
                if self._size(segment_key(name)) == first[name].size:
                    yield first[name]

    def files(self) -> Iterator[CarriedFile]:
        """What travels besides segments."""
        self._asked(self._files.update)
        for line in self._lines(self._files, 0):
            try:
                yield _file.decode(line)
            except msgspec.MsgspecError as error:
                raise SourceGone(f"{self.where}: the list of files cannot be read: {error}") from error

    def read(self, name: str, offset: int, length: int) -> bytes:
        """A range of a segment or file."""
        if not (is_segment(name) or is_carried(name)):
            raise SegmentMissing(f"{name[:80]!r} is no segment or file that travels")
        key = file_key(name) if is_carried(name) else segment_key(name)
        length = min(length, self._size(key) - offset)
        if length <= 0:
            return b""
        if not (self._ahead[0] == key and self._ahead[1] <= offset <= self._ahead[1] + len(self._ahead[2]) - length):
            size = min(max(length, _AHEAD_BYTES), self._size(key) - offset)
            self._ahead = (key, offset, self._asked(lambda: self._bucket.get_range(key, offset, size)))
        at = offset - self._ahead[1]
        return self._ahead[2][at : at + length]

    def close(self) -> None:
        """Nothing is open."""

    def _size(self, key: str) -> int:
        if key not in self._sizes:
            found = self._asked(lambda: self._bucket.find(key))
            if found is None:
                raise SegmentMissing(f"{self.where}/{key} is missing")
            self._sizes[key] = found.bytes
        return self._sizes[key]

    def _lines(self, of: BucketList, after: int) -> Iterator[bytes]:
        lines = of.lines(after)
        while (line := self._asked(lambda: next(lines, None))) is not None:
            yield line

    def _asked(self, action: Callable[[], T]) -> T:
        try:
            return action()
        except StoreError as error:
            raise SourceGone(str(error)) from error
