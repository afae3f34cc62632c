"""Lines of a plant's list that are not received yet, read ahead so that it is known how far the copy is behind."""

from collections import deque
from collections.abc import Iterable, Mapping

from storage.manifests.entries import SegmentEntry
from storage.manifests.log import LOST
from storage.replication.plant_list import ListRefused, checked_line
from storage.replication.progress import Lag

_MAX_LINES = 100_000
_MAX_BYTES = 256 << 20


class LinesAhead:
    """Takes lines as far as they are a list, 100,000 at once; the first one that is not ends it and is the last.

    `is_whole` says whether the list has no further lines.
    """

    def __init__(self, lines: Iterable[bytes], last: str) -> None:
        self._raw: deque[bytes] = deque()
        self._size: dict[str, int] = {}
        self._newest_ns = 0
        self.is_whole = True
        size = 0
        for raw in lines:
            self._raw.append(raw)
            size += len(raw)
            try:
                line = checked_line(raw, last)
            except ListRefused:
                break
            last = line.chained
            if line.entry.origin != LOST:
                self._size[line.entry.segment] = line.entry.size
                self._newest_ns = max(self._newest_ns, line.entry.arrival_last_ns)
            if len(self._raw) >= _MAX_LINES or size >= _MAX_BYTES:
                self.is_whole = False
                break

    def next(self) -> bytes | None:
        """The next line; None at the end."""
        return self._raw.popleft() if self._raw else None

    def arrived(self, segment: str) -> None:
        """A segment is here."""
        self._size.pop(segment, None)

    def lag(self, held: Mapping[str, SegmentEntry], pending: Iterable[SegmentEntry]) -> Lag:
        """How far a copy with these segments is behind; `pending` are further ones that it lacks."""
        missing = dict(self._size)
        missing.update((entry.segment, entry.size) for entry in pending)
        if not missing:
            return Lag()
        newest = max((entry.arrival_last_ns for entry in held.values()), default=0)
        behind_ns = max(0, self._newest_ns - newest) if newest else 0
        return Lag(len(missing), sum(missing.values()), behind_ns / 1e9)
