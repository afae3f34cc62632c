"""What `gyrofleet run PROCEDURE --station FILE --units FILE` does."""

import hashlib
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec

from ingest.instruments.base import Instrument
from ingest.procedures.plan import PlannedStep
from ingest.procedures.procedure import Procedure, load_procedure
from ingest.procedures.run_steps import NOTHING_RECORDED, resume_index
from ingest.run import run_path
from ingest.run.command_boxes import command_box
from ingest.run.run_path import INTERRUPTED, Destination, RunPath, TroubleWatch
from ingest.station.bench import StationBench, check_limits, check_station
from ingest.station.checks.preflight import Preflight, preflight
from ingest.station.checks.rest import by_hand
from ingest.station.operator_console import ConsoleOperator
from ingest.station.releases import Release, Releases
from ingest.station.run import RunStopped, StationRun
from ingest.station.run_commands import RunCommands
from ingest.station.run_limits import NO_LIMITS, LimitReport, RunLimits, listed, run_limits
from ingest.station.run_log import RunLog, check_same, fresh_id, left_run, other_unfinished, read_station_run
from ingest.station.run_status import run_status
from ingest.station.sources import StationSources
from ingest.station.station import Station, load_station
from ingest.station.units_file import UnitEntry, in_fixtures, mounted_documents, read_units
from ingest.station_clock import StationClock
from storage.store import writer_endpoint
from stream.errors import BadInput, InstrumentError, RunAborted
from stream.events import Verdict
from stream.status.reporter import StatusReporter, served
from stream.terminal.console import Stop, counted, notes, print_json, results, structured_log, until_stopped
from stream.worker.compile_kernels import compile_kernels
from stream.worker.estimated_signals import EstimatedSignals

_RESUMES = "the same command resumes it, and ends it with --end"


class ProcedureRun(NamedTuple):
    """What the command line asks for."""

    procedure: str
    station: Path
    units: Path
    parameters: Mapping[str, str]
    specification: str | None
    run: str | None
    operator: str | None
    lot: str | None
    says_yes: bool
    is_ended: bool
    is_check: bool
    settle_timeout_s: float
    every_s: float | None
    estimated: EstimatedSignals
    status_listen: str | None
    stops_when_decided: bool = False


class _Job(NamedTuple):
    """What is carried out where; `plan` is the SHA-256 of the steps."""

    procedure: Procedure
    steps: tuple[PlannedStep, ...]
    plan: str
    station: Station
    entries: tuple[UnitEntry, ...]
    serials: tuple[str, ...]
    clock: StationClock
    instruments: Mapping[str, Instrument]


