"""The process that runs users' statements: it can only read the store, and is killed at its limits.

``python -m storage.sql.sandbox.child``, started by `storage.sql.door`. Frames are kind, length, content.
Landlock enforces what DuckDB's settings refuse; it is set before DuckDB is imported, so that its threads have it.
"""

import json
import os
import pickle
import resource
import signal
import struct
import sys
import threading
from enum import Enum
from pathlib import Path
from queue import SimpleQueue
from typing import IO, TYPE_CHECKING, Any

from storage.sql.sandbox.landlock import allow_reading_only
from stream.decoding import converted, decode_json
from stream.files.own_files import own_folders
from stream.no_pandas import hide_pandas

if TYPE_CHECKING:
    import pyarrow as pa

    from storage.sql.catalog import Catalog

# beyond DuckDB's own limit, for results in transit and thread stacks
_SLACK_BYTES = 512 << 20
# read by Python and its libraries on import
_SYSTEM = (
    "/usr", "/lib", "/lib64", "/bin", "/opt", "/nix", "/proc", "/sys", "/dev/null", "/dev/urandom", "/etc/ld.so.cache",
    "/etc/localtime", "/etc/timezone", "/etc/ssl/openssl.cnf",
)  # fmt: skip
_HEAD = struct.Struct("<cQ")


class FrameKind(Enum):
    """Kind of a frame."""

    REQUEST = b"?"  # pickle; from the parent
    READY = b"R"  # JSON with `landlock`: whether the kernel enforces that nothing is written
    NOTES = b"M"  # JSON: texts on what the result lacks; before its first rows
    ROWS = b"B"  # an Arrow stream: the schema and some rows of the result
    DONE = b"O"  # the result is complete
    FAILED = b"E"  # JSON with `kinds`, the names of the error's classes, and `message`
    NOT_KEPT = b"N"  # a table that the statement names must be computed first


class Closed(Exception):
    """The other process has ended."""


def write_frame(file: IO[bytes], kind: FrameKind, content: bytes | memoryview = b"") -> None:
    """Send a frame."""
    file.write(_HEAD.pack(kind.value, len(content)))
    file.write(content)
    file.flush()


def read_frame(file: IO[bytes]) -> tuple[FrameKind, bytes]:
    """Receive a frame; raises Closed if the other process has ended."""
    kind, length = _HEAD.unpack(_exactly(file, _HEAD.size))
    return FrameKind(kind), _exactly(file, length)


def _exactly(file: IO[bytes], length: int) -> bytes:
    content = file.read(length)
    if len(content) < length:
        raise Closed
    return content


def _run_for(left_s: float) -> None:
    """Let a signal kill this process after some computing time: DuckDB ignores interrupts within functions."""
    signal.setitimer(signal.ITIMER_REAL, max(left_s, 1e-3))


def _pause() -> float:
    """Stop the time; returns how much is left."""
    return signal.setitimer(signal.ITIMER_REAL, 0.0)[0]


