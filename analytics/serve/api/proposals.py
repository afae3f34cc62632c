"""What waits for a second person: proposals of models, specifications and certificates."""

from typing import Annotated, Any, Literal

import msgspec

from analytics.serve.api.operation import Call, Nothing, get, post
from analytics.serve.api.rows import iso
from analytics.serve.doors.roles import Role
from analytics.serve.problems import Forbidden
from stream.decoding import decode_json


class ProposalsAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which proposals: those that wait, or all."""

    which: Literal["open", "all"] = "open"


class ProposalRow(msgspec.Struct, frozen=True, kw_only=True):
    """A proposal; `title` says what it does, `title_zh` in Chinese.

    `may_approve` is whether who asks may approve it, `ended_by` who approved or rejected it.
    """

    id: str
    subject: str
    title: str
    title_zh: str
    unit: str | None
    by: str
    identity: str
    reason: str
    proposed_ns: int
    proposed: str | None
    state: str
    may_approve: bool
    why_not: str
    ended_by: str
    ended_reason: str
    document: dict[str, Any]


class Proposals(msgspec.Struct, frozen=True, kw_only=True):
    """Proposals, the newest first, and what the site needs two persons for."""

    proposals: list[ProposalRow]
    two_persons: list[str]


class RejectionAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Why it is rejected."""

    reason: Annotated[str, msgspec.Meta(min_length=3, max_length=1000)]


class Decided(msgspec.Struct, frozen=True, kw_only=True):
    """The document that carries the proposal out, or rejects it, as it stands in the log."""

    document: dict[str, Any]


@get("/api/proposals", table="proposals", is_kept=False)
def list_proposals(call: Call, asked: ProposalsAsked) -> Proposals:
    """Acts that wait for another person; or all that were proposed."""
    from storage.recording.acts.act_titles import act_title
    from storage.recording.acts.two_persons import needs_two, read_proposals, reason_against_approver

    rows = []
    for each in reversed(read_proposals(call.store).values()):
        if asked.which == "open" and each.state != "open":
            continue
        document, ended = each.document, each.ended_by
        why_not = reason_against_approver(each, call.person.actor) or ""
        if call.person.role < Role.APPROVER:
            why_not = f"{call.person.role.word} may not approve"
        if call.person.is_program:
            why_not = _no_person(call)
        row = ProposalRow(
            id=document.uid, subject=document.subject, title=document.title,
            title_zh=act_title(each.act).zh, unit=document.unit, by=document.by, identity=document.identity,
            reason=document.reason, proposed_ns=document.t_ns, proposed=iso(document.t_ns),
            state=each.state, may_approve=each.state == "open" and not why_not, why_not=why_not,
            ended_by="" if ended is None else ended.identity, ended_reason=getattr(ended, "reason", ""),
            document=decode_json(document.content),
        )  # fmt: skip
        rows.append(row)
    return Proposals(proposals=rows, two_persons=sorted(needs_two(call.store)))


@post("/api/proposals/{proposal}/approve", role=Role.APPROVER)
def approve_proposal(call: Call, asked: Nothing) -> Decided:
    """Approve what somebody else has proposed; it is then carried out. 403 for a program: a person has to approve."""
    from analytics.approval import approve

    del asked
    if call.person.is_program:
        raise Forbidden(_no_person(call))
    return Decided(document=msgspec.to_builtins(approve(call.store, call.path["proposal"], call.person.actor)))


@post("/api/proposals/{proposal}/reject", role=Role.ENGINEER)
def reject_proposal(call: Call, asked: RejectionAsked) -> Decided:
    """Reject a proposal, which needs an approver who is no program, or withdraw one's own."""
    from storage.recording.acts.proposing import open_proposal, reject

    uid, actor = call.path["proposal"], call.person.actor
    is_own = actor.is_authenticated and actor.identity == open_proposal(call.store, uid).document.identity
    if not is_own and call.person.role < Role.APPROVER:
        raise Forbidden(f"{call.person.name} may withdraw own proposals only: rejecting another's needs an approver")
    if not is_own and call.person.is_program:
        raise Forbidden(_no_person(call))
    return Decided(document=msgspec.to_builtins(reject(call.store, uid, by=actor, reason=asked.reason)))


def _no_person(call: Call) -> str:
    return f"{call.person.name} is a program: a person has to decide, who signs in with a password or a certificate"
