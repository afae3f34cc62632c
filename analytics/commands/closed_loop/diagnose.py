"""The command `gyrofleet diagnose`: effects that a declared error model lacks, their certainty and their gain."""

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from analytics.commands.evaluation.engine_option import engine_option, opened_tracing
from analytics.commands.evaluation.metrics import language_option, opened_catalog
from storage.commands.stored_names import RUN, SIGNAL, UNIT
from stream.errors import BadInput, GyrofleetError
from stream.files.atomic_file import write_durably
from stream.security.actor import acting
from stream.terminal.console import notes, print_json, reporting, status_line, store_option

if TYPE_CHECKING:
    from analytics.loop.model.declared_noise import GivenNoise
    from analytics.loop.next_test.recommendation import NextTest
    from analytics.loop.report.wording import Language
    from analytics.loop.unit_diagnosis import UnitsDiagnosis
    from analytics.loop.unit_reduction import ReducedUnits

_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_ABSOLUTE_ZERO_DEG_C = -273.15
_NOISE_TERMS = ("N", "B", "K", "turn_on")
_LEAST_NOISE, _MOST_NOISE = 1e-20, 1e20


@click.command("diagnose")
@store_option
@click.option("--unit", "units", type=UNIT, multiple=True, help="Unit; may be given several times.")
@click.option("--fleet", is_flag=True, help="Search for effects common to the units as well; all units by default.")
@click.option("--signal", type=SIGNAL, help="The signal, such as rate; by default the one that the model names.")
@click.option(
    "--model", required=True, help="Declared error model: 'rate = bias + scale_factor*input_rate + temperature'."
)
@click.option(
    "--block", show_default="30s, or the sample interval if longer", help="Length of the averaged blocks: 10s, 1min."
)
@click.option(
    "--noise",
    metavar="N=..,B=..,K=..[,turn_on=..]",
    help="Declared noise in deg/sqrt(h), deg/h, deg/h/sqrt(h), deg/h; by default from each unit's own Allan fits. "
    "Turn-on scatter is by default estimated from the runs.",
)
@click.option(
    "--holdout", default="last-third", show_default=True, metavar="last-third|none|runs=A,B",
    help="Runs held out of the fit, which confirm the findings.",
)  # fmt: skip
@click.option("--run", "runs", type=RUN, multiple=True, help="Only this run; may be given several times.")
@click.option("--since", help="Only samples since then: 2026-11-21, or with time and zone.")
@click.option("--report", "report_path", type=click.Path(path_type=Path), help="Write a report: FILE.html.")
@click.option("--plot", "plot_folder", type=click.Path(path_type=Path), help="Write the pictures to this folder, PNG.")
@click.option("--save", is_flag=True, help="Save the model found as a version for `gyrofleet model promote`.")
@click.option(
    "--next-test", "asks_next_test", is_flag=True, help="Compute the test that would decide what is left open."
)
@click.option(
    "--bounds",
    metavar="NAME=VALUE,..",
    help="What a test may use: least_deg_c, most_deg_c, slope_deg_c_per_min, rate_deg_per_s, acceleration_deg_per_s2, "
    "least_angle_deg, most_angle_deg, least_v, most_v; by default what the unit has been through.",
)
@click.option(
    "--station",
    "station_path",
    type=click.Path(path_type=Path),
    help="Station file: a test keeps to the limits of its chamber, rate table and power supply as well.",
)
@click.option(
    "--write-procedure",
    "procedure_path",
    type=click.Path(path_type=Path),
    help="Write the first plan of the next test as a procedure for `gyrofleet run`: FILE.toml; without a plan the exit "
    "code is 1.",
)
@click.option(
    "--recover",
    "tries",
    type=click.IntRange(1, 1000),
    metavar="N",
    help="Plant what was found in N simulations of these data, and count how often it is found again.",
)
@click.option(
    "--explainable/--no-explainable",
    "asks_explainable",
    default=None,
    help="Try how much more of the error a function of the channels explains; by default for one unit without "
    "an effect. Needs pip install 'gyrofleet[explain]'.",
)
@click.option(
    "--embed-report", "embeds", is_flag=True,
    help="With --json: the texts of the report in English and Chinese and the curves of its pictures as well.",
)  # fmt: skip
@engine_option
@language_option
@reporting
def diagnose(
    folder: Path, units: tuple[str, ...], signal: str | None, model: str, block: str | None, noise: str | None,
    holdout: str, runs: tuple[str, ...], since: str | None, report_path: Path | None, plot_folder: Path | None,
    bounds: str | None, station_path: Path | None, procedure_path: Path | None, engine: str | None,
    language: "Language", *, fleet: bool, save: bool, tries: int | None, asks_next_test: bool,
    asks_explainable: bool | None, embeds: bool, as_json: bool,
) -> None:  # fmt: skip
    """Find effects that a declared error model lacks, or report that none is missing or that the data cannot tell.

    Verdicts: nothing_missing, effect_found, confounded, unreplicated, unknown_function, unexplained, not_enough_data.
    The exit code is 0 with any verdict, and 1 if a unit could not be diagnosed.

    \b
    gyrofleet diagnose --unit FOG-1 --model 'rate = bias + temperature'
    gyrofleet diagnose --fleet --signal rate --model bias --report nov.html
    """  # noqa: D301  \b keeps the lines apart
    from analytics.cluster.diagnosis_tasks import local_reading
    from analytics.loop.tracing.processors import processors
    from analytics.loop.unit_diagnosis import trace_units, with_explainable, with_next_tests, with_recovery
    from analytics.loop.unit_reduction import Question, reduce_units, units_with

    if not units and not fleet:
        raise BadInput("no unit is named: give --unit, once or several times, or --fleet for all units with the signal")
    if procedure_path is not None and (len(units) != 1 or fleet):
        raise BadInput("a procedure is written for one unit: give one --unit with --write-procedure")
    _check_suffixes(report_path, procedure_path)
    asks_next_test = asks_next_test or procedure_path is not None or bounds is not None or station_path is not None
    allowed, limits = bounds_of(bounds or ""), station_limits(station_path)
    question = Question(
        model=model, signal=signal, block_s=None if block is None else block_seconds(block),
        noise=None if noise is None else noise_of(noise), holdout=holdout_of(holdout), runs=runs or None,
        since_ns=None if since is None else _since_ns(since),
    )  # fmt: skip
    with status_line() as report:
        with opened_tracing(engine, report) as tracing:
            with opened_catalog(folder, quiet=as_json) as catalog:
                chosen = list(dict.fromkeys(units)) or units_with(catalog, question.signal_name)
                by = (
                    local_reading(catalog.store, len(chosen), processors(), report) if tracing is None else tracing.read
                )
                read = reduce_units(catalog, chosen, question, read=by, on_progress=report)
            _refuse_wrong_bounds(read, allowed, limits)
            # the catalogue is closed to free its memory for the trace
            spread = None if tracing is None else tracing.spread
            found = trace_units(
                read, question, is_pooled=fleet, processes=processors(), spread=spread, on_progress=report
            )
        if asks_explainable is not False:
            found = with_explainable(found, report, is_asked=asks_explainable is not None)
        if tries is not None:
            found = with_recovery(found, read.models, tries, report)
        if asks_next_test:
            found = with_next_tests(found, read.models, allowed, report, limits)
    saved, unsaved = _saved(folder, found) if save else ({}, {})
    is_one = len(chosen) == 1 and not fleet
    _write(found, report_path, plot_folder, language)
    is_written = procedure_path is None or _write_procedure(next(iter(found.units.values())).next_test, procedure_path)
    if as_json:
        document = next(iter(found.units.values())).document() if is_one else found.document()
        print_json(document | _reports(found, embeds=embeds) | ({"saved": saved, "not_saved": unsaved} if save else {}))
    else:
        from analytics.commands.closed_loop.diagnose_output import print_unit, print_units

        if is_one:
            print_unit(next(iter(found.units.values())), language)
        else:
            print_units(found, language)
    for unit, why in found.failed.items():
        notes().print(f"warning: unit {unit}: {why}", soft_wrap=True)
    for unit, why in unsaved.items():
        notes().print(f"error: the model of unit {unit} is not saved: {why}", soft_wrap=True)
    if found.failed or unsaved or not is_written:
        sys.exit(1)


