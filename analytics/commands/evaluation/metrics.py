"""The command `gyrofleet metrics`: the characteristics of the standards, of one unit or of all."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from analytics.commands.evaluation.engine_option import compute_by_engine, engine_option
from analytics.commands.evaluation.limits import warn_of_copies
from analytics.commands.evaluation.plants import check_one_store, of_plants, with_plant
from storage.commands.lake_address import asked_at, lake_options
from storage.commands.stored_names import RUN, UNIT
from stream.errors import BadInput
from stream.terminal.completion import ListedName
from stream.terminal.console import counted, notes, print_json, progress_bar, reporting, results, store_option, styled
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from analytics.evaluation.inner_page import InnerRow
    from analytics.evaluation.selection import Row
    from storage.sql.catalog import Catalog
    from storage.store import Store

_SHOWN_ROWS = 500
_SHOWN_REASONS = 5
_NOTHING = 'no metric matches the selection; `gyrofleet sql "from unit_runs"` lists the tested units and runs'
language_option = click.option(
    "--lang", "language", type=click.Choice(["en", "zh"]), default="en", show_default=True,
    help="Language of names and titles.",
)  # fmt: skip


def _metric_names() -> list[str]:
    from analytics.metric_registry.registry import metrics

    return list(metrics())


METRIC = ListedName(_metric_names)


@click.command("metrics")
@store_option
@click.option(
    "--unit", "units", type=UNIT, multiple=True, help="Only this unit; may be given several times, as all of these."
)
@lake_options
@click.option("--lot", "lots", multiple=True, help="Only units of this lot, in runs in which they were of it.")
@click.option("--run", "runs", type=RUN, multiple=True, help="Only what rests on this run.")
@click.option("--metric", "ids", type=METRIC, multiple=True, help="Only this metric, as bias_stability.")
@click.option("--standard", "standards", multiple=True, help="Only this standard: GJB2426A, JJF2014, JJF1536.")
@click.option("--since", help="Only what rests on a run begun then or later: 2026-11-21, or with time and zone.")
@click.option("--annex-a", "annex_unit", metavar="UNIT", help="The 24 rows of JJF 2014-2022 annex A for this unit.")
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), help="Write to this CSV file.")
@click.option("--xlsx", "xlsx_path", type=click.Path(path_type=Path), help="Write to this workbook.")
@engine_option
@language_option
@reporting
def metrics(
    folder: Path, units: tuple[str, ...], lots: tuple[str, ...], runs: tuple[str, ...], ids: tuple[str, ...],
    standards: tuple[str, ...], since: str | None, annex_unit: str | None, csv_path: Path | None,
    xlsx_path: Path | None, engine: str | None, url: str | None, endpoint_url: str | None, cache_size: str | None,
    language: str, *, as_json: bool,
) -> None:  # fmt: skip
    """Characteristics of the test standards: value, 95 % interval, clause, or the reason why there is none.

    Changed runs are reduced first; other values are read from the store. With --metric only these metrics are computed.
    With --lake they are those of a published lake.

    \b
    gyrofleet metrics --unit FOG-0231
    gyrofleet metrics --standard GJB2426A --since 2026-11-01 --xlsx november.xlsx
    gyrofleet metrics --annex-a FOG-0231 --lang zh
    """  # noqa: D301  click's mark for lines that are not to be joined
    from analytics.evaluation.inner_page import inner_page
    from analytics.evaluation.selection import Selection, dated, selected, undated_runs, unused_steps
    from analytics.evaluation.table import metrics_table, write_csv, write_xlsx

    if annex_unit is not None and (units or lots or runs or ids or standards or since or csv_path or xlsx_path):
        raise BadInput("--annex-a stands alone, with --lang and --json: it is the unit's last values of JJF 2014-2022")
    asked = Selection(units, lots, runs, ids, standards, None if since is None else dated(since))
    at = asked_at(folder, url, endpoint_url, cache_size)
    if annex_unit is not None:
        check_one_store(at, "--annex-a")
        with opened_catalog(at, quiet=as_json) as catalog:
            compute_by_engine(catalog, engine)
            _print_annex(inner_page(catalog, annex_unit, "JJF2014"), annex_unit, language, as_json=as_json)
        return

    def ask(catalog: "Catalog") -> "tuple[list[Row], int, list[tuple[str, int, str]]]":
        compute_by_engine(catalog, engine, ids)
        undated = undated_runs(catalog, asked) if since else 0
        found = selected(catalog, asked)
        warn_of_failed(catalog, found)
        # a step is unused where no metric at all uses it
        return found, undated, [] if ids else unused_steps(catalog, asked)

    answers = of_plants(at, ask, quiet=as_json)
    rows = [row for plant, (found, _, _) in answers for row in with_plant(plant, found)]
    undated = sum(count for _, (_, count, _) in answers)
    for _, (_, _, unused) in answers:
        _print_unused(unused, language)
    if undated:
        notes().print(f"--since leaves out {undated} runs whose date is not known; import them with --start")
    if csv_path is not None:
        write_csv(rows, csv_path, language)
    if xlsx_path is not None:
        write_xlsx(rows, xlsx_path, language)
    for path in filter(None, (csv_path, xlsx_path)):
        notes().print(f"{len(rows):,} rows written to {path}")
    if not rows and (csv_path is not None or xlsx_path is not None):
        notes().print(_NOTHING)
    if as_json:
        print_json(rows)
    elif csv_path is None and xlsx_path is None:
        _print_table(metrics_table(rows[:_SHOWN_ROWS], language), len(rows))


@contextmanager
def opened_catalog(at: "Path | Store", *, quiet: bool, is_anew: bool = False) -> "Iterator[Catalog]":
    """A store's catalogue that shows the progress of the reduction of changed runs on standard error.

    If `is_anew`, nothing that the store has kept of earlier computations is used.
    """
    from storage.specifications.chain import read_chain
    from storage.sql.catalog import Catalog, catalog_anew
    from storage.sql.opened import opened_at

    with progress_bar(hidden=quiet) as progress:
        task = progress.add_task("reducing changed runs", total=None, visible=False)

        def update(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total, visible=done < total)

        store = opened_at(at)
        opened = catalog_anew if is_anew else Catalog
        with opened(store, progress=update) as catalog:
            if store.is_local:
                warn_of_copies(store, read_chain(store, catalog))
            yield catalog


def warn_of_failed(catalog: "Catalog", rows: "Sequence[Row] | None" = None) -> None:
    """Note metrics of the site's own that fail, by their file: those of the rows, or all."""
    from analytics.metric_registry.failed_metrics import remarks_on_failed

    for remark in remarks_on_failed(catalog, rows):
        notes().print(f"warning: {remark}", soft_wrap=True)


