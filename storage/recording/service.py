"""A recorder's answers to sources: exclusive claims on units' runs, and what the store has of them."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING, Any, NamedTuple

from storage.log.run_owners import RunOwners
from storage.store import Store
from stream.errors import GyrofleetError, StoreError, WireError
from stream.transport.bus import Bus
from stream.wire import requests

if TYPE_CHECKING:
    from storage.sql.catalog import Catalog

_MOST_WAITING = 1000


class _Held(NamedTuple):
    holder: str
    text: str
    until: float


class Claims:
    """Exclusive rights to send samples of a unit in a run.

    >>> claims = Claims()
    >>> claims.claim(requests.Claim("a", "import of a.csv", (("U1", "r1"),)), now=0.0)
    >>> claims.claim(requests.Claim("b", "import of b.csv", (("U2", "r1"), ("U1", "r1"))), now=1.0)
    ['U1', 'r1', 'import of a.csv']
    >>> claims.claim(requests.Claim("b", "import of b.csv", (("U1", "r1"),)), now=4.0)  # the first was not renewed
    """

    def __init__(self) -> None:
        self._held: dict[tuple[str, str], _Held] = {}

    def claim(self, claim: requests.Claim, now: float) -> list[str] | None:
        """Grant or renew a claim; if another holder has part of it, its unit, run and description."""
        for unit, run in claim.owners:
            held = self._held.get((unit, run))
            if held is not None and held.holder != claim.holder and held.until > now:
                return [unit, run, held.text]
        for owner in claim.owners:
            self._held[owner] = _Held(claim.holder, claim.text[:300], now + requests.LEASE_S)
        return None

    def release(self, holder: str) -> None:
        """Release all claims of a holder."""
        self._held = {owner: held for owner, held in self._held.items() if held.holder != holder}


class RecorderService:
    """Answers requests for the recorder of one store, in its own threads.

    `settle` brings all received to the lake; with `owners`, a claim on a run of another station is refused.
    """

    def __init__(self, store: Store, bus: Bus, settle: Callable[[], None], owners: RunOwners | None = None) -> None:
        self._store, self._bus, self._settle, self._owners = store, bus, settle, owners
        self._claims = Claims()
        self._catalog: Catalog | None = None
        self._closing = False
        # claims are answered at once, whatever else takes time
        self._quick: Queue[requests.Request] = Queue(_MOST_WAITING)
        self._slow: Queue[requests.Request] = Queue(_MOST_WAITING)
        self._threads = [
            threading.Thread(target=self._loop, args=(queue,), name="gyrofleet-service", daemon=True)
            for queue in (self._quick, self._slow)
        ]
        for thread in self._threads:
            thread.start()
        bus.subscribe(requests.REQUEST_KEY, self._on_request)

    def close(self) -> None:
        """Stop answering."""
        self._closing = True
        for thread in self._threads:
            thread.join()
        self._forget()

    def _on_request(self, _key: str, payload: bytes) -> None:
        try:
            request = requests.decode(payload, requests.Request)
        except WireError:
            return  # no one to answer
        if request.store not in {"", self._store.identity} or self._closing or not requests.is_id(request.id):
            return
        is_quick = isinstance(request.question, requests.Hello | requests.Claim | requests.Release)
        with suppress(Full):  # else it is requested again
            (self._quick if is_quick else self._slow).put_nowait(request)

    def _loop(self, queue: "Queue[requests.Request]") -> None:
        while not self._closing:
            try:
                request = queue.get(timeout=0.1)
            except Empty:
                continue
            try:
                reply = requests.Reply(
                    request.id, self._store.identity, self._answer(request.question), form=requests.FORM
                )
            except GyrofleetError as error:
                reply = requests.Reply(request.id, self._store.identity, error=str(error))
            except Exception as error:  # noqa: BLE001  the requester gets any error
                reply = requests.Reply(request.id, self._store.identity, error=f"{type(error).__name__}: {error}")
            with suppress(GyrofleetError):  # else it is requested again
                self._bus.publish(requests.reply_key(request.id), requests.encode(reply))

    def _answer(self, question: requests.Question) -> Any:
        match question:
            case requests.Hello():
                return str(self._store.folder.absolute())
            case requests.Claim():
                self._check_owners(question)
                return self._claims.claim(question, time.monotonic())
            case requests.Release():
                self._claims.release(question.holder)
                return None
            case requests.Settle():
                self._forget()
                self._settle()
                return None
        from storage.recording.knowledge import CatalogKnowledge, packed
        from storage.sql.catalog import Catalog  # a recorder without requests needs no DuckDB

        self._catalog = self._catalog or Catalog(self._store)
        knowledge = CatalogKnowledge(self._catalog)
        match question:
            case requests.AskSignals():
                return knowledge.signals(list(question.runs))
            case requests.AskRuns():
                return knowledge.runs(list(question.runs))
            case requests.AskSamples(unit, signal, run, first_ns, last_ns):
                times_ns, values = knowledge.samples(unit, signal, run, first_ns, last_ns)
                return packed(times_ns, values) if len(times_ns) <= requests.MOST_ROWS else None
        raise StoreError(f"a recorder of this version does not answer {type(question).__name__}")

    def _check_owners(self, claim: requests.Claim) -> None:
        if self._owners is None or not claim.station:
            return
        for run in sorted({run for _, run in claim.owners}):
            if (reason := self._owners.reason_against(run, claim.station)) is not None:
                raise StoreError(reason)

    def _forget(self) -> None:
        if self._catalog is not None:
            self._catalog.close()
            self._catalog = None
