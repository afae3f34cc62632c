"""The command `gyrofleet audit`: what happened to a unit, from the log."""

from pathlib import Path

import click

from analytics.commands.evaluation.metrics import language_option
from storage.commands.stored_names import UNIT
from stream.security.actor import UNAUTHENTICATED
from stream.terminal.console import counted, notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable

_TITLES = {
    "en": ("arrived (UTC)", "of (UTC)", "what", "run", "who", "proved", "details"),
    "zh": ("到达(UTC)", "时间(UTC)", "事件", "试验", "人员", "身份验证", "内容"),
}


@click.command("audit")
@store_option
@click.option("--unit", type=UNIT, required=True, help="Which unit.")
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), help="Write to this CSV file.")
@language_option
@reporting
def audit(folder: Path, unit: str, csv_path: Path | None, language: str, *, as_json: bool) -> None:
    """Who did what to a unit when, with which data, limits and version, from the log alone.

    In the order of arrival in the log; what a document is of, as the records of an imported file, may lie long before.

    \b
    gyrofleet audit --unit FOG-0231
    gyrofleet audit --unit FOG-0231 --csv audit.csv
    """  # noqa: D301  click's mark for lines that are not to be joined
    from analytics.audit import audit_of, spoken, write_audit
    from analytics.event_words import kind_name
    from storage.sql.catalog import Catalog
    from storage.store import Store

    with Catalog(Store.open(folder)) as catalog:
        rows = audit_of(catalog, unit)
    if csv_path is not None:
        write_audit(rows, csv_path, language)
        notes().print(f"{counted(len(rows), 'row')} written to {csv_path}")
    if as_json:
        print_json(rows)
    elif csv_path is None:
        table = ResultTable(*_TITLES[language], title=unit)
        for row in rows:
            what = ", ".join(filter(None, (spoken(row, language), row.limits)))
            table.add_row(
                row.arrival,
                row.at,
                kind_name(row.kind, language),
                row.run or "",
                row.by,
                _proof(row.identity, language),
                what,
            )
        results().print(table)


def _proof(identity: str, language: str) -> str:
    """How an identity is shown: that of a certificate or a sign-in, or that nobody has proved it."""
    if identity == UNAUTHENTICATED:
        return {"en": "no", "zh": "未验证"}[language]
    return identity
