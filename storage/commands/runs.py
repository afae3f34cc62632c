"""The commands `gyrofleet runs`: what was measured, and what of it is excluded from evaluation."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
import msgspec

from storage.commands.stored_names import RUN, UNIT
from stream.errors import BadInput, NotFound
from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import counted, notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable
from stream.terminal.security_options import secured

if TYPE_CHECKING:
    from storage.store import Store
    from stream.events import ExclusionEntered

_MOST_TEXT = 1000
_RUNS = """
with tested as (
  select run, unit from steps union select run, unit from units
), excluded as (
  select run, {unit: unit, reason: reason, "by": by_whom} as unit from exclusions
)
select r.run, r.started, r.duration_s, r.outcome,
  (select count(*) from tested t where t.run = r.run) as units,
  (select coalesce(list(x.unit order by x.unit), []) from excluded x where x.run = r.run) as excluded
from runs r order by r.started, r.run
"""
_UNITS = """
with tested as (
  select run, unit from steps union select run, unit from units
)
select t.unit, x.reason from tested t left join exclusions x on x.run = t.run and x.unit = t.unit
where t.run = $run order by t.unit
"""
_CHECK = """
select c.unit, c.run, (
    select arg_max(x.document->>'$.action', x.t_ns) from events x
    where x.kind = 'ExclusionEntered' and x.document->>'$.check' = c.uid) as action
from events c where c.kind = 'CheckEntered' and c.uid = $uid
"""

_units_option = click.option("--unit", "units", type=UNIT, multiple=True, help="Only this unit of it; repeatable.")
_check_option = click.option("--check", metavar="UID", help="A check entered by hand, in place of a run.")
_reason_option = click.option("--reason", required=True, help="Why; it stands in the log with your name.")
_by_option = click.option("--by", help="Who; by default the user of the system, with --security whom it names.")


class _Found(NamedTuple):
    """Units that an action changes, those that are as it wants them, and its documents without who, why and when."""

    changed: list[str]
    others: list[str]
    documents: "list[ExclusionEntered]"


@click.group("runs", cls=CommandGroup)
def runs() -> None:
    """Runs of a store: list them, exclude a bad one from evaluation with a reason, include it again.

    What is excluded stays in the log and can be seen; metrics, verdicts, trends, diagnoses and certificates leave it
    out, and name it. The last word counts, for each unit of a run.

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
@click.argument("run", type=RUN, required=False)
@_units_option
@_check_option
@_reason_option
@_by_option
@store_option
@reporting
@secured(Role.APPROVER, Role.RECORDER)
def exclude(run: str | None, folder: Path, **given: Any) -> None:
    """Exclude a RUN from every evaluation; its samples stay."""
    _enter("excluded", run, folder, **given)


@runs.command("include")
@click.argument("run", type=RUN, required=False)
@_units_option
@_check_option
@_reason_option
@_by_option
@store_option
@reporting
@secured(Role.APPROVER, Role.RECORDER)
def include(run: str | None, folder: Path, **given: Any) -> None:
    """Include a RUN again that was excluded from evaluation."""
    _enter("included", run, folder, **given)


