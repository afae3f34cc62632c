"""A store of recorded batches for the tests of verification and recovery."""

from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import numpy as np

from storage.check.verify import verify
from storage.log.event_log import EventLog
from storage.recording.recorder import Recorder
from storage.segments.reader import SegmentScan
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.identity import Place, sample_key
from stream.transport.bus import LocalBus

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")


def batch(i: int, n: int = 100) -> SampleBatch:
    counts = np.random.default_rng(i).normal(0, 50, n).astype(np.int32)
    return SampleBatch("U1", "rate", "r1", UUID(int=1), i * n, i * n * 10**6, 10**6, "deg/s", counts=counts)


def fill(store: Store, batches: range) -> None:
    """A segment with a chunk for each batch."""
    bus = LocalBus()
    with Recorder(store, bus, EventLog(store), sync_interval_s=0.001), DurablePublisher(bus) as publisher:
        for i in batches:
            publisher.send_batch(KEY, batch(i))
            publisher.drain()


_KEPT: dict[tuple[object, ...], dict[str, tuple[int, bytes | None]]] = {}


def filled(folder: Path, *segments: range, then: Callable[[Store], None] = lambda _: None) -> Store:
    """A store with a segment for each range of batches, after `then`.

    It is recorded once for each name of the folder, and written again from what is kept of that: its copies have one
    identity.
    """
    key = (folder.name, segments, then)
    if key not in _KEPT:
        store = Store.create(folder)
        for batches in segments:
            fill(store, batches)
        then(store)
        _KEPT[key] = {
            str(path.relative_to(folder)): (path.stat().st_mode & 0o777, path.read_bytes() if path.is_file() else None)
            for path in sorted(folder.rglob("*"))
        }
        return store
    folder.mkdir(parents=True)
    for name, (mode, content) in _KEPT[key].items():
        path = folder / name
        if content is None:
            path.mkdir()
        else:
            path.write_bytes(content)
        path.chmod(mode)
    return Store.open(folder)


def damage_last_chunk(segment: Path) -> None:
    scan = SegmentScan(segment, sealed=True)
    list(scan)
    content = bytearray(segment.read_bytes())
    content[scan.summary.chunks[-1].chunk_start_offset + 100] ^= 1
    segment.write_bytes(content)


def kinds(store: Store) -> list[str]:
    return sorted(finding.kind for finding in verify(store)[0].findings)
