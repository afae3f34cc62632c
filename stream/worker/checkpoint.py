"""A worker's checkpoint: the state of every signal in one file, written atomically.

Two generations are kept. A damaged one is quarantined and the one before it is used: more is then read from the log.
"""

import hashlib
import struct
import time
from pathlib import Path

import msgspec

from stream.decoding import msgpack_decoder
from stream.errors import CheckpointDamaged, EstimatorError
from stream.events import CompensationStarted, LimitsApplied, UnitReleased
from stream.files.atomic_file import write_durably
from stream.worker.signal_analysis import SignalState

CHECKPOINT_VERSION = 2

_HEAD = struct.Struct("<4sI32s")  # mark, version, SHA-256 of version and content
_MARK = b"GFCP"


class Checkpoint(msgspec.Struct, frozen=True):
    """State of a worker; the log of the store of that identity continues where it ends.

    `positions` are key, epoch and next number of every stream; messages of `ended` runs beyond those are left out.
    `limits` and `signals` are those of the runs in progress; `compensated` are signals among them whose samples the end
    of a run waits for; `released` are units that were released from them.
    """

    store: str
    positions: list[tuple[str, str, int]]
    ended: list[str]
    limits: list[LimitsApplied]
    signals: list[SignalState]
    compensated: list[CompensationStarted] = []
    released: list[UnitReleased] = []


_decoder = msgpack_decoder(Checkpoint)


def generations(path: Path) -> tuple[Path, Path]:
    """Files of the newest checkpoint and of the one before it."""
    return path, path.with_name(path.name + ".previous")


def write_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write the newest checkpoint, keeping the one before; EstimatorError if it cannot be written."""
    content = msgspec.msgpack.encode(checkpoint)
    head = _HEAD.pack(_MARK, CHECKPOINT_VERSION, _digest(CHECKPOINT_VERSION, content))
    newest, previous = generations(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_durably(newest, head + content, previous=previous)
    except OSError as error:
        raise EstimatorError(
            f"the checkpoint {path} cannot be written: {error}; free space or repair the disk, so that estimation can "
            "resume from it after a stop"
        ) from error


def read_checkpoint(path: Path) -> Checkpoint | None:
    """The checkpoint in a file; None where there is none.

    Raises a CheckpointDamaged if its checksum is wrong, or it is of an older version, an EstimatorError if it cannot be
    read, or is of a newer version.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise EstimatorError(
            f"the checkpoint {path} cannot be read: {error}; repair the disk or move it away"
        ) from error
    if len(content) < _HEAD.size or content[:4] != _MARK:
        raise CheckpointDamaged(f"the checkpoint {path} is damaged: it does not begin as one")
    _, version, digest = _HEAD.unpack_from(content)
    packed = content[_HEAD.size :]
    is_whole = digest == _digest(version, packed)
    if is_whole and version > CHECKPOINT_VERSION:
        raise EstimatorError(
            f"checkpoint {path} of version {version}, this gyrofleet reads {CHECKPOINT_VERSION}: use the one that "
            "wrote it, or move it away to begin again from the log"
        )
    if not is_whole or version < CHECKPOINT_VERSION:
        raise CheckpointDamaged(
            f"the checkpoint {path} is damaged, or of an older gyrofleet: its SHA-256 does not hold"
        )
    try:
        return _decoder.decode(packed)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise CheckpointDamaged(f"the checkpoint {path} cannot be read: {error}") from error


def quarantine(path: Path) -> Path:
    """Rename a checkpoint that cannot be used; returns its new path, or raises an EstimatorError if it cannot be."""
    aside = path.with_name(f"{path.name}.damaged-{time.time_ns()}")
    try:
        path.rename(aside)
    except OSError as error:
        raise EstimatorError(f"the checkpoint {path} cannot be renamed: {error}; move it away yourself") from error
    return aside


def _digest(version: int, content: bytes) -> bytes:
    return hashlib.sha256(version.to_bytes(4, "little") + content).digest()