def _enter(
    wanted: str, run: str | None, folder: Path, units: tuple[str, ...], check: str | None, reason: str, by: str | None,
    *, as_json: bool,
) -> None:  # fmt: skip
    from storage.recording.client import record_documents
    from storage.store import Store, writer_endpoint
    from stream.events import ExclusionAction
    from stream.identity import Place

    reason = reason.strip()
    if not reason or len(reason) > _MOST_TEXT:
        raise BadInput(f"--reason has {len(reason)} characters; say why, in 1 to {_MOST_TEXT}")
    if (run is None) is (check is None) or (check is not None and units):
        raise BadInput("name a RUN, of which --unit chooses units, or the --check of one that was entered by hand")
    store = Store.open(folder)
    found = _run_targets(store, run, units, wanted) if check is None else _check_target(store, check, wanted)
    actor, now_ns = acting(by), time.time_ns()
    documents = [
        msgspec.structs.replace(each, t_ns=now_ns, action=ExclusionAction(wanted), by=actor.name,
                                identity=actor.identity, reason=reason)
        for each in found.documents
    ]  # fmt: skip
    is_in_lake = writer_endpoint(store.folder) is None
    if documents:
        record_documents(store, documents, role="gyrofleet runs", place=Place("local", "entered"), builds_lake=True)
    if as_json:
        print_json({"store": str(folder), "run": run, "check": check, "action": wanted, "units": found.changed,
                    "already": found.others, "by": actor.name, "reason": reason,
                    "uids": [each.uid for each in documents], "in_lake": is_in_lake})  # fmt: skip
        return
    if found.others:
        results().print(f"{wanted} already: {', '.join(found.others)}", soft_wrap=True)
    left_out = "metrics, verdicts, trends, diagnoses and certificates leave it out from now on"
    what = f"check {check}, unit {', '.join(found.changed)}" if run is None else f"run {run}, {_listed(found.changed)}"
    text = f"excluded {what}: {left_out}" if wanted == "excluded" else f"included {what} again"
    results().print(text if found.changed else "nothing to change", soft_wrap=True)
    if documents and not is_in_lake:
        sees = "SQL sees it with the recorder's next segment."
        notes().print(f"The recorder that writes the store has it on disk; {sees}")


def _listed(units: list[str]) -> str:
    more = f" and {len(units) - 8} more" if len(units) > 8 else ""
    return f"{counted(len(units), 'unit')} ({', '.join(units[:8])}{more})"


def _check_target(store: "Store", check: str, wanted: str) -> _Found:
    """A check entered by hand; NotFound where there is none of this uid."""
    from storage.sql.catalog import Catalog
    from stream.events import ExclusionAction, ExclusionEntered

    with Catalog(store, live=True) as catalog:
        rows = catalog.user_reader(_CHECK, {"uid": check}).read_all().to_pylist()
    if not rows:
        raise NotFound(
            f"no check {check!r} was entered into {store.folder}; `gyrofleet audit --unit UNIT --json` has uids"
        )
    (row,) = rows
    unit = str(row["unit"])
    if (row["action"] == "excluded") is (wanted == "excluded"):
        return _Found([], [unit], [])
    document = ExclusionEntered(
        run=row["run"] or "", t_ns=0, action=ExclusionAction(wanted), by="", reason="", unit=unit, check=check
    )
    return _Found([unit], [], [document])


def _run_targets(store: "Store", run: str | None, units: tuple[str, ...], wanted: str) -> _Found:
    """Units of a run that an action changes, and those that are as it wants them; NotFound where there is none."""
    from storage.sql.catalog import Catalog
    from stream.events import ExclusionAction, ExclusionEntered

    assert run is not None
    with Catalog(store, live=True) as catalog:
        rows = catalog.user_reader(_UNITS, {"run": run}).read_all().to_pylist()
        tested = {str(row["unit"]): row["reason"] is not None for row in rows}
        if not tested:
            last = catalog.user_reader("select run from runs order by recorded desc limit 8").read_all()
            raise NotFound(
                f"run {run!r} with tested units is not in {store.folder}; the last runs are "
                f"{', '.join(last['run'].to_pylist()) or 'none'}; `gyrofleet runs list` has all"
            )
    if strangers := sorted(set(units) - tested.keys()):
        raise NotFound(f"run {run!r} tested no unit {', '.join(strangers)}; it tested {', '.join(sorted(tested)[:20])}")
    chosen = sorted(set(units)) if units else sorted(tested)
    changed = [unit for unit in chosen if tested[unit] is not (wanted == "excluded")]
    others = [unit for unit in chosen if unit not in changed]
    # a run as a whole also with units that are tested in it later
    named: list[str | None] = [*changed] if units or others else [None]
    action = ExclusionAction(wanted)
    documents = [ExclusionEntered(run=run, t_ns=0, action=action, by="", reason="", unit=unit) for unit in named]
    return _Found(changed, others, documents)
