"""The course of a run while it goes on and afterwards: steps, gaps, what measured it, limits, commands, notes."""

from typing import Any

import msgspec

from analytics.alerts.kept_alerts import raised_alerts
from analytics.serve.api.alerts import AlertRow, alert_row
from analytics.serve.api.operation import Call, Nothing, get
from analytics.serve.api.rows import dictionaries, iso
from analytics.serve.live.course import OfCourse, Received
from storage.recording.run_command import withdrawn_commands
from storage.recording.status_board import read_statuses
from storage.recording.store_status import conditions
from stream.decoding import decode_json
from stream.errors import NotFound
from stream.events import (
    Limit,
    LimitsApplied,
    NoteAdded,
    RunCommandAnswered,
    RunCommandGiven,
    RunEnded,
    RunResumed,
    RunStarted,
    StepEnded,
    StepStarted,
    StepWords,
)
from stream.identity import Place
from stream.status.role_status import Role as ProgramRole

_STEPS = """
select b.document->'$.words' as words, b.t_ns as t_start_ns, e.t_ns as t_end_ns,
  case when e.uid is null then 'open' else coalesce(e.document->>'$.outcome', 'completed') end as outcome,
  count(*) as units, coalesce(list(b.uid) filter (e.uid is null), []) as open
from (select * from internal.lake_documents where kind = 'StepStarted' and run = $run) b
left join (
  select * from internal.lake_documents where kind = 'StepEnded' and run = $run
  qualify row_number() over (partition by unit, document->>'$.step_uid' order by t_ns desc, uid) = 1
) e
  on e.unit = b.unit and e.document->>'$.step_uid' = b.uid
group by all order by t_start_ns limit 20000
"""
_DOCUMENTS = """
select document, arrival_ns, site, station from internal.lake_documents
where run = $run and kind in ('RunStarted', 'RunResumed', 'RunEnded', 'NoteAdded', 'LimitsApplied', 'RunCommandGiven',
  'RunCommandAnswered')
order by arrival_ns, t_ns limit 20000
"""
_MEASURED = """
select unit, signal, any_value(unit_of_measure) as unit_of_measure, min(arrival_first_ns) as first_ns,
  max(arrival_last_ns) as last_ns
from internal.lake_channels where run = $run group by unit, signal order by unit, signal
"""
_PLOTTED = ("degC", "deg/s", "K", "rad/s", "deg/h")
_MOST_NOTES = 500
_LATE_NS = 60 * 10**9


class CourseStep(msgspec.Struct, frozen=True, kw_only=True):
    """A step as it was commanded, of all units that began and ended it together; `is_current` while it is recorded."""

    words: StepWords
    t_start_ns: int
    t_end_ns: int | None
    outcome: str
    units: int
    is_current: bool = False


class CourseGap(msgspec.Struct, frozen=True, kw_only=True):
    """A stretch in which nothing was measured, since the run was interrupted."""

    from_ns: int
    to_ns: int
    reason: str


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """A signal of an instrument of the station."""

    instrument: str
    signal: str
    unit_of_measure: str


class CourseNote(msgspec.Struct, frozen=True, kw_only=True):
    """A note of a person or of the station; `t_ns` by the station's clock, of an import by the recorder's."""

    t_ns: int
    time: str | None
    author: str
    text: str
    unit: str | None


class CommandRow(msgspec.Struct, frozen=True, kw_only=True):
    """A command to the station of the run: who gave it when and why, and what came of it.

    `outcome` is ``accepted``, ``done``, ``refused`` or ``unanswered``; `given_ns` is by the clock of who gave it.
    """

    command: str
    action: str
    by: str
    reason: str
    given_ns: int
    given: str | None
    outcome: str
    text: str
    text_zh: str


class CourseProgress(msgspec.Struct, frozen=True, kw_only=True):
    """What the station reports of itself; its `condition` is ``working``, ``paused`` or what `gyrofleet status` has."""

    condition: str
    step: int
    steps: int
    doing: str
    left_s: float | None


class RunCourse(msgspec.Struct, frozen=True, kw_only=True):
    """A run's course, with what only the log has so far; times are of the station's clock.

    `limits` are those on the Allan deviation by unit, those of all units under ``""``.
    """

    run: str
    is_live: bool
    outcome: str
    date_known: bool
    units: list[str]
    steps: list[CourseStep]
    gaps: list[CourseGap]
    measured: list[Measured]
    limits: dict[str, list[Limit]]
    commands: list[CommandRow]
    notes: list[CourseNote]
    alerts: list[AlertRow]
    progress: CourseProgress | None


