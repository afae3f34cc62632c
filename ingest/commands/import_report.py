"""The report of `gyrofleet import`: for each file its signals, remarks and bad rows, and what to ask next."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stream.channel_names import signal_axis
from stream.terminal.console import DEFAULT_STORE, counted, notes, results

if TYPE_CHECKING:
    from ingest.importing.file_sending import FileImport

LISTED_FILES = 10
_LISTED_BAD_ROWS = 5
_LISTED_REMARKS = 20
_FEWEST_SAMPLES, _FEWEST_OF_FIT = 3, 64  # of an Allan deviation, and of a noise fit


def report_files(imported: "Sequence[FileImport]", folder: Path) -> None:
    """Report imported files: few of them with a table each, many with a line each and a total."""
    for each in imported:
        if len(imported) <= LISTED_FILES:
            _report(each, folder)
        else:
            _report_briefly(each)
    if len(imported) > LISTED_FILES:
        results().print(_total(imported, folder), soft_wrap=True)
    _report_next(imported[-1], folder)


def _report(imported: "FileImport", folder: Path) -> None:
    for segment in imported.recovered:
        notes().print(f"recovered {segment}, left open by an interrupted process")
    _report_bad_rows(imported)
    for remark in imported.remarks[:_LISTED_REMARKS]:
        notes().print(f"{imported.file}: {remark}", soft_wrap=True)
    if len(imported.remarks) > _LISTED_REMARKS:
        notes().print(f"  ... and {len(imported.remarks) - _LISTED_REMARKS:,} more (--json lists all)")
    from stream.terminal.result_table import ResultTable

    table = ResultTable(title=f"{imported.file}: {imported.rows:,} {imported.counted}")
    for title in ("unit", "run", "signal", "in", "interval", "in file", "added", "already stored", "in lake"):
        table.add_column(title, justify="right" if title in {"interval", "in file", "added", "in lake"} else "left")
    for signal in imported.signals:
        table.add_row(
            signal.unit, signal.run, signal.signal, signal.unit_of_measure,
            f"{signal.sample_interval_s:g} s" + (" (irregular)" if signal.irregular else ""), f"{signal.in_file:,}",
            f"{signal.added:,}", f"{signal.already_stored:,}",
            "not seen from here" if signal.in_lake is None else f"{signal.in_lake:,}",
        )  # fmt: skip
    results().print(table)
    results().print(_conclusion(imported, folder))
    _report_restated(imported)
    _report_damage(imported)


def _report_briefly(imported: "FileImport") -> None:
    """Report one of many files in a line; its defects in full."""
    _report_bad_rows(imported)
    signals, stored = len(imported.signals), sum(signal.already_stored for signal in imported.signals)
    line = f"{imported.file}: {imported.rows:,} {imported.counted}, {signals} signals, {imported.added:,} samples added"
    line += f", {stored:,} already stored" if stored else ""
    warnings = [remark for remark in imported.remarks if remark.startswith("warning: ")]
    others = len(imported.remarks) - len(warnings)
    results().print(line + (f"; {others} remarks, --json lists them" if others else ""), soft_wrap=True)
    for warning in warnings:
        notes().print(f"{imported.file}: {warning}", soft_wrap=True)
    _report_restated(imported)
    _report_damage(imported)


def _report_restated(imported: "FileImport") -> None:
    for each in imported.restated:
        notes().print(f"{imported.file}: {each}", soft_wrap=True)


def _report_damage(imported: "FileImport") -> None:
    if imported.damage:
        text = f"error: {imported.file}: {imported.damage}; what is good of it is imported"
        notes().print(text, style="red", soft_wrap=True)


def _total(imported: "Sequence[FileImport]", folder: Path) -> str:
    added, seconds = sum(each.added for each in imported), sum(each.seconds for each in imported)
    is_counted = all(signal.in_lake is not None for each in imported for signal in each.signals)
    where = f"in {_lake(imported[0], folder)}, each once" if is_counted else "sent and acknowledged as recorded"
    undated = sum(not each.date_known for each in imported)
    date = f" The date of {undated} files is unknown, as no --start was given." if undated else ""
    return f"{len(imported)} files: {added:,} samples {where} ({seconds:.1f} s).{date}"


def _lake(imported: "FileImport", folder: Path) -> str:
    """The lake that has the samples: where a recorder of another store took them, its store by its identity."""
    elsewhere = imported.recorder_store
    return f"the lake of {folder}" if elsewhere is None else f"the lake of the recorder's store {elsewhere}"


def _report_next(imported: "FileImport", folder: Path) -> None:
    from ingest.importing.tested_units import is_instrument_name
    from stream.quantities import is_angular_rate

    if not imported.steps and not _has_steps(imported, folder):
        rates = {each.signal.lower() for each in imported.signals if is_angular_rate(each.unit_of_measure)}
        axes = {signal_axis(rate) for rate in rates} - {None}
        position = "Z_up" if len(axes) > 1 else "IRA_up"  # of several axes IRA would not say which one
        notes().print(
            "No step says what was measured, so there are no characteristics of it: give the same command again with "
            f"--procedure, as --procedure static_bias --position {position} for a record at rest",
            soft_wrap=True,
        )
    here = [
        signal for signal in imported.signals
        if (signal.in_lake or 0) >= _FEWEST_SAMPLES and not is_instrument_name(signal.signal)
    ]  # fmt: skip
    if not here:
        return
    signal = next((each for each in here if is_angular_rate(each.unit_of_measure)), here[0])
    which = f"--unit {shlex.quote(signal.unit)} --signal {shlex.quote(signal.signal)} --run {shlex.quote(signal.run)}"
    store = "" if str(folder) == DEFAULT_STORE else f" --store {shlex.quote(str(folder))}"
    where = ""
    if imported.recorder_store is not None:
        store, where = " --store STORE", f", STORE the folder of the recorder's store {imported.recorder_store}"
    is_fit = is_angular_rate(signal.unit_of_measure) and (signal.in_lake or 0) >= _FEWEST_OF_FIT
    how = " --fit" if is_fit else ""
    if signal.irregular:
        how = f" --resample {10 * signal.sample_interval_s:.3g}"  # Allan's deviation needs a grid
    notes().print(f"Ask it: gyrofleet allan {which}{how}{store}{where}", soft_wrap=True)


def _has_steps(imported: "FileImport", folder: Path) -> bool:
    """Whether the store has a step of samples that were in it before this file."""
    from storage.sql.catalog import Catalog
    from storage.store import Store

    if imported.recorder_store is not None:
        return False
    before = {(each.unit, each.run) for each in imported.signals if each.already_stored and each.in_lake is not None}
    if not before:
        return False
    with Catalog(Store.open(folder)) as catalog:
        return not before.isdisjoint(catalog.rows("select distinct unit, run from steps"))


def _conclusion(imported: "FileImport", folder: Path) -> str:
    in_file = sum(signal.in_file for signal in imported.signals)
    steps_text = counted(imported.steps, "step")
    if imported.added == 0:
        verb = "says" if imported.steps == 1 else "say"
        says = f"; {steps_text} in the store {verb} what was measured" if imported.steps else ""
        says += f", {imported.steps_added} new or longer with this import" if imported.steps_added else ""
        stated = "" if not imported.restated else (
            f" What is stated of the station is recorded for {counted(len(imported.restated), 'run')}."
        )  # fmt: skip
        nothing = "No sample to add" if imported.steps_added else "Nothing to add"
        return f"{nothing}: all {in_file:,} samples are stored already{says}.{stated}"
    rate = imported.added / imported.seconds
    speed = f"{imported.seconds:.2f} s" + (f", {rate / 1e6:.2f} M samples/s" if rate >= 1e5 else "")
    steps = f", {steps_text}" if imported.steps else ""
    date = "" if imported.date_known else " Their date is unknown, as no --start was given."
    if any(signal.in_lake is None for signal in imported.signals):
        return f"{imported.added:,} samples{steps} sent and acknowledged as recorded ({speed}).{date}"
    added = f"{imported.added:,} samples in, {imported.added:,} more in {_lake(imported, folder)}, each once"
    return f"{added}{steps} ({speed}).{date}"


def _report_bad_rows(imported: "FileImport") -> None:
    if imported.bad_row_count:
        notes().print(f"{imported.bad_row_count:,} of {imported.rows:,} rows of {imported.file} left out as bad:")
    for row in imported.bad_rows[:_LISTED_BAD_ROWS]:
        notes().print(f"  {row}")
    if imported.bad_row_count > _LISTED_BAD_ROWS:
        notes().print(f"  ... and {imported.bad_row_count - _LISTED_BAD_ROWS:,} more (--json lists up to 1000)")