def _reports(found: "UnitsDiagnosis", *, embeds: bool) -> dict[str, Any]:
    """The report of each unit as data, if that was asked for."""
    from analytics.loop.report.embedded import embedded_report

    return {"reports": {unit: embedded_report(each) for unit, each in found.units.items()}} if embeds else {}


def _refuse_wrong_bounds(read: "ReducedUnits", bounds: dict[str, float], limits: dict[str, float]) -> None:
    """Before the search, which takes long."""
    from analytics.loop.next_test.station_bounds import StationBounds

    if bounds or limits:
        for each in read.units.values():
            StationBounds.of_runs(each.runs, limits, **bounds)


def _since_ns(since: str) -> int:
    from analytics.evaluation.selection import dated  # slow to import

    return dated(since)


def _check_suffixes(report_path: Path | None, procedure_path: Path | None) -> None:
    if report_path is not None and report_path.suffix.lower() not in (".html", ".htm"):
        raise BadInput(f"report {report_path}: reports are written as .html; for pictures only give --plot FOLDER")
    if procedure_path is not None and procedure_path.suffix.lower() != ".toml":
        raise BadInput(f"procedure {procedure_path}: procedures are written as .toml; name a file such as next.toml")


def _saved(folder: Path, found: "UnitsDiagnosis") -> tuple[dict[str, dict[str, object]], dict[str, str]]:
    """Save the models found as versions not in use: number and hash by unit; and why others are not saved."""
    from analytics.loop.model.model_registry import ModelRegistry
    from analytics.loop.model.model_use import InUse, read_uses
    from analytics.loop.model_promotion import version_of
    from storage.store import Store

    saved: dict[str, dict[str, object]] = {}
    unsaved: dict[str, str] = {}
    store = Store.open(folder)
    registry, uses = ModelRegistry(store), read_uses(store)
    with opened_catalog(folder, quiet=True) as catalog:
        for unit, each in found.units.items():
            if each.diagnosis.model is None:
                notes().print(f"{unit}: not enough data; there is no model to save")
                continue
            use = uses.get((unit, each.diagnosis.signal), InUse())
            try:
                made = version_of(catalog, each, use, by=acting(None), note="gyrofleet diagnose --save")
                written = registry.add(made)
            except GyrofleetError as error:
                unsaved[unit] = str(error)
                continue
            saved[unit] = {"version": written.version, "hash": written.hash}
            notes().print(f"{unit}: version {written.version} of its error model: {written.text}")
            if left_out := [name for name in each.diagnosis.names if name not in written.added]:
                text = f"{unit}: no model predicts {', '.join(left_out)}; that version does not include it"
                notes().print(text)
    return saved, unsaved