class _Stored(msgspec.Struct):
    """What the lake has of a run's course."""

    received: list[Received]
    steps: list[dict[str, Any]]
    measured: list[dict[str, Any]]


@get("/api/runs/{run}/course", is_kept=False)
def run_course(call: Call, asked: Nothing) -> RunCourse:
    """The course of a run: steps, gaps, instruments, limits, commands, notes and alerts, up to this moment."""
    del asked
    name = call.path["run"]
    stored: _Stored = call.service.memo.result(("course", name, call.state.tag), lambda: _stored(call, name))
    fresh = call.service.live.course.received(name, call.state.segments)
    known = {each.document.uid: each for each in (*fresh, *stored.received)}
    received = sorted(known.values(), key=lambda each: each.arrival_ns)
    tested = next((each.document.units for each in received if isinstance(each.document, RunStarted)), ())
    channels = {(row["unit"], row["signal"]): row["unit_of_measure"] for row in stored.measured}
    channels |= call.service.live.tail.channels(name)
    if not received and not channels:
        raise NotFound(f"run {name!r} is not in the store; /api/runs lists them")
    ended = _ended(received)
    progress = _progress(call, name)
    last_ns = max([each.arrival_ns for each in received] + [row["last_ns"] or 0 for row in stored.measured], default=0)
    is_at_work = progress is not None and progress.condition not in ("ended", "interrupted", "killed")
    is_live = ended is None and is_at_work
    started = [each.document for each in received if isinstance(each.document, RunStarted)]
    instruments = sorted({unit for unit, _ in channels} - set(tested)) if tested else []
    return RunCourse(
        run=name, is_live=is_live, outcome="open" if ended is None else ended.outcome,
        date_known=all(each.date_known for each in started),
        units=sorted(tested) or sorted({unit for unit, _ in channels}),
        steps=_steps(stored.steps, fresh, is_live=is_live), gaps=_gaps(received),
        measured=[
            Measured(instrument=unit, signal=signal, unit_of_measure=of)
            for (unit, signal), of in sorted(channels.items())
            if unit in instruments and of in _PLOTTED
        ],
        limits=_limits(received), commands=_commands(call, name, received), notes=_notes(received),
        alerts=_alerts(call, name, {*tested, *instruments}, received, None if is_live else last_ns), progress=progress,
    )  # fmt: skip


def _stored(call: Call, run: str) -> _Stored:
    of = {"run": run}
    received = []
    for row in dictionaries(call.views, _DOCUMENTS, of):
        document = decode_json(row["document"], OfCourse)
        received.append(Received(row["arrival_ns"], Place(row["site"], row["station"]), document))
    return _Stored(received, dictionaries(call.views, _STEPS, of), dictionaries(call.views, _MEASURED, of))


def _ended(received: list[Received]) -> RunEnded | None:
    """The document of the run's end, if it has not gone on since."""
    ended = None
    for each in received:
        if isinstance(each.document, RunEnded):
            ended = each.document
        elif isinstance(each.document, RunResumed):
            ended = None
    return ended


def _steps(stored: list[dict[str, Any]], fresh: list[Received], *, is_live: bool) -> list[CourseStep]:
    """Steps of the lake and of the log's tail, in their order; those of one stretch and the same words as one."""
    rows: dict[str, tuple[StepWords, int, int]] = {}  # open ones by uid: words, start, weight
    done: list[tuple[StepWords, int, int | None, str, int]] = []
    for row in stored:
        words = decode_json(row["words"], StepWords)
        if row["outcome"] == "open":
            rows |= dict.fromkeys(row["open"], (words, row["t_start_ns"], 1))
        else:
            done.append((words, row["t_start_ns"], row["t_end_ns"], row["outcome"], row["units"]))
    for each in fresh:
        document = each.document
        if isinstance(document, StepStarted):
            rows.setdefault(document.uid, (document.words, document.t_ns, 1))
        elif isinstance(document, StepEnded) and (begun := rows.pop(document.step_uid, None)) is not None:
            done.append((begun[0], begun[1], document.t_ns, document.outcome, 1))
    done += [(words, start_ns, None, "open", n) for words, start_ns, n in rows.values()]
    together: dict[tuple[bytes, int, int | None, str], tuple[StepWords, int]] = {}
    for words, start_ns, end_ns, outcome, n in done:
        key = (msgspec.json.encode(words), start_ns, end_ns, outcome)
        together[key] = words, together.get(key, (words, 0))[1] + n
    return [
        CourseStep(
            words=words, t_start_ns=start_ns, t_end_ns=end_ns, outcome=outcome, units=n,
            is_current=is_live and outcome == "open",
        )
        for (_, start_ns, end_ns, outcome), (words, n) in sorted(together.items(), key=lambda each: each[0][1])
    ]  # fmt: skip


