"""The command `gyrofleet diagnose`: what a declared error model lacks, with what certainty, and what it would win."""

import getpass
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table

from analytics.commands.metrics import language_option, opened_catalog
from storage.commands.stored_names import RUN, SIGNAL, UNIT
from stream.console import notes, print_json, reporting, results, status_line, store_option, styled
from stream.errors import BadInput, GyrofleetError

if TYPE_CHECKING:
    from analytics.loop.model.declared_noise import GivenNoise
    from analytics.loop.report.report_tables import TextTable
    from analytics.loop.report.wording import Language, Wording
    from analytics.loop.unit_diagnosis import UnitDiagnosis, UnitsDiagnosis

_MOST_NAMED = 3
_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_NOISE_TERMS = ("N", "B", "K", "turn_on")
_LEAST_NOISE, _MOST_NOISE = 1e-20, 1e20


@click.command("diagnose")
@store_option
@click.option("--unit", "units", type=UNIT, multiple=True, help="Which unit; may be given several times.")
@click.option("--fleet", is_flag=True, help="Search for what units have in common as well; all units if none is named.")
@click.option("--signal", type=SIGNAL, help="Which signal, as rate; left out where the model names it.")
@click.option(
    "--model", required=True, help="The declared error model: 'rate = bias + scale_factor*input_rate + temperature'."
)
@click.option(
    "--block",
    show_default="30s, or the interval of the samples where that is longer",
    help="Length of the blocks that are averaged: 10s, 1min.",
)
@click.option(
    "--noise",
    metavar="N=..,B=..,K=..[,turn_on=..]",
    help="Declared noise in deg/sqrt(h), deg/h, deg/h/sqrt(h), deg/h; from each unit's own Allan fits if left out. "
    "Turn-on scatter is estimated from the runs if left out.",
)
@click.option(
    "--holdout",
    default="last-third",
    show_default=True,
    metavar="last-third|none|runs=A,B",
    help="Runs that take no part in the fit and confirm what was found.",
)
@click.option("--run", "runs", type=RUN, multiple=True, help="Only this run; may be given several times.")
@click.option("--since", help="Only samples from then on: 2026-11-21, or with time and zone.")
@click.option("--report", "report_path", type=click.Path(path_type=Path), help="Write a report: FILE.html.")
@click.option("--plot", "plot_folder", type=click.Path(path_type=Path), help="Write the pictures to this folder, PNG.")
@click.option("--save", is_flag=True, help="Keep the model found as a version that `gyrofleet model promote` can use.")
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
    """Find what a declared error model lacks, or say that nothing is missing, or that the data cannot tell.

    Verdicts: nothing_missing, effect_found, confounded, unreplicated, unknown_function, unexplained, not_enough_data.
    The exit code is 0 with any of them, and 1 where a unit could not be diagnosed.

    \b
    gyrofleet diagnose --unit FOG-1 --model 'rate = bias + temperature'
    gyrofleet diagnose --fleet --signal rate --model bias --report nov.html
    """  # noqa: D301  click's mark for lines that are not to be joined
    from analytics.evaluation.selection import dated
    from analytics.loop.unit_diagnosis import trace_units
    from analytics.loop.unit_reduction import Question, reduce_units, units_with

    if not units and not fleet:
        raise BadInput("which units? give --unit, once or several times, or --fleet for all that have the signal")
    if report_path is not None and report_path.suffix.lower() not in (".html", ".htm"):
        raise BadInput(f"report {report_path}: reports are written as .html; pictures alone with --plot FOLDER")
    question = Question(
        model=model,
        signal=signal,
        block_s=None if block is None else block_seconds(block),
        noise=None if noise is None else noise_of(noise),
        holdout=holdout_of(holdout),
        runs=runs or None,
        since_ns=None if since is None else dated(since),
    )
    with status_line() as told:
        with opened_catalog(folder, quiet=as_json) as catalog:
            chosen = list(dict.fromkeys(units)) or units_with(catalog, question.signal_name)
            read = reduce_units(catalog, chosen, question, told=told)
        # the catalogue's memory is free for the trace
        found = trace_units(read, question, is_pooled=fleet, told=told)
    saved, unsaved = _saved(folder, found) if save else ({}, {})
    is_one = len(chosen) == 1 and not fleet
    _write(found, report_path, plot_folder, language)
    if as_json:
        document = next(iter(found.units.values())).document() if is_one else found.document()
        print_json(document | ({"saved": saved, "not_saved": unsaved} if save else {}))
    elif is_one:
        _tell_unit(next(iter(found.units.values())), language)
    else:
        _tell_units(found, language)
    for unit, why in found.failed.items():
        notes().print(f"warning: unit {unit}: {why}", markup=False, soft_wrap=True)
    for unit, why in unsaved.items():
        notes().print(f"error: the model of unit {unit} is not saved: {why}", markup=False, soft_wrap=True)
    if found.failed or unsaved:
        sys.exit(1)


