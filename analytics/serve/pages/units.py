"""The pages of units: all of them, and one."""

import datetime as dt
from typing import Any

import msgspec

from analytics.event_words import summary
from analytics.plots.picture import Picture
from analytics.serve.api import events
from analytics.serve.api.operation import Call, Nothing, NotYet, link
from analytics.serve.api.rows import Name, Paged
from analytics.serve.api.unit import unit_pictures as pictures
from analytics.serve.api.unit import units as api
from analytics.serve.api.unit.certificates import CertificateRow
from analytics.serve.pages.events import shortened
from analytics.serve.pages.frame.language import LANGUAGES
from analytics.serve.pages.frame.page import shown

_MOST_HISTORIES = 6
_AUDIT = 30
_ORDER = {"FAIL": 0, "MARGINAL": 1, "NO_DATA": 2}


@shown("/units", "units.html.jinja", shared_s=1.0)
def list_units(call: Call, asked: api.UnitsAsked) -> dict[str, Any]:
    """All units."""
    found = api.list_units(call, asked)
    return {"found": found, "next": _page_link(found.next), "data": f"/api{call.url}"}


class UnitPageAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which signal the curves are of, and which characteristic is shown over time beside those with limits."""

    signal: Name = ""
    metric: Name = ""


@shown("/units/{unit}", "unit.html.jinja", is_slow=True, shared_s=1.0)
def unit(call: Call, asked: UnitPageAsked) -> dict[str, Any]:
    """One unit."""
    try:
        found, is_whole = api.unit(call, Nothing()), True
    except NotYet:
        if not call.is_partial:
            raise
        found, is_whole = api.unit_without_metrics(call), False
    limited = dict.fromkeys(row["metric"] for row in found.verdicts if row["value"] is not None)
    asked_for = asked.metric if is_whole else ""
    histories = list(dict.fromkeys([asked_for, *limited] if asked_for else limited))[:_MOST_HISTORIES]
    of_signal = pictures.OfSignal(signal=asked.signal)
    drawn = [
        _drawn(pictures.unit_history(call, pictures.HistoryAsked(metric=metric)), found.unit, "history", metric=metric)
        for metric in histories
    ]
    return {
        "found": found,
        "verdicts_first": sorted(found.verdicts, key=_by_need),
        "named": {row["metric"]: (row["en"], row["zh"]) for row in found.verdicts},
        "histories": drawn,
        "allan": _drawn(pictures.unit_allan(call, of_signal), found.unit, "allan", signal=asked.signal),
        "temperature": _drawn(
            pictures.unit_temperature(call, of_signal), found.unit, "temperature", signal=asked.signal
        )
        if is_whole
        else None,
        "is_whole": is_whole,
        "metrics": sorted({(row["metric"], row["en"], row["zh"]) for row in found.metrics if row["value"] is not None}),
        "signals": sorted({name for run in found.runs for name in run.signals}),
        "certificates": [(row, _state(row)) for row in found.certificates],
        "audit": [
            (row, {language: shortened(summary(row.document, language)) for language in LANGUAGES})
            for row in events.unit_audit(call, Paged(limit=_AUDIT)).events
        ],
        "data": link("api", "units", found.unit),
    }


def _state(row: CertificateRow) -> str:
    """Whether a certificate is ``valid``, ``superseded`` or ``expired`` today."""
    if row.superseded_by is not None:
        return "superseded"
    today = dt.datetime.now(dt.UTC).date().isoformat()
    return "valid" if row.valid_until is None or today <= row.valid_until else "expired"


def _by_need(row: dict[str, Any]) -> tuple[int, int]:
    """What needs somebody first; of these the newest first."""
    return _ORDER.get(row["verdict"], len(_ORDER)), -(row["t_ns"] or 0)


def _drawn(found: Picture, unit: str, which: str, **parameters: str) -> dict[str, Any]:
    """A picture with the address of its data."""
    return {"picture": found, "url": link("api", "units", unit, which, **parameters)}


def _page_link(url: str | None) -> str | None:
    return None if url is None else url.removeprefix("/api")
