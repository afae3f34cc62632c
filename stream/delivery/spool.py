"""The spool: a publisher's messages on its own disk, until a recorder has them.

A folder of numbered files. Each begins with a table of all streams, so that it can be read without those before it;
messages follow in the order in which they were sent, and between them the acknowledgements. A file is removed when all
its messages are acknowledged. Every start begins a new file: nothing is written after a torn end.
"""

import fcntl
import os
import threading
import time
from collections import deque
from contextlib import ExitStack
from pathlib import Path

from stream.closing import Closing
from stream.delivery.spool_frames import FIRST_STREAM, encode_frame
from stream.delivery.spool_room import SpoolRoom
from stream.delivery.spool_streams import (
    SUFFIX,
    SpooledMessage,
    SpoolError,
    SpoolFile,
    SpoolFull,
    StreamState,
    StreamTable,
    held_messages,
    scan,
)
from stream.files.atomic_file import sync_folder
from stream.wire.acknowledgement import StreamId

__all__ = ["Spool", "SpoolError", "SpoolFull", "SpooledMessage", "held_messages"]

_LOCK = "lock"
_RETRY_S = 1.0
_LEAST_FILES = 4


def spool_is_held(folder: Path) -> bool:
    """Whether a process has a spool open.

    >>> spool_is_held(Path("/nowhere"))
    False
    """
    try:
        with (folder / _LOCK).open() as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


