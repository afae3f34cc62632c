"""Result of the first pass over a CAN log, and the account of its frames in words."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ingest.can.frames import id_text, ids_text
from ingest.can.pairs import Pairs
from ingest.seen_interval import SeenInterval
from ingest.tables.sample_file import TableSummary

COUNTED = {
    "lost": "lost",
    "repeated": "repeated or late left out",
    "restarts": "restarts of its counter",
    "strays": "whose counter fits neither those before nor those after left out",
    "checksum_failures": "with a wrong checksum left out",
    "short": "too short for all of its signals",
    "not_finite": "values that are no finite number left out",
    "other_channel": "on another channel left out (say which with --mapping)",
    "other_source": "from another source address left out (say which with --mapping)",
    "not_available": "values that say error or not available (J1939-71) left out",
    "outside": "values outside the range that the database states",
    "late": "before one that came earlier left out",
    "retimed": "at the time of the one before, put a nanosecond after it",
}

_FAR_S = 1.0  # beyond what waits and priorities on a bus can delay a frame


@dataclass
class LogFrameCounts:
    """Frames of a log by kind; unusable are those whose time, channel, id or length no bus has.

    `echoes` repeat a data frame of the other direction.
    """

    data: int = 0
    errors: int = 0
    remote: int = 0
    unusable: int = 0
    echoes: int = 0

    @property
    def all(self) -> int:
        """All frames that were read."""
        return self.data + self.errors + self.remote + self.unusable + self.echoes


@dataclass
class MessageCount:
    """Account of the frames of one message of one unit; `lost`, `repeated`, `restarts`, `strays` are by its counter."""

    message: str
    unit: str
    arbitration_id: int  # bit 31 is set if it is of 29 bits
    frames: int = 0  # received
    decoded: int = 0  # those whose signals were used
    lost: int = 0
    repeated: int = 0  # came again
    restarts: int = 0  # places where the counter began again
    strays: int = 0  # left out, as their counter fits neither those before nor those after
    checksum_failures: int = 0  # frames left out for a wrong checksum
    short: int = 0  # frames that lack bytes of a signal; that signal was left out
    not_finite: int = 0  # values left out as they are not finite
    not_available: int = 0  # values of J1939 left out that say error or not available
    outside: int = 0  # values outside the range that the database states
    other_channel: int = 0  # left out, of another channel than the first frame's, if the mapping names none
    late: int = 0  # left out as their time lies before that of an earlier one
    retimed: int = 0  # a little late, put after the one before
    off_grid_s: float = 0.0  # largest distance of a reception from its place on the grid (counter with interval), s
    other_source: int = 0  # left out, of another J1939 source than the first frame's, if the mapping names none
    set_back: int = 0  # places where the receiving clock went back, of frames on a grid
    set_back_s: float = 0.0  # by how much at most
    seen: SeenInterval | None = None  # the interval at which they come, if it is certainly not the stated one
    pairs: Pairs | None = None  # frames that come in pairs of the same data; None if they do not


@dataclass(frozen=True)
class CanCounts:
    """Account of all frames."""

    frames: int
    messages: tuple[MessageCount, ...]  # by message and unit, those that came
    unknown: dict[int, int]  # frames by arbitration id that no message of the plan has
    unrouted: dict[int, int]  # frames by arbitration id whose channel, source or multiplexer belongs to no unit


@dataclass(frozen=True)
class CanSummary(TableSummary):
    """Summary of a CAN log; `rows` are its data frames, `frames` their account."""

    frames: CanCounts = field(default_factory=lambda: CanCounts(0, (), {}, {}))


def remarks(counts: CanCounts, of_kind: LogFrameCounts) -> Iterator[str]:
    """Remarks on the account of the frames of a log, a sentence each."""
    if of_kind.errors:
        yield f"{of_kind.errors} error frames"
    if of_kind.remote:
        yield f"{of_kind.remote} remote frames"
    if of_kind.unusable:
        yield f"{of_kind.unusable} frames left out: no bus has their time, channel, id or length"
    if of_kind.echoes:
        yield echoes_remark(of_kind.echoes)
    if counts.unknown:
        frames = sum(counts.unknown.values())
        yield f"{frames} frames of {len(counts.unknown)} ids that are not mapped: {ids_text(counts.unknown)}"
    for identifier, frames in counts.unrouted.items():
        yield f"{frames} frames of {id_text(identifier)} on a channel or of a source or multiplexer that is no unit's"
    for count in counts.messages:
        text = ", ".join(
            f"{number}{f' of {count.frames}' if name == 'late' else ''} {what}"
            for name, what in COUNTED.items()
            if (number := getattr(count, name))
        )
        if text:
            yield f"message {count.message} of unit {count.unit}: {text}"
        if count.pairs is not None:
            yield _pairs_remark(count, count.pairs)
        if count.set_back:
            where = "1 place" if count.set_back == 1 else f"{count.set_back} places"
            yield (
                f"message {count.message} of unit {count.unit}: the log's clock goes back at {where}, by up to "
                f"{count.set_back_s:,.4g} s; the samples have the times that counter and interval_s give them from the "
                "first frame on"
            )
        if count.off_grid_s > _FAR_S:
            yield (
                f"message {count.message} of unit {count.unit}: frames came up to {count.off_grid_s:,.4g} s before or "
                f"after the time that counter and interval_s give them, which they now have: the interval is not "
                f"exact, or the logger's clock was changed"
            )


def echoes_remark(frames: int) -> str:
    """A remark on frames that a log has twice, sent and received."""
    return (
        f"{frames} frames left out: each repeats a frame of the other direction (Rx, Tx) of its id, channel and data "
        "within 5 ms, as a logger records what it sends itself"
    )


def _pairs_remark(count: MessageCount, pairs: Pairs) -> str:
    return (
        f"warning: message {count.message} of unit {count.unit}: {pairs.number} of {count.frames} frames repeat the "
        f"data of the frame before, {pairs.within_s:.3g} s after it, where the others come {pairs.between_s:.3g} s "
        "apart: the log seems to have every frame twice, as of two loggers, or sent and received; all are taken as "
        "samples, so write the log with each frame once, or name the counter of the message in a mapping"
    )


@contextmanager
def logged_by(*libraries: str) -> Iterator[list[str]]:
    """What libraries log as warnings and errors within it, a line each; it is not printed.

    >>> with logged_by("can") as logged:
    ...     logging.getLogger("can.io.trc").warning("Failed to parse message")
    >>> logged
    ['Failed to parse message']
    """
    found: list[str] = []

    class Collecting(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            lines = record.getMessage().strip().splitlines()
            found.append(lines[-1][:200] if lines else "an error without a text")

    loggers = [logging.getLogger(name) for name in libraries]
    before = [(each.handlers, each.propagate) for each in loggers]
    for each in loggers:
        each.handlers, each.propagate = [Collecting(logging.WARNING)], False
    try:
        yield found
    finally:
        for each, (handlers, propagates) in zip(loggers, before, strict=True):
            each.handlers, each.propagate = handlers, propagates
