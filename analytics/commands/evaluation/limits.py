"""The command `gyrofleet limits`: the product specifications by which a store judges its units."""

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from analytics.commands.records.proposal import print_proposed
from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import counted, notes, print_json, reporting, results, store_option
from stream.terminal.hints import completed
from stream.terminal.result_table import ResultTable
from stream.terminal.security_options import secured

if TYPE_CHECKING:
    from storage.specifications.chain import Chain
    from storage.specifications.validity import Period
    from storage.store import Store
    from stream.events import SpecificationEntered


_NONE = "no specification; `gyrofleet limits add FILE` adds one"
by_option = click.option(
    "--by", help="Who does it; by default the user of the system, with --security whom the certificate names."
)
_rejudge = click.option(
    "--rejudge", "rejudges", is_flag=True, help="Judge what was recorded before again, by what holds from now on."
)


@click.group("limits", cls=CommandGroup)
def limits() -> None:
    """Product specifications: limits of metrics, by revision, and since when they hold.

    They stand in the store's log, with who entered them, when and why; a revision is never changed. A run is judged by
    the revision that was valid when it began, as it was known when the run was recorded: what is entered later,
    valid from whenever, changes no verdict given before, unless --rejudge says so.

    \b
    revision = "B"
    valid_from = 2026-01-01              # in UTC; valid_until is optional
    [product."FOG-70"]                   # numbers of the product that metrics use
    max_rate_deg_per_s = 300.0
    [[limit]]
    metric = "bias_stability_averaged"
    parameters = { average_s = 100 }     # omitted parameters match all values
    product = "FOG-70"                   # every product if left out
    upper = 0.05                         # and, or lower
    unit_of_measure = "deg/h"

    Limits on bias_stability_averaged, allan_deviation and angle_random_walk are also judged while a run goes on.
    """  # noqa: D301  click's mark for lines that are not to be joined


@limits.command("add")
@click.argument("file", type=click.Path(path_type=Path))
@store_option
@click.option("--reason", default="", help="Why, in free words.")
@by_option
@_rejudge
@reporting
@secured(Role.APPROVER, Role.RECORDER)
def add(file: Path, folder: Path, reason: str, by: str | None, *, rejudges: bool, as_json: bool) -> None:
    """Check a specification and enter it into the log as NAME-REVISION; a copy to read is in the folder products."""
    _enter(file, folder, reason, by, is_revision=False, rejudges=rejudges, as_json=as_json)


@limits.command("revise")
@click.argument("file", type=click.Path(path_type=Path))
@store_option
@click.option("--reason", required=True, help="Why, in free words; it stands in the log.")
@by_option
@_rejudge
@reporting
@secured(Role.APPROVER, Role.RECORDER)
def revise(file: Path, folder: Path, reason: str, by: str | None, *, rejudges: bool, as_json: bool) -> None:
    """Enter another revision of a specification that is there; it holds from its valid_from on."""
    _enter(file, folder, reason, by, is_revision=True, rejudges=rejudges, as_json=as_json)


@limits.command("withdraw")
@click.argument("label", metavar="NAME-REVISION")
@store_option
@click.option("--reason", required=True, help="Why, in free words; it stands in the log.")
@by_option
@_rejudge
@reporting
@secured(Role.APPROVER, Role.RECORDER)
def withdraw(label: str, folder: Path, reason: str, by: str | None, *, rejudges: bool, as_json: bool) -> None:
    """Take a revision out of force; the one before it holds again. Verdicts given by it stay."""
    from analytics.specifications.entering import withdraw_specification
    from storage.store import Store
    from stream.events import ActProposed

    document = withdraw_specification(Store.open(folder), label, by=acting(by), reason=reason, rejudges=rejudges)
    if as_json:
        print_json(document)
        return
    if isinstance(document, ActProposed):
        print_proposed(document)
        return
    results().print(f"{label}: withdrawn by {document.by}: {reason}")
    _print_rejudged(rejudges=rejudges)


