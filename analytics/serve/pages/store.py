"""The page of the store."""

from typing import Any

from analytics.serve.api import store as api
from analytics.serve.api.operation import Call, Nothing
from analytics.serve.pages.page import shown


@shown("/store", "store.html.jinja")
def store(call: Call, asked: Nothing) -> dict[str, Any]:
    """Log, lake, disk, clocks, notes, verification."""
    jobs = [job for job in call.service.jobs.all() if job.kind == "verify"]
    return {"found": api.store(call, asked), "jobs": jobs, "data": "/api/store"}
