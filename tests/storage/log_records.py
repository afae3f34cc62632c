"""Records for the tests of the event log, and a log of them."""

from pathlib import Path
from uuid import UUID

import numpy as np

from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.segments.records import EVENTS, SAMPLES, LogRecord
from storage.store import Store
from stream.batch import SampleBatch
from stream.events import NoteAdded, encode_event
from stream.identity import Place, event_key, sample_key
from stream.wire.batches import encode_batch

PLACE = Place("plant", "bench")


def samples(unit: str, first: int, n: int = 100) -> LogRecord:
    counts = np.random.default_rng(first).normal(0, 50, n).astype(np.int32)
    batch = SampleBatch(unit, "rate", "r1", UUID(int=1), first, first * 10**6, 10**6, "deg/s", counts=counts)
    return LogRecord(sample_key(PLACE, unit, "rate"), SAMPLES, 10**18 + first, batch.t0_ns, encode_batch(batch))


def document(text: str, seq: int) -> LogRecord:
    note = NoteAdded(run="r1", t_ns=5, text=text)
    return LogRecord(event_key(PLACE), EVENTS, 10**18, 5, encode_event(note, "e", seq))


def append(log: EventLog, record: LogRecord) -> None:
    place = place_of(record)
    assert place is not None
    log.append(place, record)


def written(tmp_path: Path, *, syncs: int = 20, seal: bool = True) -> tuple[Store, list[LogRecord]]:
    """A store with one segment of so many chunks, and what was put into it."""
    store = Store.create(tmp_path / "store")
    log = EventLog(store)
    records = []
    for i in range(syncs):
        for record in [samples(f"U{unit}", 100 * i) for unit in range(5)] + [document(f"note {i}", i)]:
            append(log, record)
            records.append(record)
        log.sync()
    if seal:
        log.seal()
    return store, records
