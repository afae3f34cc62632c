"""How the process that runs statements and the one that asks it talk: frames of a kind, a length and a content."""

import struct
from enum import Enum
from typing import IO

_HEAD = struct.Struct("<cQ")


class Kind(Enum):
    """Of a frame."""

    REQUEST = b"?"
    """Pickle; from the one that asks."""
    READY = b"R"
    """JSON with `landlock`: whether the kernel enforces that nothing is written."""
    ROWS = b"B"
    """An Arrow stream: the schema and some rows of the result."""
    DONE = b"O"
    """The result is complete."""
    FAILED = b"E"
    """JSON with `kinds`, the names of the error's classes, and `message`."""
    NOT_KEPT = b"N"
    """A table that the statement names must be computed first."""


class Closed(Exception):
    """The other side has ended."""


def write_frame(file: IO[bytes], kind: Kind, content: bytes | memoryview = b"") -> None:
    """Send a frame."""
    file.write(_HEAD.pack(kind.value, len(content)))
    file.write(content)
    file.flush()


def read_frame(file: IO[bytes]) -> tuple[Kind, bytes]:
    """Receive a frame."""
    kind, length = _HEAD.unpack(_exactly(file, _HEAD.size))
    return Kind(kind), _exactly(file, length)


def _exactly(file: IO[bytes], length: int) -> bytes:
    content = file.read(length)
    if len(content) < length:
        raise Closed
    return content