def main() -> None:
    """Answer requests until the parent has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what libraries print is not an answer
    hide_pandas()
    setup: dict[str, Any] = json.loads(read_frame(requests)[1])
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    is_enforced = setup["landlock"] and allow_reading_only(Path(each) for each in (*setup["readable"], *system_paths()))
    waiting: SimpleQueue[dict[str, Any]] = SimpleQueue()
    threading.Thread(target=_listen, args=(requests, waiting), daemon=True).start()
    _serve(setup, waiting, answers, is_enforced=bool(is_enforced))


def system_paths() -> set[str]:
    """Folders and files that Python and its libraries read."""
    folders = {sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix, *sys.path, *_SYSTEM}
    folders.update(os.environ.get("LD_LIBRARY_PATH", "").split(":"))
    folders.update(str(each.resolve()) for each in own_folders())  # of metrics, which are packages as well
    return {each for each in folders if each}


def _listen(requests: IO[bytes], waiting: "SimpleQueue[dict[str, Any]]") -> None:
    """Queue requests; end this process when the parent has ended."""
    try:
        while True:
            content = read_frame(requests)[1]
            try:
                # pickle, since parameters may be any values; from the parent only
                waiting.put(pickle.loads(content))  # noqa: S301
            except Exception as error:  # noqa: BLE001  of a class that this process lacks: whatever it raises
                waiting.put({"unreadable": str(error)})
    except Closed:
        os._exit(0)


def _serve(
    setup: dict[str, Any], waiting: "SimpleQueue[dict[str, Any]]", answers: IO[bytes], *, is_enforced: bool
) -> None:
    from stream.errors import GyrofleetError, QueryError

    try:
        catalog = _catalog(setup)
    except GyrofleetError as error:
        write_frame(answers, FrameKind.FAILED, _encode(error))
        return
    write_frame(answers, FrameKind.READY, json.dumps({"landlock": is_enforced}).encode())
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    while True:
        request = waiting.get()
        try:
            if "unreadable" in request:
                raise QueryError(f"a parameter is of a kind that SQL has not: {request['unreadable']}")
            _answer(catalog, request, answers, setup)
        except (GyrofleetError, MemoryError) as error:
            _pause()
            write_frame(answers, FrameKind.FAILED, _encode(error))


def _catalog(setup: dict[str, Any]) -> "Catalog":

    from storage.manifests.part import Part
    from storage.object_lake.range_service import RangeClient
    from storage.sql.catalog import Catalog
    from storage.sql.lake_source import RangeLake
    from storage.store import Store

    if "plants" in setup:
        from storage.sql.fleet.fleet_catalog import FleetCatalog, PlantFile

        return FleetCatalog(
            Path(setup["folder"]), converted(setup["plants"], list[PlantFile]), setup["tables"],
            memory_bytes=setup["memory_bytes"],
        )  # fmt: skip
    parts = decode_json(setup["parts"], tuple[Part, ...])
    source = RangeLake(parts, RangeClient(setup["ranges"]).read) if setup["ranges"] else None
    return Catalog(
        Store(Path(setup["folder"]), setup["identity"]), parts=parts, source=source, kept=Path(setup["kept"]),
        frozen=True, memory_bytes=setup["memory_bytes"], live=True,
    )  # fmt: skip


def _answer(catalog: "Catalog", request: dict[str, Any], answers: IO[bytes], setup: dict[str, Any]) -> None:
    from storage.sql.catalog import NotKept

    _limit_memory(None)
    _run_for(setup["time_s"])
    try:
        notes = catalog.prepare(request["statement"])
    except NotKept:
        _pause()
        write_frame(answers, FrameKind.NOT_KEPT)
        return
    _run_for(setup["time_s"])  # opening tables for the first time does not count
    _limit_memory(setup["memory_bytes"])
    reader = catalog.user_reader(request["statement"], request["parameters"])
    left_s = _pause()
    write_frame(answers, FrameKind.NOTES, json.dumps(notes).encode())
    write_frame(answers, FrameKind.ROWS, _stream(reader.schema))
    _run_for(left_s)
    for batch in catalog.guarded(reader):
        content = _stream(reader.schema, batch)
        left_s = _pause()
        write_frame(answers, FrameKind.ROWS, content)
        _run_for(left_s)
    _pause()
    _limit_memory(None)
    write_frame(answers, FrameKind.DONE)


def _stream(schema: "pa.Schema", *batches: "pa.RecordBatch") -> memoryview:
    import pyarrow as pa

    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, schema) as writer:
        for batch in batches:
            writer.write_batch(batch)
    return memoryview(sink.getvalue())


def _limit_memory(memory_bytes: int | None) -> None:
    """Limit the memory that this process may take in addition; None for no limit."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    soft = hard
    if memory_bytes is not None:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        soft = pages * resource.getpagesize() + memory_bytes + _SLACK_BYTES
        soft = soft if hard == resource.RLIM_INFINITY else min(soft, hard)
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _encode(error: Exception) -> bytes:
    return json.dumps({"kinds": [each.__name__ for each in type(error).__mro__], "message": str(error)}).encode()


if __name__ == "__main__":
    main()
