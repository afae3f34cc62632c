"""The page of what waits for a second person."""

from typing import Any

from analytics.serve.api import proposals as api
from analytics.serve.api.operation import Call
from analytics.serve.pages.frame.page import shown


@shown("/proposals", "proposals.html.jinja")
def proposals(call: Call, asked: api.ProposalsAsked) -> dict[str, Any]:
    """Proposals, with forms to approve and reject."""
    return {"found": api.list_proposals(call, asked), "data": "/api/proposals"}
