"""The book of a store's alerts: what was raised, who was told, who has taken note; kept through kills."""

import hashlib
import threading
from collections.abc import Iterable
from pathlib import Path

import msgspec

from analytics.alerts.finding import Finding
from analytics.alerts.rules import Rule
from storage.store import Store
from stream.atomic_file import write_durably
from stream.errors import StoreError
from stream.events import AlertCleared, AlertRaised, AlertSent

FOLDER = "alerts"
RAISED = "raised"
CLEARED = "cleared"
_KEPT_NS = 90 * 86_400 * 10**9
_FIRST_WAIT_S = 5.0
_LONGEST_WAIT_S = 600.0


class Delivery(msgspec.Struct, kw_only=True):
    """One message to one target; `sent_ns` is None until the target has taken it."""

    target: str
    event: str
    attempts: int = 0
    due_ns: int = 0
    sent_ns: int | None = None
    error: str = ""


class Alert(msgspec.Struct, kw_only=True):
    """An alert; `since_ns` is since when its condition lasts, `raised_ns` since when people are told of it."""

    id: str
    rule: str
    severity: str
    key: str
    subject: str
    text: str
    text_zh: str
    since_ns: int
    is_event: bool
    unit: str | None = None
    seen_ns: int = 0
    raised_ns: int | None = None
    cleared_ns: int | None = None
    acknowledged_ns: int | None = None
    acknowledged_by: str = ""
    deliveries: list[Delivery] = []


class _Pages(msgspec.Struct, kw_only=True):
    format: int = 1
    segment: str = ""  # up to which segment of the log, exclusive, every document was looked at
    alerts: dict[str, Alert] = {}
    to_log: list[AlertRaised | AlertCleared | AlertSent] = []


