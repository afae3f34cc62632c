"""The page of what is at work, and of the alerts."""

from typing import Any

from analytics.serve.api import at_work as api
from analytics.serve.api.operation import Call, Nothing
from analytics.serve.pages.page import shown


@shown("/work", "at_work.html.jinja")
def at_work(call: Call, asked: api.AlertsAsked) -> dict[str, Any]:
    """Roles, troubles, alerts."""
    return {
        "found": api.status(call, Nothing()), "alerts": api.alerts(call, asked).alerts, "data": "/api/status",
        "has_table": False,
    }  # fmt: skip
