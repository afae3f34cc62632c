"""A worker's checkpoint: what it knows of every signal, in one file that is there whole or not at all."""

import os
import struct
import zlib
from pathlib import Path

import msgspec

from stream.errors import EstimatorError
from stream.events import LimitsApplied
from stream.signal_analysis import SignalState

CHECKPOINT_VERSION = 1

_HEAD = struct.Struct("<4sII")  # mark, version, CRC-32 of version and content
_MARK = b"GFCP"


class Checkpoint(msgspec.Struct, frozen=True):
    """State of a worker.

    Parameters
    ----------
    store : str
        Identity of the store whose log goes on where the checkpoint ends.
    every_ns : int
        Interval between estimates, nanoseconds.
    positions : list of (key, epoch, next number)
        How far every stream was taken in.
    limits : list of LimitsApplied
        Those of the runs that go on.
    signals : list of SignalState
        The signals of the runs that go on.
    """

    store: str
    every_ns: int
    positions: list[tuple[str, str, int]]
    limits: list[LimitsApplied]
    signals: list[SignalState]


_decoder = msgspec.msgpack.Decoder(Checkpoint)


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Put a checkpoint in the place of the one before.

    Raises
    ------
    EstimatorError
        If it cannot be written; the one before is then still there.
    """
    content = msgspec.msgpack.encode(checkpoint)
    head = _HEAD.pack(_MARK, CHECKPOINT_VERSION, zlib.crc32(content, CHECKPOINT_VERSION))
    fresh = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with fresh.open("wb") as file:
            file.write(head + content)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        raise EstimatorError(
            f"the checkpoint {path} cannot be written: {error}; free space or mend the disk, so that estimating can go "
            "on from it after a stop"
        ) from error


def read_checkpoint(path: Path) -> Checkpoint | None:
    """The last checkpoint; None where there is none.

    Raises
    ------
    EstimatorError
        If it is damaged, or of another version.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise EstimatorError(f"the checkpoint {path} cannot be read: {error}") from error
    remedy = f"remove {path} to begin anew"
    if len(content) < _HEAD.size or content[:4] != _MARK:
        raise EstimatorError(f"{path} is no checkpoint; {remedy}")
    _, version, checksum = _HEAD.unpack_from(content)
    if version != CHECKPOINT_VERSION:
        raise EstimatorError(
            f"checkpoint {path} of version {version}, this gyrofleet reads {CHECKPOINT_VERSION}; use the gyrofleet "
            f"that wrote it, or {remedy}"
        )
    try:
        if checksum != zlib.crc32(content[_HEAD.size :], version):
            raise EstimatorError(f"the checkpoint {path} is damaged; {remedy}")
        return _decoder.decode(content[_HEAD.size :])
    except msgspec.MsgspecError as error:
        raise EstimatorError(f"the checkpoint {path} cannot be read ({error}); {remedy}") from error
