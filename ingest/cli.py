"""Commands of what comes in: `gyrofleet import`."""

import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table

from stream.console import (
    DEFAULT_STORE,
    compile_kernels,
    notes,
    print_json,
    progress_bar,
    reporting,
    results,
    store_option,
)
from stream.errors import BadInput

if TYPE_CHECKING:
    from ingest.importer import FileImport
    from ingest.instruments.can_mapping import CanPlan
    from ingest.instruments.table_columns import TableOptions
    from ingest.sample_file import SampleFile

_LISTED_BAD_ROWS = 20
_LISTED_REMARKS = 20


@click.command("import")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@store_option
@click.option("--unit", help="Unit (serial number) that the samples are of, where the file has no column 'unit'.")
@click.option("--run", help="Run that they belong to, where the file has no column 'run'; else the file's name.")
@click.option("--start", help="Moment of the run's start where times count from it: 2026-11-21T18:00:00+08:00.")
@click.option("--sample-rate", "sample_rate_hz", type=float, help="Hz, for a file without a time column.")
@click.option("--dbc", "databases", multiple=True, type=click.Path(path_type=Path), help="CAN database of a CAN log.")
@click.option("--mapping", type=click.Path(path_type=Path), help="Which signal of the database is which (TOML file).")
@click.option("--skip-bad", is_flag=True, help="Leave bad rows out, and list them, instead of refusing the file.")
@click.option(
    "--units",
    "units_file",
    metavar="FILE",
    help="Product, lot, fixture of the units: columns serial, product, lot, fixture, ... (- for standard input).",
)
@click.option("--site", default="local", show_default=True, help="Site the samples come from.")
@click.option("--station", default="files", show_default=True, help="Station the samples come from.")
@click.option("--connect", help="Send to a `gyrofleet record` there instead of recording in this process.")
@click.option("--listen", help="Let others listen in at this endpoint while the import runs.")
@reporting
def import_files(
    files: tuple[Path, ...],
    folder: Path,
    unit: str | None,
    run: str | None,
    start: str | None,
    sample_rate_hz: float | None,
    databases: tuple[Path, ...],
    mapping: Path | None,
    units_file: str | None,
    site: str,
    station: str,
    connect: str | None,
    listen: str | None,
    *,
    skip_bad: bool,
    as_json: bool,
) -> None:
    """Import CSV and Parquet files (columns `signal[unit]` and `time[s]`) and CAN logs (with their --dbc).

    Every sample goes the way of live data: over the bus, into the log and the lake, past the estimators. All files
    are checked before the first is imported. A file that is there already adds nothing; give the same command again
    to complete an import that was interrupted.

    CAN logs are .blf, .asc, .trc, .log (candump) and .mf4. Without --mapping, every signal of the database comes
    under its own name in lower case; `gyrofleet can scan` proposes a mapping. Of a damaged log what is good is
    imported, and the exit code is 1.

    What --units says of a unit, its product above all, which limits go by, can be added later too: give the same
    command again with it.
    """
    from ingest.importer import import_file
    from ingest.instruments.table_columns import TableOptions
    from ingest.moment import moment_ns
    from ingest.units_file import load_units
    from stream.identity import Place, check_name

    if connect and listen:
        raise BadInput("give --connect or --listen, not both: with --connect it is the recorder that listens")
    place = Place(check_name("site", site), check_name("station", station))
    options = TableOptions(
        unit=unit,
        run=run,
        start_ns=None if start is None else moment_ns(start),
        sample_rate_hz=sample_rate_hz,
        skip_bad=skip_bad,
    )
    plan = _can_plan(files, unit, databases, mapping)
    entries = () if units_file is None else load_units(units_file)
    intervals: dict[tuple[str, str, str], int] = {}
    imported: list[FileImport] = []
    with progress_bar(hidden=as_json) as progress:
        checked = []
        for path in files:
            task = progress.add_task(f"checking {path.name}", total=1.0)
            began = time.monotonic()
            file = _file(path, plan, options, intervals)
            summary = file.check(lambda done, task=task: progress.update(task, completed=done))  # type: ignore[misc]
            progress.update(task, completed=1.0, visible=len(files) <= 10)
            checked.append((path, file, summary, time.monotonic() - began))
    if connect is None:
        compile_kernels(quiet=as_json)
    with progress_bar(hidden=as_json) as progress:
        for path, file, summary, checking_s in checked:
            task = progress.add_task(f"importing {path.name}", total=1.0)
            imported.append(
                import_file(
                    path,
                    file,
                    summary,
                    folder,
                    place,
                    connect=connect,
                    listen=[listen] if listen else (),
                    units=entries,
                    checking_s=checking_s,
                    progress=lambda done, task=task: progress.update(task, completed=done),  # type: ignore[misc]
                )
            )
    known = {entry.serial for entry in entries}
    units = dict.fromkeys(signal.unit for each in imported for signal in each.signals)
    left_out = [each for each in units if entries and each not in known]
    if as_json:
        print_json({"store": str(folder), "files": imported, "units_not_listed": left_out})
    else:
        if len(units) > len(left_out) and entries:
            notes().print(f"product, lot and the rest of {len(units) - len(left_out)} units as in {units_file}")
        if left_out:
            told = f"{units_file} says nothing of {len(left_out)} of the {len(units)} units: {', '.join(left_out[:10])}"
            notes().print(told, markup=False, soft_wrap=True)
        for each in imported:
            _tell(each, folder)
        _tell_next(imported[-1], folder)
    if any(each.damage for each in imported):
        sys.exit(1)