def _write_procedure(found: "NextTest | None", path: Path) -> bool:
    """Write the procedure of the first plan that is no repetition; whether there is one."""
    import msgspec

    plan = None if found is None else next((each for each in found.plans if not each.test.like), None)
    if plan is None:
        why = "nothing is open" if found is None else found.why_not or "the plans repeat runs that were done"
        notes().print(f"no procedure is written: {why}", soft_wrap=True)
        return False
    try:
        write_durably(path, msgspec.toml.encode(plan.test.document))
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error}; name a file in a folder you can write") from error
    hours = f"{plan.test.repeats} x {plan.hours / plan.test.repeats:.2g} h"
    notes().print(
        f"procedure: {path}, {hours}, decides with a power of {plan.power:.0%}, {plan.assured:.0%} for the least sure "
        "of those with a weight of 5 % or more",
        soft_wrap=True,
    )
    return True


def _write(found: "UnitsDiagnosis", report_path: Path | None, plot_folder: Path | None, language: "Language") -> None:
    if report_path is not None:
        from analytics.loop.report.diagnosis_html import write_report

        with notes().status("writing the report"):
            write_report(found, report_path, language)
        notes().print(f"report: {report_path}")
    if plot_folder is not None:
        from analytics.loop.report.diagnosis_plots import write_figures
        from analytics.loop.report.wording import Wording

        for each in found.units.values():
            for path in write_figures(each, plot_folder, Wording(language, each.data.runs[0])):
                notes().print(f"plot: {path}")


