"""A router in between forges: nothing of it is recorded or believed, all of it is counted, named and quarantined."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple
from uuid import UUID

import msgspec
import numpy as np
import pytest

from storage.log.event_log import EventLog
from storage.recording.recorder import Recorder
from storage.store import Store
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.events import (
    AnyDocument,
    CompensationStarted,
    ModelActivated,
    NoteAdded,
    RunEnded,
    RunStarted,
    StationStated,
    StepStarted,
    StepWords,
    StoreNoted,
    UnitMounted,
    UnitReleased,
    Verdict,
    VerdictGiven,
    encode_event,
)
from stream.identity import ACKNOWLEDGEMENT_KEY
from stream.security.proof import Proof, SourceProver, joined, split
from stream.transport.zenoh_bus import ZenohBus
from stream.wire.acknowledgement import StreamPosition, decode_acknowledgement, encode_acknowledgement
from stream.wire.batches import encode_batch
from tests.secured_sites import credentials, make_site, session

KEY, EVENTS = "gyrofleet/plant/c1/U1/rate", "gyrofleet/plant/c1/event"
VERDICT_KEY = f"{KEY}/estimate/verdict"
STORE_KEY = "gyrofleet/store/lake/event"
BATCH = SampleBatch("U1", "rate", "r1", UUID(int=1), 0, 0, 10_000_000, "deg/s", values=np.arange(10.0))
NEXT = replace(BATCH, seq=10, t0_ns=100_000_000)
STEPS = StoreNoted(run="", t_ns=0, what="disk_low", text="")
VERDICT = VerdictGiven(run="r1", t_ns=0, unit="U1", verdict=Verdict.PASS)
LEAD = "approver:lead"
MODEL = ModelActivated(run="", t_ns=0, unit="U1", model="a", version=1, by=LEAD, identity=LEAD)
IN_ANOTHERS_NAME = msgspec.structs.replace(MODEL, by="approver:chief")
AS_ANOTHER = msgspec.structs.replace(MODEL, identity="user:chief")
AS_NOBODY = msgspec.structs.replace(MODEL, identity="unauthenticated")
STATIONS_NOTE = NoteAdded(run="r1", t_ns=0, text="let it pass", author="chief", identity="approver:lead")
ANOTHERS_NOTE = NoteAdded(run="r1", t_ns=0, text="let it pass", author="chief", identity=LEAD)
# run r1 is of station c1, whose samples came first
C2_EVENTS, C2_KEY = "gyrofleet/plant/c2/event", "gyrofleet/plant/c2/U1/rate"
NOT_OF_C2 = "run r1 is of station c1"
ABOUT_R1 = (
    RunStarted(run="r1", t_ns=0), RunEnded(run="r1", t_ns=0, outcome="aborted"),
    StationStated(run="r1", t_ns=0, details={"time_zone": "Asia/Tokyo"}),
    StepStarted(run="r1", t_ns=0, unit="U1", words=StepWords(procedure="static_bias")),
    UnitMounted(run="r1", t_ns=0, unit="U1", product="another"),
    UnitReleased(run="r1", t_ns=0, unit="U1", verdict=Verdict.PASS, recorded_s=1.0, planned_s=1.0),
    NoteAdded(run="r1", t_ns=0, text="door opened"),
)  # fmt: skip
STARTED = CompensationStarted(
    run="r1", t_ns=0, unit="U1", signal="rate", epoch="e", model="a", version=1, compensated="rate_compensated",
    compensated_epoch="f",
)  # fmt: skip


class Between(NamedTuple):
    """The router, what it passes on, and who is behind it."""

    site: Path
    store: Store
    router: ZenohBus
    recorder: Recorder
    source: DurablePublisher
    passed: dict[str, list[bytes]]


@pytest.fixture
def between(tmp_path: Path, endpoint: str) -> Iterator[Between]:
    site = tmp_path / "site"
    make_site(site)
    store = Store.create(tmp_path / "store")
    passed: dict[str, list[bytes]] = {}
    with (
        session(site, "router:router", listen=endpoint) as router,
        session(site, "recorder:recorder", connect=endpoint) as far,
        Recorder(
            store, far, EventLog(store), sync_interval_s=0.01, builds_lake=False, reports_status=False
        ) as recorder,
        session(site, "station:c1", connect=endpoint) as near,
        DurablePublisher(near, resend_after_s=0.5) as source,
    ):
        for each in ("gyrofleet/**", ACKNOWLEDGEMENT_KEY):
            router.subscribe(each, lambda key, payload: passed.setdefault(key, []).append(payload))
        time.sleep(0.3)
        source.send_batch(KEY, BATCH)
        source.send_event(EVENTS, NoteAdded(run="r1", t_ns=0, text="door opened"))
        source.drain()
        assert (recorder.counts.samples, recorder.counts.rejected) == (10, 0)
        _until(lambda: {KEY, EVENTS, ACKNOWLEDGEMENT_KEY} <= passed.keys())  # the router gets its own copies later
        yield Between(site, store, router, recorder, source, passed)


def prove(between: Between, who: str, key: str, document: AnyDocument) -> bytes:
    return SourceProver(credentials(between.site, who)).prove(key, encode_event(document, "forged", 0))


def claimed(proof_of: bytes, by: str, body: bytes) -> bytes:
    """A message under another's proof, in another's name."""
    proof = split(proof_of).proof
    assert proof is not None
    return joined(body, msgspec.structs.replace(proof, by=by))


def test_nothing_that_a_router_makes_up_is_recorded(between: Between) -> None:
    genuine, note = between.passed[KEY][0], between.passed[EVENTS][0]
    others = SourceProver(credentials(between.site, "station:c2")).prove(KEY, encode_batch(NEXT))
    bare_store = encode_event(STEPS, "forged", 0)
    cases = [
        (KEY, encode_batch(NEXT), "no proof of its source"),
        (KEY, claimed(genuine, "station:c1", encode_batch(NEXT)), "proof is not that of station c1"),
        (KEY, claimed(others, "station:c1", encode_batch(NEXT)), "proof is not that of station c1"),
        (KEY, others, "station c2 may not send under this key"),
        ("gyrofleet/plant/c1/U2/rate", genuine, "proof is not that of station c1"),
        (KEY, joined(encode_batch(NEXT), Proof("station:nobody", {"r": b"x"})), "not on the access list"),
        (KEY, joined(encode_batch(NEXT), Proof("station:c1")), "station c1 does not know recorder recorder"),
        (EVENTS, claimed(note, "station:c1", bare_store), "proof is not that of station c1"),
        (STORE_KEY, bare_store, "no proof of its source"),
        (EVENTS, prove(between, "station:c1", EVENTS, STEPS), "station c1 may not send a StoreNoted"),
        (STORE_KEY, prove(between, "approver:lead", STORE_KEY, STEPS), "approver lead may not send a StoreNoted"),
        (VERDICT_KEY, encode_event(VERDICT, "forged", 0), "no proof of its source"),
        (VERDICT_KEY, prove(between, "station:c1", VERDICT_KEY, VERDICT), "station c1 may not send under this key"),
        (EVENTS, prove(between, "station:c1", EVENTS, VERDICT), "station c1 may not send a VerdictGiven"),
        (STORE_KEY, prove(between, "station:c1", STORE_KEY, MODEL), "station c1 may not send under this key"),
        (EVENTS, prove(between, "station:c1", EVENTS, MODEL), "station c1 may not send a ModelActivated"),
        (EVENTS, prove(between, "estimator:e1", EVENTS, MODEL), "estimator e1 may not send a ModelActivated"),
        (STORE_KEY, encode_event(MODEL, "forged", 0), "no proof of its source"),
        (STORE_KEY, prove(between, LEAD, STORE_KEY, IN_ANOTHERS_NAME), "may not act in the name of 'approver:chief'"),
        (STORE_KEY, prove(between, LEAD, STORE_KEY, AS_ANOTHER), "approver lead may not act as user:chief"),
        (STORE_KEY, prove(between, LEAD, STORE_KEY, AS_NOBODY), "approver lead may not act as unauthenticated"),
        (EVENTS, prove(between, "station:c1", EVENTS, STATIONS_NOTE), "station c1 may not act as approver:lead"),
        (STORE_KEY, prove(between, LEAD, STORE_KEY, MODEL), "no version a of the error model of U1"),
        (STORE_KEY, prove(between, LEAD, STORE_KEY, ANOTHERS_NOTE), "approver lead may not write a note of 'chief'"),
        *((C2_EVENTS, prove(between, "station:c2", C2_EVENTS, each), NOT_OF_C2) for each in ABOUT_R1),
        (C2_KEY, SourceProver(credentials(between.site, "station:c2")).prove(C2_KEY, encode_batch(NEXT)), NOT_OF_C2),
    ]  # fmt: skip
    counts = between.recorder.counts
    for number, (key, payload, reason) in enumerate(cases, 1):
        between.router.publish(key, payload)
        _until(partial(_has_rejected, between.recorder, number))
        assert reason in counts.rejections[-1], (key, reason)
    assert counts.samples == 10
    quarantined = len(cases)
    assert (counts.rejected, counts.rejected_not_kept, counts.conflicts) == (quarantined, 0, 0)
    between.source.send_batch(KEY, NEXT)  # the genuine next batch has its numbers still
    between.source.drain()
    assert counts.samples == 20


@pytest.mark.long
def test_what_is_replayed_adds_nothing_and_who_may_is_recorded(between: Between) -> None:
    counts = between.recorder.counts
    between.router.publish(KEY, between.passed[KEY][0])
    between.router.publish(EVENTS, between.passed[EVENTS][0])
    _until(lambda: counts.duplicates == 2)
    assert (counts.samples, counts.rejected, counts.conflicts) == (10, 0, 0)
    messages = counts.messages
    models = between.store.folder / "models" / "U1"
    models.mkdir(parents=True)
    (models / "0001-a.json").write_text("{}")
    for who, key, document in (
        ("estimator:e1", VERDICT_KEY, VERDICT),
        ("estimator:e1", EVENTS, STARTED),
        ("approver:lead", STORE_KEY, MODEL),
    ):
        between.router.publish(key, prove(between, who, key, document))
    _until(lambda: counts.messages == messages + 3)
    time.sleep(0.1)
    assert counts.rejected == 0, counts.rejections


def test_a_source_believes_a_recorders_acknowledgement_only(between: Between) -> None:
    (*_, genuine) = between.passed[ACKNOWLEDGEMENT_KEY]
    store = decode_acknowledgement(genuine).store
    position = StreamPosition(KEY, UUID(int=1).hex, 20)
    forged = encode_acknowledgement(store, (position,), signer=credentials(between.site, "station:c2"))
    named = msgspec.structs.replace(decode_acknowledgement(forged), by="recorder:recorder")
    moved = msgspec.structs.replace(decode_acknowledgement(genuine), positions=(position,))
    between.recorder.end()  # it acknowledges nothing more
    between.source.send_batch(KEY, NEXT)
    made_up = [encode_acknowledgement(store, (position,)), forged, *map(msgspec.msgpack.encode, (named, moved))]
    for number, payload in enumerate(made_up, 1):
        between.router.publish(ACKNOWLEDGEMENT_KEY, payload)
        _until(partial(_warns, between.source, f"a forged acknowledgement is refused, {number} so far"))
    assert between.source.outstanding == 1
    between.source.abandon()


def _has_rejected(recorder: Recorder, number: int) -> bool:
    return recorder.counts.rejected == number


def _warns(source: DurablePublisher, text: str) -> bool:
    return text in (source.warning or "")


def _until(is_so: Callable[[], bool]) -> None:
    until = time.monotonic() + 5.0
    while not is_so():
        assert time.monotonic() < until, "it does not come"
        time.sleep(0.01)