def _gaps(received: list[Received]) -> list[CourseGap]:
    resumed = [each.document for each in received if isinstance(each.document, RunResumed)]
    return [
        CourseGap(from_ns=each.t_ns - each.gap_ns, to_ns=each.t_ns, reason=each.reason)
        for each in resumed
        if each.gap_ns > 0
    ]


def _limits(received: list[Received]) -> dict[str, list[Limit]]:
    found: dict[str, list[Limit]] = {}
    for each in received:
        if isinstance(each.document, LimitsApplied) and each.document.limits:
            found[each.document.unit or ""] = list(each.document.limits)
    return found


def _commands(call: Call, run: str, received: list[Received]) -> list[CommandRow]:
    """Commands, the newest first; the last answer counts."""
    given: dict[str, RunCommandGiven] = {}
    answers: dict[str, RunCommandAnswered] = {}
    for each in received:
        if isinstance(each.document, RunCommandGiven):
            given[each.document.uid] = each.document
        elif isinstance(each.document, RunCommandAnswered):
            before = answers.get(each.document.command)
            if before is None or before.outcome == "accepted":
                answers[each.document.command] = each.document
    rows = []
    for uid, document in given.items():
        answer = answers.get(uid)
        outcome, text, text_zh = ("accepted", "", "") if answer is None else (
            answer.outcome.value, answer.text, answer.text_zh
        )  # fmt: skip
        rows.append(_row(uid, document, outcome, text, text_zh))
    for waiting in withdrawn_commands(call.store, run):
        if waiting.command.id not in given:
            answer_ = waiting.answer
            rows.append(_row(waiting.command.id, waiting.command, answer_.outcome.value, answer_.text, answer_.text_zh))
    return sorted(rows, key=lambda each: -each.given_ns)


def _row(uid: str, of: Any, outcome: str, text: str, text_zh: str) -> CommandRow:
    return CommandRow(
        command=uid, action=of.action.value, by=of.by, reason=of.reason, given_ns=of.given_ns, given=iso(of.given_ns),
        outcome=outcome, text=text, text_zh=text_zh,
    )  # fmt: skip


def _notes(received: list[Received]) -> list[CourseNote]:
    notes = [(each.arrival_ns, each.document) for each in received if isinstance(each.document, NoteAdded)]
    found = []
    for arrival_ns, note in notes[-_MOST_NOTES:]:
        # that on an import has the time of the last sample, which may be months before
        t_ns = arrival_ns if note.is_of_import else note.t_ns
        found.append(CourseNote(t_ns=t_ns, time=iso(t_ns), author=note.author, text=note.text, unit=note.unit))
    return found


def _alerts(call: Call, run: str, units: set[str], received: list[Received], last_ns: int | None) -> list[AlertRow]:
    """Alerts on the run, and those on its units that were raised while it went on."""
    first_ns = min((each.arrival_ns for each in received), default=0)
    until_ns = 2**62 if last_ns is None else last_ns + _LATE_NS
    return [
        alert_row(alert)
        for alert in raised_alerts(call.store)
        if run in alert.key.split("/") or (alert.unit in units and first_ns <= (alert.raised_ns or 0) <= until_ns)
    ]


def _progress(call: Call, run: str) -> CourseProgress | None:
    statuses = read_statuses(call.store)
    for status, condition in zip(statuses, conditions(statuses), strict=True):
        if status.role is ProgramRole.RUN and status.run is not None and status.run.run == run:
            now = status.run
            return CourseProgress(
                condition=condition, step=now.step, steps=now.steps, doing=now.doing, left_s=now.left_s
            )
    return None
