"""Units: all of them by name, and one with its runs, metrics, verdicts and error models."""

from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple, TypedDict

import msgspec

from analytics.metric_registry.registry import alike
from analytics.serve.api.operation import Call, Nothing, get, link
from analytics.serve.api.rows import Name, Paged, dictionaries, iso, page_of
from analytics.serve.api.unit.certificates import CertificateRow, certificates_of
from analytics.serve.api.unit.models import ModelRow, models_of
from analytics.serve.live.fresh_views import Recorded
from stream.errors import NotFound

_NOTHING = Recorded()
_UNITS = """
with named as (
  select distinct run, unnest(from_json(document->'$.units', '["varchar"]')) as unit
  from internal.lake_documents where kind = 'RunStarted'
  union select run, unit from internal.served_units
), dated as (                          -- runs of known date by their samples, before them the others as they came
  select c.*, row(if(r.date_known, t_last_ns, 0), arrival_last_ns) as place,
    if(r.date_known, t_last_ns, null) as measured_ns
  from internal.lake_channels c left join internal.served_runs r using (run)
), recorded as (
  select unit, bool_and(run in (select run from named)) as is_in_runs_that_name_units,
    count(distinct run) as runs, count(distinct signal) as signals, sum(samples)::bigint as samples,
    arg_max(run, place) as last_run, arg_max(site, place) as site, arg_max(station, place) as station,
    list(distinct station order by station) as stations,
    max(measured_ns) as measured_ns, max(arrival_last_ns) as recorded_ns
  from dated group by unit
), mounted as (
  select unit, arg_max(product, t_ns) as product, arg_max(lot, t_ns) as lot, arg_max(slot, t_ns) as slot,
    arg_max(fixture, t_ns) as fixture, arg_max(firmware, t_ns) as firmware, arg_max(run, t_ns) as run
  from internal.served_units group by unit
), given as (
  select unit, arg_max(verdict, row(if(r.date_known, epoch_ns(r.started), 0), v.arrival_ns)) as verdict
  from internal.served_verdicts v left join internal.served_runs r using (run) group by unit
)
select coalesce(r.unit, m.unit) as unit, m.product, m.lot, r.site, r.station,
  coalesce(r.stations, []) as stations, m.slot, m.fixture, m.firmware,
  coalesce(r.runs, 0) as runs, coalesce(r.last_run, m.run) as last_run, coalesce(r.signals, 0) as signals,
  coalesce(r.samples, 0) as samples, coalesce(r.is_in_runs_that_name_units, false)
    and coalesce(r.unit, m.unit) not in (select unit from named) as is_instrument, g.verdict,
  r.measured_ns, r.recorded_ns, z.time_zone
from recorded r full join mounted m using (unit) left join given g using (unit)
left join (select run, time_zone from internal.served_runs) z on z.run = coalesce(r.last_run, m.run)
"""
_RUNS = """
select r.run, r.station, r.procedure, r.outcome, u.slot, u.lot, u.product, coalesce(s.signals, []) as signals,
  case when r.date_known then epoch_ns(r.started) end as started_ns,
  case when r.date_known then epoch_ns(r.ended) end as ended_ns, r.duration_s, r.time_zone, g.verdict,
  x.reason || ' (' || x.by_whom || ')' as excluded
from (
  select run, list(signal order by signal) as signals from internal.served_signals where unit = $unit group by run
) s
full join (select * from internal.served_units where unit = $unit) u using (run)
join internal.served_runs r using (run)
left join (select run, verdict from internal.served_verdicts where unit = $unit) g using (run)
left join (select run, reason, by_whom from exclusions where unit = $unit) x using (run)
order by coalesce(if(r.date_known, r.started, r.recorded), r.recorded) desc, r.run
"""


