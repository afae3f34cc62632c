"""The command `gyrofleet check`: what a person found of a unit, entered by hand."""

import time
from pathlib import Path

import click

from stream.console import notes, print_json, reporting, results, store_option
from stream.errors import BadInput


@click.command("check")
@store_option
@click.option("--unit", required=True, help="Which unit.")
@click.option("--item", required=True, help="What was checked: visual, electrical, or another word.")
@click.option("--by", required=True, help="Who did.")
@click.option("--verdict", type=click.Choice(["PASS", "FAIL"], case_sensitive=False), help="How it was judged.")
@click.option("--value", type=float, help="What was measured; judged by its limits where it has some.")
@click.option("--unit-of-measure", default="", help="Of the value and its limits, as megaohm.")
@click.option("--lower", type=float, help="Least value that is good.")
@click.option("--upper", type=float, help="Greatest value that is good.")
@click.option("--note", "words", default="", help="Free words.")
@click.option("--run", default="", help="The run that it belongs to, if any.")
@click.option("--at", "moment", help="When, if not now: 2026-11-21T18:00:00+08:00.")
@reporting
def check(
    folder: Path,
    unit: str,
    item: str,
    by: str,
    verdict: str | None,
    value: float | None,
    unit_of_measure: str,
    lower: float | None,
    upper: float | None,
    words: str,
    run: str,
    moment: str | None,
    *,
    as_json: bool,
) -> None:
    """Enter a check that was made by eye or by hand (GJB 2426A-2004 5.2, 5.3): it stands in the log beside the samples.

    A recorder that is at work on the store gets it over its bus.

    \b
    gyrofleet check --unit FOG-0231 --item visual --verdict PASS --by "Li Wei"
    gyrofleet check --unit FOG-0231 --item electrical --value 120 --unit-of-measure megaohm --lower 100 --by "Li Wei" \\
      --note "insulation, 100 V"
    """  # noqa: D301  click's mark for lines that are not to be joined
    from ingest.entered import Entry, check_entered, enter
    from ingest.moment import moment_ns
    from stream.events import Verdict

    given = None if verdict is None else Verdict(verdict.upper())
    t_ns = time.time_ns() if moment is None else moment_ns(moment, "--at")
    if t_ns > time.time_ns() + 60 * 10**9:
        raise BadInput(f"--at {moment} lies in the future; a check is entered when it has been made")
    document = check_entered(Entry(unit, item, by, given, value, unit_of_measure, lower, upper, words, run), t_ns)
    _refuse_second_name(folder, unit)
    is_seen = enter(folder, [document], role="gyrofleet check")
    if as_json:
        print_json({"store": str(folder), "uid": document.uid, "verdict": document.verdict, "in_lake": is_seen})
        return
    results().print(f"{document.verdict}: {document.item} of unit {unit}, entered by {document.by}", markup=False)
    if not is_seen:
        notes().print(
            "The recorder that writes the store has it on disk; SQL sees it with the recorder's next segment."
        )


def _refuse_second_name(folder: Path, unit: str) -> None:
    """A unit that is in the store under this name in other letters is the same unit."""
    from storage.catalog import Catalog
    from storage.store import Store
    from storage.store_marker import MARKER

    if not (folder / MARKER).exists():
        return
    with Catalog(Store.open(folder)) as catalog:
        known = {
            name for (name,) in catalog.rows("select unit from lake_channels union select unit from lake_documents")
        }
    same = sorted(each for each in known if each and each.casefold() == unit.casefold())
    if same and unit not in same:
        raise BadInput(
            f"unit {unit!r} is in the store as {same[0]!r}; give that name, since names are told by letter case"
        )
