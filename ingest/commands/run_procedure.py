"""What `gyrofleet run PROCEDURE --station FILE --units FILE` does."""

import datetime as dt
import hashlib
import shlex
import string
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple
from zoneinfo import ZoneInfo

import msgspec

from ingest.instruments.base import Instrument
from ingest.procedures.procedure import PlannedStep, Procedure, load_procedure
from ingest.procedures.run_steps import resume_index
from ingest.run.run_path import RunPath, TroubleWatch, opened_spool, path_to, recorder_at
from ingest.station.abilities import check_limits, check_station
from ingest.station.log import RunLog
from ingest.station.operator_console import ConsoleOperator
from ingest.station.preflight import Preflight, preflight
from ingest.station.run import RunStopped, StationRun
from ingest.station.run_state import StationRunState, check_same, read_station_run, unfinished_runs
from ingest.station.sources import StationSources
from ingest.station.station import Station, load_station
from ingest.station.units_file import UnitEntry, load_units, mounted_documents
from ingest.station_clock import StationClock
from storage.store import writer_endpoint
from stream.console import Stop, notes, print_json, results, until_stopped
from stream.errors import BadInput, InstrumentError, RunAborted
from stream.worker.compile_kernels import compile_kernels
from stream.worker.estimated_signals import EstimatedSignals

_INTERRUPTED = 130
_PATIENCE_S = 5.0


class ProcedureRun(NamedTuple):
    """What the command line asks for."""

    procedure: str
    station: Path
    units: Path
    parameters: Mapping[str, str]
    run: str | None
    operator: str | None
    lot: str | None
    says_yes: bool
    is_ended: bool
    is_check: bool
    settle_timeout_s: float
    every_s: float | None
    estimated: EstimatedSignals


def run_procedure(
    asked: ProcedureRun, folder: Path, connect: str | None, spool_folder: Path, spool_bytes: int, *, as_json: bool
) -> int:
    """Carry out a procedure at a station, from where it is; returns the exit code.

    Raises
    ------
    GyrofleetError: If a file cannot be used, the station cannot do what the procedure asks, or recording fails.
    """
    procedure = load_procedure(asked.procedure)
    steps = procedure.steps(asked.parameters)
    station = load_station(asked.station)
    entries = load_units(asked.units, station.slots or None)
    serials = tuple(entry.serial for entry in entries)
    check_station(station, procedure, asked.parameters)
    clock = station.make_clock()
    instruments = station.make_instruments(clock)
    check_limits(station, instruments, procedure, asked.parameters)
    with ExitStack() as stack:
        stack.enter_context(station.held())
        plan = hashlib.sha256(msgspec.json.encode(steps)).hexdigest()
        left = asked.run or _left_run(spool_folder, procedure, serials)
        known = None if left is None else _known(spool_folder / left, procedure, plan, serials)
        if known is None and asked.is_ended:
            raise BadInput(
                f"there is nothing to end: no run of {procedure.name} with these units has been left unfinished"
            )
        connect = connect or writer_endpoint(folder)
        phase = "starting" if known is None else known.phase
        sources = None if _is_over(phase, asked) else StationSources(station, instruments, clock, serials)
        folders = [spool_folder] if connect is not None else [folder, spool_folder]
        found = _looked(
            stack, sources, station, instruments, folders, clock, procedure.duration_s(None, asked.parameters)
        )
        if asked.is_check:
            _tell_checked(found, procedure, steps, as_json=as_json)
            return 0
        run = left or _fresh_id(spool_folder, procedure, station, clock.now_ns())
        if connect is None:
            compile_kernels(quiet=as_json)
        stop = stack.enter_context(until_stopped())
        operator = stack.enter_context(
            ConsoleOperator(
                notes(), stop, says_yes=asked.says_yes, quiet=as_json, listens=not asked.says_yes or sys.stdin.isatty()
            )
        )
        # nothing is made on disk before everybody is reached
        elsewhere = stack.enter_context(recorder_at(None if phase == "ended" else connect))
        spool = stack.enter_context(
            opened_spool(folder, spool_folder / run, spool_bytes, is_remote=connect is not None)
        )
        log = RunLog(run, procedure.name, plan, serials, station, spool, clock)
        if log.state.phase == "ended":
            _tell(log, steps, "ended", "nothing to do, all of it is recorded", as_json=as_json)
            return 0
        path = stack.enter_context(path_to(folder, run, elsewhere, spool, asked.every_s, asked.estimated, serials))
        trouble = TroubleWatch(path.publisher, operator.told)
        operator.watch(trouble.look)
        leave = partial(_leave, log, steps, path, stop, as_json=as_json)
        log.begin(
            path.sender,
            mounted_documents(entries, run, log.state.t0_ns),
            {f"instrument.{name}": each for name, each in found.instruments.items()}
            | _about(station, procedure, asked.parameters),
            operator=asked.operator or _common(entries, "operator"),
            lot=asked.lot or _common(entries, "lot"),
            at=resume_index(steps, log.state.step),
            warnings=found.warnings,
        )
        for warning in _others(spool_folder, log, procedure):
            operator.told(warning)
        resumed = f"goes on at step {log.state.step + 1} after a gap of {log.gap_s:,.0f} s, " if log.is_resumed else ""
        _tell(log, steps, "running", f"{resumed}{path.where}", as_json=as_json)
        code = 0
        if log.state.phase == "running" and asked.is_ended:
            _bring_to_rest(log, steps, station, instruments, operator, clock)
            log.end("stopped")
        elif log.state.phase == "running" and sources is not None:
            live = StationRun(
                log, steps, station, instruments, operator, clock, settle_timeout_s=asked.settle_timeout_s
            )
            try:
                live.go(partial(sources.make, log, live.report), sources.samplers(log, live.report))
            except (RunStopped, InstrumentError) as stopped:
                return leave(str(stopped))
            except RunAborted as aborted:
                operator.told(str(aborted))
                code = 1
            log.end("aborted" if code else "completed")
            code = code or len(live.unsafe[:1])  # told already; whoever waits for the command is to look as well
        else:
            log.end(log.state.outcome)  # it was killed while it waited for the recorder
        _drain(path, trouble, stop)
        if path.publisher.outstanding:
            return leave("interrupted before all of it was recorded")
        path.finish()
        log.close()
        short = log.state.short_records
        lacking = f"{short} records of a unit in a step lack samples, see its notes; " if short else ""
        _tell(log, steps, "ended", lacking + _next(path), as_json=as_json)
        return code