@limits.command("settle")
@store_option
@click.option("--reason", required=True, help="Why, in free words; it stands in the log.")
@by_option
@reporting
@secured(Role.APPROVER, Role.RECORDER)
def settle(folder: Path, reason: str, by: str | None, *, as_json: bool) -> None:
    """Accept that specification documents are lost (`gyrofleet verify`): units are judged by those that are there."""
    from analytics.specifications.entering import settle_chain
    from storage.store import Store

    breaks, proposal = settle_chain(Store.open(folder), by=acting(by), reason=reason)
    if as_json:
        print_json({"settled": breaks} if proposal is None else {"breaks": breaks, "proposal": proposal.uid})
        return
    if proposal is not None:
        print_proposed(proposal)
        return
    for each in breaks:
        results().print(f"settled: {each}")


@limits.command("history")
@store_option
@reporting
def history(folder: Path, *, as_json: bool) -> None:
    """Who added, revised or withdrew which specification, when and why."""
    from storage.specifications.chain import read_chain
    from storage.specifications.validity import format_moment
    from storage.store import Store

    links = read_chain(Store.open(folder)).links
    if as_json:
        print_json([{"sha256": link.hash, "document": link.document} for link in links])
        return
    table = ResultTable("entered", "action", "specification", "by", "reason", "earlier runs")
    for link in links:
        each = link.document
        what, when = link.label if each.name else "", format_moment(each.t_ns) or ""
        rejudged = "judged again" if each.rejudges else "keep their verdicts"
        table.add_row(when, each.action.value, what, _people(each), each.reason, rejudged)
    results().print(table if links else completed(_NONE))


@limits.command("list")
@store_option
@reporting
def list_all(folder: Path, *, as_json: bool) -> None:
    """List the specifications of a store."""
    from storage.specifications.chain import read_chain
    from storage.specifications.validity import in_force, ordered_periods, withdrawn_labels
    from storage.store import Store

    store = Store.open(folder)
    chain = read_chain(store)
    entered = {link.label: link.document for link in chain.links}
    periods = ordered_periods(in_force(chain.links))
    if as_json:
        print_json([_period_document(each) | _entry(entered[each.specification.label]) for each in periods])
    else:
        table = ResultTable("specification", "revision", "valid", "limits", "products", "entered", "by")
        for each in periods:
            found = each.specification
            document = entered[found.label]
            words = (found.name, found.revision, each.text, str(len(found.limits)), ", ".join(found.products))
            table.add_row(*words, _entry(document)["entered"], _people(document))
        withdrawn = ", ".join(withdrawn_labels(chain.links))
        results().print(table if periods else "no specification is in force" if withdrawn else completed(_NONE))
        if withdrawn:
            results().print(f"withdrawn: {withdrawn} (`gyrofleet limits history` says why)")
    warn_of_copies(store, chain)


@limits.command("show")
@click.argument("name", metavar="NAME[-REVISION]")
@store_option
@click.option("--toml", "as_toml", is_flag=True, help="Print the file as it was added.")
@click.option("--lang", "language", type=click.Choice(["en", "zh"]), default="en", show_default=True)
@reporting
def show(name: str, folder: Path, language: str, *, as_toml: bool, as_json: bool) -> None:
    """Show the limits of a specification."""
    from analytics.evaluation.table import name_of
    from analytics.metric_registry.magnitudes import as_judged
    from storage.specifications.chain import read_chain
    from storage.specifications.validity import specification_named, withdrawn_labels
    from storage.store import Store

    links = read_chain(Store.open(folder)).links
    period, content = specification_named(links, name)
    found = period.specification
    judged = [as_judged(each) for each in found.limits]
    if as_toml:
        click.echo(content, nl=False)
        return
    if as_json:
        print_json({**_period_document(period), "limits": [msgspec.structs.asdict(each) for each in judged]})
        return
    titles = ("characteristic", "of", "product", "lower", "upper", "unit of measure")
    if language == "zh":
        titles = ("特性", "限定", "产品", "下限", "上限", "单位")
    state = (", withdrawn" if language == "en" else "，已撤销") if found.label in withdrawn_labels(links) else ""
    table = ResultTable(*titles, title=f"{found.label}, {period.text}{state}")
    for each in judged:
        of = each.subject.removeprefix(each.metric).strip(" ()")
        numbers = ("" if number is None else f"{number:g}" for number in (each.lower, each.upper))
        table.add_row(name_of(each.metric, language), of, each.product or "", *numbers, each.unit_of_measure)
    results().print(table)


