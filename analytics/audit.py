"""Audit of a unit: who did what when, with which data, limits and version, from the log alone."""

import csv
import datetime as dt
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from analytics.event_words import kind_name, summary
from ingest.station.units_file import COLUMNS
from storage.manifests.part import with_sources
from storage.sql.catalog import Catalog
from stream.decoding import decode_json
from stream.errors import BadInput, NotFound
from stream.files.atomic_file import replacement
from stream.terminal.console import csv_text

# documents of a unit, and of its runs as a whole; without the figures of the worker, of which a run has hundreds
AUDITED = """
(unit = $unit or (unit is null and run in (select run from internal.lake_channels where unit = $unit
  union select run from internal.lake_documents where unit = $unit)))
and kind not in ('EarlyDecision', 'EstimatePublished', 'NoiseFitted', 'SpectralLinesFound')
"""
_ROWS = f"""
select kind, nullif(run, '') as run, nullif(unit, '') as unit, site, station, t_ns, arrival_ns, uid, document,
  regexp_extract(filename, '([^/]+)/[^/]+$', 1) as part
from internal.lake_documents where {AUDITED} order by arrival_ns, t_ns, uid
"""  # noqa: S608  our own statement
_MOST_CHARACTERS = 60  # of a value that changes: measurement standards are long
_BY = ("by", "author", "operator")
_COLUMNS = (
    "arrival", "at", "kind", "event", "run", "station", "by", "identity", "what", "limits", "software", "segments",
    "uid",
)  # fmt: skip


class AuditRow(msgspec.Struct, frozen=True, kw_only=True):
    """One document: its time and arrival (UTC), who entered it, what it says, and the log segments that hold it.

    `identity` is whom a certificate or a sign-in has proved, ``unauthenticated`` where nobody; empty where the document
    is no act of a person, or of a version that did not record it. `changes` are what it corrects of the station of its
    run, or of its unit: each detail before (null where it was not given) and from then on.
    """

    at: str
    arrival: str
    kind: str
    run: str | None
    station: str
    by: str
    identity: str
    what: str
    limits: str
    software: str
    segments: dict[str, str]  # name and SHA-256
    uid: str
    document: dict[str, Any]
    changes: dict[str, tuple[str | None, str | None]] = msgspec.field(default_factory=dict)


def audit_of(catalog: Catalog, unit: str) -> list[AuditRow]:
    """Everything that happened to a unit, by arrival, the earliest first; NotFound if the store has nothing of it."""
    sources = {part.name: with_sources(catalog.store.lake, part).sources for part in catalog.parts}
    rows = list(_rows(catalog, unit, sources))
    if not rows:
        raise NotFound(f"the log of {catalog.store.folder} has no document of unit {unit!r}")
    return rows


def _rows(catalog: Catalog, unit: str, sources: dict[str, dict[str, str]]) -> Iterator[AuditRow]:
    before: dict[tuple[str, ...], dict[str, str]] = {}
    for kind, run, _, site, station, t_ns, arrival_ns, uid, text, part in catalog.rows(_ROWS, {"unit": unit}):
        document = decode_json(text)
        changes = _changes(document, before)
        details = document.get("details") or {}
        yield AuditRow(
            at=_moment(t_ns), arrival=_moment(arrival_ns), kind=kind, run=run, station=f"{site}/{station}",
            by=next((str(document[name]) for name in _BY if document.get(name)), ""),
            identity=str(document.get("identity", "")), what=summary(document),
            limits=str(document.get("revision", "")) if kind == "LimitsApplied" else "",
            software=str(document.get("software") or details.get("software") or ""),
            segments=sources.get(part, {}), uid=uid, document=document, changes=changes,
        )  # fmt: skip


def _changes(
    document: dict[str, Any], before: dict[tuple[str, ...], dict[str, str]]
) -> dict[str, tuple[str | None, str | None]]:
    """What a document corrects of the station of its run or of a unit; `before` has what was last stated of each."""
    kind, run = document["kind"], str(document.get("run", ""))
    if kind not in {"RunStarted", "StationStated", "UnitMounted"}:
        return {}
    stated = {name: str(value) for name, value in (document.get("details") or {}).items()}
    if kind == "UnitMounted":
        stated |= {name: str(document[name]) for name in COLUMNS[1:] if document.get(name) is not None}
    of = (run, str(document["unit"])) if kind == "UnitMounted" else (run,)
    last = before.get(of)
    before[of] = stated if kind != "RunStarted" or last is None else last
    if last is None or kind == "RunStarted":
        return {}
    names = dict.fromkeys([*last, *stated])
    return {name: (last.get(name), stated.get(name)) for name in names if last.get(name) != stated.get(name)}


def write_audit(rows: Iterable[AuditRow], path: Path, language: str = "en") -> None:
    """Write the audit as CSV, in UTF-8 with the byte-order mark that spreadsheets need.

    Columns and kinds keep their names; `event`, the kind for people, and what a document says are in the language.
    """
    try:
        with replacement(path) as fresh, fresh.open("w", encoding="utf-8-sig", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(_COLUMNS)
            for row in rows:
                segments = " ".join(f"{name}:{sha256}" for name, sha256 in row.segments.items())
                own = {"segments": segments, "event": kind_name(row.kind, language), "what": spoken(row, language)}
                cells = [own[name] if name in own else getattr(row, name) or "" for name in _COLUMNS]
                writer.writerow([csv_text(each) for each in cells])
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error.strerror or error}; give --csv another file") from error


def spoken(row: AuditRow, language: str) -> str:
    """What a row says in a language."""
    none, comma = ("（未给出）", "，") if language == "zh" else ("(not given)", ", ")
    values = {name: [_short(each) if each is not None else none for each in pair] for name, pair in row.changes.items()}
    corrected = [f"{name} {old} -> {new}" for name, (old, new) in values.items()]
    return comma.join(filter(None, [summary(row.document, language), *corrected]))


def _short(value: str) -> str:
    return value if len(value) <= _MOST_CHARACTERS else f"{value[:_MOST_CHARACTERS]}..."


def _moment(t_ns: int) -> str:
    return dt.datetime.fromtimestamp(t_ns / 1e9, dt.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
