"""The command `gyrofleet proposal`: acts that another person has to approve."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable
from stream.terminal.security_options import secured

if TYPE_CHECKING:
    from storage.recording.acts.two_persons import Proposal
    from stream.events import ActProposed

_UID = click.argument("uid", metavar="ID")


@click.group("proposal", cls=CommandGroup)
def proposal() -> None:
    """Models, specifications and certificates that wait for a second person: list, approve, reject.

    The site asks for two persons in site.toml, by `two_persons`. Nothing that is proposed is active before another
    person approves it; both are in the log.
    """


@proposal.command("list")
@store_option
@click.option("--all", "is_all", is_flag=True, help="Approved and rejected ones as well.")
@reporting
def list_proposals(folder: Path, *, is_all: bool, as_json: bool) -> None:
    """List what waits for another person."""
    from storage.recording.acts.two_persons import read_proposals
    from storage.store import Store

    found = [each for each in read_proposals(Store.open(folder)).values() if is_all or each.state == "open"]
    if as_json:
        print_json([_row(each) for each in found])
        return
    if not found:
        results().print("nothing waits for another person")
        return
    table = ResultTable("id", "what", "by", "reason", "state")
    for each in found:
        document = each.document
        table.add_row(document.uid[:12], document.title, document.by, document.reason, each.state)
    results().print(table)


@proposal.command("approve")
@_UID
@store_option
@reporting
@secured(Role.APPROVER)
def approve(uid: str, folder: Path, *, as_json: bool) -> None:
    """Approve a proposal of somebody else, which is then carried out."""
    from analytics.approval import approve as carry_out
    from storage.store import Store

    document = carry_out(Store.open(folder), uid, acting(None))
    if as_json:
        print_json(document)
        return
    results().print(f"approved by {document.identity}; proposed by {document.proposed_by}")


@proposal.command("reject")
@_UID
@store_option
@click.option("--reason", required=True, help="Why, in free words; it stands in the log.")
@reporting
@secured(Role.APPROVER)
def reject(uid: str, folder: Path, reason: str, *, as_json: bool) -> None:
    """Reject a proposal, or withdraw your own."""
    from storage.recording.acts.proposing import reject as write_rejection
    from storage.store import Store

    document = write_rejection(Store.open(folder), uid, by=acting(None), reason=reason)
    if as_json:
        print_json(document)
        return
    results().print(f"rejected by {document.by}: {document.reason}")


def print_proposed(document: "ActProposed") -> None:
    """Report that an act waits for another person."""
    results().print(f"{document.title}: proposed by {document.by} as {document.uid[:12]}")
    notes().print(
        f"nothing is active before another person approves it: `gyrofleet proposal approve {document.uid[:12]} "
        "--security FOLDER` with that person's certificate, or the page Proposals",
        soft_wrap=True,
    )


def _row(proposal: "Proposal") -> dict[str, object]:
    document = proposal.document
    ended = proposal.ended_by
    return {
        "id": document.uid, "subject": document.subject, "title": document.title, "unit": document.unit,
        "by": document.by, "identity": document.identity, "reason": document.reason, "t_ns": document.t_ns,
        "state": proposal.state, "ended_by": None if ended is None else ended.identity,
        "ended_reason": getattr(ended, "reason", ""),
    }  # fmt: skip
