"""The book of a store's alerts: what was raised, which targets took it, who acknowledged it; kept through kills."""

import hashlib
import threading
from collections.abc import Callable, Collection, Iterable, Sequence

from analytics.alerts.finding import Finding
from analytics.alerts.kept_alerts import Alert, AlertFile, Delivery, LogDocument
from analytics.alerts.rules import Rule
from analytics.loop.bilingual import Bilingual
from storage.store import Store
from stream.closing import Closing
from stream.events import AlertCleared, AlertRaised, AlertSent

RAISED = "raised"
CLEARED = "cleared"
ENDED = "ended"  # without passing
_KEPT_NS = 90 * 86_400 * 10**9
LONGEST_WAIT_S = 600.0

Parcel = list[tuple[Alert, Delivery]]
"""Messages that a target is given at once."""


class AlertBook(Closing):
    """The alerts of a store by id, for the one process that keeps them; for several threads.

    What changes is on disk after `save`, which the methods for senders call. `now_ns` is of a clock that nobody sets
    while the process works, `wall_ns` of that which people read. Raises StoreError if the book cannot be read.
    """

    def __init__(self, store: Store, now_ns: int) -> None:
        self._file = AlertFile(store)
        self.lock = threading.RLock()
        kept = self._file.kept
        self._alerts, self._to_log, self._segment = kept.alerts, kept.to_log, kept.segment
        self._changed: set[str] = set()
        self._changed_log: set[int] = set()
        self._number = max(self._to_log, default=0)
        for alert in self._alerts.values():  # the clock was set back while no process kept the book
            alert.since_ns, alert.seen_ns = min(alert.since_ns, now_ns), min(alert.seen_ns, now_ns)
        self._current = {
            (each.rule, each.key): each for each in self._alerts.values() if each.is_event or each.cleared_ns is None
        }
        self._waiting = {
            name: each for name, each in self._alerts.items() if any(sent.sent_ns is None for sent in each.deliveries)
        }

    @property
    def segment(self) -> str:
        """Segments of the log before this one need not be looked at again."""
        return self._segment

    def read_to(self, segment: str) -> None:
        """Note that every document before a segment was looked at."""
        with self.lock:
            self._segment = max(segment, self._segment)

    def hold(self, now_ns: int) -> None:
        """Take what lasts as seen now: nobody has looked meanwhile."""
        with self.lock:
            for alert in self._current.values():
                alert.seen_ns = max(alert.seen_ns, now_ns)

    def see(self, rule: Rule, finding: Finding, now_ns: int, wall_ns: int) -> None:
        """Take what a rule finds now; it is raised once it lasts as long as the rule asks."""
        with self.lock:
            alert = self._current.get((rule.name, finding.key))
            if alert is None:
                alert = Alert(
                    id=_id(rule, finding, now_ns), rule=rule.name, severity=rule.severity, key=finding.key,
                    subject=finding.subject, text=str(finding.text), text_zh=finding.text.zh, since_ns=now_ns,
                    is_event=finding.is_event, unit=finding.unit,
                )  # fmt: skip
                self._alerts[alert.id] = self._current[rule.name, finding.key] = alert
                self._changed.add(alert.id)
            alert.seen_ns, alert.ending, alert.ending_zh = now_ns, None, ""
            is_due = finding.is_event or now_ns - alert.since_ns >= rule.after_s * 1e9
            if alert.raised_ns is None and is_due:
                alert.raised_ns, alert.text, alert.text_zh = wall_ns, str(finding.text), finding.text.zh
                alert.deliveries += [Delivery(target=name, event=RAISED) for name in rule.to]
                self._mark_changed(alert)
                raised = AlertRaised(
                    run="", t_ns=wall_ns, uid=alert.id, rule=rule.name, severity=rule.severity, subject=alert.subject,
                    text=alert.text, text_zh=alert.text_zh, unit=alert.unit,
                )  # fmt: skip
                self._log(raised)

    def settle(
        self, rules: Iterable[Rule], now_ns: int, wall_ns: int, unknown: Collection[str] = (),
        ending: Callable[[Alert], Bilingual | None] = lambda _: None,
    ) -> None:  # fmt: skip
        """Clear lasting alerts that were not found for as long as their rule asks; forget old ones.

        Of the rules `unknown` nothing is known now: what they have found stays as it is. `ending` says how an alert
        ended that is no longer found, and is asked once; None if it passed.
        """
        clear_after = {rule.name: rule.clear_after_s for rule in rules}
        with self.lock:
            for alert in list(self._alerts.values()):
                if alert.rule in unknown and not alert.is_event and alert.cleared_ns is None:
                    alert.seen_ns = now_ns
                gone_s = (now_ns - alert.seen_ns) / 1e9
                if gone_s > 0.0 and alert.raised_ns and not alert.is_event and alert.ending is None:
                    found = None if alert.cleared_ns is not None else ending(alert)
                    alert.ending, alert.ending_zh = ("", "") if found is None else (str(found), found.zh)
                    self._changed.add(alert.id)
                if alert.raised_ns is None and gone_s > 0.0:
                    self._forget(alert)  # it did not last
                elif not alert.is_event and alert.cleared_ns is None and gone_s > clear_after.get(alert.rule, 0.0):
                    self._clear(alert, wall_ns)
                elif (alert.cleared_ns is not None or alert.is_event) and now_ns - alert.seen_ns > _KEPT_NS:
                    self._forget(alert)

    def acknowledge(self, alert_id: str, by: str, t_ns: int) -> None:
        """Note who has taken note of an alert, the first of them."""
        with self.lock:
            alert = self._alerts.get(alert_id)
            if alert is not None and alert.acknowledged_ns is None:
                alert.acknowledged_ns, alert.acknowledged_by = t_ns, by
                self._changed.add(alert_id)

    def due(self, target: str, now_ns: int, is_held: Callable[[Alert], bool]) -> Parcel:
        """Messages that a target is to have now, the oldest first, but those `is_held`; of an alert one by one."""
        with self.lock:
            found: Parcel = []
            for alert in self._waiting.values():
                first = next(
                    (each for each in alert.deliveries if each.target == target and each.sent_ns is None), None
                )
                if first is not None and _is_due(first, now_ns) and (first.mail or not is_held(alert)):
                    found.append((alert, first))
            return sorted(found, key=lambda each: each[0].raised_ns or 0)

    def wrap(self, parcel: Parcel) -> str:
        """Give messages that are sent as one an identity, which is on disk before they are sent."""
        with self.lock:
            names = "\0".join(f"{alert.id}.{delivery.event}" for alert, delivery in parcel)
            mail = hashlib.sha256(names.encode()).hexdigest()[:12]
            for alert, delivery in parcel:
                delivery.mail = mail
                self._changed.add(alert.id)
            self.save()
            return mail

    def sent(self, parcel: Parcel, wall_ns: int) -> None:
        """Note that a target has taken messages."""
        with self.lock:
            for alert, delivery in parcel:
                delivery.attempts, delivery.sent_ns, delivery.error = delivery.attempts + 1, wall_ns, ""
                self._mark_changed(alert)
                sent = AlertSent(
                    run="", t_ns=wall_ns, alert=alert.id, target=delivery.target, attempts=delivery.attempts
                )
                self._log(sent)
            self.save()

    def not_sent(self, parcel: Parcel, why: str, taken: Collection[str], now_ns: int, first_wait_s: float) -> None:
        """Note why a target has not taken messages, or which addresses have; they are tried again after a while."""
        with self.lock:
            for alert, delivery in parcel:
                wait_s = min(first_wait_s * 2.0 ** min(delivery.attempts, 10), LONGEST_WAIT_S)
                delivery.attempts, delivery.error = delivery.attempts + 1, why[:500]
                delivery.due_ns, delivery.taken = now_ns + round(wait_s * 1e9), (*delivery.taken, *taken)
                self._changed.add(alert.id)
            self.save()

    def waiting(self) -> dict[str, int]:
        """How many messages wait for each target."""
        with self.lock:
            counts: dict[str, int] = {}
            for alert in self._waiting.values():
                for each in alert.deliveries:
                    counts[each.target] = counts.get(each.target, 0) + (each.sent_ns is None)
            return {name: count for name, count in counts.items() if count}

    def to_log(self, most: int) -> Sequence[LogDocument]:
        """The first documents that the log does not have yet."""
        with self.lock:
            return [self._to_log[number] for number in sorted(self._to_log)[:most]]

    def logged(self, count: int) -> None:
        """Note that the log has the first so many."""
        with self.lock:
            for number in sorted(self._to_log)[:count]:
                del self._to_log[number]
                self._changed_log.add(number)
            self.save()

    def save(self) -> None:
        """Write what has changed; StoreError if the disk refuses, and then with the next time."""
        with self.lock:
            self._file.write(
                {name: self._alerts.get(name) for name in self._changed},
                {number: self._to_log.get(number) for number in self._changed_log}, self._segment,
            )  # fmt: skip
            self._changed.clear()
            self._changed_log.clear()

    def close(self) -> None:
        """Close the file."""
        with self.lock:
            self._file.close()

    def _mark_changed(self, alert: Alert) -> None:
        """Note that the messages of an alert have changed."""
        self._changed.add(alert.id)
        if any(each.sent_ns is None for each in alert.deliveries):
            self._waiting[alert.id] = alert
        else:
            self._waiting.pop(alert.id, None)

    def _forget(self, alert: Alert) -> None:
        del self._alerts[alert.id]
        self._waiting.pop(alert.id, None)
        if self._current.get((alert.rule, alert.key)) is alert:
            del self._current[alert.rule, alert.key]
        self._changed.add(alert.id)

    def _clear(self, alert: Alert, wall_ns: int) -> None:
        alert.cleared_ns = wall_ns
        self._current.pop((alert.rule, alert.key), None)
        alert.deliveries += [
            Delivery(target=each.target, event=ENDED if alert.ending else CLEARED)
            for each in alert.deliveries
            if each.event == RAISED
        ]
        self._mark_changed(alert)
        self._log(
            AlertCleared(
                run="", t_ns=wall_ns, alert=alert.id, text=alert.ending or "", text_zh=alert.ending_zh, unit=alert.unit
            )
        )

    def _log(self, document: LogDocument) -> None:
        self._number += 1
        self._to_log[self._number] = document
        self._changed_log.add(self._number)


def _id(rule: Rule, finding: Finding, now_ns: int) -> str:
    """Identity of an alert; of an event the same however often it is read."""
    when = "" if finding.is_event else str(now_ns)
    return hashlib.sha256(f"{rule.name}\0{finding.key}\0{when}".encode()).hexdigest()[:12]


def _is_due(delivery: Delivery, now_ns: int) -> bool:
    """Whether its time has come; a time that no wait explains is of a clock that was set back."""
    return delivery.due_ns <= now_ns or delivery.due_ns > now_ns + LONGEST_WAIT_S * 1e9
