"""`gyrofleet import`."""

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ingest.commands.import_report import LISTED_FILES, report_files
from ingest.commands.import_warnings import warn_of_overdue, warn_of_words
from stream.errors import BadInput
from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.console import (
    estimates_option,
    interrupted_by_term,
    notes,
    print_json,
    progress_bar,
    reporting,
    store_option,
)
from stream.terminal.security_options import secured
from stream.worker.compile_kernels import compile_new_kernels

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ingest.can.mapping import CanMapping
    from ingest.tables.columns import TableOptions
    from ingest.tables.sample_file import SampleFile
    from stream.identity import Place

_LOCATION_OPTIONS = {"latitude_deg": "--latitude", "time_zone": "--time-zone", "altitude_m": "--altitude"}
_PATH = click.Path(path_type=Path)


@click.command("import")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=_PATH)
@store_option
@click.option("--unit", help="Unit (serial number) of the samples, if the file has no column 'unit'.")
@click.option("--run", help="Run of the samples, if the file has no column 'run'.  [default: the file's name]")
@click.option(
    "--start",
    help="Start of the run, if times count from it: 2026-11-21T18:00:00+08:00; with --time-zone also 2026/11/21 18:00.",
)
@click.option("--sample-rate", "sample_rate_hz", type=float, help="Hz, for a file without a time column.")
@click.option(
    "--rename", "renames", metavar="TITLE=SIGNAL", multiple=True,
    help="Name of the signal of a column, as 'Gyro X=gyro_x'; with a unit of measure as 'Status=status[1]'; 'Note=' "
    "leaves a column out.",
)  # fmt: skip
@click.option("--dbc", "databases", multiple=True, type=_PATH, help="CAN database of a CAN log.")
@click.option("--mapping", type=_PATH, help="Names and units of the signals of the database (TOML file).")
@click.option(
    "--message", "variants", metavar="NAME=ID", multiple=True,
    help="Which one to take of several messages of one name in the CAN databases, as IMU=0x101.",
)  # fmt: skip
@click.option("--skip-bad", is_flag=True, help="Leave bad rows out and list them instead of refusing the file.")
@click.option(
    "--units", "units_file", metavar="FILE",
    help="Product, lot, fixture of the units: columns serial, product, lot, fixture, ... (- for standard input).",
)  # fmt: skip
@click.option(
    "--procedure", help="Procedure of the record, as static_bias; all rows are one step. See `procedure list`."
)
@click.option("--position", help="Direction of the input axis in that step, as IRA_up or IRA_east_west.")
@click.option("--site", help="Site of the samples.  [default: local]")
@click.option("--station", help="Station of the samples: its file (TOML), or a name.  [default: files]")
@click.option("--latitude", "latitude_deg", type=float, help="Of the station, deg: used to remove the Earth's rate.")
@click.option(
    "--time-zone", help="Of the station, as Asia/Shanghai: for days, and time stamps without a zone.  [default: UTC]"
)
@click.option("--altitude", "altitude_m", type=float, help="Of the station, m: gives g, together with the latitude.")
@click.option("--restate", "restates", is_flag=True, help="Replace what the store has of the station.")
@click.option(
    "--by", help="Who states it (--units, --restate); by default the user of the system, with --security whom the "
    "certificate names.",
)  # fmt: skip
@click.option("--connect", help="Send to a `gyrofleet record` at this endpoint instead of recording in this process.")
@click.option("--listen", help="Let subscribers connect at this endpoint during the import.")
@estimates_option
@reporting
@secured(Role.STATION, Role.RECORDER)
def import_files(
    files: tuple[Path, ...], folder: Path, unit: str | None, run: str | None, start: str | None,
    sample_rate_hz: float | None, renames: tuple[str, ...], databases: tuple[Path, ...], mapping: Path | None,
    variants: tuple[str, ...], units_file: str | None, procedure: str | None, position: str | None, site: str | None,
    station: str | None, by: str | None, connect: str | None, listen: str | None, estimated: tuple[str, ...], *,
    skip_bad: bool, restates: bool, as_json: bool, **location: Any,
) -> None:  # fmt: skip
    """Import CSV and Parquet files (columns `signal[unit]` and `time[s]`) and CAN logs (with their --dbc).

    Every sample takes the path of live data: over the bus, into the log and the lake, through the estimators. All
    files are read and checked before the first is imported. What contradicts the store, as the same rows at other
    times, is found file by file: the files before it are then imported. A file that is stored already adds nothing;
    give the same command again to complete an import that was interrupted.

    Titles of other programs, as `Time (s)` and `Gyro X (deg/s)`, ISO 8601 time stamps, decimal commas and lines of
    comment (#) are understood. CAN logs are .blf, .asc, .trc, .log (candump) and .mf4. Without --mapping, every
    signal of the database comes under its own name in lower case; `gyrofleet can scan` proposes a mapping. Of a
    damaged log the good part is imported, and the exit code is 1.

    Details of a unit (--units), above all its product, by which limits are chosen, the location of the station
    (--station FILE, or --latitude, --time-zone, --altitude), and the step of the file (--procedure, --position) can be
    added later: give the same command again with them. Stored details of a station stay, unless --restate replaces
    them.
    """
    from ingest.importing.file_sending import CheckedFile
    from ingest.importing.importer import import_files as import_checked
    from ingest.station.units_file import read_units
    from ingest.tables.columns import TableOptions
    from stream.events import StepWords
    from stream.worker.estimated_signals import EstimatedSignals

    if connect and listen:
        raise BadInput("give --connect or --listen, not both: with --connect it is the recorder that listens")
    actor = acting(by)
    place, about = _stated_place(site, station, location)
    words = StepWords(procedure=procedure or None, position=position or None)
    options = TableOptions(
        unit=unit, run=run, start_ns=_start_ns(start, about.get("time_zone")), sample_rate_hz=sample_rate_hz,
        skip_bad=skip_bad, words=words if procedure or position else None,
        renames=tuple(_pair(each, "--rename", "'Gyro X=gyro_x'", may_be_empty=True) for each in renames),
        time_zone=about.get("time_zone"),
    )  # fmt: skip
    warn_of_words(procedure, position)
    plan = _can_mapping(files, unit, databases, mapping, variants)
    entries = () if units_file is None else read_units(units_file).entries
    intervals: dict[tuple[str, str, str], int] = {}
    with progress_bar(hidden=as_json) as progress:
        checked = []
        for path in files:
            task = progress.add_task(f"checking {path.name}", total=1.0)
            began = time.monotonic()
            file = _file(path, plan, options, intervals)
            summary = file.check(lambda done, task=task: progress.update(task, completed=done))  # type: ignore[misc]
            progress.update(task, completed=1.0, visible=len(files) <= LISTED_FILES)
            checked.append(CheckedFile(path, file, summary, time.monotonic() - began))
    warn_of_overdue(station, [each.summary for each in checked])
    signals = EstimatedSignals.named(estimated)
    if remark := signals.remark_on(signal.signal for each in checked for signal in each.summary.signals):
        notes().print(f"warning: {remark}", soft_wrap=True)
    if connect is None:
        compile_new_kernels(quiet=as_json)
    with interrupted_by_term(), progress_bar(hidden=as_json) as progress:
        tasks = {each.path: progress.add_task(f"importing {each.path.name}", total=1.0) for each in checked}

        def show(path: Path, done: float) -> None:
            progress.update(tasks[path], completed=done, visible=done < 1.0 or len(files) <= LISTED_FILES)

        imported = list(
            import_checked(
                checked, folder, place, connect=connect, listen=[listen] if listen else (), units=entries, about=about,
                restates=restates, by=actor, estimated=signals, progress=show,
            )
        )  # fmt: skip
    units = dict.fromkeys(signal.unit for each in imported for signal in each.signals)
    known = {entry.serial for entry in entries}
    not_listed = [each for each in units if entries and each not in known]
    not_measured = [each.serial for each in entries if each.serial not in units]
    if as_json:
        lists = {"units_not_listed": not_listed, "units_without_samples": not_measured}
        print_json({"store": str(folder), "files": imported} | lists)
    else:
        if len(units) > len(not_listed) and entries:
            notes().print(f"product, lot and the rest of {len(units) - len(not_listed)} units as in {units_file}")
        if not_listed:
            said_of = f"{units_file} says nothing of {len(not_listed)} of the {len(units)} units"
            notes().print(f"{said_of}: {', '.join(not_listed[:10])}", soft_wrap=True)
        if not_measured:
            named = f"{', '.join(not_measured[:10])}{', ...' if len(not_measured) > 10 else ''}"
            said_of = f"these files have no sample of {len(not_measured)} of the {len(known)} units of {units_file}"
            notes().print(f"{said_of}: {named}", soft_wrap=True)
        report_files(imported, folder)
    if any(each.damage for each in imported):
        sys.exit(1)


