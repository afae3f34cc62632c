"""What is at work on the store, and the alerts."""

import time
from typing import Annotated, Any

import msgspec

from analytics.alerts.book import AlertBook
from analytics.serve.api.operation import Call, Nothing, get, post
from analytics.serve.api.rows import iso
from analytics.serve.doors.roles import Role
from ingest.importing.entered import enter
from storage.recording.store_status import StoreStatus, store_status
from stream.errors import NotFound
from stream.events import AlertAcknowledged


class AlertsAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which alerts: the open ones, or `every` one."""

    every: bool = False


class AlertRow(msgspec.Struct, frozen=True, kw_only=True):
    """An alert; `waiting` are the messages that no target has taken yet."""

    id: str
    rule: str
    severity: str
    subject: str
    unit: str | None
    text: str
    text_zh: str
    raised_ns: int
    raised: str | None
    cleared_ns: int | None
    acknowledged_ns: int | None
    acknowledged_by: str
    waiting: int


class Alerts(msgspec.Struct, frozen=True, kw_only=True):
    """Alerts, the newest first."""

    alerts: list[AlertRow]


class AcknowledgeAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What was done about an alert."""

    note: Annotated[str, msgspec.Meta(max_length=1000)] = ""


class Acknowledged(msgspec.Struct, frozen=True, kw_only=True):
    """The document that stands in the log."""

    document: dict[str, Any]


@get("/api/status", is_kept=False)
def status(call: Call, asked: Nothing) -> StoreStatus:
    """Roles at work, runs with step and time left, units by verdict so far, disk, and what is wrong."""
    del asked
    return store_status(call.store)


@get("/api/alerts", table="alerts", is_kept=False)
def alerts(call: Call, asked: AlertsAsked) -> Alerts:
    """Alerts of `gyrofleet alert run`, the newest first."""
    rows = []
    for each in AlertBook(call.store).alerts():
        if asked.every or (each.cleared_ns is None and each.acknowledged_ns is None):
            names = ("id", "rule", "severity", "subject", "unit", "text", "text_zh", "cleared_ns")
            rows.append(
                AlertRow(
                    **{name: getattr(each, name) for name in names}, raised_ns=each.raised_ns or 0,
                    raised=iso(each.raised_ns or 0), acknowledged_ns=each.acknowledged_ns,
                    acknowledged_by=each.acknowledged_by,
                    waiting=sum(delivery.sent_ns is None for delivery in each.deliveries),
                )
            )  # fmt: skip
    return Alerts(alerts=rows)


@post("/api/alerts/{alert}/acknowledge", role=Role.OPERATOR)
def acknowledge_alert(call: Call, asked: AcknowledgeAsked) -> Acknowledged:
    """Take note of an alert; the log has who did, and `gyrofleet alert run` reads it there."""
    alert = call.path["alert"]
    if alert not in {each.id for each in AlertBook(call.store).alerts()}:
        raise NotFound(f"there is no alert {alert!r}; /api/alerts?every=true lists them")
    document = AlertAcknowledged(run="", t_ns=time.time_ns(), alert=alert, by=call.person.name, note=asked.note.strip())
    enter(call.store.folder, [document], role="gyrofleet serve")
    return Acknowledged(document=msgspec.to_builtins(document))
