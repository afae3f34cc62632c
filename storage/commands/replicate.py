"""The command `gyrofleet replicate`."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stream.console import notes, print_json, progress_bar, reporting, results, until_stopped
from stream.errors import BadInput
from stream.result_table import ResultTable

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

    from storage.replication.progress import Progress
    from storage.replication.service import Pass

_EVERY_S = 2.0


@click.command("replicate")
@click.option(
    "--from", "sources", multiple=True, metavar="PLANT",
    help="Folder of a plant's store, may be repeated; of a fleet store: all of its plants.",
)  # fmt: skip
@click.option("--to", "target", type=click.Path(path_type=Path), metavar="FLEET", help="Folder of the fleet store.")
@click.option("--plant", metavar="NAME", help="Name of the plant at its first use, else its folder's; then which one.")
@click.option("--watch", "is_watch", is_flag=True, help="Keep following, until stopped.")
@click.option(
    "--bandwidth", type=click.FloatRange(min=1), metavar="BYTES_PER_S", help="Limit of all plants together; as 2e6."
)
@click.option("--no-lake", is_flag=True, help="Leave the lakes to `gyrofleet rebuild`, or to a later pass.")
@reporting
def replicate(
    sources: tuple[str, ...], target: Path | None, plant: str | None, bandwidth: float | None, *, is_watch: bool,
    no_lake: bool, as_json: bool,
) -> None:  # fmt: skip
    """Copy the sealed segments of plants into a fleet store, each once, verified at arrival.

    What a plant sends can only continue its own history: a changed segment, a fork of its list, or a wrong hash is
    refused and reported, and the exit code is 1. A pass that is cut off resumes where it was.

    \b
    gyrofleet replicate --from night --to fleet --plant hangzhou
    gyrofleet replicate --from day --from night --to fleet --watch
    """  # noqa: D301  click's mark for lines that are not to be joined
    from storage.fleet_store import FleetStore
    from storage.replication.bandwidth import Bandwidth
    from storage.replication.opened import opened_sources
    from storage.replication.service import Replication

    if not sources or target is None:
        raise BadInput("give --from PLANT and --to FLEET")
    with until_stopped() as stopped, progress_bar(hidden=as_json) as bar, opened_sources(sources, plant) as opened:
        replication = Replication(
            FleetStore.create(target), bandwidth=Bandwidth(bandwidth, sleep=stopped.wait), builds_lakes=not no_lake,
            report=_Shown(bar), stopped=lambda: stopped.asked_at is not None,
        )  # fmt: skip
        shown: object = None
        while True:
            found = replication.run(opened)
            state = (found.conflicts, found.lakes, [(each.refused, each.trouble, each.lag) for each in found.plants])
            if not is_watch or found.added or found.added_files or state != shown:
                shown = state
                if as_json:
                    print_json(
                        {"is_well": found.is_well, **{name: getattr(found, name) for name in found.__struct_fields__}}
                    )
                else:
                    _print(found)
            if not is_watch or stopped.wait(_EVERY_S):
                break
    sys.exit(0 if found.is_well or is_watch else 1)


class _Shown:
    """Shows the bytes that arrive in a bar for each plant."""

    def __init__(self, bar: "Bar") -> None:
        self._bar = bar
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, progress: "Progress") -> None:
        task = self._tasks.get(progress.plant)
        if task is None:
            task = self._tasks[progress.plant] = self._bar.add_task(progress.plant, total=None)
        total = progress.transferred_bytes + progress.lag.bytes
        self._bar.update(task, completed=progress.transferred_bytes, total=max(total, 1))


def _print(found: "Pass") -> None:
    table = ResultTable("plant", "added", "bytes", "files", "segments", "behind")
    for each in found.plants:
        lag = (
            f"{each.lag.segments:,} segments, {each.lag.bytes:,} B, {each.lag.seconds:,.0f} s"
            if each.lag.segments
            else "-"
        )
        table.add_row(
            each.plant or "?",
            f"{each.added:,}",
            f"{each.added_bytes:,}",
            f"{each.added_files:,}",
            f"{each.segments:,}",
            lag,
        )
    results().print(table)
    for each in found.plants:
        for note in each.notes:
            notes().print(f"note: {each.plant}: {note}", soft_wrap=True, markup=False)
        for refusal in each.refused:
            where = f" {refusal.segment}" if refusal.segment else ""
            notes().print(f"refused: {each.plant}{where}: {refusal.what}", soft_wrap=True, markup=False)
        if each.trouble:
            notes().print(f"trouble: {each.plant}: {each.trouble}", soft_wrap=True, markup=False)
    for plant, why in found.lakes.items():
        notes().print(f"trouble: the lake of {plant}: {why}", soft_wrap=True, markup=False)
    for conflict in found.conflicts:
        notes().print(f"conflict: {conflict}", soft_wrap=True, markup=False)