def _start_ns(text: str | None, zone: str | None) -> int | None:
    """The start that was given; in a `zone` it may be written as time stamps of tables are."""
    from ingest.moment import moment_ns
    from ingest.tables.times import ns_from_stamp

    if text is None:
        return None
    found = None if zone is None else ns_from_stamp(text.strip(), zone)
    return moment_ns(text) if found is None else found


def _stated_place(site: str | None, station: str | None, location: dict[str, Any]) -> "tuple[Place, dict[str, str]]":
    """Site and station, and what the runs record of them: of the station's file, overridden by options."""
    from msgspec.structs import replace

    from stream.identity import UNSTATED, Place, check_name

    is_file = station is not None and Path(station).suffix.lower() == ".toml"
    place = UNSTATED
    named: dict[str, str] = {}
    if not is_file:
        place = Place(check_name("site", site or UNSTATED.site), check_name("station", station or UNSTATED.station))
        named = _named({"site": site, "station": station})
        if all(value is None for value in location.values()):
            return place, named
    from ingest.station.station import StationLocation, load_station

    given = StationLocation(**location)
    given.check(_LOCATION_OPTIONS.__getitem__)
    if station is None or not is_file:
        return place, given.details | named
    found = load_station(Path(station))
    if site is not None and site != found.place.site:
        raise BadInput(f"--site is {site!r}, but {station} says {found.place.site!r}; leave out --site")
    stated = {name: value for name, value in location.items() if value is not None}
    if stated.keys() & {"latitude_deg", "altitude_m"}:
        stated["gravity_m_per_s2"] = None  # measured gravity does not hold at another latitude or altitude
    named = _named(found.place._asdict())
    return found.place, replace(found.table, **stated).details | found.standards_details | named