def run_procedure(asked: ProcedureRun, destination: Destination, *, as_json: bool) -> int:
    """Carry out a procedure from where it is; the exit code. Raises GyrofleetError if it cannot be done or recorded."""
    job = _job(asked)
    with ExitStack() as stack:
        stack.enter_context(job.station.held())
        left = asked.run or left_run(destination.spools, job.procedure.name, job.serials)
        known = None if left is None else read_station_run(destination.spools / left)
        if known is not None:
            check_same(known, job.procedure.name, job.plan, job.serials)
        if known is None and asked.is_ended:
            no_run = f"no run of {job.procedure.name} with these units has been left unfinished"
            raise BadInput(f"there is nothing to end: {no_run}")
        phase = "starting" if known is None else known.phase
        is_ending = asked.is_ended or (known is not None and known.aborted_by is not None)
        is_over = phase not in {"starting", "running"} or (phase == "running" and is_ending)
        sources = None if is_over else StationSources(job.station, job.instruments, job.clock, job.serials)
        at = 0 if known is None else resume_index(job.steps, known.step)
        found = _checked(stack, job, asked, sources, destination, at)
        t0_ns = job.clock.now_ns() if known is None else known.t0_ns
        limits = _limits(asked, job, sources, destination.folder, t0_ns)
        if asked.is_check:
            _report_check(found, limits, job, as_json=as_json)
            return 0
        run = left or fresh_id(destination.spools, job.procedure.name, job.station.day(job.clock.now_ns()))
        if destination.connect is None:
            compile_kernels(quiet=as_json)
        stop = stack.enter_context(until_stopped())
        says_yes, listens = asked.says_yes, not asked.says_yes or sys.stdin.isatty()
        operator = stack.enter_context(
            ConsoleOperator(
                notes(), stop, says_yes=says_yes, quiet=as_json, listens=listens, takes_s=job.clock.computer_s
            )
        )
        # nothing is made on disk before everybody is reached
        bus = stack.enter_context(run_path.recorder_at(None if phase == "ended" else destination.connect))
        spool = stack.enter_context(run_path.opened_spool(destination, destination.spools / run))
        log = RunLog(run, job.procedure.name, job.plan, job.serials, job.station, spool, job.clock)
        judged = (
            [unit for unit, found in limits.units.items() if found.live] if limits.is_live and bus is not None else ()
        )
        decisions = LimitReport(operator.report, judged, limits.units)
        report = partial(_report, log, len(job.steps), decisions, as_json=as_json)
        if log.state.phase == "ended":
            report("ended", "nothing to do, all of it is recorded")
            return 0
        reached = run_path.path_to(
            destination, run, bus, spool, asked.every_s, asked.estimated, job.serials, decisions.see,
            station=job.station.place.station, on_estimate=decisions.estimate_arrived,
        )  # fmt: skip
        path = stack.enter_context(reached)
        trouble = TroubleWatch(path.publisher, operator.report, lambda: decisions.silence, lambda: log.unsaved)
        log.keep_waiting = partial(setattr, path.publisher, "waits_when_full")
        log.keep_waiting(True)
        releases = _releases(asked, job, limits, decisions)
        operator.may_end_early = releases is not None
        why_left: list[str] = []
        about = (log, job.steps, job.station, job.clock, operator, decisions, path.publisher, time.time_ns(), why_left)
        collect = partial(run_status, *about)
        stack.enter_context(served(asked.status_listen, collect))
        stack.enter_context(StatusReporter(collect, path.put_status))
        operator.watch(trouble.look)
        nothing = () if any(each.is_recorded for each in job.steps) else (f"warning: {NOTHING_RECORDED}",)
        lots = _other_lots(asked.lot, job.entries)
        for remark in (*nothing, *lots, *limits.remarks, *(releases.remarks() if releases else ())):
            operator.report(remark)
        log.begin(
            path.sender, mounted_documents(job.entries, run, log.state.t0_ns),
            {f"instrument.{name}": each for name, each in found.instruments.items()} | _about(job, asked.parameters),
            operator=asked.operator or _common(job.entries, "operator"),
            lot=asked.lot or _common(job.entries, "lot"), at=resume_index(job.steps, log.state.step),
            warnings=found.warnings, limits=limits,
        )  # fmt: skip
        box = command_box(destination, run, operator.report)
        commands = stack.enter_context(RunCommands(box, log, time.time_ns, operator.report))
        commands.begin()
        operator.attend(commands)
        for warning in other_unfinished(destination.spools, job.procedure.name, run, job.serials):
            operator.report(warning)
        resumed = f"resumes at step {log.state.step + 1} after a gap of {log.gap_s:,.0f} s, " if log.is_resumed else ""
        report("running", f"{resumed}{path.where}")
        try:
            with _noted(why_left):
                code = _carried_out(log, job, asked, sources, operator, releases, decisions, commands, why_left)
        except (RunStopped, InstrumentError) as stopped:
            return _leave(str(stopped), path, stop, report)
        run_path.drain(path, trouble, stop)
        if path.publisher.outstanding:
            why_left.append(f"not all of it is recorded yet; {_RESUMES}")
            return _leave("interrupted before all of it was recorded", path, stop, report)
        path.finish()
        log.close()
        for line in log.savings():
            operator.report(line)
        has_limits = bool(limits.units)
        report("ended", "; ".join([*why_left, _done(log, decisions.verdicts, path.folder, has_limits=has_limits)]))
        return code


def _job(asked: ProcedureRun) -> _Job:
    procedure = load_procedure(asked.procedure)
    steps = procedure.steps(asked.parameters)
    station = load_station(asked.station)
    entries = in_fixtures(read_units(asked.units, station.slots or None).entries, station.slots)
    check_station(station, procedure, asked.parameters)
    clock = station.make_clock()
    instruments = station.make_instruments(clock)
    check_limits(station, instruments, procedure, asked.parameters)
    plan = hashlib.sha256(msgspec.json.encode(steps)).hexdigest()
    serials = tuple(entry.serial for entry in entries)
    return _Job(procedure, steps, plan, station, entries, serials, clock, instruments)


def _releases(asked: ProcedureRun, job: _Job, limits: RunLimits, decisions: LimitReport) -> Releases | None:
    if not asked.stops_when_decided:
        return None
    return Releases(job.station, StationBench(job.station, job.instruments), job.entries, limits, decisions)


