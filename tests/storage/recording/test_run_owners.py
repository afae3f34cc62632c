"""A run is of the station that began it: with security no other one adds to it, also after a restart."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from storage.log.event_log import EventLog
from storage.recording.client import HeldClaim, RecorderClient
from storage.recording.recorder import Recorder
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.errors import StoreError
from stream.events import NoteAdded, RunStarted
from stream.transport.zenoh_bus import ZenohBus
from stream.wire import requests
from tests.secured_sites import make_site, session

BATCH = SampleBatch("U1", "rate", "night", UUID(int=1), 0, 0, 10_000_000, "deg/s", values=np.arange(10.0))


@contextmanager
def recording(store: Store, site: Path, endpoint: str) -> Iterator[tuple[Recorder, ZenohBus, ZenohBus]]:
    """A recorder, and sessions of two stations."""
    with ExitStack() as stack:
        bus = stack.enter_context(session(site, "recorder:recorder", listen=endpoint))
        recorder = stack.enter_context(
            Recorder(store, bus, EventLog(store), sync_interval_s=0.01, builds_lake=False, reports_status=False)
        )
        first, second = (stack.enter_context(session(site, f"station:{c}", connect=endpoint)) for c in ("c1", "c2"))
        time.sleep(0.3)
        yield recorder, first, second


def rejections(recorder: Recorder, count: int) -> str:
    until = time.monotonic() + 5.0
    while recorder.counts.rejected < count:
        assert time.monotonic() < until, "nothing is refused"
        time.sleep(0.01)
    return recorder.counts.rejections[-1]


def test_a_station_adds_nothing_to_the_run_of_another(tmp_path: Path, endpoint: str) -> None:
    site, store = tmp_path / "site", Store.create(tmp_path / "store")
    make_site(site)
    with recording(store, site, endpoint) as (recorder, first, second):
        with DurablePublisher(first) as source:
            source.send_event("gyrofleet/plant/c1/event", RunStarted(run="day", t_ns=0))
            source.send_batch("gyrofleet/plant/c1/U1/rate", BATCH)
            source.drain()
        other = DurablePublisher(second)
        other.send_batch("gyrofleet/plant/c2/U1/rate", BATCH)
        assert "run night is of station c1; choose another name for a run of station c2" in rejections(recorder, 1)
        other.abandon()
        assert recorder.counts.samples == 10
    with recording(store, site, endpoint) as (recorder, first, second):  # known from the log
        other = DurablePublisher(second)
        other.send_event("gyrofleet/plant/c2/event", NoteAdded(run="day", t_ns=0, text="door opened"))
        assert "run day is of station c1" in rejections(recorder, 1)
        other.abandon()
        client = RecorderClient(second)
        with pytest.raises(StoreError, match="run night is of station c1; choose another name"):
            HeldClaim(client, [("U7", "night")], "an import", station="c2")
        HeldClaim(client, [("U7", "another")], "an import", station="c2").close()
        HeldClaim(RecorderClient(first), [("U7", "night")], "an import", station="c1").close()


@pytest.mark.parametrize("request_id", ["", "a/**/b#?", "x" * 65, "a b"], ids=["empty", "pattern", "long", "space"])
@pytest.mark.in_gate("pattern")
def test_a_request_that_cannot_be_answered_stops_no_answer(tmp_path: Path, endpoint: str, request_id: str) -> None:
    site, store = tmp_path / "site", Store.create(tmp_path / "store")
    make_site(site)
    with recording(store, site, endpoint) as (_, first, second):
        second.publish(requests.REQUEST_KEY, requests.encode(requests.Request(request_id, "", requests.Hello())))
        second.publish(requests.REQUEST_KEY, requests.encode(requests.Request(request_id, "", requests.AskRuns(()))))
        time.sleep(0.3)
        client = RecorderClient(first)
        assert client.store == store.identity
        client.runs(["night"])