class Spool(Closing):
    """Messages of one publisher on disk.

    Appended messages survive the process, and after at most `sync_interval_s` a power loss as well. `damages` lists
    what was found damaged; `failure` is why nothing can be written at the moment.

    It lies in `folder`, which is created if missing and has one process at a time. All files have `max_bytes` together,
    one `file_bytes`, at most a quarter of that. Files are synced to disk, and acknowledgements written, every
    `sync_interval_s`. Raises a SpoolError if it cannot be opened, or another process has it.

    >>> import tempfile
    >>> stream = StreamId("gyrofleet/plant/bench/U1/rate", "e")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Spool(Path(folder)) as spool:
    ...         spool.append(stream, 0, 100, b"samples")
    ...     with Spool(Path(folder)) as spool:
    ...         spool.waiting, spool.read(1000)[0].payload, spool.position(stream)
    (1, b'samples', 100)
    """

    def __init__(
        self, folder: Path, *, max_bytes: int = 4 << 30, file_bytes: int = 16 << 20, sync_interval_s: float = 0.2
    ) -> None:
        self.folder = folder
        self.damages: list[str] = []
        self.failure: str | None = None
        self.waiting = 0
        self.room = SpoolRoom(folder, max_bytes)
        self._file_bytes = min(file_bytes, max_bytes // _LEAST_FILES)
        self._sync_interval_s = sync_interval_s
        self._table = StreamTable()
        self._files: deque[SpoolFile] = deque()
        self._bytes = 0
        self._out = -1
        self._unsynced: list[int] = []  # descriptors of earlier files that are not on the disk yet
        self._failed_at = float("-inf")
        self._moved: set[int] = set()
        self._lock = threading.RLock()
        self._stopped = threading.Event()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with ExitStack() as stack:
                self._lock_file = stack.enter_context((folder / _LOCK).open("a"))
                fcntl.flock(self._lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                found = scan(folder)
                self._table, self.damages = found.table, found.damages
                self._files = deque(found.files)
                self._bytes = sum(file.size for file in self._files)
                self.waiting = sum(file.unread for file in self._files)
                self._begin_file()
                stack.pop_all()  # it is closed with the spool
        except BlockingIOError:
            raise SpoolError(
                f"another process sends from the spool {self.folder}; wait until it has ended, or stop it"
            ) from None
        except OSError as error:
            raise SpoolError(
                f"the spool {folder} cannot be opened: {error}; its messages are kept; correct this and start again"
            ) from error
        self._syncer = threading.Thread(target=self._sync_loop, name="gyrofleet-spool", daemon=True)
        self._syncer.start()

    @property
    def store(self) -> str:
        """Identity of the store that last acknowledged; empty if none has."""
        return self._table.store

    @property
    def streams(self) -> dict[StreamId, StreamState]:
        """State of every stream."""
        with self._lock:
            return dict(self._table.streams)

    @property
    def unacknowledged(self) -> bool:
        """Whether it holds anything that no recorder has."""
        with self._lock:
            return any(state.acknowledged < state.appended for state in self._table.streams.values())

    def position(self, stream: StreamId) -> int:
        """Number after the last message of a stream; 0 if there is none."""
        state = self._table.streams.get(stream)
        return 0 if state is None else state.appended

    def append(
        self, stream: StreamId, seq: int, next_seq: int, payload: bytes, *, taken: bool = False,
        is_document: bool = False,
    ) -> None:  # fmt: skip
        """Keep a message; one that is `taken` is not read back by this process.

        Raises a SpoolFull if there is no room, of which documents have more than samples; there is when more has been
        acknowledged. Raises a SpoolError if it
        cannot be written. It is then not kept; after a second a new file is tried.
        """
        with self._lock:
            if self.failure is not None and time.monotonic() - self._failed_at < _RETRY_S:
                raise SpoolError(self.failure)
            try:
                state = self._table.streams.get(stream)
                if state is None:
                    state = self._table.add(stream)
                    self._write(self._table.rows([state]))
                frame = encode_frame(state.number, seq, next_seq, payload)
                if not self.room.fits(self._bytes + len(frame), is_document=is_document):
                    self._make_room(len(frame), is_document=is_document)
                self._write(frame)
            except OSError as error:
                raise self._failed(error) from error
            self.failure = None
            self.room.grew(self._bytes)
            state.appended = next_seq
            file = self._files[-1]
            file.last[state.number] = next_seq
            if taken:
                file.read_to = file.size
            else:
                file.unread += 1
                self.waiting += 1
            if file.size >= self._file_bytes:
                try:
                    self._begin_file()
                except OSError as error:
                    self._failed(error)  # what was appended is kept; the next append tries again

    def acknowledge(self, store: str, stream: StreamId, next_seq: int) -> None:
        """Record that a recorder has the messages before `next_seq` on disk."""
        state = self._table.streams.get(stream)
        if state is not None and next_seq > state.acknowledged:
            with self._lock:
                self._table.store = store
                state.acknowledged = next_seq
                self._moved.add(state.number)
                self.room.acknowledged()

    def rebase(self, stream: StreamId, base: int) -> None:
        """Record that the messages before `base` are lost and the stream continues under another epoch."""
        with self._lock:
            state = self._table.streams[stream]
            state.base = base
            try:
                self._write(self._table.rows([state]))
            except OSError as error:
                self._failed(error)

    def read(self, most_bytes: int) -> list[SpooledMessage]:
        """The next waiting messages, about so many bytes, without those that were acknowledged."""
        found: list[SpooledMessage] = []
        size = 0
        with self._lock:
            while size < most_bytes and self.waiting:
                file = next(each for each in self._files if each.unread)
                try:
                    frames = file.read(most_bytes - size)
                except OSError as error:
                    raise SpoolError(
                        f"the spool file {file.path} cannot be read: {error}; repair the disk and start again"
                    ) from error
                messages = [frame for frame in frames if frame.number >= FIRST_STREAM]
                is_read = file.read_to >= file.size
                if is_read and file.unread > len(messages):
                    missing = file.unread - len(messages)
                    self.damages.append(f"{file.path}: {missing} messages cannot be read any more")
                counted = file.unread if is_read else len(messages)
                file.unread -= counted
                self.waiting -= counted
                for frame in messages:
                    state = self._table.by_number.get(frame.number)
                    if state is not None and frame.next_seq > state.acknowledged:
                        found.append(SpooledMessage(state.id, frame.seq, frame.next_seq, frame.payload))
                        size += len(frame.payload)
        return found

    def close(self) -> None:
        """Sync everything to disk and release the lock; acknowledged messages are removed."""
        self._stopped.set()
        self._syncer.join()
        with self._lock:
            try:
                if not self.unacknowledged:
                    self._begin_file()
                self._sync()
            except OSError as error:
                self._failed(error)
            for descriptor in [*self._unsynced, self._out]:
                os.close(descriptor)
            self._unsynced, self._out = [], -1
            self._lock_file.close()

    def _begin_file(self) -> None:
        number = 1 + max((int(file.path.stem) for file in self._files), default=0)
        path = self.folder / f"{number:08d}{SUFFIX}"
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        head = self._table.rows()
        try:
            _write_whole(descriptor, head)
        except OSError:
            os.close(descriptor)
            path.unlink()  # a file without its table cannot be read alone
            raise
        if self._out >= 0:
            self._unsynced.append(self._out)
        self._out = descriptor
        self._files.append(SpoolFile(path, size=len(head)))
        self._bytes += len(head)

    def _write(self, frame: bytes) -> None:
        """Write a frame whole, or leave the file as it was."""
        if self.failure is not None:
            self._begin_file()
        file = self._files[-1]
        try:
            _write_whole(self._out, frame)
        except OSError:
            # a partial frame would be reported as damage
            os.ftruncate(self._out, file.size)
            raise
        file.size += len(frame)
        self._bytes += len(frame)

    def _failed(self, error: OSError) -> SpoolError:
        self._failed_at = time.monotonic()
        self.failure = (
            f"the spool {self.folder} cannot be written: {error}; until it can, messages are kept in memory only: "
            f"free space or repair the disk"
        )
        return SpoolError(self.failure)

    def _make_room(self, needed: int, *, is_document: bool) -> None:
        if not self.unacknowledged:
            self._begin_file()
        self._drop_acknowledged()
        if not self.room.fits(self._bytes + needed, is_document=is_document):
            raise SpoolFull(
                f"the spool {self.folder} is full: {self._bytes / 1e6:.0f} MB wait for a recorder; start "
                f"`gyrofleet record` again, or let the spool be larger"
            )

    def _sync_loop(self) -> None:
        while not self._stopped.wait(self._sync_interval_s):
            try:
                self._sync()
            except OSError as error:
                with self._lock:
                    self._failed(error)

    def _sync(self) -> None:
        with self._lock:
            if self._moved:
                self._write(self._table.acknowledged(self._moved))
                self._moved.clear()
            older, self._unsynced = self._unsynced, []
            current = os.dup(self._out)
        try:
            for descriptor in (*older, current):  # in order: a later file is not durable before an earlier one
                os.fdatasync(descriptor)
            sync_folder(self.folder)
        finally:
            for descriptor in (*older, current):
                os.close(descriptor)
        with self._lock:
            self._drop_acknowledged()

    def _drop_acknowledged(self) -> None:
        """Remove the oldest files while all their messages are acknowledged."""
        known = self._table.by_number
        while len(self._files) > 1:
            file = self._files[0]
            if any(n not in known or known[n].acknowledged < last for n, last in file.last.items()):
                return
            file.path.unlink(missing_ok=True)
            self.waiting -= file.unread
            self._bytes -= file.size
            self._files.popleft()


def _write_whole(descriptor: int, data: bytes) -> None:
    written = os.write(descriptor, data)
    while written < len(data):
        written += os.write(descriptor, data[written:])
