"""The process in which a user's statements run: it can read the store and nothing else, and is killed at its limits.

``python -m storage.sql.child``, started by `storage.sql.door`. What DuckDB's own settings refuse, the kernel refuses
once more: Landlock is set before DuckDB is imported, since its threads would not have it otherwise.
"""

import json
import os
import pickle
import resource
import signal
import sys
import threading
from pathlib import Path
from queue import SimpleQueue
from typing import IO, TYPE_CHECKING, Any

from storage.sql.frames import Closed, Kind, read_frame, write_frame
from storage.sql.landlock import allow_reading_only

if TYPE_CHECKING:
    import pyarrow as pa

    from storage.sql.catalog import Catalog

# besides what DuckDB may take of itself: results on their way, stacks of threads
_SLACK_BYTES = 512 << 20
# what Python and its libraries read when they are imported or ask what machine this is
_SYSTEM = (
    "/usr", "/lib", "/lib64", "/bin", "/opt", "/nix", "/proc", "/sys", "/dev/null", "/dev/urandom", "/etc/ld.so.cache",
    "/etc/localtime", "/etc/timezone", "/etc/ssl/openssl.cnf",
)  # fmt: skip


class _Timer:
    """Ends this process when statements have computed for so long; waiting for the reader does not count.

    The kernel's own signal does it: DuckDB answers to no interrupt inside of a function.
    """

    def __init__(self, time_s: float) -> None:
        self._time_s = time_s
        signal.signal(signal.SIGALRM, signal.SIG_DFL)

    def begin(self) -> None:
        signal.setitimer(signal.ITIMER_REAL, self._time_s)

    def pause(self) -> float:
        return signal.setitimer(signal.ITIMER_REAL, 0.0)[0]

    def resume(self, left_s: float) -> None:
        signal.setitimer(signal.ITIMER_REAL, max(left_s, 1e-3))


def main() -> None:
    """Answer requests until the one that asks has gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one that asks
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what a library prints is no answer
    setup: dict[str, Any] = json.loads(read_frame(requests)[1])
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    is_enforced = setup["landlock"] and allow_reading_only(Path(each) for each in (*setup["readable"], *system_paths()))
    waiting: SimpleQueue[dict[str, Any]] = SimpleQueue()
    threading.Thread(target=_listen, args=(requests, waiting), daemon=True).start()
    _serve(setup, waiting, answers, is_enforced=bool(is_enforced))


def system_paths() -> set[str]:
    """Folders and files that Python and its libraries need for themselves."""
    folders = {sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix, *sys.path, *_SYSTEM}
    folders.update(os.environ.get("LD_LIBRARY_PATH", "").split(":"))
    return {each for each in folders if each}


def _listen(requests: IO[bytes], waiting: "SimpleQueue[dict[str, Any]]") -> None:
    """Take requests; when the one that asks has gone, end whatever is at work."""
    try:
        while True:
            # pickle: parameters are any values; they come from the process that started this one
            waiting.put(pickle.loads(read_frame(requests)[1]))  # noqa: S301
    except Closed:
        os._exit(0)


def _serve(
    setup: dict[str, Any], waiting: "SimpleQueue[dict[str, Any]]", answers: IO[bytes], *, is_enforced: bool
) -> None:
    from stream.errors import GyrofleetError

    try:
        catalog = _catalog(setup)
    except GyrofleetError as error:
        write_frame(answers, Kind.FAILED, _told(error))
        return
    write_frame(answers, Kind.READY, json.dumps({"landlock": is_enforced}).encode())
    timer = _Timer(setup["time_s"])
    while True:
        request = waiting.get()
        try:
            _answer(catalog, request, answers, timer, setup["memory_bytes"])
        except GyrofleetError as error:
            timer.pause()
            write_frame(answers, Kind.FAILED, _told(error))
        except MemoryError:
            timer.pause()
            write_frame(answers, Kind.FAILED, json.dumps({"kinds": ["MemoryError"], "message": ""}).encode())


def _catalog(setup: dict[str, Any]) -> "Catalog":
    import msgspec

    from storage.manifests.lake import Part
    from storage.sql.catalog import Catalog
    from storage.store import Store

    return Catalog(
        Store(Path(setup["folder"]), setup["identity"]),
        parts=msgspec.json.decode(setup["parts"], type=tuple[Part, ...]),
        kept=Path(setup["kept"]),
        frozen=True,
        memory_bytes=setup["memory_bytes"],
    )


def _answer(catalog: "Catalog", request: dict[str, Any], answers: IO[bytes], timer: _Timer, memory_bytes: int) -> None:
    from storage.sql.catalog import NotKept

    _limit_memory(None)
    timer.begin()
    try:
        catalog.prepare(request["statement"])
    except NotKept:
        timer.pause()
        write_frame(answers, Kind.NOT_KEPT)
        return
    timer.begin()  # tables that are made for the first time are not this statement's
    _limit_memory(memory_bytes)
    reader = catalog.user_reader(request["statement"], request["parameters"])
    left_s = timer.pause()
    write_frame(answers, Kind.ROWS, _stream(reader.schema, None))
    timer.resume(left_s)
    for batch in catalog.guarded(reader):
        content = _stream(reader.schema, batch)
        left_s = timer.pause()
        write_frame(answers, Kind.ROWS, content)
        timer.resume(left_s)
    timer.pause()
    _limit_memory(None)
    write_frame(answers, Kind.DONE)


def _stream(schema: "pa.Schema", batch: "pa.RecordBatch | None") -> memoryview:
    import pyarrow as pa

    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, schema) as writer:
        if batch is not None:
            writer.write_batch(batch)
    return memoryview(sink.getvalue())


def _limit_memory(memory_bytes: int | None) -> None:
    """Let this process take so much more than it has now; None: as much as there is."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    soft = hard
    if memory_bytes is not None:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        soft = pages * resource.getpagesize() + memory_bytes + _SLACK_BYTES
        soft = soft if hard == resource.RLIM_INFINITY else min(soft, hard)
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _told(error: Exception) -> bytes:
    return json.dumps({"kinds": [each.__name__ for each in type(error).__mro__], "message": str(error)}).encode()


if __name__ == "__main__":
    main()
