"""What replication asks of a plant: its identity, the chained list of its segments, and ranges of their bytes.

A folder, an endpoint or a bucket can answer. Nothing that a source returns is trusted: see `plant_list` and `arrival`.
"""

import re
from collections.abc import Iterable, Iterator
from typing import Protocol

import msgspec

from storage.manifests.entries import SegmentEntry
from storage.plant import Plant
from stream.errors import GyrofleetError

MAX_LINE_BYTES = 1 << 20
MAX_SEGMENT_BYTES = 64 << 30
MAX_FILE_BYTES = 256 << 20
MAX_FILES = 1_000_000
CHUNK_BYTES = 1 << 20
_SEGMENT = re.compile(r"\d{8}\.mcap")


class SourceGone(GyrofleetError):
    """A source that cannot be reached, or ended in the middle; the next pass resumes."""


class SegmentMissing(GyrofleetError):
    """A segment or file that the source lists and cannot deliver."""


class CarriedFile(msgspec.Struct, frozen=True):
    """A file of a store that is no segment and is never changed once written: as an error model."""

    name: str
    size: int
    sha256: str


class SegmentSource(Protocol):
    """A plant as replication sees it. Any method may raise `SourceGone`."""

    where: str  # folder, endpoint or bucket, for messages

    def plant(self) -> Plant | None:
        """Identity of the plant; None as long as it has no segment."""

    def segments(self, after: int) -> Iterator[bytes]:
        """Lines of the list of its segments, without their ends, beyond the first `after`.

        A line is the segment's entry as JSON, a tab, and the SHA-256 of the line before's hash and this entry.
        """

    def originals(self) -> Iterable[SegmentEntry]:
        """Segments that are kept as first listed, though the plant has listed a part or the loss of them since."""

    def files(self) -> Iterable[CarriedFile]:
        """What travels besides segments."""

    def read(self, name: str, offset: int, length: int) -> bytes:
        """At most `length` bytes of a segment or file, fewer only at its end; SegmentMissing if it is not there."""

    def close(self) -> None:
        """Leave it."""


def is_segment(name: str) -> bool:
    """Whether a name is that of a sealed segment."""
    return _SEGMENT.fullmatch(name) is not None