def block_seconds(text: str) -> float:
    """Seconds of a length of time as it is written.

    Raises
    ------
    BadInput: If it is none.

    Examples
    --------
    >>> block_seconds("30s"), block_seconds("0.5 min"), block_seconds("10")
    (30.0, 30.0, 10.0)
    """
    match = re.fullmatch(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*(s|min|h|)\s*", text)
    try:
        if match is None:
            raise ValueError(text)
        return float(match[1]) * _SECONDS[match[2]]
    except ValueError:
        raise BadInput(f"--block {text}: give a length of time, as 30s, 1min or 0.5h") from None


def noise_of(text: str) -> "GivenNoise":
    """Noise as it is declared on the command line.

    Raises
    ------
    BadInput: If a term other than turn_on is missing, one is not known or no number, or N is zero.

    Examples
    --------
    >>> noise_of("N=0.005, B=0.02, K=0.01, turn_on=0.3").turn_on
    0.3
    >>> noise_of("N=0.005, B=0.02, K=0.01").turn_on is None
    True
    """
    from analytics.loop.model.declared_noise import GivenNoise

    form = "N=..,B=..,K=..[,turn_on=..] in deg/sqrt(h), deg/h, deg/h/sqrt(h), deg/h, 0 for a term that is not there"
    pairs = [(name.strip(), value.strip()) for name, _, value in (part.partition("=") for part in text.split(","))]
    names = [name for name, _ in pairs]
    if sorted({*names, "turn_on"}) != sorted(_NOISE_TERMS) or len(set(names)) < len(names):
        missing = [name for name in _NOISE_TERMS[:3] if name not in names]
        wrong = f"{', '.join(missing)} is missing" if missing else "each term stands once"
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


def holdout_of(text: str) -> tuple[str, ...] | None:
    """Runs to hold out, by name; None for the last third.

    Raises
    ------
    BadInput: If it is written otherwise.

    Examples
    --------
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


def _saved(folder: Path, found: "UnitsDiagnosis") -> tuple[dict[str, dict[str, object]], dict[str, str]]:
    """Write down the models found, as versions that nobody uses yet: number and hash by unit; why others are not."""
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
                notes().print(f"{unit}: not enough data, there is no model to save", markup=False)
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
                text = f"{unit}: no model predicts {', '.join(left_out)}: it is not in that version"
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


def _tell_unit(found: "UnitDiagnosis", language: "Language") -> None:
    from analytics.loop.report.evidence import alternative, evidence, separating_test
    from analytics.loop.report.report_tables import absent_rows, achieved, error_rows, gain_rows, noise_rows
    from analytics.loop.report.sentences import verdict_sentence
    from analytics.loop.report.wording import Wording

    words, diagnosis, console = Wording(language, found.data.runs[0]), found.diagnosis, results()
    for text in diagnosis.losses:
        console.print(f"{words.of('limit', '局限')}: {words.remark(text)}", markup=False)
    console.print(styled(verdict_sentence(diagnosis, words), "bold"))
    for effect in (*diagnosis.effects, *diagnosis.unreplicated):
        console.print(f"\n{words.effect(effect)}: {words.coefficient(effect)}", markup=False)
        for text in evidence(effect, diagnosis, words):
            console.print(f"  {text}", markup=False)
        for other in effect.confounded:
            or_else = words.of("or", "或")
            console.print(f"  {or_else} {alternative(other, words)}", markup=False)
            tells = words.of("to tell", "区分方法")
            console.print(f"     {tells}: {separating_test(other, words)}", markup=False)
    if diagnosis.error is not None:
        console.print("", _rich(error_rows(diagnosis.error, words)))
        if (within := gain_rows(diagnosis.error, words)).rows:
            console.print(_rich(within))
        if (won := achieved(diagnosis.error, words)) is not None:
            console.print(won, markup=False)
    if diagnosis.noise is not None:
        console.print(_rich(noise_rows(diagnosis, words)))
        source = words.of("declared noise", "已声明噪声的来源")
        console.print(f"{source}: {words.remark(found.data.noise_source)}", markup=False)
    if diagnosis.detection_limits:
        console.print(_rich(absent_rows(diagnosis, words)))
    _tell_remarks(found, words)


def _tell_remarks(found: "UnitDiagnosis", words: "Wording") -> None:
    limit, note = words.of("limit", "局限"), words.of("note", "说明")
    for text in (each for each in found.diagnosis.limits if each not in found.diagnosis.losses):
        notes().print(f"{limit}: {words.remark(text)}", markup=False, soft_wrap=True)
    for each in found.data.notes:
        notes().print(f"{limit if each.is_limit else note}: {words.remark(each.text)}", markup=False, soft_wrap=True)


def _tell_units(found: "UnitsDiagnosis", language: "Language") -> None:
    from analytics.loop.report.fleet_sentences import fleet_rows, fleet_sentence, unit_rows
    from analytics.loop.report.wording import Wording

    words, console = Wording(language, next(iter(found.units.values())).data.runs[0]), results()
    for unit, each in found.units.items():
        for text in each.diagnosis.losses:
            console.print(f"{words.of('limit', '局限')} ({unit}): {words.remark(text)}", markup=False)
    if found.fleet is not None:
        console.print(styled(fleet_sentence(found.fleet, words), "bold"))
        for name, rows in found.fleet.by_unit.items():
            console.print(_rich(fleet_rows(name, rows, words)))
        for text in found.fleet.limits:
            notes().print(f"{words.of('limit', '局限')}: {words.remark(text)}", markup=False, soft_wrap=True)
    console.print(_rich(unit_rows(found, words)))
    _tell_remarks_of(found, words)


def _tell_remarks_of(found: "UnitsDiagnosis", words: "Wording") -> None:
    """Limits and notes of several units, each said once, with the units that it is of."""
    units: dict[tuple[bool, str], list[str]] = {}
    for unit, each in found.units.items():
        told = [(True, text) for text in each.diagnosis.limits if text not in each.diagnosis.losses]
        told += [(note.is_limit, note.text) for note in each.data.notes]
        for remark in dict.fromkeys(told):
            units.setdefault(remark, []).append(unit)
    for (is_limit, text), of in sorted(units.items(), key=lambda each: not each[0][0]):
        kind = words.of("limit", "局限") if is_limit else words.of("note", "说明")
        named = ", ".join(of) if len(of) <= _MOST_NAMED else words.of(f"{len(of)} units", f"{len(of)}个产品")
        notes().print(f"{kind} ({named}): {words.remark(text)}", markup=False, soft_wrap=True)


def _rich(table: "TextTable") -> Table:
    shown = Table(title=table.title, title_justify="left", header_style="bold")
    for at, title in enumerate(table.columns):
        shown.add_column(title, justify="right" if table.is_numeric(at) else "left", overflow="fold")
    for row in table.rows:
        shown.add_row(*row)
    return shown
