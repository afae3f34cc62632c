"""Users' statements, run in a separate process that can only read the store."""

import importlib
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, NamedTuple

import msgspec

import stream.errors
from storage.object_lake.range_service import RangeService
from storage.sql.lake_source import source_of
from storage.sql.sandbox.child import Closed, FrameKind, read_frame, write_frame
from storage.store import Store
from stream.closing import Closing
from stream.errors import GyrofleetError, QueryError, StoreError

if TYPE_CHECKING:
    import pyarrow as pa

_GIB = 1 << 30
_STDERR_BYTES = 2000
_ATTEMPTS = 3
_REFUSED = "_Refused"  # the class of the guard's errors, which is of the process
_ENDING = ("INTERNAL Error", "FATAL Error")  # after which DuckDB answers no statement any more


class QueryLimits(NamedTuple):
    """Limits of one statement; `time_s` is elapsed computing time, without the time its result waits to be read."""

    time_s: float = 60.0
    memory_bytes: int = min(4 * _GIB, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2)
    rows: int = 100_000_000


class Result:
    """Rows of a statement's result as they come; iterating may raise a `QueryError`.

    `notes` say what of the log the result lacks, and why; mostly there are none.
    """

    def __init__(
        self, schema: "pa.Schema", batches: "Generator[pa.RecordBatch, None, None]", notes: tuple[str, ...] = ()
    ) -> None:
        self.schema, self.batches, self.notes = schema, batches, notes

    def read_all(self) -> "pa.Table":
        """All rows."""
        import pyarrow as pa

        return pa.Table.from_batches(self.batches, self.schema)


class Advice(NamedTuple):
    """What who asks can do: to keep a result, and of a statement with too many rows, too much time or memory."""

    kept: str
    rows: str
    time: str
    memory: str


COMMAND_LINE = Advice(
    kept="to keep a result use --csv or --parquet FILE",
    rows="ask for less, or for more rows (--max-rows, QueryLimits.rows)",
    time="ask for less, or give it more time (--max-time, QueryLimits.time_s)",
    memory="ask for less, or give it more (--max-memory, QueryLimits.memory_bytes)",
)


class SqlDoor(Closing):
    """Runs users' statements on a store as it was when the door was opened; StoreError if its lake is damaged.

    Rows that only the log has are seen as well, as they were when a statement first needed them. With `landlock` the
    kernel enforces that nothing is written, else only the other guards do; `is_enforced` says whether it does, and is
    None until the first statement. `advice` ends the messages of statements that are refused or exceed the limits.

    >>> with SqlDoor(Store.open(Path("night"))) as door:  # doctest: +SKIP
    ...     table = door.ask("select unit, signal, samples from signals").read_all()
    """

    _ranges: RangeService | None = None  # serves a published lake to the process

    _advice = COMMAND_LINE

    def __init__(
        self, store: Store, limits: QueryLimits | None = None, *, landlock: bool = True, advice: Advice = COMMAND_LINE
    ) -> None:
        self.store = store
        self.limits = limits or QueryLimits()
        self.is_enforced: bool | None = None
        self._landlock, self._advice = landlock, advice
        self._source = source_of(store)
        self._kept = store.folder
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        self._process: _Process | None = None

    def start(self) -> None:
        """Start the process, so that the first statement does not wait for it; StoreError if it cannot start."""
        if self._process is None:
            self._started()

    def ask(self, statement: str, parameters: object = None) -> Result:
        """Run one statement with its parameters; QueryError if it would not only read, fails, or exceeds limits."""
        try:
            request = pickle.dumps({"statement": statement, "parameters": parameters})
        except Exception as error:
            raise QueryError(f"a parameter is of a kind that SQL has not: {error}") from error
        for attempt in range(_ATTEMPTS):
            process = self._process or self._started()
            process.send(FrameKind.REQUEST, request)
            import pyarrow as pa

            kind, content = self._received(process)
            if kind is FrameKind.NOTES:
                notes = tuple(json.loads(content))
                with pa.ipc.open_stream(self._received(process)[1]) as reader:
                    return Result(reader.schema, self._batches(process), notes)
            self._compute(statement, scratch=attempt > 0)
        raise StoreError(f"{self.store.folder} changes while it is read; run the statement again")

    def _batches(self, process: "_Process") -> "Generator[pa.RecordBatch, None, None]":
        import pyarrow as pa

        rows, is_complete = 0, False
        try:
            while True:
                kind, content = self._received(process)
                if kind is FrameKind.DONE:
                    is_complete = True
                    return
                with pa.ipc.open_stream(content) as reader:
                    for batch in reader:
                        rows += batch.num_rows
                        if rows > self.limits.rows:
                            raise QueryError(f"the result has more than {self.limits.rows:,} rows; {self._advice.rows}")
                        yield batch
        finally:
            if not is_complete:  # the rest must not be taken for the next answer
                self._end()

    def _received(self, process: "_Process") -> tuple[FrameKind, bytes]:
        """The next frame; an error is raised with its own class."""
        try:
            kind, content = read_frame(process.answers)
        except Closed:
            self._process = None
            raise process.why_it_ended(self.limits, self._advice) from None
        if kind is FrameKind.FAILED:
            failure = json.loads(content)
            if "MemoryError" in failure["kinds"] or failure["message"].startswith("Out of Memory Error"):
                if "MemoryError" in failure["kinds"]:
                    self._end()
                raise _too_much_memory(self.limits, self._advice)
            if failure["message"].startswith(_ENDING):
                self._end()
            known = [getattr(stream.errors, name, None) for name in failure["kinds"]]
            kinds = [each for each in known if isinstance(each, type) and issubclass(each, GyrofleetError)]
            advice = f"; {self._advice.kept}" if _REFUSED in failure["kinds"] else ""
            raise kinds[0](f"{failure['message']}{advice}")
        return kind, content

    def _setup(self) -> dict[str, object]:
        """What the process opens, and what it may read."""
        return {
            "folder": str(self.store.folder.resolve()), "identity": self.store.identity,
            "parts": msgspec.json.encode(self._source.parts).decode(), "kept": str(self._kept.resolve()),
            "readable": [str(self.store.folder.resolve()), str(self._kept.resolve())],
        }  # fmt: skip

    def _started(self) -> "_Process":
        ranges = self._serving()
        self._process = process = _Process([] if ranges is None else [each.fileno() for each in ranges.far_ends])
        if ranges is not None:
            ranges.handed_over()
        setup = {
            **self._setup(), "time_s": self.limits.time_s, "memory_bytes": self.limits.memory_bytes,
            "landlock": self._landlock, "ranges": process.inherited,
        }  # fmt: skip
        process.send(FrameKind.REQUEST, json.dumps(setup).encode())
        importlib.import_module("pyarrow")  # for the answers, while the process starts
        try:
            _, content = self._received(process)
        except GyrofleetError:
            self._end()
            raise
        process.has_begun = True
        self.is_enforced = bool(json.loads(content)["landlock"])
        return process

    def _compute(self, statement: str, *, scratch: bool) -> None:
        """Compute the layers a statement needs, in a scratch folder if the store cannot keep them or has others."""
        from storage.sql.catalog import Catalog, layers

        if scratch and self._scratch is None:
            self._end()  # that process reads the store's
            self._scratch = tempfile.TemporaryDirectory(prefix="gyrofleet-sql-")
            for folder in {layer.folder for layer in layers()}:
                if (self.store.folder / folder).is_dir():
                    shutil.copytree(self.store.folder / folder, Path(self._scratch.name) / folder)
            self._kept = Path(self._scratch.name)
        with Catalog(self.store, source=self._source, kept=self._kept) as catalog:
            catalog.prepare(statement)

    def _serving(self) -> RangeService | None:
        """What serves the lake to the process, if that is not in files that it can read."""
        if not hasattr(self.store, "parts"):  # one in files needs none of the libraries
            return None
        from storage.object_lake.published_store import PublishedStore

        if isinstance(self.store, PublishedStore):
            self._ranges = RangeService(self.store.read)
        return self._ranges

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process = None
        if self._ranges is not None:
            self._ranges.close()
            self._ranges = None

    def close(self) -> None:
        """End the process."""
        self._end()
        if self._scratch is not None:
            self._scratch.cleanup()