def _is_over(phase: str, asked: ProcedureRun) -> bool:
    """Whether nothing more is to be measured."""
    return phase not in {"starting", "running"} or (phase == "running" and asked.is_ended)


def _looked(
    stack: ExitStack, sources: StationSources | None, station: Station, instruments: Mapping[str, Instrument],
    folders: list[Path], clock: StationClock, duration_s: float,
) -> Preflight:  # fmt: skip
    """See whether a run can begin, where one is to; people are warned at once."""
    if sources is None:
        return Preflight({}, ())
    found = preflight(
        stack, station, instruments, sources, folders=folders, now_ns=clock.now_ns(), duration_s=duration_s
    )
    for warning in found.warnings:
        notes().print(warning, soft_wrap=True, markup=False)
    return found


def _known(spool: Path, procedure: Procedure, plan: str, units: tuple[str, ...]) -> StationRunState | None:
    """The run as it was left; None where none was begun."""
    state = read_station_run(spool)
    if state is not None:
        check_same(state, procedure.name, plan, units)
    return state


def _bring_to_rest(
    log: RunLog, steps: tuple[PlannedStep, ...], station: Station, instruments: Mapping[str, Instrument],
    operator: ConsoleOperator, clock: StationClock,
) -> None:  # fmt: skip
    """Make a station safe that a run was left at, perhaps by being killed; it is ended whether that works or not."""
    with ExitStack() as stack:
        for instrument in instruments.values():
            with suppress(InstrumentError):  # told below, where it cannot be made safe
                instrument.open()
                stack.callback(instrument.close)
        StationRun(log, steps, station, instruments, operator, clock).make_safe()


def _others(spool: Path, log: RunLog, procedure: Procedure) -> list[str]:
    """Runs of this procedure that were left unfinished with other units."""
    return [
        f"warning: run {state.run} of {', '.join(state.units[:4])}{' and others' if len(state.units) > 4 else ''} was "
        f"left unfinished at step {state.step + 1}; give its --units to go on with it, with --end to end it"
        for state in unfinished_runs(spool)
        if state.procedure == procedure.name and state.run != log.state.run
    ]


