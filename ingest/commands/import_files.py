"""Commands of what comes in: `gyrofleet import`."""

import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table

from stream.console import (
    DEFAULT_STORE,
    estimates_option,
    notes,
    print_json,
    progress_bar,
    reporting,
    results,
    store_option,
)
from stream.errors import BadInput
from stream.worker.compile_kernels import compile_kernels

if TYPE_CHECKING:
    from ingest.can.mapping import CanPlan
    from ingest.importing.file_sending import FileImport
    from ingest.tables.columns import TableOptions
    from ingest.tables.sample_file import SampleFile
    from stream.identity import Place

_LISTED_BAD_ROWS = 20
_LISTED_REMARKS = 20
_LISTED_FILES = 10
_LOCATION_OPTIONS = {"latitude_deg": "--latitude", "time_zone": "--time-zone", "altitude_m": "--altitude"}


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
@click.option("--procedure", help="What was done, as static_bias: all rows are one step of it. See `procedure list`.")
@click.option("--position", help="Where the input axis pointed in that step, as IRA_up or IRA_east_west.")
@click.option("--site", help="Site the samples come from.  [default: local]")
@click.option("--station", help="Station the samples come from: its file (TOML), or a name.  [default: files]")
@click.option("--latitude", "latitude_deg", type=float, help="Of the station, deg: the Earth's rate is removed by it.")
@click.option("--time-zone", help="Of the station, as Asia/Shanghai: whose days are days.  [default: UTC]")
@click.option("--altitude", "altitude_m", type=float, help="Of the station, m: with the latitude it gives g.")
@click.option("--restate", "restates", is_flag=True, help="Correct what the store has of the station.")
@click.option("--connect", help="Send to a `gyrofleet record` there instead of recording in this process.")
@click.option("--listen", help="Let others listen in at this endpoint while the import runs.")
@estimates_option
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
    procedure: str | None,
    position: str | None,
    site: str | None,
    station: str | None,
    latitude_deg: float | None,
    time_zone: str | None,
    altitude_m: float | None,
    connect: str | None,
    listen: str | None,
    estimated: tuple[str, ...],
    *,
    skip_bad: bool,
    restates: bool,
    as_json: bool,
) -> None:
    """Import CSV and Parquet files (columns `signal[unit]` and `time[s]`) and CAN logs (with their --dbc).

    Every sample goes the way of live data: over the bus, into the log and the lake, past the estimators. All files
    are checked before the first is imported. A file that is there already adds nothing; give the same command again
    to complete an import that was interrupted.

    CAN logs are .blf, .asc, .trc, .log (candump) and .mf4. Without --mapping, every signal of the database comes
    under its own name in lower case; `gyrofleet can scan` proposes a mapping. Of a damaged log what is good is
    imported, and the exit code is 1.

    What --units says of a unit, its product above all, which limits go by, where the station stands (--station FILE,
    or --latitude, --time-zone, --altitude), and what step the file is (--procedure, --position) can be added later
    too: give the same command again with it. What was said of a station before stays, unless --restate corrects it.
    """
    from ingest.importing.file_sending import CheckedFile
    from ingest.importing.importer import import_files as import_checked
    from ingest.moment import moment_ns
    from ingest.station.units_file import load_units
    from ingest.tables.columns import TableOptions
    from stream.events import StepWords
    from stream.worker.estimated_signals import EstimatedSignals

    if connect and listen:
        raise BadInput("give --connect or --listen, not both: with --connect it is the recorder that listens")
    place, about = _stated_place(site, station, latitude_deg, time_zone, altitude_m)
    words = StepWords(procedure=procedure or None, position=position or None)
    options = TableOptions(
        unit=unit,
        run=run,
        start_ns=None if start is None else moment_ns(start),
        sample_rate_hz=sample_rate_hz,
        skip_bad=skip_bad,
        words=words if procedure or position else None,
    )
    _warn_of_words(procedure, position)
    plan = _can_plan(files, unit, databases, mapping)
    entries = () if units_file is None else load_units(units_file)
    intervals: dict[tuple[str, str, str], int] = {}
    with progress_bar(hidden=as_json) as progress:
        checked = []
        for path in files:
            task = progress.add_task(f"checking {path.name}", total=1.0)
            began = time.monotonic()
            file = _file(path, plan, options, intervals)
            summary = file.check(lambda done, task=task: progress.update(task, completed=done))  # type: ignore[misc]
            progress.update(task, completed=1.0, visible=len(files) <= _LISTED_FILES)
            checked.append(CheckedFile(path, file, summary, time.monotonic() - began))
    if connect is None:
        compile_kernels(quiet=as_json)
    with progress_bar(hidden=as_json) as progress:
        tasks = {each.path: progress.add_task(f"importing {each.path.name}", total=1.0) for each in checked}

        def show(path: Path, done: float) -> None:
            progress.update(tasks[path], completed=done, visible=done < 1.0 or len(files) <= _LISTED_FILES)

        imported = list(
            import_checked(
                checked,
                folder,
                place,
                connect=connect,
                listen=[listen] if listen else (),
                units=entries,
                about=about,
                restates=restates,
                estimated=EstimatedSignals.named(estimated),
                progress=show,
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
            if len(imported) <= _LISTED_FILES:
                _tell(each, folder)
            else:
                _tell_briefly(each)
        if len(imported) > _LISTED_FILES:
            results().print(_total(imported, folder), soft_wrap=True, markup=False)
        _tell_next(imported[-1], folder)
    if any(each.damage for each in imported):
        sys.exit(1)


def _warn_of_words(procedure: str | None, position: str | None) -> None:
    """Say where a procedure or position is none that characteristics go by: perhaps a typing error."""
    from ingest.procedures.file import near_name, ready_names
    from ingest.procedures.procedure import load_procedure

    if procedure and procedure not in ready_names():
        near = near_name(procedure, ready_names()) or ":"
        notes().print(
            f"warning: --procedure {procedure} is none of gyrofleet's, which `gyrofleet procedure list` has{near} "
            f"the step is judged by its position alone",
            soft_wrap=True,
        )
    if position:
        steps = [step for name in ready_names() for step in load_procedure(name).steps()]
        known = sorted({step.words.position for step in steps if step.words.position})
        if position not in known:
            notes().print(
                f"warning: --position {position} is none of {', '.join(known)}: nothing tells how the input axis lies",
                soft_wrap=True,
            )


def _stated_place(
    site: str | None, station: str | None, latitude_deg: float | None, time_zone: str | None, altitude_m: float | None
) -> "tuple[Place, dict[str, str]]":
    """Site and station, and what the runs remember of where that stands: by its file, and by options before it."""
    from ingest.station.location import StationLocation
    from ingest.station.station import load_station
    from stream.identity import Place, check_name

    given = StationLocation(latitude_deg=latitude_deg, time_zone=time_zone, altitude_m=altitude_m)
    given.check(_LOCATION_OPTIONS.__getitem__)
    if station is None or Path(station).suffix.lower() != ".toml":
        return Place(check_name("site", site or "local"), check_name("station", station or "files")), given.details
    found = load_station(Path(station))
    if site is not None and site != found.place.site:
        raise BadInput(f"--site is {site!r}, but {station} says {found.place.site!r}; leave out --site")
    of_file = found.table.location
    # gravity that was measured there is not that of another latitude or altitude
    measured = None if latitude_deg is not None or altitude_m is not None else of_file.gravity_m_per_s2
    location = StationLocation(
        latitude_deg=of_file.latitude_deg if latitude_deg is None else latitude_deg,
        time_zone=time_zone or of_file.time_zone,
        altitude_m=of_file.altitude_m if altitude_m is None else altitude_m,
        gravity_m_per_s2=measured,
    )
    return found.place, location.details


def _is_can_log(path: Path) -> bool:
    from ingest.can.summary import LOG_SUFFIXES

    return path.suffix.lower() in LOG_SUFFIXES


def _can_plan(
    files: tuple[Path, ...], unit: str | None, databases: tuple[Path, ...], mapping: Path | None
) -> "CanPlan":
    """What to decode of the CAN logs among the files: read once for all of them, empty where there is none."""
    from ingest.can.mapping import CanPlan, automatic_plan, load_mapping

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


def _tell_briefly(imported: "FileImport") -> None:
    """Report one of many files in a line; what is amiss with it, in full."""
    _tell_bad_rows(imported)
    signals = len(imported.signals)
    stored = sum(signal.already_stored for signal in imported.signals)
    line = f"{imported.file}: {imported.rows:,} {imported.counted}, {signals} signals, {imported.added:,} samples added"
    line += f", {stored:,} already stored" if stored else ""
    line += f"; {len(imported.remarks)} remarks, --json lists them" if imported.remarks else ""
    results().print(line, soft_wrap=True, markup=False)
    if imported.damage:
        said = f"error: {imported.file}: {imported.damage}; what is good of it is imported"
        notes().print(said, style="red", markup=False, soft_wrap=True)


def _total(imported: "Sequence[FileImport]", folder: Path) -> str:
    """All files in one sentence."""
    added, seconds = sum(each.added for each in imported), sum(each.seconds for each in imported)
    counted = all(signal.in_lake is not None for each in imported for signal in each.signals)
    where = f"in the lake of {folder}, each once" if counted else "sent and acknowledged as recorded"
    undated = sum(not each.date_known for each in imported)
    date = f" The date of {undated} files is unknown, as no --start was given." if undated else ""
    return f"{len(imported)} files: {added:,} samples {where} ({seconds:.1f} s).{date}"


def _file(
    path: Path, plan: "CanPlan", options: "TableOptions", intervals: dict[tuple[str, str, str], int]
) -> "SampleFile":
    """What a file is, by its name; only what is needed is loaded."""
    if _is_can_log(path):
        from ingest.can.log_file import CanLogFile

        return CanLogFile(
            path, plan, run=options.run, start_ns=options.start_ns, words=options.words, intervals=intervals
        )
    from ingest.tables.file import TableFile

    return TableFile(path, options)


def _tell_next(imported: "FileImport", folder: Path) -> None:
    """What to ask of the last file, in words that can be copied."""
    from stream.quantities import is_angular_rate

    if not imported.steps and not _has_steps(imported, folder):
        notes().print(
            "No step says what was measured, so there are no characteristics of it: give the same command again with "
            "--procedure, as --procedure static_bias --position IRA_up for a record at rest",
            soft_wrap=True,
        )
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


def _has_steps(imported: "FileImport", folder: Path) -> bool:
    """Whether the store has a step of what was in it before this file."""
    from storage.sql.catalog import Catalog
    from storage.store import Store

    before = {(each.unit, each.run) for each in imported.signals if each.already_stored and each.in_lake is not None}
    if not before:
        return False
    with Catalog(Store.open(folder)) as catalog:
        return not before.isdisjoint(catalog.rows("select distinct unit, run from steps"))


def _conclusion(imported: "FileImport", folder: Path) -> str:
    in_file = sum(signal.in_file for signal in imported.signals)
    told = f"{imported.steps:,} step{'' if imported.steps == 1 else 's'}"
    if imported.added == 0:
        verb = "says" if imported.steps == 1 else "say"
        says = f"; {told} in the store {verb} what was measured" if imported.steps else ""
        return f"Nothing to add: all {in_file:,} samples are stored already{says}."
    rate = imported.added / imported.seconds
    speed = f"{imported.seconds:.2f} s" + (f", {rate / 1e6:.2f} M samples/s" if rate >= 1e5 else "")
    steps = f", {told}" if imported.steps else ""
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
