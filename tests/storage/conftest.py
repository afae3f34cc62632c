"""A store that is filled segment by segment, without a recorder, so that arrival times can be chosen."""

from collections.abc import Iterator
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from storage.lake.builder import build_missing, builder_lock
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.segments.records import EVENTS, SAMPLES, LogRecord
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.events import AnyDocument, encode_event
from stream.identity import Place, event_key, sample_key
from stream.wire.batches import encode_batch

PLACE = Place("plant", "chamber-1")
DAY_NS = 86_400 * 10**9
START_NS = 1_763_683_200 * 10**9


class Filler:
    """Writes messages into a store's log; `seal` ends a segment, `build` brings what is sealed to the lake."""

    def __init__(self, folder: Path) -> None:
        self.store = Store.create(folder)
        self.rng = np.random.default_rng(1)
        self._lock: WriterLock | None = WriterLock(self.store, "test")
        self._log = EventLog(self.store)
        self._next: dict[str, int] = {}
        self._documents = 0

    def counts(self, signal: str, t0_ns: int, n: int, *, dt_ns: int = 10**7, arrival_ns: int | None = None) -> None:
        """Noise in counts of unit U1, numbered on from what was there of the signal."""
        counts = np.round(self.rng.normal(1234, 50, n)).astype(np.int32)
        seq = self._next.get(signal, 0)
        self._next[signal] = seq + n
        self.batch(
            SampleBatch(
                "U1", signal, "r1", UUID(int=1), seq, t0_ns, dt_ns, "deg/s", counts=counts, scale=-0.5, offset=3.0
            ),
            arrival_ns,
        )

    def batch(self, batch: SampleBatch, arrival_ns: int | None = None) -> None:
        key = sample_key(PLACE, batch.unit, batch.signal)
        arrival = batch.last_ns + 10**6 if arrival_ns is None else arrival_ns
        self._append(LogRecord(key, SAMPLES, arrival, batch.t0_ns, encode_batch(batch)))

    def document(self, document: AnyDocument) -> None:
        payload = encode_event(document, "e", self._documents)
        self._documents += 1
        self._append(LogRecord(event_key(PLACE), EVENTS, document.t_ns, document.t_ns, payload))

    def raw(self, payload: bytes, key: str) -> None:
        """A message that is no sample batch, as an older version may have logged it."""
        self._log.append_aside(LogRecord(key, SAMPLES, START_NS, START_NS, payload))

    def sync(self) -> None:
        self._log.sync()

    def seal(self) -> None:
        self._log.seal()

    def build(self) -> None:
        with builder_lock(self.store):
            list(build_missing(self.store, compacts=False))

    def release(self) -> None:
        """Let other writers at the store."""
        if self._lock is not None:
            self._log.abandon()
            self._lock.close()
            self._lock = None

    def _append(self, record: LogRecord) -> None:
        place = place_of(record)
        assert place is not None
        self._log.append(place, record)


@pytest.fixture
def filler(tmp_path: Path) -> Iterator[Filler]:
    made = Filler(tmp_path / "store")
    yield made
    made.release()


def fill_days(filler: Filler, segments_a_day: int) -> Filler:
    """Two signals over three days, with a segment in which a bucket of a second is cut in two."""
    for day in range(3):
        for part in range(segments_a_day):
            t0_ns = START_NS + day * DAY_NS + part * 25 * 10**9 + 5 * 10**8
            filler.counts("rate", t0_ns, 2500)
            filler.counts("temperature", t0_ns, 25, dt_ns=10**9)
            filler.seal()
    return filler


@pytest.fixture
def days(filler: Filler) -> Filler:
    """Three days of four segments."""
    return fill_days(filler, 4)