class _Process:
    """The process, and the end of its standard error."""

    def __init__(self, inherited: list[int]) -> None:
        self.inherited = inherited
        folders = os.pathsep.join(each for each in sys.path if each)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "storage.sql.sandbox.child"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, pass_fds=inherited,
            # memory that arenas reserve would count; nothing is compiled there, and numba's cache is not writable
            env={**_environment(), "PYTHONPATH": folders, "MALLOC_ARENA_MAX": "2", "NUMBA_DISABLE_JIT": "1"},
        )  # fmt: skip
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests: IO[bytes] = self._process.stdin
        self.answers: IO[bytes] = self._process.stdout
        self._stderr = b""
        self.has_begun = False
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as file:
            for line in file:
                self._stderr = (self._stderr + line)[-_STDERR_BYTES:]

    def send(self, kind: FrameKind, content: bytes) -> None:
        with suppress(OSError):  # it has ended; reading its answer tells why
            write_frame(self._requests, kind, content)

    def why_it_ended(self, limits: QueryLimits, advice: Advice) -> GyrofleetError:
        """The error of a process that ended without an answer."""
        code = self._process.wait()
        self.kill()
        lines = self._stderr.decode(errors="replace").strip().splitlines() or ["no message"]
        if not self.has_begun:
            return StoreError(f"the process that answers statements cannot start (code {code}): {lines[-1]}")
        if code == -signal.SIGALRM:
            return QueryError(f"the statement was ended after {limits.time_s:g} s; {advice.time}")
        if code < 0:
            return _too_much_memory(limits, advice, f" (its process ended with {signal.Signals(-code).name})")
        return QueryError(f"the process of the statement ended with code {code}: {lines[-1]}")

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._listener.join()
        self.answers.close()
        with suppress(OSError):  # unsent data are discarded
            self._requests.close()


def _environment() -> dict[str, str]:
    """The environment without credentials: the process has no use for them."""
    return {name: value for name, value in os.environ.items() if not name.startswith("AWS_")}


def _too_much_memory(limits: QueryLimits, advice: Advice, how: str = "") -> QueryError:
    gib = limits.memory_bytes / _GIB
    return QueryError(f"the statement takes more memory than the {gib:.3g} GiB that it may{how}; {advice.memory}")
