"""The page of events: documents of the store with filters."""

from typing import Any

import msgspec

from analytics.floor import step_text
from analytics.serve.api import events as api
from analytics.serve.api.operation import Call
from analytics.serve.pages.page import shown
from analytics.serve.pages.zones import common_zone, zoned
from stream.events import StepWords

_SHOWN_CHARACTERS = 400
_TOLD = (
    "action", "procedure", "step", "specification", "name", "revision", "version", "stage", "product", "lot", "slot",
    "limit", "metric", "verdict", "outcome", "what", "alert", "target", "text", "note", "reason",
)  # fmt: skip


@shown("/events", "events.html.jinja")
def events(call: Call, asked: api.EventsAsked) -> dict[str, Any]:
    """The documents."""
    zone = common_zone(call)
    found = api.list_events(
        call, msgspec.structs.replace(asked, from_=zoned(asked.from_, zone), to=zoned(asked.to, zone))
    )
    next_page = None if found.next is None else found.next.removeprefix("/api")
    rows = [(row, summary(row.document), _text(row.document)) for row in found.events]
    return {"found": found, "rows": rows, "next": next_page, "data": f"/api{call.url}"}


def summary(document: dict[str, Any]) -> str:
    """What a document says in a few words: its texts, outcomes and reasons.

    >>> summary({"kind": "RunEnded", "outcome": "completed", "streams": [1]})
    'completed'
    >>> summary({"kind": "StepStarted", "words": {"step": "rate", "rate_command_deg_per_s": 10.0}})
    'rate 10 deg/s'
    >>> summary({"specification": "FOG", "revision": "A", "action": "add", "reason": "first"})
    'add, FOG, A, first'
    """
    told = [str(document[name]) for name in _TOLD if isinstance(document.get(name), str | int | float)]
    if (words := document.get("words")) is not None:
        told.append(step_text(msgspec.convert(words, StepWords)))
    text = ", ".join(each for each in told if each)
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]} ..."


def _text(document: dict[str, Any]) -> str:
    """The content of a document in one line, without what its row shows."""
    rest = {name: each for name, each in document.items() if name not in {"kind", "run", "unit", "t_ns", "uid"}}
    text = msgspec.json.encode(rest).decode()
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]} ..."
