"""The pages of runs: all of them, and one."""

from typing import Any

from analytics.serve.api import runs as api
from analytics.serve.api.operation import Call, link
from analytics.serve.pages.page import shown


@shown("/runs", "runs.html.jinja")
def list_runs(call: Call, asked: api.RunsAsked) -> dict[str, Any]:
    """All runs."""
    found = api.list_runs(call, asked)
    next_page = None if found.next is None else found.next.removeprefix("/api")
    return {"found": found, "next": next_page, "data": f"/api{call.url}"}


@shown("/runs/{run}", "run.html.jinja")
def run(call: Call, asked: api.RunAsked) -> dict[str, Any]:
    """One run."""
    found = api.run(call, asked)
    next_page = None if found.next is None else found.next.removeprefix("/api")
    return {"found": found, "next": next_page, "data": link("api", "runs", found.run.run), "zone": found.run.time_zone}
