"""What a run at a station takes on disk, estimated before it begins."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from storage.recording.disk_watch import DiskWatch, format_bytes
from storage.segments.disk import DISK, Disk

# measured, see docs/benchmarks.md: log and lake together of counts; numbers have 8 bytes and a time each; and what a
# message adds to the log, with its index and the estimates
_COUNT_BYTES, _NUMBER_BYTES, _MESSAGE_BYTES = 1.3 + 1.1, 16.0, 85.0


class Flow(NamedTuple):
    """Samples that a source sends at the station; `interval_s` is None where nothing states it.

    A message has those of `batch_s`, or one.
    """

    signals: int
    interval_s: float | None
    batch_s: float
    is_counts: bool = True


class RunRoom(NamedTuple):
    """Bytes that the rest of a run needs, beside those that are free on the disk of its store."""

    samples: int
    needed_bytes: int
    unknown_signals: int  # whose interval nothing states: they come on top
    free_bytes: int
    reserve_bytes: int  # recording pauses where no more are free
    folder: str

    @property
    def warning(self) -> str | None:
        """A sentence where the room does not suffice; None where it does."""
        if self.needed_bytes <= self.free_bytes - self.reserve_bytes:
            return None
        return (
            f"the run needs {self}, and recording pauses below {format_bytes(self.reserve_bytes)}: free space, or give "
            "--store on another disk"
        )

    def __str__(self) -> str:
        """Both figures, for people."""
        others = f", and more for {self.unknown_signals} signals whose interval nothing states"
        return (
            f"about {format_bytes(self.needed_bytes)} for {self.samples:,} samples"
            f"{others if self.unknown_signals else ''}; {format_bytes(self.free_bytes)} are free on the disk of "
            f"{self.folder}"
        )


def run_room(flows: Iterable[Flow], recorded_s: float, folder: Path, disk: Disk = DISK) -> RunRoom:
    """Estimate what `recorded_s` seconds of some sources take in a store, which may not be there yet.

    Raises OSError if its disk cannot be looked at.

    >>> room = run_room([Flow(2, 0.01, batch_s=0.05), Flow(1, None, batch_s=0.05)], 3600.0, Path("/"))
    >>> room.samples, room.needed_bytes, room.unknown_signals
    (720000, 13968000, 1)
    """
    samples, needed, unknown = 0.0, 0.0, 0
    for each in flows:
        if each.interval_s is None:
            unknown += each.signals
            continue
        count = each.signals * recorded_s / each.interval_s
        messages = each.signals * recorded_s / max(each.batch_s, each.interval_s)
        samples += count
        needed += count * (_COUNT_BYTES if each.is_counts else _NUMBER_BYTES) + messages * _MESSAGE_BYTES
    there = existing(folder)
    watch = DiskWatch(there, disk)
    return RunRoom(round(samples), round(needed), unknown, watch.free_bytes, watch.reserve_bytes, str(folder))


def existing(folder: Path) -> Path:
    """The folder, or the nearest above it that exists."""
    return next((each for each in (folder, *folder.absolute().parents) if each.is_dir()), Path("/"))