def _print_annex(rows: "Sequence[InnerRow]", unit: str, language: str, *, as_json: bool) -> None:
    from analytics.evaluation.table import format_parameters, format_value, interval_of, reason_of

    if as_json:
        print_json({"unit": unit, "standard": "JJF2014", "annex": "A", "rows": [row._asdict() for row in rows]})
        return
    in_chinese = language == "zh"
    titles = ("no.", "characteristic", "result", "95 % interval", "parameters", "clause")
    if in_chinese:
        titles = ("序号", "校准项目", "校准结果", "95 % 区间", "参数", "条款")
    table = ResultTable(*titles, title=f"JJF 2014-2022 {'附录 A' if in_chinese else 'annex A'}: {unit}")
    for row in rows:
        name = row.zh if in_chinese else row.en
        if not row.results:
            why = reason_of({"reason": row.reason or ""}, language)
            table.add_row(str(row.number), name, styled(why, "yellow"), "", "", row.clause)
        for at, each in enumerate(row.results):
            head = ("", "") if at else (str(row.number), name)
            parameters = format_parameters(each["parameters"], language)
            table.add_row(*head, format_value(each), interval_of(each), parameters, each["clause"])
    results().print(table)


def _print_unused(unused: "Sequence[tuple[str, int, str]]", language: str) -> None:
    """Note the steps that no metric uses: how many, of which units, and why."""
    from analytics.evaluation.table import reason_of

    for reason, steps, units in unused[:_SHOWN_REASONS]:
        text = f"not judged: {counted(steps, 'step')} of {units}: {reason}"
        if language == "zh":
            text = f"未评定：{units} 的 {steps} 个步骤：{reason_of({'reason': reason}, language)}"
        notes().print(text, soft_wrap=True)
    if (more := len(unused) - _SHOWN_REASONS) > 0:
        notes().print(f'... and {more} reasons more; `gyrofleet sql "from unused_steps"` has all')


def _print_table(table: ResultTable, count: int) -> None:
    console = results()
    if count == 0:
        console.print(_NOTHING)
        return
    console.print(table)
    more = "" if count <= _SHOWN_ROWS else f", the first {_SHOWN_ROWS} shown; --csv, --xlsx or --json give all"
    console.print(f"{counted(count, 'row')}{more}")