def warn_of_copies(store: "Store", chain: "Chain | None" = None) -> None:
    """Say which files in the store's folder of specifications count for nothing, and where the chain is broken."""
    from storage.specifications.chain import read_chain
    from storage.specifications.copies import chain_findings, copy_findings

    chain = read_chain(store) if chain is None else chain
    for each in [*chain_findings(store, chain), *copy_findings(store, chain)]:
        notes().print(f"warning: {each.where}: {each.what}; {each.remedy}", soft_wrap=True)


def _enter(
    file: Path, folder: Path, reason: str, by: str | None, *, is_revision: bool, rejudges: bool, as_json: bool
) -> None:
    from analytics.evaluation.kept_metrics import kept_metrics
    from analytics.metric_registry.registry import metrics
    from analytics.specifications.checking import checked_specification
    from analytics.specifications.doubts import doubts_of
    from analytics.specifications.entering import add_specification
    from analytics.specifications.far_limits import far_limits
    from storage.specifications.specification import read_specification
    from storage.specifications.validity import stored_specifications
    from storage.sql.catalog import Catalog
    from storage.store import Store
    from stream.quantities import is_noise_density, result_factor

    checked_specification(read_specification(file), str(file))  # before a store is made for it
    store = Store.create(folder)
    found, is_new, proposal = add_specification(
        store, file, by=acting(by), reason=reason, is_revision=is_revision, rejudges=rejudges
    )
    doubts = doubts_of(store, found)
    with Catalog(store) as catalog:
        kept, _ = kept_metrics(catalog.kept)
        doubts += [] if kept is None else far_limits(catalog, kept, found.limits)
    for each in doubts:
        notes().print(each, soft_wrap=True)
    if as_json:
        answer = {"specification": found.name, "revision": found.revision, "limits": len(found.limits)}
        answer |= {"new": is_new, "doubts": doubts}
        print_json(answer if proposal is None else answer | {"proposal": proposal.uid})
        return
    if proposal is not None:
        print_proposed(proposal)
        return
    what = f"{counted(len(found.limits), 'limit')}, {counted(len(found.products), 'product')}"
    results().print(f"{found.label}: {what} {'kept' if is_new else 'are there already'}")
    for limit in found.limits:
        if is_noise_density(limit.unit_of_measure) and limit.upper is not None:
            unit = metrics()[limit.metric].header.unit
            notes().print(
                f"{limit.subject}: {limit.upper:g} {limit.unit_of_measure}, is "
                f"{limit.upper * result_factor(limit.unit_of_measure, unit):.4g} {unit}",
                soft_wrap=True,
            )
    if rejudges or (is_new and len(stored_specifications(store)) > 1):
        _print_rejudged(rejudges=rejudges)


def _print_rejudged(*, rejudges: bool) -> None:
    after = "is judged again." if rejudges else "keeps its verdicts; with --rejudge it would be judged again."
    notes().print(f"What was recorded before {after}", soft_wrap=True)


def _people(document: "SpecificationEntered") -> str:
    """Who entered it; where two persons did, who proposed and who approved it."""
    if not document.proposal:
        return document.by
    return f"proposed by {document.proposed_by}, approved by {document.by}"


def _entry(document: "SpecificationEntered") -> dict[str, str]:
    from storage.specifications.validity import format_moment

    return {"entered": format_moment(document.t_ns) or "", "by": document.by, "reason": document.reason}


def _period_document(period: "Period") -> dict[str, object]:
    from storage.specifications.validity import EVER, NEVER, format_moment

    found = period.specification
    return {
        "specification": found.name, "revision": found.revision,
        "valid_from": format_moment(None if period.from_ns == EVER else period.from_ns),
        "valid_until": format_moment(None if period.until_ns == NEVER else period.until_ns),
        "products": list(found.products), "limit_count": len(found.limits),
    }  # fmt: skip
