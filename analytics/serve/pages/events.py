"""The page of events: documents of the store with filters."""

from typing import Any

import msgspec

from analytics.event_words import summary
from analytics.serve.api import events as api
from analytics.serve.api.operation import Call
from analytics.serve.pages.frame.language import LANGUAGES
from analytics.serve.pages.frame.page import shown
from analytics.serve.pages.frame.zones import common_zone, zoned
from stream.errors import BadInput

_SHOWN_CHARACTERS = 400


@shown("/events", "events.html.jinja", shared_s=1.0)
def events(call: Call, asked: api.EventsAsked) -> dict[str, Any]:
    """The documents."""
    zone = common_zone(call)
    wrong = None
    try:
        between = {"from_": zoned(asked.from_, zone), "to": zoned(asked.to, zone)}
        found = api.list_events(call, msgspec.structs.replace(asked, **between))
    except BadInput as error:
        if not (asked.from_ or asked.to):
            raise
        wrong = str(error)  # the form stays, with what was typed
        found = api.list_events(call, msgspec.structs.replace(asked, from_=None, to=None))
    next_page = None if found.next is None else found.next.removeprefix("/api")
    rows = [
        (row, {language: shortened(summary(row.document, language)) for language in LANGUAGES}, _text(row.document))
        for row in found.events
    ]
    return {"found": found, "rows": rows, "next": next_page, "data": f"/api{call.url}", "wrong": wrong}


def _text(document: dict[str, Any]) -> str:
    """The content of a document in one line, without what its row shows."""
    rest = {name: each for name, each in document.items() if name not in {"kind", "run", "unit", "t_ns", "uid"}}
    return shortened(msgspec.json.encode(rest).decode())


def shortened(text: str) -> str:
    """A text, cut where it is long."""
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]} ..."