class UnitsAsked(Paged, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which units: all by default."""

    search: Name = ""
    product: Name = ""
    lot: Name = ""
    station: Name = ""
    verdict: Literal["", "PASS", "FAIL", "MARGINAL", "NO_DATA", "ABORTED"] = ""
    instruments: bool = False  # what delivers samples in runs that do not name it as a unit, such as a chamber, as well


class UnitRow(msgspec.Struct, frozen=True, kw_only=True):
    """A unit, with its last mounting, its last station, all its stations, and the last verdict that a run gave it."""

    unit: str
    product: str | None
    lot: str | None
    site: str | None
    station: str | None
    stations: list[str]
    slot: str | None
    fixture: str | None
    firmware: str | None
    runs: int
    last_run: str | None
    signals: int
    samples: int
    is_instrument: bool
    verdict: str | None
    measured_ns: int | None  # the last sample of a run whose date is known
    recorded_ns: int | None
    time_zone: str | None
    measured: str | None = None
    recorded: str | None = None


class Units(msgspec.Struct, frozen=True, kw_only=True):
    """A page of units by name, how many there are with these properties, and the next page."""

    units: list[UnitRow]
    count: int
    next: str | None


class UnitRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run of a unit."""

    run: str
    station: str | None
    procedure: str | None
    outcome: str
    slot: str | None
    lot: str | None
    product: str | None
    signals: list[str]
    started_ns: int | None
    ended_ns: int | None
    duration_s: float | None
    time_zone: str | None
    verdict: str | None
    excluded: str | None  # why it is excluded from evaluation, and by whom
    started: str | None = None
    ended: str | None = None


class UnitMetric(TypedDict):
    """A characteristic with its names, as the table ``unit_metrics`` has it."""

    metric: str
    en: str
    zh: str
    unit: str
    signal: str | None
    run: str | None
    value: float | None
    unit_of_measure: str
    lo: float | None
    hi: float | None
    standard_uncertainty: float | None
    u_type_a: float | None
    u_type_b: float | None
    U: float | None
    k: float | None
    p: float | None
    nu: float | None
    uncertainty_reason: str | None
    n: int | None
    parameters: dict[str, Any]
    runs: list[str]
    steps: list[int]
    standard: str
    clause: str
    reason: str | None


class UnitDocument(msgspec.Struct, frozen=True, kw_only=True):
    """Everything of a unit: runs, characteristics, verdicts by the specifications, error models, certificates."""

    unit: str
    about: UnitRow
    verdict: dict[str, Any] | None
    runs: list[UnitRun]
    metrics: list[UnitMetric]
    verdicts: list[dict[str, Any]]
    models: list[ModelRow]
    certificates: list[CertificateRow]
    warnings: list[dict[str, Any]]


@get("/api/units", table="units", sees_log=True)
def list_units(call: Call, asked: UnitsAsked) -> Units:
    """All units by name: their product, lot, last run and its verdict."""
    found = [unit for unit in _all_units(call) if _is_asked(unit, asked)]
    rows, has_more = page_of([row for row in found if row["unit"] > asked.after], asked.limit)
    units = [_unit_row(row) for row in rows]
    parameters = msgspec.to_builtins(asked) | {"after": units[-1].unit if units else None}
    return Units(units=units, count=len(found), next=link("api", "units", **parameters) if has_more else None)


@get("/api/units/{unit}", table="metrics", is_slow=True, sees_log=True)
def unit(call: Call, asked: Nothing) -> UnitDocument:
    """One unit: its runs, characteristics with limits and verdicts, error models, certificates."""
    del asked
    name = call.path["unit"]
    # the lake's, so that they are not computed again for every message that the log gets
    found = call.service.of_units.result(("unit", name, call.metrics_tag), lambda: _judged(call, name))
    return _document(call, name, found)


def unit_without_metrics(call: Call) -> UnitDocument:
    """One unit as it is known before its characteristics are computed."""
    return _document(call, call.path["unit"], {"metrics": [], "verdict": None, "verdicts": [], "warnings": []})


def _document(call: Call, name: str, found: dict[str, Any]) -> UnitDocument:
    about = unit_row(call, name)
    runs = dictionaries(call.fresh, _RUNS, {"unit": name})
    return UnitDocument(
        unit=name,
        about=about,
        runs=[UnitRun(**row, started=iso(row["started_ns"]), ended=iso(row["ended_ns"])) for row in runs],
        models=models_of(call.store, name),
        certificates=certificates_of(call, name),
        **found,
    )


def _judged(call: Call, name: str) -> dict[str, Any]:
    """Characteristics and verdicts of a unit in the lake."""
    from analytics.evaluation.selection import Selection, selected
    from analytics.specifications.verdicts import values_of, verdicts_of

    key = ("judged", call.metrics_tag)
    every = call.service.memo.result(key, lambda: verdicts_of(call.metrics, with_values=False))
    verdict = next((row for row in every.units if row["unit"] == name), None)
    with_metrics = call.service.memo.result(
        ("with metrics", call.metrics_tag),
        lambda: frozenset(unit for (unit,) in call.metrics.rows("select distinct unit from unit_metrics")),
    )
    rows = selected(call.metrics, Selection(units=(name,))) if name in with_metrics else []
    return {
        "metrics": [_named(row) for row in rows],
        "verdict": verdict,
        "verdicts": [_named(row) for row in values_of(call.metrics, [name])] if verdict else [],
        "warnings": [row for row in every.warnings if row["unit"] == name] if verdict else [],
    }


def unit_row(call: Call, name: str) -> UnitRow:
    """A unit; NotFound names similar ones."""
    every = _units_but_newest(call).rows
    if name not in every:
        raise NotFound(f"unit {name!r} is not in the store; {alike(name, list(every), 'units are')}")
    return _unit_row(_all_units(call, [name])[0])


def _unit_row(row: dict[str, Any]) -> UnitRow:
    return UnitRow(**row, measured=iso(row["measured_ns"]), recorded=iso(row["recorded_ns"]))


def _all_units(call: Call, names: Iterable[str] | None = None) -> list[dict[str, Any]]:
    """Units by name, all by default."""
    then, now = _units_but_newest(call), call.fresh.recorded
    if then.recorded is now:
        return [then.rows[name] for name in names or then.rows]
    found = []
    for name in names or then.rows:
        row, before, after = then.rows[name], then.recorded.get(name, _NOTHING), now.get(name, _NOTHING)
        if after.samples > before.samples:
            row = row | {
                "samples": row["samples"] + after.samples - before.samples,
                "measured_ns": row["measured_ns"] and max(row["measured_ns"], after.t_last_ns),  # no date known: none
                "recorded_ns": max(row["recorded_ns"] or 0, after.arrival_last_ns),
            }
        found.append(row)
    return found


class _Units(NamedTuple):
    rows: dict[str, dict[str, Any]]
    recorded: Mapping[str, Recorded]  # what the log had of them then


def _units_but_newest(call: Call) -> _Units:
    """Units by name, in order, as they were when the last document or channel came: more of the same channels may have
    come since, of which beside a recorder there always is.
    """

    def find() -> _Units:
        rows = dictionaries(call.fresh, f"from ({_UNITS}) order by unit")
        return _Units({row["unit"]: row for row in rows if row["unit"]}, call.fresh.recorded)

    key = ("units", call.state.documents_tag, call.fresh.channels)
    found: _Units = call.service.memo.result(key, find)
    return found


def _is_asked(row: dict[str, Any], asked: UnitsAsked) -> bool:
    return (
        asked.search.lower() in row["unit"].lower()
        and (asked.instruments or not row["is_instrument"])
        and asked.product in ("", row["product"])
        and asked.lot in ("", row["lot"])
        and (not asked.station or asked.station in row["stations"])
        and asked.verdict in ("", row["verdict"])
    )


def _named(row: dict[str, Any]) -> dict[str, Any]:
    """A characteristic with its names in both languages."""
    from analytics.metric_registry.registry import metrics

    known = metrics().get(row["metric"])  # checks entered by hand may be of others
    names = (
        {"en": row["metric"], "zh": row["metric"]} if known is None else {"en": known.header.en, "zh": known.header.zh}
    )
    return row | names
