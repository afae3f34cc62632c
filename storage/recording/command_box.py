"""Commands to the station of a run: small files in the store, in a folder that only its owner can read and write.

The folder ``control/DIGEST`` of a run holds each command as one file, whose name says how far it is. ``ID.given`` waits
for the station, which takes it by renaming it to ``ID.taken``; whoever gave it withdraws it by renaming it to
``ID.withdrawn``. Only one of the two renames succeeds. The station answers in ``ID.answer``, and holds a lock on
``held`` as long as it looks for commands. Notes to a run whose process alone can write the log wait there as
``ID.note``.
"""

import fcntl
import hashlib
import os
import stat
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, TypeVar
from uuid import uuid4

import msgspec

from stream.closing import Closing
from stream.decoding import decode_json
from stream.errors import StoreError
from stream.events import CommandOutcome, NoteAdded, RunAction
from stream.status.role_status import boot, uptime_ns

FOLDER = "control"
GIVEN, TAKEN, WITHDRAWN, ANSWER, NOTE = "given", "taken", "withdrawn", "answer", "note"
_HELD = "held"
_MOST_BYTES = 64 << 10
_KEPT_S = 86_400.0
_OF_OTHERS = 0o077


class RunCommand(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A command as it was given; it is not carried out after `expires_ns`, nor once this computer's `uptime_ns` of the
    start `boot` is beyond `expires_uptime_ns`, however the clock is set meanwhile.
    """

    id: str
    run: str
    action: RunAction
    by: str
    reason: str
    given_ns: int
    expires_ns: int
    expires_uptime_ns: int = 0
    boot: str = ""

    @property
    def is_over(self) -> bool:
        """Whether its time is over by the clock that nobody sets."""
        return bool(self.boot) and (self.boot != boot() or uptime_ns() > self.expires_uptime_ns)


class CommandAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a command, in English and Chinese."""

    outcome: CommandOutcome
    text: str
    text_zh: str = ""
    unsafe: tuple[str, ...] = ()  # instruments that an abort could not make safe

    @property
    def is_final(self) -> bool:
        """Whether nothing more will come."""
        return self.outcome is not CommandOutcome.ACCEPTED


class BadCommand(NamedTuple):
    """A file that is no command of this run, or that another user has put there; it is never carried out."""

    name: str
    why: str


Content = TypeVar("Content", RunCommand, CommandAnswer, NoteAdded)


class CommandFolder(Closing):
    """The folder of a run's commands, made if it is missing.

    Raises StoreError if it cannot be made, belongs to another user, or can be read or written by others.
    """

    def __init__(self, store_folder: Path, run: str, *, is_made: bool = True) -> None:
        self.run = run
        self.path = store_folder / FOLDER / hashlib.sha256(run.encode()).hexdigest()[:32]
        try:
            if is_made:
                self.path.parent.mkdir(mode=0o700, exist_ok=True)
                self.path.mkdir(mode=0o700, exist_ok=True)
            self._folder = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError as error:
            raise StoreError(f"commands for run {run}: {self.path} cannot be opened: {error}") from error
        if (why := _not_own(os.fstat(self._folder))) is not None:
            os.close(self._folder)
            raise StoreError(f"commands for run {run} are not taken: {self.path} {why}; move it away, or correct it")

    def close(self) -> None:
        """Close the folder."""
        os.close(self._folder)

    def names(self, state: str) -> list[str]:
        """Ids of the commands that are so far, in the order of their giving."""
        found = [name for name in self._listed() if name.endswith(f".{state}")]
        return sorted(name.removesuffix(f".{state}") for name in found)

    def _listed(self) -> list[str]:
        return os.listdir(self._folder)  # noqa: PTH208  an open folder, whatever its path leads to by now

    def move(self, command_id: str, before: str, after: str) -> bool:
        """Rename a command's file; False if it is not there any more."""
        try:
            os.rename(
                f"{command_id}.{before}", f"{command_id}.{after}", src_dir_fd=self._folder, dst_dir_fd=self._folder
            )
        except FileNotFoundError:
            return False
        return True

    def remove(self, command_id: str, state: str) -> None:
        """Remove a command's file, if it is there."""
        with suppress(FileNotFoundError):
            os.unlink(f"{command_id}.{state}", dir_fd=self._folder)

    def write(self, command_id: str, state: str, content: RunCommand | CommandAnswer | NoteAdded) -> None:
        """Put a file into the folder, whole or not at all; StoreError if the disk refuses."""
        fresh = f"{command_id}.{uuid4().hex}.new"
        try:
            descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600, dir_fd=self._folder)
            with open(descriptor, "wb") as file:  # noqa: PTH123  a descriptor
                file.write(msgspec.json.encode(content))
                file.flush()
                os.fsync(file.fileno())
            os.rename(fresh, f"{command_id}.{state}", src_dir_fd=self._folder, dst_dir_fd=self._folder)
            os.fsync(self._folder)
        except OSError as error:
            raise StoreError(f"{self.path} cannot be written: {error}; free or repair the disk") from error

    def read(self, command_id: str, state: str, kind: type[Content]) -> Content | BadCommand | None:
        """What a file says; None if it is not there, a BadCommand if another user owns it or it cannot be read."""
        name = f"{command_id}.{state}"
        try:
            descriptor = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=self._folder)
        except FileNotFoundError:
            return None
        except OSError as error:
            return BadCommand(name, f"cannot be opened: {error}")
        with open(descriptor, "rb") as file:  # noqa: PTH123  a descriptor
            about = os.fstat(descriptor)
            if not stat.S_ISREG(about.st_mode):
                return BadCommand(name, "is no file")
            if (why := _not_own(about)) is not None:
                return BadCommand(name, why)
            if about.st_size > _MOST_BYTES:
                return BadCommand(name, f"has {about.st_size:,} bytes")
            try:
                return decode_json(file.read(), kind)
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
                return BadCommand(name, f"cannot be read: {error}")

    def lock(self) -> int | None:
        """Take the lock of the station; its descriptor, or None if another process holds it."""
        mode = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        descriptor = os.open(_HELD, mode, 0o600, dir_fd=self._folder)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return None
        return descriptor

    @property
    def is_held(self) -> bool:
        """Whether a station looks for commands now."""
        try:
            descriptor = os.open(_HELD, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=self._folder)
        except OSError:
            return False
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(descriptor)
        return False

    def tidy(self) -> None:
        """Remove answers that nobody came for within a day, and what a killed process left half-written."""
        for name in self._listed():
            with suppress(OSError):
                is_left = name.endswith((f".{ANSWER}", ".new"))
                age_s = time.time() - os.stat(name, dir_fd=self._folder, follow_symlinks=False).st_mtime
                if is_left and age_s > _KEPT_S:
                    os.unlink(name, dir_fd=self._folder)


