"""Runs: all of them, the newest first, and one with its steps, units and documents."""

from typing import Any

import msgspec

from analytics.metric_registry.registry import alike
from analytics.serve.api.operation import Call, get, link
from analytics.serve.api.rows import Name, Paged, Views, dictionaries, iso, page_of
from stream.decoding import decode_json
from stream.errors import BadInput, NotFound

_RUN = """
select run, site, station, date_known, case when date_known then epoch_ns(started) end as started_ns,
  case when date_known then epoch_ns(ended) end as ended_ns, duration_s, outcome, resumptions, gap_s,
  greatest(coalesce(len(units), 0), coalesce(mounted, 0)) as units, coalesce(signals, 0) as signals, samples,
  "procedure", operator, lot, simulated, source, epoch_ns(recorded) as recorded_ns, released, saved_s, time_zone,
  coalesce(excluded, 0) as excluded,
  coalesce(if(date_known, epoch_ns(started), epoch_ns(recorded)), 0) as place_ns
from internal.served_runs
left join (select run, count(*) as mounted from internal.served_units group by run) using (run)
left join (select run, count(*) as excluded from exclusions group by run) using (run)
"""
_PAGE = f"""
with listed as ({_RUN}), seen as (select place_ns as before from listed where run = $after)
select listed.* from listed
where ($after = '' or (-place_ns, run) > (select row(-before, $after) from seen))
  and ($station = '' or station = $station) and ($procedure = '' or "procedure" = $procedure)
  and ($outcome = '' or outcome = $outcome)
  and ($lot = '' or lot = $lot or run in (select run from internal.served_units where lot = $lot))
  and contains(lower(run), lower($search))
order by place_ns desc, run limit $rows
"""  # noqa: S608  our own statement
_STEPS = """
select "index", "procedure", step, repeat, position, axis, phase, rate_command, temperature_command, frequency,
  amplitude, settle, room, min(t_start_ns) as t_start_ns, max(t_end_ns) as t_end_ns,
  count(distinct unit) as units, count(*) filter (outcome = 'completed') as completed,
  count(*) filter (outcome = 'open') as open
from steps where run = $run and ($unit = '' or unit = $unit)
group by all order by t_start_ns, "index" limit 5000
"""
_UNITS = """
with named as (
  select unnest(from_json(document->'$.units', '["varchar"]')) as unit from internal.lake_documents
  where kind = 'RunStarted' and run = $run
  union select unit from internal.served_units where run = $run
), recorded as (
  select unit, list(distinct signal order by signal) as signals, sum(samples)::bigint as samples,
    max(t_last_ns) as t_last_ns, max(arrival_last_ns) as arrival_last_ns
  from internal.lake_channels where run = $run group by unit
), given as (
  select unit, verdict from internal.served_verdicts where run = $run
), decided as (
  select unit, string_agg(distinct outcome, ', ' order by outcome) as early from (
    select unit, arg_max(document->>'$.outcome', arrival_ns) as outcome from internal.lake_documents
    where kind = 'EarlyDecision' and run = $run group by unit, document->>'$.limit'
  ) group by unit
)
select coalesce(r.unit, u.unit) as unit, u.product, u.lot, u.slot, u.fixture, coalesce(r.signals, []) as signals,
  coalesce(r.samples, 0) as samples, r.t_last_ns, r.arrival_last_ns, g.verdict, d.early,
  exists(from named) and coalesce(r.unit, u.unit) not in (from named) as is_instrument,
  e.verdict as released, e.t_ns as released_ns, e.planned_s - e.recorded_s as saved_s,
  x.reason || ' (' || x.by_whom || ')' as excluded
from recorded r full join (select * from internal.served_units where run = $run) u using (unit)
left join given g using (unit) left join decided d using (unit)
left join (select * from internal.served_releases where run = $run) e using (unit)
left join (select unit, reason, by_whom from exclusions where run = $run) x using (unit)
where coalesce(r.unit, u.unit) > $after order by 1 limit $rows
"""
_COUNTS = f"""
select coalesce(verdict, released, 'OPEN'), count(*) from ({_UNITS}) where not is_instrument group by 1 order by 1
"""  # noqa: S608  our own statement
_DOCUMENTS = """
select t_ns, kind, unit, document from internal.lake_documents
where run = $run and kind in ('RunStarted', 'RunResumed', 'RunEnded', 'NoteAdded',
  'LimitsApplied', 'StationStated', 'CheckEntered', 'ExclusionEntered')
order by arrival_ns, t_ns limit 500
"""


_OUTCOMES = ("open", "completed", "aborted")
_UNITS_OF = """
select unit from internal.served_units where run = $run
union select unit from internal.served_signals where run = $run
"""
_IN_RUN = f"select 1 from ({_UNITS_OF}) where unit = $unit limit 1"  # noqa: S608  our own statement


