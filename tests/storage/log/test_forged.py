"""What others say in the name of a recorder, a source or a store is not believed, and is reported."""

from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from storage.lake.builder import builder_lock
from storage.lake.lake import Lake
from storage.log.event_log import EventLog
from storage.log.store_documents import forgery, signed, store_document
from storage.manifests.lake import read_manifest
from storage.recording.recorder import Recorder
from storage.segments.reader import read_segment
from storage.segments.records import REJECTED
from storage.sql.catalog import Catalog
from storage.store import Store
from storage.upkeep.retention import Rule, apply_rule
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.delivery.spool import Spool
from stream.errors import DeliveryError
from stream.events import RAW_ROWS_DROPPED, StoreNoted, encode_event
from stream.identity import ACKNOWLEDGEMENT_KEY, Place, event_key, sample_key
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import StreamPosition, decode_acknowledgement, encode_acknowledgement
from stream.wire.batches import encode_batch

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")
N = 100


def batch(i: int, add: float = 0.0) -> SampleBatch:
    values = np.arange(i * N, (i + 1) * N, dtype=np.float64) + add
    return SampleBatch("U1", "rate", "r1", UUID(int=1), i * N, i * N * 10**6, 10**6, "deg/s", values=values)


def answer(bus: LocalBus, next_seq: int, store: str = "forged", *, rewind: bool = False) -> None:
    position = StreamPosition(KEY, UUID(int=1).hex, next_seq, rewind)
    bus.publish(ACKNOWLEDGEMENT_KEY, encode_acknowledgement(store, (position,)))


def lake_values(store: Store) -> list[float]:
    with Catalog(store) as catalog:
        return [value for (value,) in catalog.rows("select value from samples where signal = 'rate' order by seq")]


@pytest.mark.long
@pytest.mark.parametrize("next_seq", [2 * N + 1, 10**6, 2**62, 2**63 - 1, -1])
@pytest.mark.parametrize("rewind", [False, True])
def test_an_answer_beyond_what_was_sent_is_ignored_and_reported(tmp_path: Path, next_seq: int, rewind: bool) -> None:
    bus = LocalBus()
    with Spool(tmp_path) as spool:
        publisher = DurablePublisher(bus, resend_after_s=60.0, spool=spool)
        publisher.send_batch(KEY, batch(0))
        publisher.send_batch(KEY, batch(1))
        answer(bus, next_seq, rewind=rewind)
        assert publisher.outstanding == 2
        assert f"an answer is ignored, 1 so far: it names number {next_seq}" in str(publisher.warning)
        assert "200 were sent" in str(publisher.warning)
        publisher.abandon()
    store = Store.create(tmp_path / "store")
    with (
        Spool(tmp_path) as spool,
        Recorder(store, bus, EventLog(store), sync_interval_s=0.01),
        DurablePublisher(bus, spool=spool) as publisher,
    ):
        publisher.send_batch(KEY, batch(2))
        publisher.drain()
    assert lake_values(store) == list(range(3 * N))