class CommandBox(Closing):
    """The station's side: takes commands of its run and answers them. Raises StoreError if another process does."""

    def __init__(self, store_folder: Path, run: str) -> None:
        self._folder = CommandFolder(store_folder, run)
        held = self._folder.lock()
        for _ in range(20):  # whoever gives a command looks at the lock for a moment
            if held is not None:
                break
            time.sleep(0.02)
            held = self._folder.lock()
        if held is None:
            self._folder.close()
            raise StoreError(f"commands for run {run} are taken by another process already")
        self._held = held
        self._folder.tidy()

    def taken(self) -> Iterator[RunCommand | BadCommand]:
        """Commands that were taken, but not answered, by a process before this one."""
        yield from self._read(self._folder.names(TAKEN), TAKEN)

    def withdrawn(self) -> Iterator[RunCommand | BadCommand]:
        """Commands that were withdrawn, and that the log does not have; to be forgotten once it has."""
        yield from self._read(self._folder.names(WITHDRAWN), WITHDRAWN)

    def take(self) -> Iterator[RunCommand | BadCommand]:
        """Take the commands that wait; each is handed out once."""
        waiting = self._folder.names(GIVEN)
        yield from self._read([each for each in waiting if self._folder.move(each, GIVEN, TAKEN)], TAKEN)

    def answer(self, command_id: str, answer: CommandAnswer) -> None:
        """Answer a command; StoreError if the disk refuses."""
        self._folder.write(command_id, ANSWER, answer)
        self._folder.remove(command_id, TAKEN)

    def notes(self) -> Iterator[NoteAdded]:
        """Notes that wait; one that another user has put there, or that is to another run, is removed."""
        for name in self._folder.names(NOTE):
            note = self._folder.read(name, NOTE, NoteAdded)
            if isinstance(note, NoteAdded) and (note.uid, note.run) == (name, self._folder.run):
                yield note
            else:
                self._folder.remove(name, NOTE)

    def forget(self, name: str) -> None:
        """Remove a withdrawn command, or a note, that is in the log."""
        self._folder.remove(name, WITHDRAWN)
        self._folder.remove(name, NOTE)

    def close(self) -> None:
        """Take no more commands."""
        os.close(self._held)
        self._folder.close()

    def _read(self, ids: list[str], state: str) -> Iterator[RunCommand | BadCommand]:
        found = []
        for command_id in ids:
            read = self._folder.read(command_id, state, RunCommand)
            if isinstance(read, RunCommand) and (read.id, read.run) != (command_id, self._folder.run):
                read = BadCommand(f"{command_id}.{state}", f"is a command {read.id} for run {read.run}")
            if isinstance(read, BadCommand):
                self._folder.remove(command_id, state)
                yield read
            elif read is not None:
                found.append(read)
        yield from sorted(found, key=lambda each: (each.given_ns, each.id))


def _not_own(about: os.stat_result) -> str | None:
    """Why a file or folder may not be this user's own."""
    if about.st_uid != os.geteuid():
        return f"belongs to user {about.st_uid}, not to {os.geteuid()} who runs this"
    if about.st_mode & _OF_OTHERS:
        return f"is open to others (mode {stat.S_IMODE(about.st_mode):04o})"
    return None
