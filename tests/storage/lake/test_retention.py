"""Raw rows go by age or size, never without a document in the log, and nobody takes what is left for the whole."""

import json
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from storage.check.recover import recover
from storage.check.verify import verify
from storage.check.verify_lake import lake_problems
from storage.lake.builder import builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from storage.lake.rebuild import rebuild
from storage.log.event_log import EventLog
from storage.log.store_documents import is_own, store_document
from storage.manifests.lake import read_manifest
from storage.recording.recorder import Recorder
from storage.segments.reader import read_segment
from storage.sql.catalog import Catalog
from storage.sql.reading import find_signal, read_signal, stored_between
from storage.store import Store
from storage.upkeep.retention import Rule, apply_rule, parse_age, parse_size, would_drop
from stream.delivery.publisher import DurablePublisher
from stream.errors import BadInput, DeliveryError, GyrofleetError, NotFound
from stream.events import RAW_ROWS_DROPPED, RunEnded, StoreNoted, StreamTotal, decode_event
from stream.identity import event_key
from stream.transport.bus import LocalBus
from tests.conftest import Outcome
from tests.storage.conftest import DAY_NS, PLACE, START_NS, Filler
from tests.storage.lake.exported_views import LATER_NS, assert_same, export

AFTER_TWO_DAYS = Rule(older_than_s=86_400.0)
NOW_NS = START_NS + 2 * DAY_NS + 10**9


def noted(store: Store) -> list[StoreNoted]:
    """What the log says was dropped."""
    found = []
    for segment in sorted(store.log.glob("*.mcap")):
        for record in read_segment(segment):
            if record.schema == "gyrofleet.EventMessage":
                document = decode_event(record.data).document
                if isinstance(document, StoreNoted) and document.what == RAW_ROWS_DROPPED:
                    found.append(document)
    return found


@pytest.fixture
def retained(days: Filler) -> Filler:
    """The raw rows of the first day and of the second are dropped."""
    days.build()
    days.release()
    with builder_lock(days.store):
        lake = Lake(days.store)
        dropped = apply_rule(lake, AFTER_TWO_DAYS, now_ns=NOW_NS)
        assert (dropped.parts, dropped.samples) == (4, 4 * 2525)
        assert apply_rule(lake, AFTER_TWO_DAYS, now_ns=NOW_NS).parts == 0
    return days


def test_what_was_dropped_is_reported_in_the_log_and_in_the_views(retained: Filler) -> None:
    store = retained.store
    (document,) = noted(store)
    assert document.details["samples"] == 4 * 2525
    assert document.details["segments"] == [f"{i:08d}" for i in range(1, 5)]
    with Catalog(store) as catalog:
        assert catalog.rows("select samples, kept_raw from signals where signal = 'rate'") == [(30_000, 20_000)]
        assert catalog.rows("select count(*) from samples") == [(8 * 2525,)]
        assert catalog.rows("select sum(n) from rollup_1s") == [(12 * 2525,)]
        assert catalog.rows("select sum(n) from rollup_10s") == [(12 * 2525,)]
    assert list(lake_problems(store)) == []
    assert (store.lake / "00000001" / "samples.parquet").exists()
    with builder_lock(store):
        Lake(store).purge(grace_s=0)
    assert not (store.lake / "00000001" / "samples.parquet").exists()


@pytest.mark.long
def test_a_reader_gets_all_of_a_signal_or_an_error(retained: Filler) -> None:
    with Catalog(retained.store) as catalog:
        record = find_signal(catalog, "U1", "rate")
        with pytest.raises(NotFound, match=r"raw samples were dropped .*10,000 of 30,000.*rollup_1s"):
            list(read_signal(catalog, record))
        with pytest.raises(NotFound, match="raw samples were dropped"):
            stored_between(catalog, "U1", "rate", "r1", START_NS, START_NS + 10**10)
        times_ns, _ = stored_between(catalog, "U1", "rate", "r1", START_NS + DAY_NS, START_NS + DAY_NS + 10**10)
        assert len(times_ns) == 951


