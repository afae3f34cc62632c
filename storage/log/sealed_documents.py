"""Messages with documents of sealed segments, which never change: kept by the process that has read them once.

Beside a recorder a server asks for the documents that are not in the lake again and again, and nearly all that it would
read each time are samples: of a segment, only the chunks are read that hold documents.
"""

import threading
from collections import OrderedDict
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from storage.segments.reader import read_chunks_of, spans_in
from storage.segments.records import LogRecord
from stream.errors import BadInput
from stream.identity import EventKey, parse_key

_MOST_SEGMENTS = 64
_MOST_BYTES = 1 << 20  # of documents in a segment; more are read each time

_File = tuple[str, int, int, int]
_kept: OrderedDict[_File, tuple[LogRecord, ...]] = OrderedDict()
_lock = threading.Lock()


def documents_of_sealed(path: Path) -> tuple[LogRecord, ...]:
    """Messages with documents of a sealed segment, in their order; StoreError if it is damaged."""
    try:
        status = path.stat()
    except OSError:
        return tuple(_read(path))  # which says why
    file = (str(path), status.st_ino, status.st_size, status.st_mtime_ns)
    with _lock:
        if (known := _kept.get(file)) is not None:
            _kept.move_to_end(file)
            return known
    found = tuple(_read(path))
    if sum(len(record.data) for record in found) <= _MOST_BYTES:
        with _lock:
            _kept[file] = found
            while len(_kept) > _MOST_SEGMENTS:
                _kept.popitem(last=False)
    return found


@lru_cache(maxsize=100_000)
def is_of_documents(topic: str) -> bool:
    """Whether messages of a topic are documents."""
    try:
        return isinstance(parse_key(topic), EventKey)
    except BadInput:
        return False  # a rejected message


def _read(path: Path) -> Iterator[LogRecord]:
    channels: dict[int, tuple[str, str]] = {}
    for content in read_chunks_of(path, is_of_documents):
        for topic, schema, arrival_ns, publish_ns, begin, end, _ in spans_in(path, content, channels):
            if is_of_documents(topic):
                yield LogRecord(topic, schema, arrival_ns, publish_ns, content[begin:end])
