"""The command `gyrofleet status`."""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stream.terminal.console import notes, print_json, reporting, results, store_option, until_stopped
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from storage.recording.store_status import RoleReport, StoreStatus
    from storage.replication.fleet_status import FleetStatus
    from stream.status.role_status import RunProgress

_EVERY_S = 2.0
_NAMED = 8
_CHINESE = {"PASS": "合格", "FAIL": "不合格"}
_AT_WORK = ("working", "paused")


@click.command("status")
@store_option
@click.option("--watch", "is_watch", is_flag=True, help="Show it again every 2 s, until stopped.")
@reporting
def status(folder: Path, *, is_watch: bool, as_json: bool) -> None:
    """Show what is at work on a store: recorder, estimators, runs with step and time left, units by verdict, disk.

    The exit code is 0 where all that is at work is well, 1 where a role has failed, was killed, is silent or paused,
    lags, or has trouble; the troubles are listed. Each role reports once a second, also over the bus from another
    computer. --status-listen of a role serves the same to Prometheus. Of a
    fleet store: how far each plant's copy is behind, and what was refused.
    """
    from storage.fleet_store import FleetStore, is_fleet
    from storage.recording.store_status import StoreStatus, store_status
    from storage.replication.fleet_status import FleetStatus, fleet_status
    from storage.store import Store

    look: Callable[[], StoreStatus | FleetStatus]
    if is_fleet(folder):
        fleet = FleetStore.open(folder)
        look = partial(fleet_status, fleet)
    else:
        look = partial(store_status, Store.open(folder))
    with until_stopped() as stopped:
        while True:
            found = look()
            if as_json:
                print_json(found)
            else:
                if is_watch and results().is_terminal:
                    results().clear()
                if isinstance(found, FleetStatus):
                    _show_fleet(found)
                else:
                    _show(found)
            if not is_watch or stopped.wait(_EVERY_S):
                break
    sys.exit(1 if found.troubles else 0)


def _show_fleet(found: "FleetStatus") -> None:
    from storage.recording.disk_watch import format_bytes

    table = ResultTable("plant", "segments", "bytes", "behind", "last answered")
    for each in found.plants:
        lag = f"{each.lag.segments:,} segments, {each.lag.seconds:,.0f} s" if each.lag.segments else "-"
        age = "never" if each.contact_age_s is None else f"{_duration(each.contact_age_s)} ago"
        table.add_row(each.plant, f"{each.segments:,}", format_bytes(each.bytes), lag, age)
    results().print(table)
    results().print(f"{format_bytes(found.free_bytes)} free of {format_bytes(found.disk_bytes)}")
    for trouble in found.troubles:
        notes().print(f"trouble: {trouble}", soft_wrap=True, markup=False)


def _show(found: "StoreStatus") -> None:
    from storage.recording.disk_watch import format_bytes

    console = results()
    if found.roles:
        table = ResultTable("role", "name", "state", "for", "what")
        for role in found.roles:
            table.add_row(role.status.role, role.status.name, role.condition, _since(role), _what(role))
        console.print(table)
    else:
        console.print("nothing is at work on this store")
    if found.verdicts:
        listed = ", ".join(f"{count} {verdict}" for verdict, count in sorted(found.verdicts.items()))
        console.print(f"units of the runs at work, so far: {listed}")
    for role in found.roles:
        if role.status.run is not None and role.status.run.released:
            console.print(_released(role.status.run), soft_wrap=True)
    if any(role.condition == "unknown" for role in found.roles):
        console.print("no recorder is at work: what runs and estimators do now is not known")
    if found.last_message_age_s is not None:
        console.print(f"last message {found.last_message_age_s:,.1f} s ago")
    spool = f"; {format_bytes(found.spool_bytes)} in spools" if found.spool_bytes else ""
    console.print(
        f"{found.segments:,} sealed segments, {found.segments_not_in_lake:,} of them not in the lake; "
        f"{format_bytes(found.free_bytes)} free of {format_bytes(found.disk_bytes)}{spool}"
    )
    for trouble in found.troubles:
        notes().print(f"trouble: {trouble}", soft_wrap=True, markup=False)


def _since(role: "RoleReport") -> str:
    """For how long a role has worked, or how long ago it ended or reported last."""
    return _duration(role.works_s) if role.condition in _AT_WORK else f"{_duration(role.age_s)} ago"


def _what(role: "RoleReport") -> str:
    status, run = role.status, role.status.run
    if run is not None:
        left = "" if run.left_s is None else f"{_duration(run.left_s)} left"
        waits = status.numbers.get("outstanding_messages", 0.0)
        waiting = f"; {waits:,.0f} messages not recorded yet" if waits else ""
        judged = run.undecided.keys() | run.verdicts.keys()
        early = f"; {len(run.verdicts)} of {len(judged)} units have a verdict so far" if judged else ""
        if run.released:
            early += (
                f"; {len(run.released)} of {len(run.units)} units released, {run.saved_s / 3600:,.1f} unit hours saved"
            )
        doing = [run.doing, left] if role.condition in {*_AT_WORK, "silent", "unknown"} else []
        return ", ".join(filter(None, [f"{run.run}: step {run.step} of {run.steps}", *doing])) + early + waiting
    samples = status.numbers.get("samples_total")
    lag_s = status.numbers.get("lag_seconds")
    parts = [] if samples is None else [f"{samples:,.0f} samples"]
    parts += [] if lag_s is None else [f"{lag_s:,.1f} s behind"]
    segments = status.numbers.get("segments_total")
    parts += [] if segments is None else [f"{segments:,.0f} segments"]
    return ", ".join(parts)


def _released(run: "RunProgress") -> str:
    """Units that a run has released, in English and Chinese, some of them by name.

    >>> from stream.status.role_status import RunProgress
    >>> _released(RunProgress(run="r1", units=("U1", "U2"), released={"U1": "PASS"}, saved_s=5400.0))
    'released 已提前结束 r1: U1 PASS 合格; 1.5 unit hours saved 节省产品小时'
    """
    named = [f"{unit} {verdict} {_CHINESE.get(verdict, '')}".rstrip() for unit, verdict in sorted(run.released.items())]
    more = f" and {len(named) - _NAMED} more" if len(named) > _NAMED else ""
    hours = run.saved_s / 3600.0
    return (
        f"released 已提前结束 {run.run}: {', '.join(named[:_NAMED])}{more}; {hours:,.1f} unit hours saved 节省产品小时"
    )


def _duration(seconds: float) -> str:
    """A duration for people.

    >>> _duration(75.0), _duration(3 * 3600 + 120), _duration(9.4)
    ('1 min 15 s', '3 h 02 min', '9 s')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
