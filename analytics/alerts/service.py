"""The service that looks at a store and tells people: one thread looks, one for each target sends."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from analytics.alerts.book import Alert, AlertBook, Delivery
from analytics.alerts.finding import AlertView, Finding
from analytics.alerts.rules import ALARM, Rules
from analytics.alerts.targets import Message
from analytics.floor import Floor
from storage.log.files import sealed_segments
from storage.log.follower import LogFollower
from storage.recording.client import record_documents
from storage.recording.store_status import store_status
from storage.store import Store
from stream.closing import Closing
from stream.errors import GyrofleetError, StoreError
from stream.events import AlertAcknowledged, AnyDocument
from stream.identity import Place

_LOOK_EVERY_S = 1.0
_SEND_EVERY_S = 0.5
_LOG_AGAIN_S = 5.0
PLACE = Place("local", "alerts")


class AlertService(Closing):
    """Looks at a store by `look`, as often as its caller likes, and sends in threads of its own.

    `report` gets sentences for people. An alert is in the book, on disk, before it is sent, and its message is sent
    until the target takes it: a kill loses none. Raises StoreError if the book or the log cannot be read.
    """

    def __init__(self, store: Store, rules: Rules, report: Callable[[str], None]) -> None:
        self._store, self._rules, self._report = store, rules, report
        self._book = AlertBook(store)
        self._began_ns = time.time_ns()
        sealed = {path.stem for path in sealed_segments(store)}
        if not self._book.segment:  # what was before the first alert service is not told
            self._book.read_to(max(sealed, default="") + "+")
        done = {segment for segment in sealed if segment < self._book.segment}
        self._follower = LogFollower(store, without=done)
        self._floor = Floor()
        self._kept: dict[str, tuple[int, list[Finding]]] = {}
        self._log_at = 0.0
        self._closing = threading.Event()
        self._threads = [threading.Thread(target=self._send_loop, args=(name,), daemon=True) for name in rules.targets]
        for thread in self._threads:
            thread.start()

    def look(self) -> None:
        """Look once: raise, clear, log."""
        segment, documents = "", list[AnyDocument]()
        for message in self._follower.poll():
            segment = max(segment, message.segment)
            if (document := self._floor.take_message(message)) is not None:
                documents.append(document)
        self._floor.forget_changes()
        now_ns = time.time_ns()
        view = AlertView(
            now_ns=now_ns, began_ns=self._began_ns, documents=documents, units=self._floor.units,
            status=store_status(self._store), damaged_bytes=self._follower.damaged_bytes, store=self._store,
            kept=self._kept,
        )  # fmt: skip
        for rule in self._rules.rules:
            for finding in self._findings(rule.condition.findings(view), rule.name):
                if rule.concerns(finding):
                    self._book.see(rule, finding, now_ns)
        for document in documents:
            if isinstance(document, AlertAcknowledged):
                self._book.acknowledge(document.alert, document.by, document.t_ns)
        if segment:  # its earlier ones are complete; it may still be open
            self._book.read_to(segment)
        self._book.settle(self._rules.rules, now_ns)
        self._log()

    def close(self) -> None:
        """Stop; what was not sent is sent after the next start."""
        self._closing.set()
        for thread in self._threads:
            thread.join()
        self._follower.close()

    def _findings(self, found: Iterator[Finding], rule: str) -> Iterator[Finding]:
        try:
            yield from found
        except GyrofleetError as error:
            self._report(f"rule {rule}: {error}")

    def _log(self) -> None:
        """Bring what happened to the log; later if a writer takes no messages now."""
        documents = self._book.to_log()
        if documents and time.monotonic() >= self._log_at:
            try:
                record_documents(self._store, documents, role="gyrofleet alert", place=PLACE, builds_lake=True)
                self._book.logged(len(documents))
            except GyrofleetError:
                self._log_at = time.monotonic() + _LOG_AGAIN_S

    def _send_loop(self, name: str) -> None:
        while not self._closing.wait(_SEND_EVERY_S):
            for alert, delivery in self._book.due(name, time.time_ns()):
                if self._closing.is_set():
                    return
                if not self._is_quiet(name, alert) and not self._is_sent(name, alert, delivery):
                    break  # the others wait as well, in their order

    def _is_quiet(self, name: str, alert: Alert) -> bool:
        quiet = self._rules.quiet.get(name)
        if quiet is None or (alert.severity == ALARM and not quiet.holds_alarms):
            return False
        return quiet.covers(time.time_ns())

    def _is_sent(self, name: str, alert: Alert, delivery: Delivery) -> bool:
        """Send a message; whether the target has taken it."""
        message = Message(
            id=alert.id, event=delivery.event, rule=alert.rule, severity=alert.severity, subject=alert.subject,
            text=alert.text, text_zh=alert.text_zh, raised_ns=alert.raised_ns or 0, store=str(self._store.folder),
        )  # fmt: skip
        try:
            self._rules.targets[name].send(message)
        except GyrofleetError as error:
            self._report(f"{name} does not take alert {alert.id}: {error}; it is sent again")
            with suppress(StoreError):
                self._book.not_sent(delivery, str(error), time.time_ns())
            return False
        with suppress(StoreError):
            self._book.sent(alert, delivery, time.time_ns())
        return True
