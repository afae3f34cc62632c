"""The contents of a spool's folder, as an earlier process left it."""

from dataclasses import dataclass, field
from pathlib import Path

from stream.delivery.spool_frames import FIRST_STREAM, parse_frames
from stream.delivery.spool_streams import StreamTable
from stream.errors import DeliveryError

SUFFIX = ".spool"


class SpoolError(DeliveryError):
    """A spool that cannot be opened, written or read at the moment."""


@dataclass
class SpoolFile:
    """A file of a spool: `unread` messages after `read_to`, and the next number of each stream in it."""

    path: Path
    size: int = 0
    read_to: int = 0
    unread: int = 0
    last: dict[int, int] = field(default_factory=dict)


@dataclass
class Scanned:
    """All files of a spool in order, the state of its streams, its damages, and bytes of torn ends."""

    table: StreamTable = field(default_factory=StreamTable)
    files: list[SpoolFile] = field(default_factory=list)
    damages: list[str] = field(default_factory=list)
    torn_bytes: int = 0


def scan(folder: Path) -> Scanned:
    """Read every file of a spool."""
    found = Scanned()
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        data = path.read_bytes()
        file = SpoolFile(path, len(data))
        parsed = parse_frames(data, is_end=True)
        found.damages += [f"{path}: bytes {first} to {after} are damaged" for first, after in parsed.damaged]
        found.torn_bytes += parsed.torn
        for frame in parsed.frames:
            found.table.apply(frame)
            if frame.number >= FIRST_STREAM:
                file.unread += 1
                file.last[frame.number] = max(frame.next_seq, file.last.get(frame.number, 0))
        found.files.append(file)
    found.table.drop_acknowledged_losses()
    nameless = sum(number not in found.table.by_number for file in found.files for number in file.last)
    if nameless:
        found.damages.append(f"{folder}: the names of {nameless} streams are lost, their messages are kept")
    for state in found.table.streams.values():
        found.damages += [f"{state.id.key}: numbers {first} to {after - 1} are lost" for first, after in state.lost]
    return found


def held_messages(folder: Path) -> int:
    """Number of messages in a spool's folder that no recorder has, as far as its source knows; it may be in use.

    Raises
    ------
    SpoolError: If it cannot be read.
    """
    try:
        found = scan(folder)
        known = found.table.by_number
        return sum(
            frame.number >= FIRST_STREAM
            and (frame.number not in known or frame.next_seq > known[frame.number].acknowledged)
            for file in found.files
            if any(n not in known or last > known[n].acknowledged for n, last in file.last.items())
            for frame in parse_frames(file.path.read_bytes(), is_end=True).frames
        )
    except FileNotFoundError:
        return 0  # the rest has just been acknowledged
    except OSError as error:
        raise SpoolError(f"the spool {folder} cannot be read: {error}") from error
