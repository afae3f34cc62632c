"""Messages beyond their bounds in number, name or size: refused on arrival, quarantined where a log holds them."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pytest

from storage.check.recover import recover
from storage.check.verify import verify
from storage.lake.quarantine import QUARANTINED
from storage.lake.rollups import roll_up
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.recording.intake import MAX_REJECT_BYTES
from storage.recording.recorder import Recorder
from storage.segments.reader import read_segment
from storage.segments.records import EVENTS, REJECTED, SAMPLES, LogRecord
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import SampleBatch
from stream.bounds import MAX_KEY_CHARS, MAX_MESSAGE_BYTES
from stream.delivery.publisher import DurablePublisher
from stream.errors import BadInput, WireError
from stream.events import NoteAdded, RunResumed, StepStarted, StepWords
from stream.identity import Place, event_key, sample_key
from stream.transport.bus import LocalBus
from stream.wire import samples_pb2
from stream.wire.batches import encode_batch
from stream.worker.worker import EstimationWorker

PLACE = Place("plant", "chamber-1")
HOSTILE = sample_key(PLACE, "BAD", "rate")
EVENT = event_key(PLACE)


def batch(**changed: Any) -> bytes:
    """A batch of two samples on the wire, with some fields as no source of ours would send them."""
    fields = {
        "schema": 2, "unit": "BAD", "signal": "rate", "run": "r1", "epoch": UUID(int=9).bytes, "samples": 2,
        "t0_ns": 10**18, "dt_ns": 10**7, "unit_of_measure": "deg/s", "scale": 1.0, "values": bytes(16), **changed,
    }  # fmt: skip
    return bytes(samples_pb2.SampleBatch(**fields).SerializeToString())


def document(seq: int, **content: Any) -> bytes:
    message = {"schema": 1, "epoch": "e9", "seq": seq, "document": {"run": "r1", "t_ns": 10**18, **content}}
    return json.dumps(message).encode()


BATCHES: dict[str, bytes] = {
    "t0_ns": batch(t0_ns=2**63 - 20, dt_ns=1),
    "last_ns": batch(t0_ns=2**62 - 8, dt_ns=10),
    "dt_ns": batch(samples=1, values=bytes(8), dt_ns=2**63 - 1),
    "early": batch(t0_ns=-(2**61) - 1),
    "times_ns": batch(samples=3, values=bytes(24), times_ns=struct.pack("<3q", 0, 2**63 - 20, 10)),
    "seq": batch(seq=2**53),
    "run": batch(run="r" * 129),
    "unit_of_measure": batch(unit_of_measure="d" * 129),
}
ESTIMATE: dict[str, Any] = {
    "kind": "EstimatePublished", "unit": "BAD", "signal": "rate", "estimator": "x", "unit_of_measure": "deg/h",
    "confidence": 0.95, "missing": 0, "sample_interval_s": 0.01, "samples": 0, "reason": "none",
}  # fmt: skip
POINT = {"tau_s": 1.0, "value": 1.0, "lo": 1.0, "hi": 1.0, "edf": 1.0, "n": 2**70}
DOCUMENTS: dict[str, dict[str, Any]] = {
    "samples": ESTIMATE | {"samples": 2**63},
    "missing": ESTIMATE | {"missing": 2**200},
    "point": ESTIMATE | {"points": [POINT]},
    "gap_ns": {"kind": "RunResumed", "gap_ns": 2**80},
    "repeat": {"kind": "StepStarted", "unit": "BAD", "words": {"repeat": 2**80}},
    "settle_s": {"kind": "StepStarted", "unit": "BAD", "words": {"settle_s": 1e300}},
    "t_ns": {"kind": "NoteAdded", "text": "", "t_ns": 2**62 + 1},
    "run": {"kind": "NoteAdded", "text": "", "run": "r" * 1000},
    "details": {"kind": "StoreNoted", "what": "x", "text": "", "details": {"a": [{"b": 2**64}]}},
}


def good(publisher: DurablePublisher, seq: int, n: int = 100) -> None:
    values = np.arange(seq, seq + n, dtype=np.float64)
    times = 10**18 + 10**7 * seq
    batch = SampleBatch("GOOD", "rate", "r1", UUID(int=1), seq, times, 10**7, "deg/s", values=values)
    publisher.send_batch(sample_key(PLACE, "GOOD", "rate"), batch)


def rows(store: Store, sql: str) -> list[tuple[Any, ...]]:
    with Catalog(store) as catalog:
        return catalog.rows(sql)


def test_what_is_beyond_its_bounds_is_refused_on_arrival_and_the_rest_goes_on(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "store")
    bus = LocalBus()
    forged = [(HOSTILE, each) for each in BATCHES.values()]
    forged += [(EVENT, document(0, **each)) for each in DOCUMENTS.values()]
    forged += [(EVENT, json.dumps({"schema": 1, "epoch": "e9", "seq": 2**53 + 1, "document": {
        "kind": "NoteAdded", "run": "", "t_ns": 0, "text": ""}}).encode())]  # fmt: skip
    long_key = sample_key(PLACE, "U" * MAX_KEY_CHARS, "rate")
    forged += [(long_key, batch(unit="U" * MAX_KEY_CHARS)), (HOSTILE, bytes(MAX_MESSAGE_BYTES + 1))]
    with (
        Recorder(store, bus, EventLog(store), sync_interval_s=0.01) as recorder,
        DurablePublisher(bus, timeout_s=10.0) as publisher,
        EstimationWorker(bus, publisher, every_s=1.0),
    ):
        good(publisher, 0)
        for key, payload in forged:
            bus.publish(key, payload)
        good(publisher, 100)
        publisher.drain()
    assert recorder.counts.rejected == len(forged)
    assert max(len(text) for text in recorder.counts.rejections) < 1000
    kept = [record.data for segment in store.log.glob("*.mcap") for record in read_segment(segment)
            if record.schema == REJECTED]  # fmt: skip
    assert kept == [payload[:MAX_REJECT_BYTES] for _, payload in forged]
    assert rows(store, "select unit, count(*), max(value) from samples group by unit") == [("GOOD", 200, 199.0)]
    assert rows(store, "select count(*) from runs") == [(1,)]
    assert rows(store, "select count(*) from steps") == [(0,)]


def test_a_source_of_ours_refuses_to_send_what_no_recorder_takes() -> None:
    with pytest.raises(BadInput, match="between 1897 and 2116"):
        SampleBatch("U1", "rate", "r1", UUID(int=1), 0, 2**62 + 1, 1, "deg/s", values=np.zeros(1))
    with pytest.raises(BadInput, match="between 1897 and 2116"):
        times = np.array([0, 2**63 - 20, 5])
        SampleBatch("U1", "rate", "r1", UUID(int=1), 0, 0, 1, "deg/s", values=np.zeros(3), times_ns=times)
    with pytest.raises(BadInput, match="outside its range"):
        SampleBatch("U1", "rate", "r1", UUID(int=1), 0, 0, 2**62, "deg/s", values=np.zeros(1))
    publisher = DurablePublisher(LocalBus())
    for wrong in (
        RunResumed(run="r1", t_ns=0, gap_ns=2**80),
        StepStarted(run="r1", t_ns=0, unit="U1", words=StepWords(settle_s=1e300)),
        NoteAdded(run="r1", t_ns=0, text="x" * MAX_MESSAGE_BYTES),
    ):
        with pytest.raises(WireError, match="cannot be sent"):
            publisher.send_event(EVENT, wrong)
    with pytest.raises(WireError, match="characters"):
        publisher.send_event("gyrofleet/" + "x" * MAX_KEY_CHARS + "/s/event", NoteAdded(run="r1", t_ns=0, text=""))
    assert publisher.outstanding == 0
    publisher.close()


@pytest.fixture
def old_log(tmp_path: Path) -> Callable[[list[LogRecord]], Store]:
    """A store whose log an older gyrofleet wrote, that took any number: a segment of these, and a good one behind."""

    def make(records: list[LogRecord]) -> Store:
        store = Store.create(tmp_path / "old")
        log = EventLog(store)
        for n in range(2):
            values = np.arange(10 * n, 10 * n + 10, dtype=np.float64)
            each = SampleBatch("GOOD", "rate", "r1", UUID(int=1), 10 * n, 10**18 + n, 10, "deg/s", values=values)
            key = sample_key(PLACE, "GOOD", "rate")
            for record in [
                LogRecord(key, SAMPLES, 10**18, each.t0_ns, encode_batch(each)),
                *(records if n == 0 else []),
            ]:
                place = place_of(record)
                assert place is not None
                log.append(place, record)
            log.seal()
        return store

    return make


@pytest.mark.long
@pytest.mark.parametrize("name", [*(f"batch {each}" for each in BATCHES), *(f"document {each}" for each in DOCUMENTS)])
def test_a_message_in_the_log_that_cannot_be_built_is_quarantined(
    old_log: Callable[[list[LogRecord]], Store], name: str
) -> None:
    kind, _, which = name.partition(" ")
    if kind == "batch":
        record = LogRecord(HOSTILE, SAMPLES, 10**18, 10**18, BATCHES[which])
    else:
        record = LogRecord(EVENT, EVENTS, 10**18, 10**18, document(0, **DOCUMENTS[which]))
    store = old_log([record])
    list(recover(store))
    assert rows(store, "select unit, count(*) from samples group by unit") == [("GOOD", 20)]
    assert rows(store, "select count(*) from runs") == [(1,)]
    assert rows(store, "select count(*) from steps") == [(0,)]
    ((text, messages),) = rows(
        store, f"select document->>'$.text', (document->>'$.details.messages')::int from events "
        f"where document->>'$.what' = '{QUARANTINED}'"
    )  # fmt: skip
    assert messages == 1
    assert "the log keeps them" in text
    verified, _ = verify(store)
    assert verified.is_sound, verified.findings
    assert [each.kind for each in verified.findings if each.kind == "messages_quarantined"]


def test_seconds_at_the_end_of_64_bits_are_rolled_up_once_each() -> None:
    t_ns = np.array([-(2**63), -(2**63) + 1, 0, 1, 2**63 - 20, 2**63 - 10, 2**63 - 1])
    rollup = roll_up(t_ns, np.arange(7.0))
    assert rollup.n.sum() == 7
    assert (np.diff(rollup.bucket) > 0).all()


@pytest.mark.long
def test_every_view_answers_with_times_at_the_bounds(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "store")
    log = EventLog(store)
    moments = [0, -(2**61), 2**62 - 10, 10**18, -(2**61) + 5, 2**62 - 2, 1, 2**53, 2**62 - 2**58]
    for seq, t0_ns in enumerate([*moments, *reversed(moments)]):
        for unit, dt_ns in (("U1", 2), ("U2", 2**58)):
            values = np.array([1.0, 1e300])[: 2 if dt_ns == 2 else 1]
            fields = (seq * len(values), t0_ns, dt_ns, "deg/s")
            each = SampleBatch(unit, "rate", "r1", UUID(int=1), *fields, values=values, irregular=seq % 2 == 0)
            arrival_ns = 10**18 + seq * 60 * 10**9
            record = LogRecord(sample_key(PLACE, unit, "rate"), SAMPLES, arrival_ns, 0, encode_batch(each))
            place = place_of(record)
            assert place is not None
            log.append(place, record)
    log.seal()
    list(recover(store))
    with Catalog(store) as catalog:
        views = catalog.rows("select schema_name, view_name from duckdb_views() where not internal")
        assert {schema for schema, _ in views} == {"main", "internal"}
        for schema, view in views:
            catalog.rows(f"select * from {schema}.{view}")
        assert catalog.rows("select sum(n) from rollup_1s") == [(54,)]
        assert catalog.rows("select count(*) from clocks") == [(2,)]