def _is_can_log(path: Path) -> bool:
    from ingest.instruments.can_summary import LOG_SUFFIXES

    return path.suffix.lower() in LOG_SUFFIXES


def _can_plan(
    files: tuple[Path, ...], unit: str | None, databases: tuple[Path, ...], mapping: Path | None
) -> "CanPlan":
    """What to decode of the CAN logs among the files: read once for all of them, empty where there is none."""
    from ingest.instruments.can_mapping import CanPlan, automatic_plan, load_mapping

    logs = [path for path in files if _is_can_log(path)]
    if not logs:
        if databases or mapping:
            raise BadInput("--dbc and --mapping are for CAN logs, and none of the files is one")
        return CanPlan(())
    if not databases:
        raise BadInput(f"{logs[0]}: a CAN log needs its database: give --dbc FILE.dbc")
    if mapping is not None:
        return load_mapping(mapping, databases, unit)
    if unit is not None:
        return automatic_plan(databases, unit)
    raise BadInput(f"{logs[0]}: nothing says whose samples these are: give --unit, or a --mapping that does")


def _tell(imported: "FileImport", folder: Path) -> None:
    console = notes()
    for segment in imported.recovered:
        console.print(f"recovered {segment}, left open by an interrupted process")
    _tell_bad_rows(imported)
    for remark in imported.remarks[:_LISTED_REMARKS]:
        console.print(f"{imported.file}: {remark}", markup=False, soft_wrap=True)
    if len(imported.remarks) > _LISTED_REMARKS:
        console.print(f"  ... and {len(imported.remarks) - _LISTED_REMARKS:,} more (--json lists all)")
    table = Table(
        title=f"{imported.file}: {imported.rows:,} {imported.counted}", title_justify="left", header_style="bold"
    )
    for title in ("unit", "run", "signal", "in", "interval", "in file", "added", "already stored", "in lake"):
        table.add_column(title, justify="right" if title in {"interval", "in file", "added", "in lake"} else "left")
    for signal in imported.signals:
        table.add_row(
            signal.unit,
            signal.run,
            signal.signal,
            signal.unit_of_measure,
            f"{signal.sample_interval_s:g} s" + (" (irregular)" if signal.irregular else ""),
            f"{signal.in_file:,}",
            f"{signal.added:,}",
            f"{signal.already_stored:,}",
            "not seen from here" if signal.in_lake is None else f"{signal.in_lake:,}",
        )
    results().print(table)
    results().print(_conclusion(imported, folder))
    if imported.damage:
        said = f"error: {imported.file}: {imported.damage}; what is good of it is imported"
        console.print(said, style="red", markup=False, soft_wrap=True)


def _file(
    path: Path, plan: "CanPlan", options: "TableOptions", intervals: dict[tuple[str, str, str], int]
) -> "SampleFile":
    """What a file is, by its name; only what is needed is loaded."""
    if _is_can_log(path):
        from ingest.can_import import CanLogFile

        return CanLogFile(path, plan, run=options.run, start_ns=options.start_ns, intervals=intervals)
    from ingest.instruments.table_file import TableFile

    return TableFile(path, options)


def _tell_next(imported: "FileImport", folder: Path) -> None:
    """What to ask of the last file, in words that can be copied."""
    from stream.quantities import is_angular_rate

    here = [signal for signal in imported.signals if signal.in_lake is not None]
    if not here:
        return
    signal = next((each for each in here if is_angular_rate(each.unit_of_measure)), here[0])
    which = f"--unit {shlex.quote(signal.unit)} --signal {shlex.quote(signal.signal)} --run {shlex.quote(signal.run)}"
    store = "" if str(folder) == DEFAULT_STORE else f" --store {shlex.quote(str(folder))}"
    how = " --fit" if is_angular_rate(signal.unit_of_measure) else ""
    if signal.irregular:
        how = f" --resample {10 * signal.sample_interval_s:.3g}"  # Allan's deviation needs a grid
    notes().print(f"Ask it: gyrofleet allan {which}{how}{store}", soft_wrap=True, markup=False)


def _conclusion(imported: "FileImport", folder: Path) -> str:
    in_file = sum(signal.in_file for signal in imported.signals)
    if imported.added == 0:
        return f"Nothing to add: all {in_file:,} samples are stored already."
    rate = imported.added / imported.seconds
    speed = f"{imported.seconds:.2f} s" + (f", {rate / 1e6:.2f} M samples/s" if rate >= 1e5 else "")
    steps = f", {imported.steps} steps" if imported.steps else ""
    date = "" if imported.date_known else " Their date is unknown, as no --start was given."
    if any(signal.in_lake is None for signal in imported.signals):
        return f"{imported.added:,} samples{steps} sent and acknowledged as recorded ({speed}).{date}"
    counted = f"{imported.added:,} samples in, {imported.added:,} more in the lake of {folder}, each once"
    return f"{counted}{steps} ({speed}).{date}"


def _tell_bad_rows(imported: "FileImport") -> None:
    if not imported.bad_row_count:
        return
    console = notes()
    console.print(f"{imported.bad_row_count:,} of {imported.rows:,} rows of {imported.file} left out as bad:")
    for row in imported.bad_rows[:_LISTED_BAD_ROWS]:
        console.print(f"  {row}", markup=False)
    if imported.bad_row_count > _LISTED_BAD_ROWS:
        console.print(f"  ... and {imported.bad_row_count - _LISTED_BAD_ROWS:,} more (--json lists up to 1000)")