def _left_run(spool: Path, procedure: Procedure, units: tuple[str, ...]) -> str | None:
    """The run of this procedure and these units that is to go on; None where none was left."""
    for state in unfinished_runs(spool):
        if state.procedure == procedure.name and set(state.units) == set(units):
            return state.run
    return None


def _fresh_id(spool: Path, procedure: Procedure, station: Station, now_ns: int) -> str:
    """A run's id: the day and a letter."""
    day = dt.datetime.fromtimestamp(now_ns / 1e9, ZoneInfo(station.table.time_zone)).date()
    for n in range(26 * 26):
        letters = string.ascii_uppercase
        name = f"{day}-{procedure.name}-{letters[n // 26 - 1] if n >= 26 else ''}{letters[n % 26]}"
        if not any((spool / name).glob("*.json")):  # a run was begun there
            return name
    raise BadInput(f"there are {26 * 26} runs of {procedure.name} on {day}: give this one a name with --run")


def _about(station: Station, procedure: Procedure, parameters: Mapping[str, str]) -> dict[str, str]:
    """What the run's first document says beside its names."""
    chosen = {f"parameter.{name}": str(value) for name, value in procedure.chosen(parameters).items()}
    where = station.table.location.details
    calibrated = {
        f"calibration_due.{name}": options.calibration_due
        for name, (_, options) in station.instruments.items()
        if options.calibration_due is not None
    }
    return {"procedure_source": "; ".join(procedure.source), **where, **chosen, **calibrated}


def _common(entries: tuple[UnitEntry, ...], what: str) -> str | None:
    values = {getattr(entry, what) for entry in entries}
    return values.pop() if len(values) == 1 else None


def _drain(path: RunPath, trouble: TroubleWatch, stop: Stop) -> None:
    """Wait until all of it is recorded; asked to stop, not for long."""

    def is_given_up() -> bool:
        trouble.look()
        return stop.asked_at is not None and time.monotonic() > stop.asked_at + _PATIENCE_S

    path.publisher.drain(is_given_up)


def _leave(log: RunLog, steps: tuple[PlannedStep, ...], path: RunPath, stop: Stop, why: str, *, as_json: bool) -> int:
    """Leave a run that can be gone on with; the exit code."""
    until = time.monotonic() + _PATIENCE_S
    path.publisher.drain(lambda: time.monotonic() > until)
    left = path.publisher.outstanding
    if left:
        path.publisher.abandon()
    else:
        path.finish()
    kept = f"{left} messages wait in the spool; " if left else ""
    remark = f"{why}; {kept}give the same command to go on, with --end to end it"
    _tell(log, steps, "interrupted", remark, as_json=as_json)
    return _INTERRUPTED if stop.asked_at is not None else 1


def _next(path: RunPath) -> str:
    if path.folder is None:
        return "every sample is recorded"
    store = f" --store {shlex.quote(str(path.folder))}"
    query = "select run, unit, step, rate_command, started, ended from steps"
    return f'every sample is recorded; ask for it: gyrofleet sql{store} "{query}"'


def _tell(log: RunLog, steps: tuple[PlannedStep, ...], event: str, remark: str, *, as_json: bool) -> None:
    state = log.state
    if as_json:
        print_json(
            {
                "event": event,
                "run": state.run,
                "procedure": state.procedure,
                "units": list(state.units),
                "steps": len(steps),
                "steps_done": state.steps_done,
                "samples": log.samples,
                "short_records": state.short_records,
                "resumed": log.is_resumed,
                "gap_s": log.gap_s,
                "outcome": state.outcome if event == "ended" else None,
                "remark": remark,
            }
        )
        return
    console = results() if event == "ended" else notes()
    done = f"{state.steps_done} of {len(steps)} steps"
    outcome = f" ({state.outcome})" if event == "ended" else ""
    console.print(
        f"run {state.run} {event}{outcome}: {done}, {log.samples:,} samples; {remark}", soft_wrap=True, markup=False
    )


def _tell_checked(found: Preflight, procedure: Procedure, steps: tuple[PlannedStep, ...], *, as_json: bool) -> None:
    """Say that a run could begin."""
    if as_json:
        about = {"procedure": procedure.name, "steps": len(steps)}
        print_json({"event": "checked", **about, "instruments": found.instruments, "warnings": list(found.warnings)})
        return
    for name, identity in found.instruments.items():
        results().print(f"{name}: {identity}", soft_wrap=True, markup=False)
    results().print(f"{procedure.name} could begin: {len(steps)} steps; nothing was written", soft_wrap=True)
