"""The command `gyrofleet diagnose`: effects that a declared error model lacks, their certainty and their gain."""

import getpass
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from analytics.commands.metrics import language_option, opened_catalog
from storage.commands.stored_names import RUN, SIGNAL, UNIT
from stream.console import notes, print_json, reporting, status_line, store_option
from stream.errors import BadInput, GyrofleetError

if TYPE_CHECKING:
    from analytics.loop.report.wording import Language
    from analytics.loop.unit_diagnosis import UnitsDiagnosis


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
    "--holdout",
    default="last-third",
    show_default=True,
    metavar="last-third|none|runs=A,B",
    help="Runs held out of the fit, which confirm the findings.",
)
@click.option("--run", "runs", type=RUN, multiple=True, help="Only this run; may be given several times.")
@click.option("--since", help="Only samples since then: 2026-11-21, or with time and zone.")
@click.option("--report", "report_path", type=click.Path(path_type=Path), help="Write a report: FILE.html.")
@click.option("--plot", "plot_folder", type=click.Path(path_type=Path), help="Write the pictures to this folder, PNG.")
@click.option("--save", is_flag=True, help="Save the model found as a version for `gyrofleet model promote`.")
@language_option
@reporting
def diagnose(
    folder: Path,
    units: tuple[str, ...],
    signal: str | None,
    model: str,
    block: str | None,
    noise: str | None,
    holdout: str,
    runs: tuple[str, ...],
    since: str | None,
    report_path: Path | None,
    plot_folder: Path | None,
    language: "Language",
    *,
    fleet: bool,
    save: bool,
    as_json: bool,
) -> None:
    """Find effects that a declared error model lacks, or report that none is missing or that the data cannot tell.

    Verdicts: nothing_missing, effect_found, confounded, unreplicated, unknown_function, unexplained, not_enough_data.
    The exit code is 0 with any verdict, and 1 if a unit could not be diagnosed.

    \b
    gyrofleet diagnose --unit FOG-1 --model 'rate = bias + temperature'
    gyrofleet diagnose --fleet --signal rate --model bias --report nov.html
    """  # noqa: D301  \b keeps the lines apart
    from analytics.commands.diagnose_options import block_seconds, holdout_of, noise_of
    from analytics.evaluation.selection import dated
    from analytics.loop.unit_diagnosis import trace_units
    from analytics.loop.unit_reduction import Question, reduce_units, units_with

    if not units and not fleet:
        raise BadInput("no unit is named: give --unit, once or several times, or --fleet for all units with the signal")
    if report_path is not None and report_path.suffix.lower() not in (".html", ".htm"):
        raise BadInput(f"report {report_path}: reports are written as .html; for pictures only give --plot FOLDER")
    question = Question(
        model=model,
        signal=signal,
        block_s=None if block is None else block_seconds(block),
        noise=None if noise is None else noise_of(noise),
        holdout=holdout_of(holdout),
        runs=runs or None,
        since_ns=None if since is None else dated(since),
    )
    with status_line() as report:
        with opened_catalog(folder, quiet=as_json) as catalog:
            chosen = list(dict.fromkeys(units)) or units_with(catalog, question.signal_name)
            read = reduce_units(catalog, chosen, question, on_progress=report)
        # the catalogue is closed to free its memory for the trace
        found = trace_units(read, question, is_pooled=fleet, on_progress=report)
    saved, unsaved = _saved(folder, found) if save else ({}, {})
    is_one = len(chosen) == 1 and not fleet
    _write(found, report_path, plot_folder, language)
    if as_json:
        document = next(iter(found.units.values())).document() if is_one else found.document()
        print_json(document | ({"saved": saved, "not_saved": unsaved} if save else {}))
    else:
        from analytics.commands.diagnose_output import print_unit, print_units

        if is_one:
            print_unit(next(iter(found.units.values())), language)
        else:
            print_units(found, language)
    for unit, why in found.failed.items():
        notes().print(f"warning: unit {unit}: {why}", markup=False, soft_wrap=True)
    for unit, why in unsaved.items():
        notes().print(f"error: the model of unit {unit} is not saved: {why}", markup=False, soft_wrap=True)
    if found.failed or unsaved:
        sys.exit(1)


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
                notes().print(f"{unit}: not enough data; there is no model to save", markup=False)
                continue
            use = uses.get((unit, each.diagnosis.signal), InUse())
            try:
                made = version_of(catalog, each, use, by=getpass.getuser(), note="gyrofleet diagnose --save")
                written = registry.add(made)
            except GyrofleetError as error:
                unsaved[unit] = str(error)
                continue
            saved[unit] = {"version": written.version, "hash": written.hash}
            notes().print(f"{unit}: version {written.version} of its error model: {written.text}", markup=False)
            if left_out := [name for name in each.diagnosis.names if name not in written.added]:
                text = f"{unit}: no model predicts {', '.join(left_out)}; that version does not include it"
                notes().print(text, markup=False)
    return saved, unsaved


def _write(found: "UnitsDiagnosis", report_path: Path | None, plot_folder: Path | None, language: "Language") -> None:
    if report_path is not None:
        from analytics.loop.report.diagnosis_html import write_report

        with notes().status("writing the report"):
            write_report(found, report_path, language)
        notes().print(f"report: {report_path}", markup=False)
    if plot_folder is not None:
        from analytics.loop.report.diagnosis_plots import write_figures
        from analytics.loop.report.wording import Wording

        for each in found.units.values():
            for path in write_figures(each, plot_folder, Wording(language, each.data.runs[0])):
                notes().print(f"plot: {path}", markup=False)
