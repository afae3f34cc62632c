"""The pages of units: all of them, and one."""

from typing import Any

from analytics.serve.api import units as api
from analytics.serve.api.operation import Call, Nothing, link
from analytics.serve.pages.page import shown


@shown("/units", "units.html.jinja")
def list_units(call: Call, asked: api.UnitsAsked) -> dict[str, Any]:
    """All units."""
    found = api.list_units(call, asked)
    return {"found": found, "next": _page_link(found.next), "data": f"/api{call.url}"}


@shown("/units/{unit}", "unit.html.jinja", is_slow=True)
def unit(call: Call, asked: Nothing) -> dict[str, Any]:
    """One unit."""
    found = api.unit(call, asked)
    return {"found": found, "data": link("api", "units", found.unit)}


def _page_link(url: str | None) -> str | None:
    return None if url is None else url.removeprefix("/api")
