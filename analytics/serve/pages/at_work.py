"""The page of what is at work, and of the alerts."""

from typing import Any

from analytics.serve.api import alerts, store
from analytics.serve.api.operation import Call, Nothing
from analytics.serve.pages.frame.page import shown


@shown("/work", "at_work.html.jinja")
def at_work(call: Call, asked: alerts.AlertsAsked) -> dict[str, Any]:
    """Roles, troubles, alerts."""
    return {
        "found": store.status(call, Nothing()), "alerts": alerts.list_alerts(call, asked).alerts, "data": "/api/status",
        "has_table": False,
    }  # fmt: skip
