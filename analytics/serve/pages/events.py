"""The page of events: documents of the store with filters."""

from typing import Any

import msgspec

from analytics.serve.api import events as api
from analytics.serve.api.operation import Call
from analytics.serve.pages.page import shown

_SHOWN_CHARACTERS = 400
_TOLD = (
    "action", "procedure", "step", "specification", "name", "revision", "version", "stage", "product", "lot", "slot",
    "limit", "metric", "verdict", "outcome", "what", "alert", "target", "text", "note", "reason",
)  # fmt: skip


@shown("/events", "events.html.jinja")
def events(call: Call, asked: api.EventsAsked) -> dict[str, Any]:
    """The documents."""
    found = api.list_events(call, asked)
    next_page = None if found.next is None else found.next.removeprefix("/api")
    rows = [(row, summary(row.document), _text(row.document)) for row in found.events]
    return {"found": found, "rows": rows, "next": next_page, "data": f"/api{call.url}"}


def summary(document: dict[str, Any]) -> str:
    """What a document says in a few words: its texts, outcomes and reasons.

    >>> summary({"kind": "RunEnded", "outcome": "completed", "streams": [1]})
    'completed'
    >>> summary({"specification": "FOG", "revision": "A", "action": "add", "reason": "first"})
    'add, FOG, A, first'
    """
    told = [str(document[name]) for name in _TOLD if isinstance(document.get(name), str | int | float)]
    text = ", ".join(each for each in told if each)
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]} ..."


def _text(document: dict[str, Any]) -> str:
    """The content of a document in one line, without what its row shows."""
    rest = {name: each for name, each in document.items() if name not in {"kind", "run", "unit", "t_ns", "uid"}}
    text = msgspec.json.encode(rest).decode()
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]} ..."
