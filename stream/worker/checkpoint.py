"""A worker's checkpoint: what it knows of every signal, in one file that is there whole or not at all.

Two generations are kept. One that is damaged is moved aside, and the one before it is as good: it only takes more out
of the log.
"""

import hashlib
import os
import struct
import time
from pathlib import Path

import msgspec

from stream.errors import CheckpointDamaged, EstimatorError
from stream.events import CompensationStarted, LimitsApplied
from stream.worker.signal_analysis import SignalState

CHECKPOINT_VERSION = 2

_HEAD = struct.Struct("<4sI32s")  # mark, version, SHA-256 of version and content
_MARK = b"GFCP"


class Checkpoint(msgspec.Struct, frozen=True):
    """State of a worker.

    Parameters
    ----------
    store: Identity of the store whose log goes on where the checkpoint ends.
    positions: How far every stream was taken in.
    ended: Runs whose messages beyond those positions are left out.
    limits: Those of the runs that go on.
    signals: The signals of the runs that go on.
    compensated: Which of them are compensated, whose samples the end of a run waits for.
    """

    store: str
    positions: list[tuple[str, str, int]]
    ended: list[str]
    limits: list[LimitsApplied]
    signals: list[SignalState]
    compensated: list[CompensationStarted] = []


_decoder = msgspec.msgpack.Decoder(Checkpoint)


def generations(path: Path) -> tuple[Path, Path]:
    """Files of the newest checkpoint and of the one before it.

    Examples
    --------
    >>> [each.name for each in generations(Path("estimate.checkpoint"))]
    ['estimate.checkpoint', 'estimate.checkpoint.previous']
    """
    return path, path.with_name(path.name + ".previous")


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Put a checkpoint in the place of the newest, which becomes the previous one.

    Raises
    ------
    EstimatorError: If it cannot be written; those before are then still there.
    """
    content = msgspec.msgpack.encode(checkpoint)
    head = _HEAD.pack(_MARK, CHECKPOINT_VERSION, _digest(CHECKPOINT_VERSION, content))
    newest, previous = generations(path)
    fresh = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with fresh.open("wb") as file:
            file.write(head + content)
            file.flush()
            os.fsync(file.fileno())
        if newest.exists():
            newest.replace(previous)
        fresh.replace(newest)
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
    """The checkpoint in a file; None where there is none.

    Raises
    ------
    CheckpointDamaged: If it is not what was written, or of an older version.
    EstimatorError: If it cannot be read, or is of a newer version.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise EstimatorError(f"the checkpoint {path} cannot be read: {error}; mend the disk or move it away") from error
    if len(content) < _HEAD.size or content[:4] != _MARK:
        raise CheckpointDamaged(f"the checkpoint {path} is damaged: it does not begin as one")
    _, version, digest = _HEAD.unpack_from(content)
    packed = content[_HEAD.size :]
    is_whole = digest == _digest(version, packed)
    if is_whole and version > CHECKPOINT_VERSION:
        raise EstimatorError(
            f"checkpoint {path} of version {version}, this gyrofleet reads {CHECKPOINT_VERSION}: use the one that "
            "wrote it, or move it away to begin anew from the log"
        )
    if not is_whole or version < CHECKPOINT_VERSION:
        raise CheckpointDamaged(
            f"the checkpoint {path} is damaged, or of an older gyrofleet: its SHA-256 does not hold"
        )
    try:
        return _decoder.decode(packed)
    except msgspec.MsgspecError as error:
        raise CheckpointDamaged(f"the checkpoint {path} cannot be read: {error}") from error


def keep_aside(path: Path) -> Path:
    """Move a checkpoint that cannot be used out of the way; where it is then.

    Raises
    ------
    EstimatorError: If it cannot be moved.
    """
    aside = path.with_name(f"{path.name}.damaged-{time.time_ns()}")
    try:
        path.rename(aside)
    except OSError as error:
        raise EstimatorError(f"the checkpoint {path} cannot be moved aside: {error}; move it away yourself") from error
    return aside


def _digest(version: int, content: bytes) -> bytes:
    return hashlib.sha256(version.to_bytes(4, "little") + content).digest()