class RunsAsked(Paged, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which runs: all by default."""

    search: Name = ""
    station: Name = ""
    procedure: Name = ""
    outcome: Name = ""
    lot: Name = ""


class RunRow(msgspec.Struct, frozen=True, kw_only=True):
    """A run; without a known date it has no moments, and its samples count from 1970-01-01.

    `released` units were released before the end, which saved `saved_s` of records; `time_zone` is that of the station;
    `excluded` units of it are excluded from evaluation.
    """

    run: str
    site: str | None
    station: str | None
    date_known: bool
    started_ns: int | None
    ended_ns: int | None
    duration_s: float | None
    outcome: str
    resumptions: int
    gap_s: float
    units: int
    signals: int
    samples: int
    procedure: str | None
    operator: str | None
    lot: str | None
    simulated: bool
    source: str | None
    recorded_ns: int | None
    released: int
    saved_s: float | None
    time_zone: str | None
    excluded: int
    started: str | None = None
    ended: str | None = None


class Runs(msgspec.Struct, frozen=True, kw_only=True):
    """A page of runs, the newest first, and the next page."""

    runs: list[RunRow]
    next: str | None


class RunAsked(Paged, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Of which unit the steps are; pages are of the run's units."""

    unit: Name = ""


class StepRow(msgspec.Struct, frozen=True, kw_only=True):
    """A step as it was commanded: rate in deg/s, temperature in degC, frequency in Hz, times in s."""

    index: int
    procedure: str | None
    step: str | None
    repeat: int | None
    position: str | None
    axis: str | None
    phase: str | None
    rate_command: float | None
    temperature_command: float | None
    frequency: float | None
    amplitude: float | None
    settle: float | None
    room: bool | None
    t_start_ns: int | None
    t_end_ns: int | None
    units: int
    completed: int
    open: int


class RunUnit(msgspec.Struct, frozen=True, kw_only=True):
    """A unit in a run: its verdict so far, the outcomes of its early decisions, and its release before the end.

    `excluded` is why it is excluded from evaluation, and by whom.

    What delivers samples and is none of the units that the run names `is_instrument` of the station.
    """

    unit: str
    product: str | None
    lot: str | None
    slot: str | None
    fixture: str | None
    signals: list[str]
    samples: int
    t_last_ns: int | None
    arrival_last_ns: int | None
    verdict: str | None
    early: str | None
    is_instrument: bool
    released: str | None
    released_ns: int | None
    saved_s: float | None
    excluded: str | None = None


class RunDocument(msgspec.Struct, frozen=True, kw_only=True):
    """A run with its steps, the documents of its course, and a page of its units."""

    run: RunRow
    steps: list[StepRow]
    documents: list[dict[str, Any]]
    units: list[RunUnit]
    verdicts: dict[str, int]
    next: str | None


@get("/api/runs", table="runs", sees_log=True)
def list_runs(call: Call, asked: RunsAsked) -> Runs:
    """All runs, the newest first, of those without a date by when they were recorded."""
    if asked.after and not call.fresh.rows("select 1 from internal.served_runs where run = $run", {"run": asked.after}):
        raise BadInput(f"after {asked.after!r} is not what the page before gave as its next one")
    if asked.outcome:
        _check_outcome(call, asked.outcome)
    given = msgspec.to_builtins(asked) | {"rows": asked.limit + 1}
    del given["limit"]
    runs, has_more = page_of([_run_row(row) for row in dictionaries(call.fresh, _PAGE, given)], asked.limit)
    parameters = msgspec.to_builtins(asked) | {"after": runs[-1].run if runs else None}
    return Runs(runs=runs, next=link("api", "runs", **parameters) if has_more else None)


@get("/api/runs/{run}", table="units", sees_log=True)
def run(call: Call, asked: RunAsked) -> RunDocument:
    """One run: its steps, documents, units, and their verdicts so far."""
    name = call.path["run"]
    row = run_row(call.fresh, name)
    given = {"run": name, "after": asked.after, "rows": asked.limit + 1}
    units, has_more = page_of([RunUnit(**each) for each in dictionaries(call.fresh, _UNITS, given)], asked.limit)
    steps = dictionaries(call.fresh, _STEPS, {"run": name, "unit": asked.unit})
    if asked.unit and not steps:
        check_in_run(call, name, asked.unit)
    documents = [
        each | {"document": decode_json(each["document"]), "time": iso(each["t_ns"])}
        for each in dictionaries(call.fresh, _DOCUMENTS, {"run": name})
    ]
    counts = call.fresh.rows(_COUNTS, {"run": name, "after": "", "rows": 2**31})
    so_far = call.service.live.verdicts_so_far(name) if row.outcome == "open" else None
    parameters = {"limit": asked.limit, "after": units[-1].unit if units else None, "unit": asked.unit}
    return RunDocument(
        run=row, steps=[StepRow(**each) for each in steps], documents=documents, units=units,
        verdicts=so_far or {str(verdict): int(n) for verdict, n in counts},
        next=link("api", "runs", name, **parameters) if has_more else None,
    )  # fmt: skip


def _check_outcome(call: Call, outcome: str) -> None:
    found = call.fresh.rows("select distinct outcome from internal.served_runs order by outcome")
    known = sorted({*_OUTCOMES, *(each for (each,) in found)})
    if outcome not in known:
        raise BadInput(f"no run ends as {outcome!r}; there are {', '.join(known)}")


def check_in_run(call: Call, run: str, unit: str) -> None:
    """BadInput if a unit is not in a run; the message names similar ones."""
    if not call.fresh.rows(_IN_RUN, {"run": run, "unit": unit}):
        units = [each for (each,) in call.fresh.rows(_UNITS_OF, {"run": run})]
        raise BadInput(f"unit {unit!r} is not in run {run!r}; {alike(unit, units, 'its units are')}")


def run_row(views: Views, name: str) -> RunRow:
    """A run; NotFound names similar ones."""
    found = dictionaries(views, f"{_RUN} where run = $run", {"run": name})
    if not found:
        known = [
            each for (each,) in views.rows("select run from internal.served_runs order by recorded desc limit 2000")
        ]
        raise NotFound(f"run {name!r} is not in the store; {alike(name, known, 'runs are')}")
    return _run_row(found[0])


def _run_row(row: dict[str, Any]) -> RunRow:
    del row["place_ns"]
    return RunRow(**row, started=iso(row["started_ns"]), ended=iso(row["ended_ns"]))
