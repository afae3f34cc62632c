"""The service that looks at a store and tells people: one thread looks, one for each target sends."""

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from analytics.alerts.book import AlertBook
from analytics.alerts.finding import AlertView, Finding
from analytics.alerts.kept_alerts import Alert
from analytics.alerts.last_samples import LastSamples
from analytics.alerts.rules import Rule, Rules
from analytics.alerts.rules_file import RulesFile
from analytics.alerts.sender import TargetSender
from analytics.first_floor import fill_floor
from analytics.floor import Floor
from analytics.loop.bilingual import Bilingual
from storage.log.files import sealed_segments
from storage.log.follower import LogFollower
from storage.manifests.lake import read_manifest
from storage.recording.client import record_documents
from storage.recording.store_status import store_status
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.closing import Closing
from stream.errors import GyrofleetError, StoreError
from stream.events import AlertAcknowledged, AnyDocument
from stream.identity import Place
from stream.status.role_status import Role, RoleStatus, new_status

_LOG_AGAIN_S = 5.0
_LOGGED_AT_ONCE = 2_000
_LATE_LOOK_S = 60.0
PLACE = Place("local", "alerts")


class AlertService(Closing):
    """Looks at a store by `look`, as often as its caller likes, and sends in threads of its own.

    `report` gets sentences for people. An alert is in the book, on disk, before it is sent, and its message is sent
    until the target takes it: a kill loses none. A file of rules that changes is read again; while it is wrong the
    rules stay as they were. Raises BadInput for wrong rules, StoreError if the book or the log cannot be read.
    """

    def __init__(self, store: Store, rules_path: Path, report: Callable[[str], None]) -> None:
        self._store, self._report = store, report
        self._file = RulesFile(rules_path)
        self._began_ns = time.time_ns()
        self._zero_ns = self._began_ns - time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        self._book = AlertBook(store, self._now_ns())
        sealed = {path.stem for path in sealed_segments(store)}
        if not self._book.segment:  # what was before the first alert service is not reported
            self._book.read_to(max(sealed, default="") + "+")
        self._book.hold(self._now_ns())
        self._floor, self._last_samples = Floor(), LastSamples()
        done = {segment for segment in sealed if segment < self._book.segment}
        self._follower = LogFollower(store, without=done & self._fill_floor(), unread=True)
        self._kept: dict[str, tuple[float, list[Finding] | GyrofleetError]] = {}
        self._log_at = 0.0
        self._looked_s = time.monotonic()
        self._problems: dict[str, str] = {}
        self._senders: dict[str, TargetSender] = {}
        self._take_rules(Rules(rules=(), targets={}, quiet={}))

    @property
    def rules(self) -> Rules:
        """The rules now."""
        return self._file.rules

    def look(self) -> None:
        """Look once: raise, clear, log."""
        self._look_at_rules()
        segment, documents = self._look_at_log()
        now_ns, wall_ns = self._now_ns(), time.time_ns()
        self._last_samples.look(self._floor.units, now_ns, wall_ns)
        view = AlertView(
            now_ns=now_ns, began_ns=self._began_ns, documents=documents, units=self._floor.units,
            last_sample_ns=self._last_samples.last_sample_ns, status=store_status(self._store),
            damaged_bytes=self._follower.damaged_bytes, store=self._store, kept=self._kept,
        )  # fmt: skip
        unknown = {rule.name for rule in self.rules.rules if not self._is_applied(rule, view, wall_ns)}
        for document in documents:
            if isinstance(document, AlertAcknowledged):
                self._book.acknowledge(document.alert, document.by, document.t_ns)
        if segment:  # its earlier ones are complete; it may still be open
            self._book.read_to(segment)
        conditions = {rule.name: rule.condition for rule in self.rules.rules}

        def ending(alert: Alert) -> Bilingual | None:
            condition = conditions.get(alert.rule)
            return None if condition is None else condition.ending(alert.key, alert.raised_ns or 0, view)

        self._book.settle(self.rules.rules, now_ns, wall_ns, unknown, ending)
        self._save()
        self._log()
        for name, sender in self._senders.items():
            if not sender.is_alive:
                raise StoreError(f"the thread that sends to {name} has ended by an error; start the command again")
        self._looked_s = time.monotonic()

    def _look_at_rules(self) -> None:
        before = self.rules
        self._problem("rules", self._file.look())
        if self.rules is not before:
            self._report(f"the rules {self._file.path} are read again")
            self._take_rules(before)

    def _look_at_log(self) -> tuple[str, list[AnyDocument]]:
        """The last segment with news, and new documents."""
        segment, documents = "", list[AnyDocument]()
        for message in self._follower.poll():
            segment = max(segment, message.segment)
            document = self._floor.take_message(message)
            if document is not None and message.segment >= self._book.segment:
                documents.append(document)
        self._floor.forget_changes()
        return segment, documents

    def _is_applied(self, rule: Rule, view: AlertView, wall_ns: int) -> bool:
        """Take what a rule finds; whether that is known."""
        try:
            for finding in rule.condition.findings(view):
                if rule.concerns(finding):
                    self._book.see(rule, finding, view.now_ns, wall_ns)
        except GyrofleetError as error:
            self._problem(f"rule {rule.name}", str(error))
            return False
        self._problem(f"rule {rule.name}", "")
        return True

    def status(self) -> RoleStatus:
        """What it reports of itself."""
        waiting = self._book.waiting()
        late_s = time.monotonic() - self._looked_s
        troubles = [*self._problems.values(), *(each.trouble for each in list(self._senders.values()) if each.trouble)]
        troubles += [f"it has not looked for {late_s:.0f} s"] if late_s > _LATE_LOOK_S else []
        numbers = {"waiting_messages": float(sum(waiting.values())), "rules": float(len(self.rules.rules))}
        return new_status(Role.ALERT, self._began_ns, trouble="; ".join(troubles)[:4000], numbers=numbers)

    def close(self) -> None:
        """Stop; what was not sent is sent after the next start."""
        for sender in self._senders.values():
            sender.close()
        self._follower.close()
        with suppress(StoreError):
            self._book.save()
        self._book.close()

    def _now_ns(self) -> int:
        """The time by a clock that nobody sets; it begins with the computer's time."""
        return self._zero_ns + time.clock_gettime_ns(time.CLOCK_BOOTTIME)

    def _fill_floor(self) -> set[str]:
        """Put what the lake knows of runs at work on the floor; the segments that it knows."""
        manifest = read_manifest(self._store)
        with Catalog(self._store, parts=manifest.parts) as catalog:
            fill_floor(self._floor, catalog)
        return set(manifest.segments)

    def _take_rules(self, before: Rules) -> None:
        """Begin to send as the rules say now."""
        rules = self.rules
        for name, sender in list(self._senders.items()):
            if (rules.targets.get(name), rules.quiet.get(name)) != (before.targets[name], before.quiet.get(name)):
                sender.close()
                del self._senders[name]
        for name in rules.targets.keys() - self._senders.keys():
            self._senders[name] = TargetSender(
                name, rules.targets[name], rules.quiet.get(name), self._book, str(self._store.folder), self._report,
                self._now_ns,
            )  # fmt: skip
        for name, count in sorted(self._book.waiting().items()):
            if name not in rules.targets:
                self._report(f"{count} messages wait for the target {name}, which the rules do not have")

    def _save(self) -> None:
        try:
            self._book.save()
        except StoreError as error:  # it is sent all the same; after a kill perhaps twice
            self._problem("book", str(error))
        else:
            self._problem("book", "")

    def _log(self) -> None:
        """Bring what happened to the log; later if a writer takes no messages now."""
        documents = self._book.to_log(_LOGGED_AT_ONCE)
        if documents and time.monotonic() >= self._log_at:
            try:
                record_documents(self._store, documents, role="gyrofleet alert", place=PLACE, builds_lake=True)
                self._book.logged(len(documents))
            except GyrofleetError:
                self._log_at = time.monotonic() + _LOG_AGAIN_S

    def _problem(self, name: str, text: str) -> bool:
        """Keep what is wrong, and report it once; whether nothing is wrong."""
        if text and self._problems.get(name) != text:
            self._report(text if name in {"book", "rules"} else f"{name}: {text}")
        if text:
            self._problems[name] = text
        else:
            self._problems.pop(name, None)
        return not text
