"""Alerts of the store, and who takes note of them."""

import time
from typing import Annotated, Any, Literal

import msgspec

from analytics.alerts.kept_alerts import Alert, raised_alerts
from analytics.alerts.service import PLACE
from analytics.serve.api.operation import Call, get, post
from analytics.serve.api.rows import iso
from analytics.serve.doors.roles import Role
from storage.recording.client import record_documents
from stream.errors import NotFound
from stream.events import AlertAcknowledged

_ROLE = "gyrofleet serve"


class AlertsAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which alerts: open ones, or all that are kept; of one severity if it is given."""

    which: Literal["open", "all"] = "open"
    severity: Literal["", "alarm", "warning"] = ""


class AlertRow(msgspec.Struct, frozen=True, kw_only=True):
    """An alert; open until it is cleared, or, if it happened at a moment, until somebody takes note of it."""

    id: str
    rule: str
    severity: str
    subject: str
    text: str
    text_zh: str
    unit: str | None
    is_open: bool
    raised_ns: int | None
    raised: str | None
    cleared_ns: int | None
    ending: str  # how it ended without passing; empty otherwise
    ending_zh: str
    acknowledged_ns: int | None
    acknowledged_by: str
    sent: list[str]
    not_sent: dict[str, str]


class Alerts(msgspec.Struct, frozen=True, kw_only=True):
    """Alerts, the newest first."""

    alerts: list[AlertRow]


class AcknowledgementAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A word to it."""

    note: Annotated[str, msgspec.Meta(max_length=1000)] = ""


class Acknowledgement(msgspec.Struct, frozen=True, kw_only=True):
    """The acknowledgement as it stands in the log."""

    document: dict[str, Any]


@get("/api/alerts", table="alerts", is_kept=False)
def list_alerts(call: Call, asked: AlertsAsked) -> Alerts:
    """Alerts that `gyrofleet alert run` has raised: open ones, or all."""
    rows = []
    for alert in raised_alerts(call.store):
        if (asked.which == "open" and not _is_open(alert)) or asked.severity not in ("", alert.severity):
            continue
        rows.append(alert_row(alert))
    return Alerts(alerts=rows)


def alert_row(alert: Alert) -> AlertRow:
    """An alert as an answer."""
    names = ("id", "rule", "severity", "subject", "text", "text_zh", "unit", "raised_ns", "cleared_ns")
    values = {name: getattr(alert, name) for name in (*names, "acknowledged_ns", "acknowledged_by")}
    sent = [each.target for each in alert.deliveries if each.sent_ns is not None]
    not_sent = {each.target: each.error for each in alert.deliveries if each.sent_ns is None}
    values |= {"ending": alert.ending or "", "ending_zh": alert.ending_zh}
    return AlertRow(**values, is_open=_is_open(alert), raised=iso(alert.raised_ns), sent=sent, not_sent=not_sent)


def _is_open(alert: Alert) -> bool:
    return alert.acknowledged_ns is None if alert.is_event else alert.cleared_ns is None


@post("/api/alerts/{alert}/acknowledge", role=Role.OPERATOR)
def acknowledge_alert(call: Call, asked: AcknowledgementAsked) -> Acknowledgement:
    """Take note of an alert; the log has who did."""
    name = call.path["alert"]
    if name not in {each.id for each in raised_alerts(call.store)}:
        raise NotFound(f"there is no alert {name!r}; /api/alerts?which=all lists them")
    by = call.person.actor
    document = AlertAcknowledged(
        run="", t_ns=time.time_ns(), alert=name, by=by.name, identity=by.identity, note=asked.note
    )
    record_documents(call.store, [document], role=_ROLE, place=PLACE, builds_lake=True)
    return Acknowledgement(document=msgspec.to_builtins(document))