def _carried_out(
    log: RunLog, job: _Job, asked: ProcedureRun, sources: StationSources | None, operator: ConsoleOperator,
    releases: Releases | None, decisions: LimitReport, commands: RunCommands, why_left: list[str],
) -> int:  # fmt: skip
    """Carry out what is left; the exit code. `why_left` gets the instruments that could not be made safe."""
    if log.state.phase != "running":
        log.end(log.state.outcome)  # it was killed while it waited for the recorder
        return 0
    live = StationRun(
        log, job.steps, job.station, job.instruments, operator, job.clock, settle_timeout_s=asked.settle_timeout_s,
        releases=releases, on_record=decisions.begin_record,
    )  # fmt: skip
    if sources is None:
        with ExitStack() as stack:  # the station was left as it was, perhaps by a run that was killed
            for instrument in job.instruments.values():
                with suppress(InstrumentError):  # reported where it cannot be made safe
                    instrument.open()
                    stack.callback(instrument.close)
            live.make_safe()
        why_left += by_hand(live.unsafe)
        commands.finish_abort(live.unsafe)
        commands.end()
        log.end("aborted" if commands.is_aborted else "stopped")
        return int(commands.is_aborted)
    try:
        live.go(partial(sources.make, log, live.report), sources.samplers(log, live.report))
    except (RunStopped, InstrumentError) as stopped:
        raise type(stopped)(f"{stopped}; {live.safety}") from stopped
    except RunAborted as aborted:
        why_left += by_hand(live.unsafe)
        operator.report(f"{aborted}; {live.safety}")
        commands.finish_abort(live.unsafe)
        commands.end()
        log.end("aborted")
        return 1
    except Exception:
        why_left += by_hand(live.unsafe)
        raise
    why_left += by_hand(live.unsafe)
    commands.end()
    log.end("completed")
    return int(bool(live.unsafe))  # reported already; whoever waits for the command is to look as well


def _checked(
    stack: ExitStack, job: _Job, asked: ProcedureRun, sources: StationSources | None, destination: Destination, at: int
) -> Preflight:
    """Check whether a run can begin at a step, where one is to; warnings are shown at once."""
    if sources is None:
        return Preflight({}, ())
    duration_s = job.procedure.duration_s(asked.parameters)
    folders = [destination.spools] if destination.connect is not None else [destination.folder, destination.spools]
    is_here = destination.connect in {None, writer_endpoint(destination.folder)}
    recorded_s = sum(each.warm_up_s + each.settle_s + each.record_s for each in job.steps[at:])
    found = preflight(
        stack, job.station, job.instruments, sources, folders=folders, now_ns=job.clock.now_ns(), duration_s=duration_s,
        store=destination.folder if is_here else None, recorded_s=recorded_s,
        waited={what for each in job.steps[at:] for what in each.wait_settled},
    )  # fmt: skip
    if (remark := sources.remark_on(asked.estimated)) is not None:
        found = found._replace(warnings=(*found.warnings, f"warning: {remark}"))
    for warning in found.warnings:
        notes().print(warning, soft_wrap=True)
    return found


def _limits(asked: ProcedureRun, job: _Job, sources: StationSources | None, folder: Path, t_ns: int) -> RunLimits:
    if sources is None:
        return NO_LIMITS
    rates = sources.rate_signals()
    return run_limits(folder, asked.specification, job.entries, rates, job.steps, job.procedure.name, t_ns)


def _about(job: _Job, parameters: Mapping[str, str]) -> dict[str, str]:
    chosen = {f"parameter.{name}": str(value) for name, value in job.procedure.chosen(parameters).items()}
    where = job.station.table.details | job.station.standards_details
    calibrated = {
        f"calibration_due.{name}": options.calibration_due
        for name, (_, options) in job.station.instruments.items()
        if options.calibration_due is not None
    }
    return {"procedure_source": "; ".join(job.procedure.source), **where, **chosen, **calibrated}


def _common(entries: tuple[UnitEntry, ...], what: str) -> str | None:
    values = {getattr(entry, what) for entry in entries}
    return values.pop() if len(values) == 1 else None


def _other_lots(given: str | None, entries: Sequence[UnitEntry]) -> tuple[str, ...]:
    """A warning where the list of units names other lots than the run's."""
    others = sorted({entry.lot for entry in entries if entry.lot is not None and entry.lot != given})
    if given is None or not others:
        return ()
    units = sum(entry.lot in others for entry in entries)
    named = f"{units} of {len(entries)} units are of lot {', '.join(others[:4])}"
    return (f"warning: --lot is {given}, but in --units {named}: the units keep theirs",)


@contextmanager
def _noted(why_left: list[str]) -> Iterator[None]:
    """Note why a run is left before its end, for its status."""
    try:
        yield
    except (RunStopped, InstrumentError) as stopped:
        why_left.append(f"{stopped}; {_RESUMES}")
        raise
    except Exception as error:
        why_left.append(f"{type(error).__name__}: {error}; {_RESUMES}")
        raise