class AlertBook:
    """The alerts of a store by id; every change is on disk when its method returns. For several threads.

    Raises StoreError if the book cannot be read.
    """

    def __init__(self, store: Store) -> None:
        self._path = store.folder / FOLDER / "alerts.json"
        self.lock = threading.RLock()
        self._pages = _read(self._path)
        alerts = self._pages.alerts.values()
        self._current = {(each.rule, each.key): each for each in alerts if each.is_event or each.cleared_ns is None}
        self._is_changed = False

    @property
    def segment(self) -> str:
        """Segments of the log before this one need not be looked at again."""
        return self._pages.segment

    def read_to(self, segment: str) -> None:
        """Note that every document before a segment was looked at."""
        with self.lock:
            self._is_changed |= segment != self._pages.segment
            self._pages.segment = segment

    def alerts(self) -> list[Alert]:
        """All alerts, the newest first."""
        with self.lock:
            found = [each for each in self._pages.alerts.values() if each.raised_ns is not None]
            return sorted(found, key=lambda each: -(each.raised_ns or 0))

    def see(self, rule: Rule, finding: Finding, now_ns: int) -> None:
        """Take what a rule finds now; it is raised once it lasts as long as the rule asks."""
        with self.lock:
            alert = self._current.get((rule.name, finding.key))
            if alert is None:
                alert = Alert(
                    id=_id(rule, finding, now_ns), rule=rule.name, severity=rule.severity, key=finding.key,
                    subject=finding.subject, text=str(finding.text), text_zh=finding.text.zh, since_ns=now_ns,
                    is_event=finding.is_event, unit=finding.unit,
                )  # fmt: skip
                self._pages.alerts[alert.id] = self._current[rule.name, finding.key] = alert
            alert.seen_ns = now_ns
            is_lasting = finding.is_event or now_ns - alert.since_ns >= rule.after_s * 1e9
            if alert.raised_ns is None and is_lasting:
                alert.raised_ns, alert.text, alert.text_zh = now_ns, str(finding.text), finding.text.zh
                alert.deliveries += [Delivery(target=name, event=RAISED) for name in rule.to]
                raised = AlertRaised(
                    run="", t_ns=now_ns, uid=alert.id, rule=rule.name, severity=rule.severity, subject=alert.subject,
                    text=alert.text, text_zh=alert.text_zh, unit=alert.unit,
                )  # fmt: skip
                self._log(raised)

    def settle(self, rules: Iterable[Rule], now_ns: int) -> None:
        """Clear lasting alerts that were not found for as long as their rule asks; forget old ones."""
        clear_after = {rule.name: rule.clear_after_s for rule in rules}
        with self.lock:
            for alert in list(self._pages.alerts.values()):
                gone_s = (now_ns - alert.seen_ns) / 1e9
                if alert.raised_ns is None and gone_s > 0.0:
                    self._forget(alert)  # it did not last
                elif not alert.is_event and alert.cleared_ns is None and gone_s > clear_after.get(alert.rule, 0.0):
                    self._clear(alert, now_ns)
                elif _is_over(alert) and now_ns - alert.seen_ns > _KEPT_NS:
                    self._forget(alert)
            self.save()

    def acknowledge(self, alert_id: str, by: str, t_ns: int) -> bool:
        """Note who has taken note of an alert; whether it is there."""
        with self.lock:
            alert = self._pages.alerts.get(alert_id)
            if alert is not None and alert.acknowledged_ns is None:
                alert.acknowledged_ns, alert.acknowledged_by, self._is_changed = t_ns, by, True
            return alert is not None

    def due(self, target: str, now_ns: int) -> list[tuple[Alert, Delivery]]:
        """Messages that a target is to have now, the oldest first."""
        with self.lock:
            return [
                (alert, delivery)
                for alert in sorted(self._pages.alerts.values(), key=lambda each: each.raised_ns or 0)
                for delivery in alert.deliveries
                if delivery.target == target and delivery.sent_ns is None and delivery.due_ns <= now_ns
            ]

    def sent(self, alert: Alert, delivery: Delivery, now_ns: int) -> None:
        """Note that a target has taken a message."""
        with self.lock:
            delivery.attempts, delivery.sent_ns, delivery.error = delivery.attempts + 1, now_ns, ""
            self._log(
                AlertSent(run="", t_ns=now_ns, alert=alert.id, target=delivery.target, attempts=delivery.attempts)
            )
            self.save()

    def not_sent(self, delivery: Delivery, why: str, now_ns: int) -> None:
        """Note why a target has not taken a message; it is tried again after a while."""
        with self.lock:
            wait_s = min(_FIRST_WAIT_S * 2.0 ** min(delivery.attempts, 10), _LONGEST_WAIT_S)
            delivery.attempts, delivery.error = delivery.attempts + 1, why[:500]
            delivery.due_ns = now_ns + round(wait_s * 1e9)
            self._is_changed = True
            self.save()

    def to_log(self) -> list[AlertRaised | AlertCleared | AlertSent]:
        """Documents that the log does not have yet."""
        with self.lock:
            return list(self._pages.to_log)

    def logged(self, count: int) -> None:
        """Note that the log has the first so many."""
        with self.lock:
            self._pages.to_log = self._pages.to_log[count:]
            self._is_changed = True
            self.save()

    def save(self) -> None:
        """Write what has changed; StoreError if the disk refuses."""
        with self.lock:
            if not self._is_changed:
                return
            try:
                self._path.parent.mkdir(exist_ok=True)
                write_durably(self._path, msgspec.json.encode(self._pages))
            except OSError as error:
                raise StoreError(f"{self._path} cannot be written: {error}; free or repair the disk") from error
            self._is_changed = False

    def _forget(self, alert: Alert) -> None:
        del self._pages.alerts[alert.id]
        if self._current.get((alert.rule, alert.key)) is alert:
            del self._current[alert.rule, alert.key]
        self._is_changed = True

    def _clear(self, alert: Alert, now_ns: int) -> None:
        alert.cleared_ns = now_ns
        self._current.pop((alert.rule, alert.key), None)
        alert.deliveries += [
            Delivery(target=each.target, event=CLEARED) for each in alert.deliveries if each.event == RAISED
        ]
        self._log(AlertCleared(run="", t_ns=now_ns, alert=alert.id))

    def _log(self, document: AlertRaised | AlertCleared | AlertSent) -> None:
        self._pages.to_log.append(document)
        self._is_changed = True


def _read(path: Path) -> _Pages:
    try:
        return msgspec.json.decode(path.read_bytes(), type=_Pages)
    except FileNotFoundError:
        return _Pages()
    except (OSError, msgspec.MsgspecError) as error:
        raise StoreError(
            f"the alerts {path} cannot be read: {error}; move the file away, later alerts are kept in a new one"
        ) from error


def _id(rule: Rule, finding: Finding, now_ns: int) -> str:
    """Identity of an alert; of an event the same however often it is read."""
    when = "" if finding.is_event else str(now_ns)
    return hashlib.sha256(f"{rule.name}\0{finding.key}\0{when}".encode()).hexdigest()[:12]


def _is_over(alert: Alert) -> bool:
    is_told = all(each.sent_ns is not None for each in alert.deliveries)
    return is_told and (alert.cleared_ns is not None or alert.is_event)