def test_a_recorder_acknowledges_no_more_than_it_was_given(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    answers: list[int] = []
    bus.subscribe(
        ACKNOWLEDGEMENT_KEY,
        lambda _key, payload: answers.extend(each.next_seq for each in decode_acknowledgement(payload).positions),
    )
    for count in (10, 2):  # the second time it has all of them from before
        answers.clear()
        with (
            Recorder(store, bus, EventLog(store), sync_interval_s=0.01),
            DurablePublisher(bus, timeout_s=10.0) as publisher,
        ):
            for i in range(count):
                publisher.send_batch(KEY, batch(i))
            publisher.drain()
            assert publisher.warning is None
        assert max(answers) == count * N
    assert lake_values(store) == list(range(10 * N))


def test_a_recorder_of_another_store_on_the_same_bus_disturbs_nothing(tmp_path: Path) -> None:
    bus = LocalBus()
    own, other = Store.create(tmp_path / "own"), Store.create(tmp_path / "other")
    with (
        Recorder(own, bus, EventLog(own), sync_interval_s=0.01),
        DurablePublisher(bus, resend_after_s=0.02, timeout_s=10.0) as publisher,
    ):
        for i in range(20):
            publisher.send_batch(KEY, batch(i))
        publisher.drain()
        with Recorder(other, bus, EventLog(other), sync_interval_s=0.01) as late:
            for i in range(20, 40):
                publisher.send_batch(KEY, batch(i))
                answer(bus, 0, other.identity, rewind=True)
            publisher.drain()
        assert late.counts.out_of_order > 0
    assert lake_values(own) == list(range(40 * N))


def test_an_acknowledgement_of_another_store_lets_go_of_nothing() -> None:
    bus = LocalBus()
    with DurablePublisher(bus, resend_after_s=60.0, timeout_s=0.5) as publisher:
        publisher.send_batch(KEY, batch(0))
        answer(bus, N, "own")
        assert publisher.outstanding == 0
        publisher.send_batch(KEY, batch(1))
        answer(bus, 2 * N, "other")
        assert publisher.outstanding == 1
        with pytest.raises(DeliveryError, match=r"another store \(other\) requests them, but they go to the store own"):
            publisher.drain()


def test_a_number_that_comes_with_other_content_is_a_conflict_and_kept_beside(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    warnings: list[str] = []
    with (
        Recorder(store, bus, EventLog(store), sync_interval_s=0.01, on_warning=warnings.append) as recorder,
        DurablePublisher(bus, resend_after_s=5.0, timeout_s=10.0) as publisher,
    ):
        publisher.send_batch(KEY, batch(0))
        publisher.drain()
        for i in range(1, 4):  # somebody is faster under the source's numbers
            bus.publish(KEY, encode_batch(batch(i, add=0.5)))
        for i in range(1, 5):
            publisher.send_batch(KEY, batch(i))
        publisher.drain()
        bus.publish(KEY, encode_batch(batch(4)))  # the same once more is none
    assert (recorder.counts.conflicts, recorder.counts.duplicates) == (3, 1)
    assert any("other content" in text for text in warnings)
    (segment,) = store.log.glob("*.mcap")
    kept = [record for record in read_segment(segment) if record.schema == REJECTED]
    assert [(record.topic, record.data) for record in kept] == [(KEY, encode_batch(batch(i))) for i in range(1, 4)]
    with Catalog(store) as catalog:
        found = catalog.rows(
            "select (document->>'$.details.count')::int, document->>'$.details.conflicts[0].seq' from events "
            "where document->>'$.what' = 'number_conflict'"
        )
    assert sum(count for count, _ in found) == 3
    assert found[0][1] == str(N)


@pytest.fixture
def recorded(tmp_path: Path) -> Store:
    """A store with one segment."""
    store = Store.create(tmp_path / "store")
    bus = LocalBus()
    with Recorder(store, bus, EventLog(store), sync_interval_s=0.01), DurablePublisher(bus) as publisher:
        publisher.send_batch(KEY, batch(0))
        publisher.drain()
    return store


@pytest.mark.long
@pytest.mark.parametrize("seal", [None, "", "0" * 64, 7])
@pytest.mark.parametrize("is_named", [True, False])
def test_only_the_store_itself_says_that_raw_rows_are_dropped(recorded: Store, seal: object, is_named: bool) -> None:
    details = {"segments": ["00000001", "00000002"]} | ({} if seal is None else {"seal": seal})
    document = store_document(recorded.identity, RAW_ROWS_DROPPED, "dropped", details)
    if not is_named:
        document = StoreNoted(run="", t_ns=0, what=RAW_ROWS_DROPPED, text="dropped", details=details)
    bus = LocalBus()
    with Recorder(recorded, bus, EventLog(recorded), sync_interval_s=0.01) as recorder:
        bus.publish(event_key(PLACE), encode_event(document, "e", 0))
    assert recorder.counts.rejected == 1
    assert "lacks its seal" in recorder.counts.rejections[0]
    with builder_lock(recorded):
        Lake(recorded)
    assert read_manifest(recorded).dropped == {}
    assert lake_values(recorded) == list(range(N))


def test_a_seal_is_of_one_document_of_one_store(recorded: Store, tmp_path: Path) -> None:
    document = signed(
        recorded, store_document(recorded.identity, RAW_ROWS_DROPPED, "dropped", {"segments": ["00000001"]})
    )
    assert forgery(recorded, document) is None
    document.details["segments"].append("00000002")
    assert forgery(recorded, document) is not None
    other = Store.create(tmp_path / "other")
    assert forgery(other, signed(recorded, store_document(other.identity, "x", "", {}))) is not None


def test_retention_beside_a_recorder_is_believed(recorded: Store) -> None:
    bus = LocalBus()
    with builder_lock(recorded):
        apply_rule(Lake(recorded), Rule(max_bytes=0))
    with Recorder(recorded, bus, EventLog(recorded)) as recorder:
        recorder.wait_for_lake()
    assert list(read_manifest(recorded).dropped) == ["00000001"]
    assert lake_values(recorded) == []
