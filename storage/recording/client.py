"""The recorder as a source sees it that sends from elsewhere: asked what its store has, and for the word to send."""

import os
import socket
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

import numpy as np

from storage.recording.knowledge import KnownRuns, KnownSignal, KnownStep, unpacked
from storage.store import Store, recorder_endpoint
from stream.batch import FloatArray, IntArray
from stream.errors import DeliveryError, GyrofleetError, StoreError, WireError
from stream.transport.bus import Bus
from stream.wire.requests import (
    LEASE_S,
    RENEW_S,
    REQUEST_KEY,
    AskRuns,
    AskSamples,
    AskSignals,
    Claim,
    Hello,
    Question,
    Release,
    Reply,
    Request,
    Settle,
    decode_reply,
    encode,
    reply_key,
)

_AGAIN_S = 2.0
_OTHERS_S = 0.2
_PATIENCE_S = 60.0
_SETTLE_S = 300.0
_RELEASE_S = 1.0  # else it ends with its lease


class RecorderClient:
    """Asks the recorder of one store over a bus.

    Parameters
    ----------
    bus: Where it is reached.
    wanted: Identity of the store that is preferred where recorders of several answer.
    patience_s: How long is waited for a recorder.

    Raises
    ------
    DeliveryError: If no recorder answers.

    Attributes
    ----------
    store: Identity of the store.
    """

    def __init__(self, bus: Bus, *, wanted: str | None = None, patience_s: float = _PATIENCE_S) -> None:
        self._bus = bus
        self._state = threading.Condition()
        self.store = ""
        found = self._ask(Hello(), patience_s, others_s=_OTHERS_S)
        stores = [reply.store for reply in found]
        self.store = wanted if wanted in stores else stores[0]

    def ask(self, question: Question, patience_s: float = _PATIENCE_S) -> Any:
        """The answer to a question.

        Raises
        ------
        StoreError: If the recorder says why it cannot answer.
        DeliveryError: If it does not answer in that time.
        """
        (reply,) = self._ask(question, patience_s)
        if reply.error:
            raise StoreError(f"the recorder cannot answer: {reply.error}")
        return reply.answer

    def settle(self) -> None:
        """Wait until everything that has come to the recorder is in its lake."""
        self.ask(Settle(), _SETTLE_S)

    def signals(self, runs: list[str]) -> list[KnownSignal]:
        """The signals of these runs."""
        return [KnownSignal(*row) for row in self.ask(AskSignals(tuple(runs)))]

    def runs(self, runs: list[str]) -> KnownRuns:
        """What is known of these runs."""
        found = KnownRuns(*self.ask(AskRuns(tuple(runs))))
        return found._replace(steps=[KnownStep(*step) for step in found.steps])

    def samples(self, unit: str, signal: str, run: str, first_ns: int, last_ns: int) -> tuple[IntArray, FloatArray]:
        """Times (ns, ascending) and values between two moments, both inclusive."""
        answer = self.ask(AskSamples(unit, signal, run, first_ns, last_ns))
        if answer is not None:
            return unpacked(*answer)
        if last_ns <= first_ns:
            raise StoreError(f"unit {unit}, signal {signal}, run {run}: the recorder has too many samples at one time")
        middle_ns = (first_ns + last_ns) // 2
        parts = [
            self.samples(unit, signal, run, first_ns, middle_ns),
            self.samples(unit, signal, run, middle_ns + 1, last_ns),
        ]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])

    def _ask(self, question: Question, patience_s: float, others_s: float = 0.0) -> list[Reply]:
        """Answers to a question: of all who answer within `others_s` of the first."""
        request = Request(uuid4().hex, self.store, question)
        found: list[Reply] = []

        def take(_key: str, payload: bytes) -> None:
            with suppress(WireError):
                reply = decode_reply(payload)
                with self._state:
                    if reply.store not in {each.store for each in found} and self.store in {"", reply.store}:
                        found.append(reply)
                        self._state.notify_all()

        self._bus.subscribe(reply_key(request.id), take)
        until = time.monotonic() + patience_s
        try:
            while True:
                self._bus.publish(REQUEST_KEY, encode(request))
                with self._state:
                    if self._state.wait_for(lambda: bool(found), min(_AGAIN_S, max(0.0, until - time.monotonic()))):
                        break
                if time.monotonic() >= until:
                    raise DeliveryError(
                        f"no recorder has answered for {patience_s:.0f} s; is `gyrofleet record` running where this "
                        f"source is connected to, and of this version?"
                    )
            time.sleep(others_s)
            with self._state:
                return list(found)
        finally:
            self._bus.unsubscribe(reply_key(request.id))


class HeldClaim:
    """The word to send samples of some units and runs, renewed until it is released.

    Parameters
    ----------
    client: The recorder.
    owners: Units and runs.
    what: Who sends, for the message that another one gets.
    on_loss: Called once, with the reason, if another source has the word meanwhile.
    holder: Identity of who sends; one that is started again with the same need not wait for itself.

    Raises
    ------
    StoreError: If another source has the word and goes on.
    """

    def __init__(
        self,
        client: RecorderClient,
        owners: Iterable[tuple[str, str]],
        what: str,
        on_loss: Callable[[str], None] | None = None,
        holder: str | None = None,
    ) -> None:
        self._client = client
        self.on_loss = on_loss
        text = f"{what} on {socket.gethostname()}, process {os.getpid()}"
        self._claim = Claim(holder or uuid4().hex, text, tuple(sorted(set(owners))))
        self._stop = threading.Event()
        until = time.monotonic() + LEASE_S + 2.0  # one that was killed holds it no longer
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
        while not self._stop.wait(RENEW_S):
            try:
                reason = self._refused(_AGAIN_S)
            except GyrofleetError:
                continue  # the recorder is away; it is asked again
            if reason is not None:
                if self.on_loss is not None:
                    self.on_loss(reason)
                return

    def release(self) -> None:
        """Let others send."""
        self._stop.set()
        self._thread.join()
        with suppress(GyrofleetError):
            self._client.ask(Release(self._claim.holder), _RELEASE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.release()


def is_recorded(bus: Bus, folder: Path, endpoint: str) -> bool:
    """Whether the store in a folder is that of the recorder on a bus, whatever its address is called.

    Where no recorder answers now, by what the store knows of its last one.
    """
    try:
        identity = Store.open(folder).identity
    except StoreError:
        return False
    try:
        return RecorderClient(bus, wanted=identity, patience_s=_AGAIN_S).store == identity
    except DeliveryError:
        return endpoint == recorder_endpoint(folder)
