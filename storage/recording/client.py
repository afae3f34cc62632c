"""A remote recorder: requests about its store, claims on runs, and documents for its log."""

import os
import socket
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from storage.log.store_documents import LAKE
from storage.recording.acts.signed_rules import keep_signed_rules
from storage.recording.disk_watch import DiskWatch
from storage.recording.knowledge import KnownRuns, KnownSignal, KnownStep, unpacked
from storage.segments.disk import DISK
from storage.store import Store, WriterLock, recorder_endpoint, writer_endpoint, writer_security
from stream.batch import FloatArray, IntArray
from stream.closing import Closing
from stream.delivery.publisher import DurablePublisher
from stream.errors import BusError, DeliveryError, GyrofleetError, StoreError, WireError
from stream.events import Act, AnyDocument
from stream.identity import Place, event_key
from stream.security.credentials import BusSecurity, load_credentials, process_security
from stream.security.rights import Role
from stream.terminal.console import notes
from stream.transport.bus import Admitted, Bus
from stream.wire import requests

_AGAIN_S = 2.0
_OTHERS_S = 0.2
_PATIENCE_S = 60.0
_BRIEF_S = 10.0  # for others that enter documents
_SETTLE_S = 300.0
_RELEASE_S = 1.0  # else it ends with its lease


