"""Documents of the store with filters, the latest first."""

from typing import Any, Literal

import msgspec

from analytics.audit import AUDITED
from analytics.event_words import is_known_kind, kind_name
from analytics.serve.api.operation import Call, get, link
from analytics.serve.api.rows import Name, Paged, dictionaries, iso, moment, page_of
from analytics.serve.api.unit.units import unit_row
from stream.decoding import decode_json
from stream.errors import BadInput

_ROWS = """
select uid, arrival_ns, t_ns, kind, nullif(run, '') as run, nullif(unit, '') as unit, site, station,
  coalesce(document->>'$.by', document->>'$.author', document->>'$.operator', '') as "by",
  coalesce(document->>'$.identity', '') as identity, document
from internal.lake_documents
"""
_PAGE = f"""
select * from ({_ROWS})
where ($kind = '' or kind = $kind) and ($run = '' or run = $run) and ($unit = '' or unit = $unit)
  and ($station = '' or station = $station) and ($what = '' or document->>'$.what' = $what)
  and ($who = '' or "by" = $who)
  and ($only = '' or "by" not in ('', 'import', 'station', 'run', 'gyrofleet compensate'))
  and ($first is null or arrival_ns >= $first) and ($stop is null or arrival_ns < $stop)
  and ($at is null or (-arrival_ns, uid) > (-$at, $uid))
order by arrival_ns desc, uid limit $rows
"""  # noqa: S608  our own statement
_AUDIT = f"""
select * from ({_ROWS})
where {AUDITED} and ($at is null or (-arrival_ns, uid) > (-$at, $uid))
order by arrival_ns desc, uid limit $rows
"""  # noqa: S608  our own statement
_KINDS = "select kind, count(*) as n from internal.lake_documents group by kind order by kind"


class EventsAsked(Paged, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which documents; `from` and `to` are moments of their arrival, `what` that of a note of the store.

    `by` is who entered it, `only` with ``people`` leaves those that a person entered.
    """

    kind: Name = ""
    run: Name = ""
    unit: Name = ""
    station: Name = ""
    what: Name = ""
    by: Name = ""
    only: Literal["", "people"] = ""
    from_: str | None = msgspec.field(default=None, name="from")
    to: str | None = None


class EventRow(msgspec.Struct, frozen=True, kw_only=True):
    """A document: when it arrived, its time on the source's clock, who entered it, its content.

    `identity` is whom a certificate or a sign-in has proved, ``unauthenticated`` where nobody, empty if it is no act.
    """

    uid: str
    arrival_ns: int
    arrival: str | None
    t_ns: int
    kind: str
    en: str  # name of the kind
    zh: str
    run: str | None
    unit: str | None
    site: str
    station: str
    by: str
    identity: str
    document: dict[str, Any]


class Events(msgspec.Struct, frozen=True, kw_only=True):
    """A page of documents, the latest first; how many the store has of each kind; the next page."""

    events: list[EventRow]
    kinds: dict[str, int]
    next: str | None


@get("/api/events", table="events", sees_log=True)
def list_events(call: Call, asked: EventsAsked) -> Events:
    """Documents, the latest first: starts, ends, notes, limits, decisions, verdicts, notes of the store."""
    at, uid = _cursor(asked.after)
    known = kinds_of(call)
    if asked.kind and asked.kind not in known and not is_known_kind(asked.kind):
        raise BadInput(f"no kind of document is named {asked.kind!r}; the store has {', '.join(known)}")
    first_ns, stop_ns = moment(asked.from_, "from"), moment(asked.to, "to")
    if first_ns is not None and stop_ns is not None and stop_ns <= first_ns:
        raise BadInput(f"the stretch ends ({asked.to}) before it begins ({asked.from_})")
    names = ("kind", "run", "unit", "station", "what", "by", "only")
    given = {name: getattr(asked, name) for name in names} | {
        "first": first_ns,
        "stop": stop_ns,
        "at": at,
        "uid": uid,
        "rows": asked.limit + 1,
    }
    given["who"] = given.pop("by")  # a word of SQL
    rows, has_more = page_of([_row(each) for each in dictionaries(call.fresh, _PAGE, given)], asked.limit)
    following = {name: getattr(asked, name) for name in names} | {"from": asked.from_, "to": asked.to}
    after = f"{rows[-1].arrival_ns}:{rows[-1].uid}" if has_more else None
    next_page = link("api", "events", limit=asked.limit, after=after, **following) if has_more else None
    return Events(events=rows, kinds=known, next=next_page)


def kinds_of(call: Call) -> dict[str, int]:
    """How many documents the store has of each kind."""
    key = ("kinds", call.state.documents_tag)
    rows: list[tuple[str, int]] = call.service.memo.result(key, lambda: call.fresh.rows(_KINDS))
    return {str(kind): int(n) for kind, n in rows}


class UnitAudit(msgspec.Struct, frozen=True, kw_only=True):
    """A page of what happened to a unit, the latest first; the next page."""

    unit: str
    events: list[EventRow]
    next: str | None


@get("/api/units/{unit}/audit", table="events", sees_log=True)
def unit_audit(call: Call, asked: Paged) -> UnitAudit:
    """What happened to a unit: who did what when, its runs, mountings, verdicts, models; the latest first."""
    unit = call.path["unit"]
    about = unit_row(call, unit)
    at, uid = _cursor(asked.after)
    given = {"unit": unit, "at": at, "uid": uid, "rows": asked.limit + 1}
    # it changes with the documents, and with the runs that the unit has samples of
    key = ("audit", *given.values(), call.state.documents_tag, about.runs, about.last_run)
    found = call.service.of_units.result(key, lambda: [_row(row) for row in dictionaries(call.fresh, _AUDIT, given)])
    rows, has_more = page_of(found, asked.limit)
    after = f"{rows[-1].arrival_ns}:{rows[-1].uid}" if has_more else None
    next_page = link("api", "units", unit, "audit", limit=asked.limit, after=after) if has_more else None
    return UnitAudit(unit=unit, events=rows, next=next_page)


def _row(row: dict[str, Any]) -> EventRow:
    named = {"en": kind_name(row["kind"], "en"), "zh": kind_name(row["kind"], "zh")}
    return EventRow(**row | {"document": decode_json(row["document"]), "arrival": iso(row["arrival_ns"])} | named)


def _cursor(after: str) -> tuple[int | None, str]:
    if not after:
        return None, ""
    at, _, uid = after.partition(":")
    try:
        return int(at), uid
    except ValueError:
        raise BadInput(f"after {after!r} is not what the page before gave as its next one") from None