def block_seconds(text: str) -> float:
    """Seconds of a length of time.

    >>> block_seconds("30s"), block_seconds("0.5 min"), block_seconds("10")
    (30.0, 30.0, 10.0)
    """
    match = re.fullmatch(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*(s|min|h|)\s*", text)
    try:
        if match is None:
            raise ValueError(text)
        return float(match[1]) * _SECONDS[match[2]]
    except ValueError:
        raise BadInput(f"--block {text}: give a length of time such as 30s, 1min or 0.5h") from None


def noise_of(text: str) -> "GivenNoise":
    """Noise declared on the command line; only turn_on may be missing.

    >>> noise_of("N=0.005, B=0.02, K=0.01, turn_on=0.3").turn_on
    0.3
    >>> noise_of("N=0.005, B=0.02, K=0.01").turn_on is None
    True
    """
    from analytics.loop.model.declared_noise import GivenNoise

    form = "N=..,B=..,K=..[,turn_on=..] in deg/sqrt(h), deg/h, deg/h/sqrt(h), deg/h, 0 for a term that is absent"
    pairs = [(name.strip(), value.strip()) for name, _, value in (part.partition("=") for part in text.split(","))]
    names = [name for name, _ in pairs]
    if sorted({*names, "turn_on"}) != sorted(_NOISE_TERMS) or len(set(names)) < len(names):
        missing = [name for name in _NOISE_TERMS[:3] if name not in names]
        wrong = f"{', '.join(missing)} is missing" if missing else "a term is unknown or repeated"
        raise BadInput(f"--noise {text}: {wrong}; give {form}")
    try:
        values = {name: float(value) for name, value in pairs}
    except ValueError as error:
        raise BadInput(f"--noise {text}: {error}; give {form}") from error
    if not all(0 <= value < float("inf") for value in values.values()) or values["N"] == 0:
        raise BadInput(f"--noise {text}: terms are positive numbers, N above 0; give {form}")
    if strange := [name for name, value in values.items() if value and not _LEAST_NOISE <= value <= _MOST_NOISE]:
        raise BadInput(f"--noise {text}: {', '.join(strange)} is of no sensor's size; give {form}")
    return GivenNoise(values["N"], values["B"], values["K"], values.get("turn_on"))


def bounds_of(text: str) -> dict[str, float]:
    """What a test may use, as given on the command line.

    >>> bounds_of("least_deg_c=-20, slope_deg_c_per_min=1")
    {'least_deg_c': -20.0, 'slope_deg_c_per_min': 1.0}
    """
    from analytics.loop.next_test.station_bounds import UNITS

    names = tuple(UNITS)
    found: dict[str, float] = {}
    for part in filter(None, (each.strip() for each in text.split(","))):
        name, _, value = (each.strip() for each in part.partition("="))
        if name in found:
            raise BadInput(f"--bounds {part}: {name} is given twice; give it once")
        try:
            found[name] = float(value)
        except ValueError:
            raise BadInput(f"--bounds {part}: give NAME=NUMBER; names are {', '.join(names)}") from None
        if name not in names:
            raise BadInput(f"--bounds {part}: {name} is not known; names are {', '.join(names)}")
        if name.endswith("deg_c") and found[name] < _ABSOLUTE_ZERO_DEG_C:
            raise BadInput(
                f"--bounds {part}: below absolute zero, {_ABSOLUTE_ZERO_DEG_C} degC; give what the unit withstands"
            )
    return found


def station_limits(path: Path | None) -> dict[str, float]:
    """Limits of the instruments in a station file; none without one."""
    from analytics.loop.next_test.station_bounds import limits_of_station

    return {} if path is None else limits_of_station(path)


def holdout_of(text: str) -> tuple[str, ...] | None:
    """Runs to hold out, by name; None for the last third.

    >>> holdout_of("last-third"), holdout_of("none"), holdout_of("runs=r7,r8")
    (None, (), ('r7', 'r8'))
    """
    if text == "last-third":
        return None
    if text == "none":
        return ()
    names = tuple(name.strip() for name in text.removeprefix("runs=").split(",") if name.strip())
    if not text.startswith("runs=") or not names:
        raise BadInput(f"--holdout {text}: give last-third, none, or runs=A,B with the names of runs")
    return names