@pytest.mark.long
def test_the_lake_stays_a_function_of_the_log(retained: Filler, tmp_path: Path) -> None:
    store = retained.store
    retained.build()  # the segment with the document
    with builder_lock(store):
        list(compact(Lake(store), now_ns=LATER_NS))
        Lake(store).purge(grace_s=0)
    export(store, tmp_path / "before")
    assert list(lake_problems(store)) == []
    with builder_lock(store):
        list(rebuild(store))
    export(store, tmp_path / "after")
    assert_same(tmp_path / "before", tmp_path / "after")
    shutil.rmtree(store.lake)
    store.lake.mkdir()
    retained.build()
    export(store, tmp_path / "again")
    assert_same(tmp_path / "before", tmp_path / "again")


@pytest.mark.long
def test_a_document_without_its_deed_is_honoured_later(days: Filler, tmp_path: Path) -> None:
    """Killed after the document and before the files went; meanwhile a part was compacted beyond what it names."""
    days.build()
    store = days.store
    with builder_lock(store):
        list(compact(Lake(store), now_ns=LATER_NS))
    details = {"segments": ["00000001", "00000002"], "samples": 0, "bytes": 0, "store": store.identity}
    days.document(StoreNoted(run="", t_ns=START_NS, what=RAW_ROWS_DROPPED, text="dropped", details=details))
    days.seal()
    days.build()
    with Catalog(store) as catalog:
        assert catalog.rows("select sum(kept_raw), sum(samples) from signals") == [(10 * 2525, 12 * 2525)]
        assert catalog.rows("select count(*) from samples") == [(10 * 2525,)]
    export(store, tmp_path / "before")
    with builder_lock(store):
        list(rebuild(store))
    export(store, tmp_path / "after")
    assert_same(tmp_path / "before", tmp_path / "after")


@pytest.mark.long
def test_what_another_store_has_dropped_is_kept_here(days: Filler) -> None:
    """Two recorders on one bus: each log has the documents of both stores, and segments are numbered alike."""
    details = {"segments": ["00000001", "00000002"], "samples": 0, "bytes": 0}
    for others in (details | {"store": "0" * 32}, details):
        days.document(StoreNoted(run="", t_ns=START_NS, what=RAW_ROWS_DROPPED, text="dropped", details=others))
    days.seal()
    days.build()
    with builder_lock(days.store):
        list(rebuild(days.store))
    assert read_manifest(days.store).dropped == {}
    with Catalog(days.store) as catalog:
        assert catalog.rows("select count(*) from samples") == [(12 * 2525,)]


def test_two_recorders_on_one_bus_and_one_store_lets_go(days: Filler, tmp_path: Path) -> None:
    days.build()
    days.release()
    store, other = days.store, Store.create(tmp_path / "other")
    document = store_document(store.identity, RAW_ROWS_DROPPED, "dropped", {"segments": ["00000001"]})
    with (
        LocalBus() as bus,
        Recorder(other, bus, EventLog(other), builds_lake=False),
        pytest.raises(DeliveryError),
        DurablePublisher(bus, timeout_s=0.5, only_store=store.identity) as publisher,
    ):
        publisher.send_event(event_key(PLACE), document)
    assert noted(other) == [document]
    assert (is_own(document, store.identity), is_own(document, other.identity)) == (True, False)


def test_a_document_that_makes_no_sense_holds_nothing_up(filler: Filler) -> None:
    """A log from before such were refused."""
    own = {"store": filler.store.identity}
    filler.counts("rate", START_NS, 100)
    totals = [("U1", "zzz", 1), ("a/b", str(UUID(int=1)), 1), ("U1", str(UUID(int=1)), 2**62)]
    for unit, epoch, samples in totals:
        total = StreamTotal(unit=unit, signal="rate", epoch=epoch, samples=samples)
        filler.document(RunEnded(run="r1", t_ns=START_NS, totals=(total,)))
    for odd in ({"segments": 7}, {}, {"segments": [[1]]}, {"lost": 7}, {"lost": [1, 2]}, {"lost": [{"key": [1]}]}):
        details = odd | own
        filler.document(StoreNoted(run="", t_ns=START_NS, what=RAW_ROWS_DROPPED, text="", details=details))
    filler.seal()
    filler.build()
    filler.release()
    found, _ = verify(filler.store)
    assert [finding.kind for finding in found.findings] == ["document_odd"] * 9
    assert found.is_sound
    assert (found.samples, found.lake_samples) == (100, 100)
    assert list(recover(filler.store)) == []