def _named(names: "Mapping[str, str | None]") -> dict[str, str]:
    """Details of a run that say where it was measured; what is not given states nothing."""
    return {name: text for name, text in names.items() if text}


def _is_can_log(path: Path) -> bool:
    from ingest.tables.sample_file import CAN_LOG_SUFFIXES

    return path.suffix.lower() in CAN_LOG_SUFFIXES


def _can_mapping(
    files: tuple[Path, ...], unit: str | None, databases: tuple[Path, ...], mapping: Path | None,
    variants: tuple[str, ...],
) -> "CanMapping | None":  # fmt: skip
    """What to decode of the CAN logs among the files, read once for all of them; None if there is no log."""
    logs = [path for path in files if _is_can_log(path)]
    if not logs:
        if databases or mapping or variants:
            raise BadInput("--dbc, --mapping and --message are for CAN logs, and none of the files is one")
        return None
    from ingest.can.mapping import CanMapping

    if not databases:
        signals = "" if logs[0].suffix.lower() != ".mf4" else (
            "; an MF4 file of measured signals, without frames of a bus, is not read: export it as CSV or Parquet"
        )  # fmt: skip
        raise BadInput(f"{logs[0]}: a CAN log needs its database: give --dbc FILE.dbc{signals}")
    if mapping is None and unit is None:
        raise BadInput(f"{logs[0]}: nothing says whose samples these are: give --unit, or a --mapping that does")
    chosen = {}
    for each in variants:
        name, identifier = _pair(each, "--message", "IMU=0x101")
        try:
            chosen[name] = int(identifier, 0)
        except ValueError as error:
            raise BadInput(f"--message {each}: {identifier!r} is no id; write it like IMU=0x101") from error
    return CanMapping(databases, mapping, unit=unit, variants=chosen)


def _pair(text: str, option: str, example: str, *, may_be_empty: bool = False) -> tuple[str, str]:
    left, mark, right = text.rpartition("=")
    if not mark or not left.strip() or not (right.strip() or may_be_empty):
        raise BadInput(f"{option} {text!r}: write it like {example}")
    return left.strip(), right.strip()


def _file(
    path: Path, plan: "CanMapping | None", options: "TableOptions", intervals: dict[tuple[str, str, str], int]
) -> "SampleFile":
    """Reader of a file, by its name; only what is needed is loaded."""
    if _is_can_log(path):
        from ingest.can.logs.log_file import CanLogFile

        assert plan is not None
        return CanLogFile(path, plan, options.run, options.start_ns, options.words, intervals, options.time_zone)
    from ingest.tables.file import TableFile

    return TableFile(path, options)
