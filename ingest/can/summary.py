"""What a CAN log holds, as its first pass finds it, and the account of its frames in words."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice

from ingest.can.database import id_text
from ingest.can.samples import CanCounts, MessageCount
from ingest.tables.summary import TableSummary

LOG_SUFFIXES = frozenset({".blf", ".asc", ".trc", ".log", ".mf4"})

_IDS_NAMED = 8


@dataclass
class FrameCounts:
    """Frames of a log by kind: of data, which are given out, and others, which are only counted.

    Unusable are those whose time, channel, id or length no bus has, as in a damaged or forged file.
    """

    data: int = 0
    errors: int = 0
    remote: int = 0
    unusable: int = 0

    @property
    def all(self) -> int:
        """All that were read."""
        return self.data + self.errors + self.remote + self.unusable


@dataclass(frozen=True)
class CanSummary(TableSummary):
    """What a CAN log holds; `rows` are its data frames, and `frames` says what became of them."""

    frames: CanCounts = field(default_factory=lambda: CanCounts(0, (), {}, {}))


def some_ids(identifiers: Iterable[int]) -> str:
    """The first of some arbitration ids, for people.

    Examples
    --------
    >>> some_ids([0x24, 0x25])
    '0x024, 0x025'
    """
    named = [id_text(identifier) for identifier in islice(identifiers, _IDS_NAMED + 1)]
    return ", ".join([*named[:_IDS_NAMED], "..."] if len(named) > _IDS_NAMED else named)


def remarks(counts: CanCounts, of_kind: FrameCounts) -> Iterator[str]:
    """What is remarkable in the account of the frames of a log, a sentence each."""
    if of_kind.errors:
        yield f"{of_kind.errors} error frames"
    if of_kind.remote:
        yield f"{of_kind.remote} remote frames"
    if of_kind.unusable:
        yield f"{of_kind.unusable} frames left out: no bus has their time, channel, id or length"
    if counts.unknown:
        frames = sum(counts.unknown.values())
        yield f"{frames} frames of {len(counts.unknown)} ids that are not mapped: {some_ids(counts.unknown)}"
    for identifier, frames in counts.unrouted.items():
        yield f"{frames} frames of {id_text(identifier)} on a channel or of a multiplexer that is no unit's"
    for count in counts.messages:
        told = ", ".join(_told(count))
        if told:
            yield f"message {count.message} of unit {count.unit}: {told}"


def _told(count: MessageCount) -> Iterator[str]:
    for number, text in (
        (count.lost, "lost"),
        (count.repeated, "repeated"),
        (count.restarts, "restarts of its counter"),
        (count.checksum_failures, "with a wrong checksum left out"),
        (count.short, "too short for all of its signals"),
        (count.not_finite, "values that are no finite number left out"),
        (count.other_channel, "on another channel left out (say which with --mapping)"),
        (count.late, "before one that came earlier left out"),
        (count.retimed, "at the time of the one before, put a nanosecond after it"),
    ):
        if number:
            yield f"{number} {text}"
