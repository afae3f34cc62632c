"""Small files that say how far something is: there whole or not at all."""

from pathlib import Path
from typing import TypeVar

import msgspec

from stream.atomic_file import write_durably
from stream.errors import StoreError

State = TypeVar("State", bound=msgspec.Struct)


def read_state(path: Path, kind: type[State]) -> State | None:
    """The state of a run that is kept in a file; None where there is no such file.

    Raises
    ------
    StoreError: If it cannot be read, or is not a state of this kind.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as error:
        raise StoreError(
            f"{path} cannot be read: {error}; the run's samples are safe, but it cannot be gone on with: give another "
            f"--run"
        ) from error


def write_state(path: Path, state: State) -> State:
    """Put a state in the place of the one before; returns it.

    Raises
    ------
    StoreError: If it cannot be written; the one before is then still there.

    Examples
    --------
    >>> import tempfile
    >>> class Progress(msgspec.Struct):
    ...     step: int
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = write_state(Path(folder) / "run.json", Progress(3))
    ...     read_state(Path(folder) / "run.json", Progress)
    Progress(step=3)
    """
    replace_file(path, msgspec.json.format(msgspec.json.encode(state)) + b"\n")
    return state


def replace_file(path: Path, content: bytes) -> None:
    """Put a file in the place of the one before, whole or not at all.

    Raises
    ------
    StoreError: If it cannot be written; the one before is then still there.
    """
    try:
        write_durably(path, content)
    except OSError as error:
        raise StoreError(f"{path} cannot be written: {error}; free space or mend the disk, and start again") from error