def test_without_a_document_in_the_log_nothing_is_dropped(days: Filler) -> None:
    days.build()  # the writer lock is held, and its holder takes no messages
    with builder_lock(days.store), pytest.raises(GyrofleetError, match="is being written by test"):
        apply_rule(Lake(days.store), AFTER_TWO_DAYS, now_ns=NOW_NS)
    assert all(part.dropped is None for part in read_manifest(days.store).parts)


def test_by_size_the_oldest_go_first(days: Filler) -> None:
    days.build()
    days.release()
    store = days.store
    sizes = [part.files["samples.parquet"].bytes for part in read_manifest(store).parts]
    with builder_lock(store):
        dropped = would_drop(read_manifest(store), Rule(max_bytes=sum(sizes[5:])))
        assert dropped.bytes == sum(sizes[:5])
        assert all(part.dropped is None for part in read_manifest(store).parts)
        apply_rule(Lake(store), Rule(max_bytes=sum(sizes[5:])))
    assert [part.dropped is None for part in read_manifest(store).parts] == [False] * 5 + [True] * 7


@pytest.mark.parametrize(("text", "seconds"), [("90d", 90 * 86_400), ("1.5h", 5400), ("0s", 0)])
def test_ages(text: str, seconds: float) -> None:
    assert parse_age(text) == seconds


@pytest.mark.parametrize("text", ["", "90", "d", "-1d", "nand", "infd", "1y"])
def test_what_is_no_age_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match="for example 90d"):
        parse_age(text)


@pytest.mark.parametrize(("text", "size"), [("500GB", 500 * 10**9), ("10 kb", 10_000), ("7", 7)])
def test_sizes(text: str, size: int) -> None:
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["", "GB", "-1GB", "1PB", "1GBB"])
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match="for example 500GB"):
        parse_size(text)


@pytest.mark.long
def test_retain_sends_its_document_to_a_recorder_that_runs(
    days: Filler, gyrofleet: Callable[..., Outcome], command_line: Callable[..., list[str]]
) -> None:
    days.build()
    days.release()
    store = days.store
    listen = f"tcp/127.0.0.1:{int(np.random.default_rng().integers(20_000, 60_000))}"
    recorder = subprocess.Popen(
        command_line("record", "--store", store.folder, "--listen", listen, "--json"), stdout=subprocess.PIPE, text=True
    )
    try:
        assert recorder.stdout is not None
        assert json.loads(recorder.stdout.readline())["event"] == "recording"
        time.sleep(0.5)
        dry = gyrofleet("retain", "--older-than", "1d", "--dry-run", "--store", store.folder, "--json")
        assert (dry.json["dry_run"], dry.json["segments"], dry.json["samples"]) == (True, 12, 12 * 2525)
        paused = gyrofleet("retain", "--older-than", "1d", "--store", store.folder, "--json")
        assert paused.code == 1  # these were recorded a long time ago, and nothing since
        assert "after what was recorded last" in paused.json["error"]["message"]
        done = gyrofleet("retain", "--older-than", "1d", "--trust-clock", "--store", store.folder, "--json")
        assert (done.code, done.json["samples"]) == (0, 12 * 2525), done
    finally:
        recorder.terminate()
        recorder.communicate(timeout=30)
    assert len(noted(store)) == 1
    assert all(part.dropped is not None for part in read_manifest(store).parts if part.samples)
    reported = gyrofleet("retain", "--store", store.folder)
    assert (reported.code, "--older-than AGE or --max-size SIZE" in reported.err) == (1, True)