class RecorderClient:
    """Sends requests to the recorder of one store, whose identity is `store`, over a bus.

    If several recorders answer, that of the store `wanted` is preferred. Raises a DeliveryError if none does.
    """

    def __init__(self, bus: Bus, *, wanted: str | None = None, patience_s: float = _PATIENCE_S) -> None:
        self._bus = bus
        self._state = threading.Condition()
        self.store = ""
        found = self._ask(requests.Hello(), patience_s, others_s=_OTHERS_S)
        forms = {reply.store: reply.form for reply in found}
        self.store = wanted if wanted in forms else next(iter(forms))
        self._form = forms[self.store]

    def ask(self, question: requests.Question, patience_s: float = _PATIENCE_S) -> Any:
        """The answer to a question; StoreError if the recorder cannot answer, DeliveryError if not in time."""
        (reply,) = self._ask(question, patience_s)
        if reply.error:
            raise StoreError(f"the recorder cannot answer: {reply.error}")
        return reply.answer

    def settle(self) -> None:
        """Wait until everything the recorder has received is in its lake."""
        self.ask(requests.Settle(), _SETTLE_S)

    def signals(self, runs: list[str]) -> list[KnownSignal]:
        """The signals of these runs."""
        return [KnownSignal(*row) for row in self._ask_known(requests.AskSignals(tuple(runs)))]

    def runs(self, runs: list[str]) -> KnownRuns:
        """What is known of these runs."""
        found = KnownRuns(*self._ask_known(requests.AskRuns(tuple(runs))))
        return found._replace(steps=[KnownStep(*step) for step in found.steps])

    def samples(self, unit: str, signal: str, run: str, first_ns: int, last_ns: int) -> tuple[IntArray, FloatArray]:
        """Times (ns, ascending) and values between two times, inclusive."""
        answer = self.ask(requests.AskSamples(unit, signal, run, first_ns, last_ns))
        if answer is not None:
            return unpacked(*answer)
        if last_ns <= first_ns:
            raise StoreError(f"unit {unit}, signal {signal}, run {run}: the recorder has too many samples at one time")
        earlier = self.samples(unit, signal, run, first_ns, (first_ns + last_ns) // 2)
        later = self.samples(unit, signal, run, (first_ns + last_ns) // 2 + 1, last_ns)
        return np.concatenate([earlier[0], later[0]]), np.concatenate([earlier[1], later[1]])

    def _ask_known(self, question: requests.AskSignals | requests.AskRuns) -> Any:
        """An answer whose fields this version reads by their place."""
        if self._form != requests.FORM:
            raise StoreError(
                f"the recorder is of another version than this program: its answers about runs have form {self._form}, "
                f"this program reads {requests.FORM}; install one version of gyrofleet at both"
            )
        return self.ask(question)

    def _ask(self, question: requests.Question, patience_s: float, others_s: float = 0.0) -> list[requests.Reply]:
        """All answers to a question within `others_s` of the first."""
        request = requests.Request(uuid4().hex, self.store, question)
        found: list[requests.Reply] = []

        def take(_key: str, payload: bytes) -> None:
            with suppress(WireError):
                reply = requests.decode(payload, requests.Reply)
                with self._state:
                    if reply.store not in {each.store for each in found} and self.store in {"", reply.store}:
                        found.append(reply)
                        self._state.notify_all()

        self._bus.subscribe(requests.reply_key(request.id), take)
        until = time.monotonic() + patience_s
        try:
            while True:
                self._bus.publish(requests.REQUEST_KEY, requests.encode(request))
                with self._state:
                    if self._state.wait_for(lambda: bool(found), min(_AGAIN_S, max(0.0, until - time.monotonic()))):
                        break
                if time.monotonic() >= until:
                    refused = self._bus.why_refused() if isinstance(self._bus, Admitted) else ""
                    raise DeliveryError(
                        f"no recorder has answered for {patience_s:.0f} s; is `gyrofleet record` of this version "
                        f"running where this source connects to?{refused}"
                    )
            time.sleep(others_s)
            with self._state:
                return list(found)
        finally:
            self._bus.unsubscribe(requests.reply_key(request.id))


class HeldClaim(Closing):
    """The exclusive right to send samples of some units and runs (`owners`), renewed until it is released.

    `what` describes the source in the message that another one gets. `on_loss` is called once, with the reason, if
    another source has taken over. With the same `holder` a restarted source does not wait for its own claim. Raises a
    StoreError if another source holds the claim, or a run is of another station than `station`.
    """

    def __init__(
        self, client: RecorderClient, owners: Iterable[tuple[str, str]], what: str,
        on_loss: Callable[[str], None] | None = None, holder: str | None = None, station: str = "",
    ) -> None:  # fmt: skip
        self._client, self.on_loss = client, on_loss
        text = f"{what} on {socket.gethostname()}, process {os.getpid()}"
        self._claim = requests.Claim(holder or uuid4().hex, text, tuple(sorted(set(owners))), station)
        self._stop = threading.Event()
        until = time.monotonic() + requests.LEASE_S + 2.0  # the lease of a killed source ends
        while (reason := self._refused()) is not None:
            if time.monotonic() >= until:
                raise StoreError(reason)
            time.sleep(0.2)
        self._thread = threading.Thread(target=self._renew, name="gyrofleet-claim", daemon=True)
        self._thread.start()

    def _refused(self, patience_s: float = _PATIENCE_S) -> str | None:
        taken = self._client.ask(self._claim, patience_s)
        if taken is None:
            return None
        unit, run, text = taken
        return (
            f"unit {unit}, run {run} is being sent to this recorder by another source ({text}); wait until it has "
            f"ended, or give another --run"
        )

    def _renew(self) -> None:
        while not self._stop.wait(requests.RENEW_S):
            try:
                reason = self._refused(_AGAIN_S)
            except GyrofleetError:
                continue  # the recorder is unreachable; it is asked again
            if reason is not None:
                if self.on_loss is not None:
                    self.on_loss(reason)
                return

    def close(self) -> None:
        """End the claim."""
        self._stop.set()
        self._thread.join()
        with suppress(GyrofleetError):
            self._client.ask(requests.Release(self._claim.holder), _RELEASE_S)


def is_recorded(bus: Bus, folder: Path, endpoint: str) -> bool:
    """Whether the store in a folder is that of the recorder on a bus, else whether its last recorder was there."""
    try:
        identity = Store.open(folder).identity
    except StoreError:
        return False
    try:
        return RecorderClient(bus, wanted=identity, patience_s=_AGAIN_S).store == identity
    except DeliveryError:
        return endpoint == recorder_endpoint(folder)


def record_documents(
    store: Store, documents: Sequence[AnyDocument], *, role: str, place: Place = LAKE, builds_lake: bool = False
) -> None:
    """Append documents to the log of a store, durably: through its recorder, else through a temporary one.

    `role` is who writes, for the message that another writer gets, `place` where the documents are from. A temporary
    recorder also builds the lake if `builds_lake`, and waits for another one that enters documents.
    """
    endpoint = writer_endpoint(store.folder)
    if endpoint is not None:
        from stream.transport.zenoh_bus import ZenohBus

        with ZenohBus(connect=[endpoint], security=_as_writer(store.folder, documents)) as remote:
            _send(remote, documents, place, store)
        return
    from storage.log.event_log import EventLog
    from storage.recording.recorder import Recorder
    from stream.transport.bus import LocalBus

    with WriterLock(store, role, is_brief=True, patience_s=_BRIEF_S):
        full, _ = DiskWatch(store.folder, DISK).look(time.monotonic())
        if full is not None:
            raise StoreError(f"nothing was entered: {full}")
        if (own := process_security().credentials) is not None:
            keep_signed_rules(store, own, lambda text: notes().print(f"warning: {text}", soft_wrap=True, markup=False))
        with (
            LocalBus() as bus,
            Recorder(store, bus, EventLog(store), sync_interval_s=0.01, builds_lake=builds_lake, reports_status=False),
        ):
            _send(bus, documents, place, store)


def _as_writer(folder: Path, documents: Sequence[AnyDocument]) -> BusSecurity:
    """As whom documents are sent to the recorder of a store: as this process, else with the recorder's certificate.

    As this process only if they name nobody else: a server sends what its users do.

    Who can read that certificate's key writes the store anyway. A recorder that is not secured was started so.
    """
    own, certificate = process_security(), writer_security(folder)
    if certificate is None:
        return BusSecurity(is_insecure=True)
    if own.credentials is not None and own.credentials.principal.role in {Role.APPROVER, Role.RECORDER}:
        name = own.credentials.principal.common_name
        if all(each.identity == name for each in documents if isinstance(each, Act)):
            return own
    try:
        return BusSecurity(load_credentials(certificate))
    except BusError as error:
        raise BusError(
            f"the recorder of {folder} admits certificates only: set GYROFLEET_SECURITY to the folder of an approver's "
            f"(`gyrofleet site add-approver`); that of the recorder itself cannot be used: {error}"
        ) from error


def _send(bus: Bus, documents: Sequence[AnyDocument], place: Place, store: Store) -> None:
    with DurablePublisher(bus, timeout_s=20.0, only_store=store.identity) as publisher:
        for document in documents:
            publisher.send_event(event_key(place), document)
        publisher.drain(given_up=lambda: publisher.paused is not None)
        if publisher.outstanding and (why := publisher.paused) is not None:
            publisher.abandon()  # a person waits, and enters it again
            raise StoreError(f"nothing was entered, the recorder of {store.folder} is paused: {why}")
