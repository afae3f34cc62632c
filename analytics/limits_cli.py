"""The command `gyrofleet limits`: the product specifications by which a store judges its units."""

from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table

from stream.console import print_json, reporting, results, store_option

if TYPE_CHECKING:
    from analytics.specification import SpecificationLimit
    from analytics.specification_store import Period


@click.group("limits")
def limits() -> None:
    """Product specifications: limits of metrics, by revision, and since when they hold.

    \b
    revision = "B"
    valid_from = 2026-01-01              # a date counts in UTC; valid_until is optional
    [product."FOG-70"]                   # numbers of the product that metrics use
    max_rate_deg_per_s = 300.0
    [[limit]]
    metric = "bias_stability_averaged"
    parameters = { average_s = 100 }     # which of the metric's values; all that are not told apart are meant
    product = "FOG-70"                   # every product if left out
    upper = 0.05                         # and, or lower
    unit_of_measure = "deg/h"

    (`gyrofleet run` and `allan --limits` take other files: limits of estimates while a test runs.)
    """  # noqa: D301  click's mark for lines that are not to be joined


@limits.command("add")
@click.argument("file", type=click.Path(path_type=Path))
@store_option
@reporting
def add(file: Path, folder: Path, *, as_json: bool) -> None:
    """Check a specification and keep a copy of it in the store, as NAME-REVISION; it cannot be changed then."""
    from analytics.specification_store import add_specification
    from storage.store import Store

    found, is_new = add_specification(Store.create(folder), file)
    if as_json:
        print_json(
            {"specification": found.name, "revision": found.revision, "limits": len(found.limits), "new": is_new}
        )
        return
    what = f"{_counted(len(found.limits), 'limit')}, {_counted(len(found.products), 'product')}"
    results().print(f"{found.label}: {what} {'kept' if is_new else 'are there already'}", markup=False)


@limits.command("list")
@store_option
@reporting
def list_all(folder: Path, *, as_json: bool) -> None:
    """List the specifications of a store."""
    from analytics.specification_store import periods_of, stored_specifications
    from storage.store import Store

    periods = periods_of(stored_specifications(Store.open(folder)))
    if as_json:
        print_json([_told(each) for each in periods])
        return
    table = Table(header_style="bold")
    for title in ("specification", "revision", "valid", "limits", "products"):
        table.add_column(title, overflow="fold")
    for each in periods:
        found = each.specification
        table.add_row(found.name, found.revision, each.told, str(len(found.limits)), ", ".join(found.products))
    results().print(table if periods else "no specification; `gyrofleet limits add FILE` adds one")


@limits.command("show")
@click.argument("name", metavar="NAME[-REVISION]")
@store_option
@click.option("--toml", "as_toml", is_flag=True, help="Print the file as it was added.")
@click.option("--lang", "language", type=click.Choice(["en", "zh"]), default="en", show_default=True)
@reporting
def show(name: str, folder: Path, language: str, *, as_toml: bool, as_json: bool) -> None:
    """Show the limits of a specification."""
    from analytics.metrics_table import name_of
    from analytics.specification_store import specification_named
    from storage.store import Store

    period, content = specification_named(Store.open(folder), name)
    found = period.specification
    if as_toml:
        click.echo(content.decode(), nl=False)
        return
    if as_json:
        print_json({**_told(period), "limits": [_told_limit(each) for each in found.limits]})
        return
    table = Table(title=f"{found.label}, {period.told}", title_justify="left", header_style="bold")
    titles = ("特性", "限定", "产品", "下限", "上限", "单位")
    for title in (
        titles if language == "zh" else ("characteristic", "of", "product", "lower", "upper", "unit of measure")
    ):
        table.add_column(title, overflow="fold")
    for each in found.limits:
        of = each.subject.removeprefix(each.metric).strip(" ()")
        numbers = ("" if number is None else f"{number:g}" for number in (each.lower, each.upper))
        table.add_row(name_of(each.metric, language), of, each.product or "", *numbers, each.unit_of_measure)
    results().print(table)


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _told(period: "Period") -> dict[str, object]:
    from analytics.specification_dates import told_moment
    from analytics.specification_store import EVER, NEVER

    found = period.specification
    return {
        "specification": found.name,
        "revision": found.revision,
        "valid_from": told_moment(None if period.from_ns == EVER else period.from_ns),
        "valid_until": told_moment(None if period.until_ns == NEVER else period.until_ns),
        "products": list(found.products),
        "limit_count": len(found.limits),
    }


def _told_limit(limit: "SpecificationLimit") -> dict[str, object]:
    return {name: getattr(limit, name) for name in limit.__struct_fields__}
