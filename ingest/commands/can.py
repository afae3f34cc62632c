"""Commands of the CAN bus: `gyrofleet can scan`."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stream.errors import BadInput
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import notes, print_json, progress_bar, reporting, results
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from ingest.can.scan import IdScan, LogScan


@click.group("can", cls=CommandGroup)
def can() -> None:
    """Look at CAN buses and their logs."""


@can.command("scan")
@click.argument("log", metavar="LOG", type=click.Path(path_type=Path))
@click.option("--dbc", "databases", multiple=True, required=True, type=click.Path(path_type=Path), help="CAN database.")
@click.option("--write", "target", type=click.Path(path_type=Path), help="Write the mapping that is proposed here.")
@click.option("--unit", help="Unit (serial number) for the mapping.")
@reporting
def scan(log: Path, databases: tuple[Path, ...], target: Path | None, unit: str | None, *, as_json: bool) -> None:
    """Show the content of a CAN log: ids, rates, messages of the database, varying signals, frame counters.

    With --write it proposes a mapping of all signals that vary, for `gyrofleet import --mapping`. What it leaves out,
    as counters, stands there as a comment with the reason. Of a damaged log the good part is shown; the exit code is 1
    then.
    """
    from ingest.can.scan import counter_remarks, mapping_text, scan_log
    from stream.identity import check_name

    if unit is not None:
        check_name("unit", unit)
    if target is not None and target.exists():
        raise BadInput(f"{target}: exists already and is not overwritten; give --write another name")
    with progress_bar(hidden=as_json) as progress:
        task = progress.add_task(f"reading {log.name}", total=1.0)
        found = scan_log(log, databases, lambda done: progress.update(task, completed=done))
    if target is not None:
        try:
            target.write_text(mapping_text(found, databases, unit), encoding="utf-8")
        except OSError as error:
            raise BadInput(f"{target}: cannot be written ({error.strerror or error})") from error
    if as_json:
        remarks = counter_remarks(found)
        mapping = None if target is None else str(target)
        print_json({"scan": found, "unknown": len(found.unknown), "remarks": remarks, "mapping": mapping})
    else:
        _report(found)
        if target is not None:
            for remark in counter_remarks(found):
                notes().print(remark, soft_wrap=True)
            command = " ".join([f"gyrofleet import {log}", *(f"--dbc {path}" for path in databases)])
            own = "" if unit else " --unit UNIT"
            notes().print(f"Wrote {target}. Check it, then: {command}{own} --mapping {target}", soft_wrap=True)
    if found.damage:
        sys.exit(1)


def _report(found: "LogScan") -> None:
    from ingest.can.summary import echoes_remark

    clock = "UTC" if found.date_known else "from the log's start, date unknown"
    table = ResultTable(title=f"{found.file}: {found.frames:,} frames in {found.seconds:.1f} s (times: {clock})")
    for name in ("id", "channel", "frames", "rate", "bytes", "message", "varies", "counter", "constant"):
        table.add_column(name, justify="right" if name in {"channel", "frames", "rate"} else "left")
    for each in found.ids:
        table.add_row(*_cells(each))
    results().print(table)
    if found.unknown:
        results().print(f"{len(found.unknown)} of {len(found.ids)} ids are not in the database.")
    for number, kind in ((found.error_frames, "error"), (found.remote_frames, "remote")):
        if number:
            notes().print(f"{number:,} {kind} frames")
    if found.echoes:
        notes().print(echoes_remark(found.echoes), soft_wrap=True)
    if found.damage:
        notes().print(f"error: {found.file}: {found.damage}; the good part of it is shown", style="red", soft_wrap=True)


def _cells(each: "IdScan") -> list[str]:
    varying = [signal.name for signal in each.signals if signal.varies and not signal.looks_like_counter]
    counters = [signal.name for signal in each.signals if signal.looks_like_counter]
    constant = sum(not signal.varies for signal in each.signals)
    return [
        f"0x{each.arbitration_id:08X}" if each.is_extended else f"0x{each.arbitration_id:03X}", str(each.channel),
        f"{each.frames:,}",
        "" if each.rate_hz is None else f"{each.rate_hz:.4g} Hz", " ".join(map(str, each.lengths)),
        each.message or "not in the database", " ".join(varying), " ".join(counters),
        f"{constant} signals" if constant else "",
    ]  # fmt: skip