def _done(log: RunLog, verdicts: Mapping[str, str], folder: Path | None, *, has_limits: bool) -> str:
    """What to report of a run that has ended: what lacks, what the live limits say, and what to ask next."""
    short = log.state.short_records
    lacking = f"{short} records of a unit in a step lack samples, see its notes; " if short else ""
    lost, not_read = log.account.lost, log.account.not_read
    lacking += f"{not_read:,} samples were not read while there was no room for them; " if not_read else ""
    lacking += f"{lost - not_read:,} samples were lost on their way; " if lost > not_read else ""
    # what an earlier process had not on disk when it ended is known to nobody
    which = "every sample that was kept" if log.is_resumed else "every sample"
    if not log.is_resumed and (lost or log.account.has_waited):
        which = "every other sample"
    where = f"{lacking}{which} is recorded{_by_live_limits(verdicts)}"
    if folder is None:
        return where
    store = shlex.quote(str(folder))
    if has_limits:
        where += f"; judge it: gyrofleet verdicts --store {store}"
    query = "select run, unit, step, rate_command, started, ended from steps"
    return f'{where}; ask for it: gyrofleet sql --store {store} "{query}"'


def _by_live_limits(verdicts: Mapping[str, str]) -> str:
    """How many units have each verdict, and which do not pass; empty where nothing was judged live."""
    if not verdicts:
        return ""
    by_verdict: dict[str, list[str]] = {}
    for unit, verdict in sorted(verdicts.items()):
        by_verdict.setdefault(verdict, []).append(unit)
    named = (
        f"{len(units)} {verdict}{f' ({listed(units)})' if verdict != Verdict.PASS else ''}"
        for verdict, units in by_verdict.items()
    )
    return f"; by the live limits {', '.join(named)}"


def _leave(why: str, path: RunPath, stop: Stop, report: Callable[[str, str], None]) -> int:
    """Leave a run that can be resumed; the exit code."""
    report("interrupted", f"{why}; {run_path.left_behind(path, 'the spool')}")
    return INTERRUPTED if stop.asked_at is not None else 1


def _report(log: RunLog, steps: int, decisions: LimitReport, event: str, remark: str, *, as_json: bool) -> None:
    state = log.state
    if as_json:
        about = {"event": event, "run": state.run, "procedure": state.procedure, "units": list(state.units)}
        done = {"steps": steps, "steps_done": state.steps_done, "samples": log.samples}
        account = {"lost_samples": log.account.lost, "not_read_samples": log.account.not_read}
        short = {"short_records": state.short_records, **account, "resumed": log.is_resumed, "gap_s": log.gap_s}
        released = {unit: _release(each) for unit, each in state.released.items()}
        outcome = state.outcome if event == "ended" else None
        print_json(
            {
                **about,
                **done,
                **short,
                "outcome": outcome,
                "verdicts": decisions.verdicts,
                "released": released,
                "remark": remark,
            }
        )
        return
    ended, console = (f" ({state.outcome})", results()) if event == "ended" else ("", notes())
    progress = f"{state.steps_done} of {steps} steps, {log.samples:,} samples"
    text = f"run {state.run} {event}{ended}: {progress}; {remark}"
    if structured_log:
        structured_log[-1]("info", event, text)
        return
    console.print(text, soft_wrap=True)


def _release(release: Release) -> dict[str, object]:
    return {**msgspec.to_builtins(release), "saved_s": release.saved_s}


def _report_check(found: Preflight, limits: RunLimits, job: _Job, *, as_json: bool) -> None:
    if as_json:
        about = {"procedure": job.procedure.name, "steps": len(job.steps), "instruments": found.instruments}
        about["measured"] = found.measured
        room = None if found.room is None else found.room._asdict()
        remarks = {"warnings": list(found.warnings), "limits": list(limits.remarks)}
        print_json({"event": "checked", **about, **remarks, "room": room})
        return
    for name, identity in found.instruments.items():
        measured = ", ".join(f"{what} {value}" for what, value in found.measured[name].items())
        results().print(f"{name}: {identity}{f'; {measured}' if measured else ''}", soft_wrap=True)
    for line in limits.remarks:
        results().print(line, soft_wrap=True)
    if found.room is not None and found.room.warning is None:
        results().print(f"it takes {found.room}", soft_wrap=True)
    warned = f", {counted(len(found.warnings), 'warning')}" if found.warnings else ""
    could = f"{job.procedure.name} could begin: {len(job.steps)} steps{warned}; nothing was written"
    results().print(could, soft_wrap=True)
