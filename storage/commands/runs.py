"""The commands `gyrofleet runs`: what was measured, and what of it is excluded from evaluation."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from storage.commands.stored_names import RUN, UNIT
from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import counted, notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable
from stream.terminal.security_options import secured

_RUNS = """
with tested as (
  select run, unit from steps union select run, unit from units
), excluded as (
  select run, {unit: unit, reason: reason, "by": by_whom} as unit from exclusions
)
select r.run, r.started::timestamp as started, r.duration_s, r.outcome,
  (select count(*) from tested t where t.run = r.run) as units,
  (select coalesce(list(x.unit order by x.unit), []) from excluded x where x.run = r.run) as excluded
from runs r order by r.started, r.run
"""

_ACT = (
    click.argument("run", type=RUN, required=False),
    click.option("--unit", "units", type=UNIT, multiple=True, help="Only this unit of it; repeatable."),
    click.option("--check", metavar="UID", help="A check entered by hand, in place of a run."),
    click.option("--reason", required=True, help="Why; it stands in the log with your name."),
    click.option("--by", help="Who; by default the user of the system, with --security whom it names."),
    store_option,
    reporting,
    secured(Role.APPROVER, Role.RECORDER),
)


def _act(function: Callable[..., None]) -> Callable[..., None]:
    """What both acts on runs take."""
    for each in reversed(_ACT):
        function = each(function)
    return function


@click.group("runs", cls=CommandGroup)
def runs() -> None:
    """Runs of a store: list them, exclude a bad one from evaluation with a reason, include it again.

    What is excluded stays in the log and can be seen; metrics, verdicts, trends, diagnoses and new certificates leave
    it out, and all but certificates name it. The last word counts, for each unit of a run.

    A check that was entered by hand (`gyrofleet check`) is excluded alone by its --check, the uid that `audit --json`
    and `events` name.

    \b
    gyrofleet runs exclude static-3 --reason "the table was kicked"
    gyrofleet runs exclude lot-7 --unit FOG-12 --reason "was FOG-21"
    """  # noqa: D301  click's mark for lines that are not to be joined


@runs.command("list")
@store_option
@reporting
def list_runs(folder: Path, *, as_json: bool) -> None:
    """List all runs, and which units of them are excluded."""
    from storage.sql.catalog import Catalog
    from storage.store import Store

    with Catalog(Store.open(folder), live=True) as catalog:
        found = catalog.user_reader(_RUNS).read_all().to_pylist()
    if as_json:
        print_json([{**row, "started": None if row["started"] is None else f"{row['started']}Z"} for row in found])
        return
    table = ResultTable("run", "started", "duration, s", "outcome", "units", "excluded")
    for row in found:
        excluded = row["excluded"]
        named = [f"{each['unit']}: {each['reason']} ({each['by']})" for each in excluded[:4]]
        more = [f"and {len(excluded) - 4} more"] if len(excluded) > 4 else []
        lasted = "" if row["duration_s"] is None else f"{row['duration_s']:.6g}"
        started = "" if row["started"] is None else f"{row['started']:%Y-%m-%d %H:%M:%S}Z"
        table.add_row(row["run"], started, lasted, row["outcome"], str(row["units"]), "; ".join(named + more))
    results().print(table)


@runs.command("exclude")
@_act
def exclude(run: str | None, folder: Path, **given: Any) -> None:
    """Exclude a RUN from every evaluation; its samples stay."""
    _enter("excluded", run, folder, **given)


@runs.command("include")
@_act
def include(run: str | None, folder: Path, **given: Any) -> None:
    """Include a RUN again that was excluded from evaluation."""
    _enter("included", run, folder, **given)


def _enter(
    wanted: str, run: str | None, folder: Path, units: tuple[str, ...], check: str | None, reason: str, by: str | None,
    *, as_json: bool,
) -> None:  # fmt: skip
    from storage.recording.exclusions import enter_exclusion
    from storage.store import Store
    from stream.events import ExclusionAction

    store, actor = Store.open(folder), acting(by)
    done = enter_exclusion(
        store, ExclusionAction(wanted), reason, actor, role="gyrofleet runs", run=run, units=units, check=check
    )
    if as_json:
        print_json({"store": str(folder), "run": run, "check": check, "action": wanted, "units": done.changed,
                    "already": done.others, "by": actor.name, "reason": reason.strip(),
                    "uids": [each.uid for each in done.documents], "in_lake": done.is_in_lake})  # fmt: skip
        return
    if done.others:
        results().print(f"{wanted} already: {', '.join(done.others)}", soft_wrap=True)
    left_out = "metrics, verdicts, trends, diagnoses and certificates leave it out from now on"
    what = f"check {check}, unit {', '.join(done.changed)}" if run is None else f"run {run}, {_listed(done.changed)}"
    text = f"excluded {what}: {left_out}" if wanted == "excluded" else f"included {what} again"
    results().print(text if done.changed else "nothing to change", soft_wrap=True)
    if not done.is_in_lake:
        notes().print(
            "warning: the recorder that writes the store has it on disk, but not yet in the lake: until then metrics, "
            "verdicts and certificates still count as before; `gyrofleet runs list` shows it already",
            soft_wrap=True,
        )


def _listed(units: list[str]) -> str:
    more = f" and {len(units) - 8} more" if len(units) > 8 else ""
    return f"{counted(len(units), 'unit')} ({', '.join(units[:8])}{more})"
