"""The command `gyrofleet check`: what a person found of a unit, entered by hand."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from storage.commands.stored_names import RUN, UNIT
from stream.errors import BadInput
from stream.mistakes import similar_names
from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.console import notes, print_json, reporting, results, store_option
from stream.terminal.security_options import secured

if TYPE_CHECKING:
    from storage.sql.catalog import Catalog


@click.command("check")
@store_option
@click.option("--unit", type=UNIT, required=True, help="Which unit.")
@click.option("--item", required=True, help="What was checked: visual, electrical, or another word.")
@click.option("--by", help="Who did; with --security whom the certificate names.")
@click.option("--verdict", type=click.Choice(["PASS", "FAIL"], case_sensitive=False), help="How it was judged.")
@click.option("--value", type=float, help="What was measured; judged by its limits where it has some.")
@click.option("--unit-of-measure", default="", help="Of the value and its limits, as megaohm.")
@click.option("--lower", type=float, help="Least value that is good.")
@click.option("--upper", type=float, help="Greatest value that is good.")
@click.option("--note", default="", help="Free words.")
@click.option("--run", type=RUN, default="", help="The run that it belongs to, if any.")
@click.option("--at", "moment", help="When, if not now: 2026-11-21T18:00:00+08:00.")
@reporting
@secured(Role.APPROVER, Role.RECORDER, Role.STATION)
def check(
    folder: Path, verdict: str | None, moment: str | None, by: str | None, *, as_json: bool, **given: Any
) -> None:
    """Enter a check that was made by eye or by hand (GJB 2426A-2004 5.2, 5.3): it stands in the log beside the samples.

    A recorder that is at work on the store gets it over its bus. A check can fail a unit; it does not pass a unit of
    which no limit was judged. A serial number of which the store has no recording is entered with a warning.

    \b
    gyrofleet check --unit FOG-0231 --item visual --verdict PASS --by "Li Wei"
    gyrofleet check --unit FOG-1 --item electrical --value 120 \\
      --unit-of-measure megaohm --lower 100 --by "Li Wei" --note "100 V"
    """  # noqa: D301  click's mark for lines that are not to be joined
    from ingest.importing.entered import Entry, check_entered, enter
    from ingest.moment import moment_ns
    from stream.events import Verdict

    judged = None if verdict is None else Verdict(verdict.upper())
    t_ns = time.time_ns() if moment is None else moment_ns(moment, "--at")
    if t_ns > time.time_ns() + 60 * 10**9:
        raise BadInput(f"--at {moment} lies in the future; a check is entered when it has been made")
    actor = acting(by, may_be_user=False)
    entered = check_entered(Entry(verdict=judged, by=actor.name, **given), t_ns)
    document = msgspec.structs.replace(entered, identity=actor.identity)
    unknown = _unknown_unit(folder, document.unit)
    warnings = [each for each in (unknown, _unknown_run(folder, document.run)) if each is not None]
    is_seen = enter(folder, [document], role="gyrofleet check")
    if as_json:
        answer = {"store": str(folder), "uid": document.uid, "verdict": document.verdict, "in_lake": is_seen}
        print_json({**answer, "unit_is_known": unknown is None, "warnings": warnings})
        return
    results().print(f"{document.verdict}: {document.item} of unit {document.unit}, entered by {document.by}")
    for warning in warnings:
        notes().print(f"warning: {warning}", soft_wrap=True)
    if not is_seen:
        sees = "verdicts and SQL follow it in a few seconds."
        notes().print(f"The recorder that writes the store has it on disk; {sees}")


def _unknown_run(folder: Path, run: str) -> str | None:
    """Say that the store has no such run, if so."""
    from storage.sql.catalog import Catalog
    from storage.store import Store
    from storage.store_marker import MARKER

    if not run or not (folder / MARKER).exists():
        return None
    with Catalog(Store.open(folder), live=True) as catalog:
        found = catalog.user_reader("select run from runs where run = $run", {"run": run}).read_all()
    return None if found.num_rows else f"the store has no run {run!r}: is its name right? The check is entered"


def _unknown_unit(folder: Path, unit: str) -> str | None:
    """Say that nothing was recorded of a unit, if so; raises BadInput if the store has it in other letters."""
    from storage.sql.catalog import Catalog
    from storage.store import Store
    from storage.store_marker import MARKER

    recorded: set[str] = set()
    entered: set[str] = set()
    if (folder / MARKER).exists():
        with Catalog(Store.open(folder)) as catalog:
            recorded = _names(catalog, "select unit from internal.lake_channels union select unit from units")
            entered = _names(catalog, "select distinct unit from internal.lake_documents where kind = 'CheckEntered'")
    same = sorted(each for each in recorded | entered if each.casefold() == unit.casefold())
    if same and unit not in same:
        raise BadInput(
            f"unit {unit!r} is in the store as {same[0]!r}; give that name, since names differ by letter case"
        )
    if unit in recorded:
        return None
    near = similar_names(unit, sorted(recorded), most=3)
    alike = f", which has {', '.join(near)}" if near else ""
    return (
        f"nothing was recorded of unit {unit!r} in {folder}{alike}: is the serial number right? The check is entered; "
        "it can fail the unit, which passes only when its limits are judged"
    )


def _names(catalog: "Catalog", sql: str) -> set[str]:
    return {str(name) for (name,) in catalog.rows(sql) if name}
