"""The page of the store."""

from typing import Any

from analytics.serve.api import alerts, events
from analytics.serve.api import store as api
from analytics.serve.api.operation import Call, Nothing
from analytics.serve.pages.frame.page import shown


@shown("/store", "store.html.jinja", shared_s=1.0)
def store(call: Call, asked: Nothing) -> dict[str, Any]:
    """Verification, alerts, disk, log, lake, delivery, clocks, events, notes."""
    jobs = [job for job in call.service.jobs.all() if job.kind == "verify"]
    return {
        "found": api.store(call, asked),
        "jobs": jobs,
        "alerts": alerts.list_alerts(call, alerts.AlertsAsked()).alerts,
        "kinds": events.kinds_of(call),
        "data": "/api/store",
    }
