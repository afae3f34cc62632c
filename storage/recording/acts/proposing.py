"""Proposing an act that two persons are needed for, rejecting a proposal, and carrying one out."""

import time
from typing import TypeVar
from uuid import uuid4

import msgspec

from storage.log.store_documents import sealed
from storage.recording.acts.act_titles import act_title
from storage.recording.acts.two_persons import SUBJECT_OF, Proposal, needs_two, read_proposals, reason_against_approver
from storage.recording.client import record_documents
from storage.store import Store
from stream.errors import BadInput, NotFound
from stream.events import ActProposed, ApprovedAct, ProposalRejected
from stream.identity import Place
from stream.security.actor import Actor

_PLACE = Place("store", "proposals")
_ROLE = "gyrofleet proposal"
CarriedOut = TypeVar("CarriedOut", bound=ApprovedAct)


def has_to_be_proposed(store: Store, kind: type[ApprovedAct]) -> bool:
    """Whether an act of that kind needs two persons in a store."""
    return SUBJECT_OF[kind] in needs_two(store)


def check_may_propose(store: Store, kind: type[ApprovedAct], by: Actor) -> None:
    """Raise BadInput if an act needs two persons, and who does it has not proved who they are."""
    if has_to_be_proposed(store, kind) and not by.is_authenticated:
        raise BadInput(
            f"two persons are needed for {SUBJECT_OF[kind]} here, and {by.name or 'you'} has not proved who it is: "
            "give --security FOLDER of a certificate, or sign in at the pages"
        )


def propose(
    store: Store, act: ApprovedAct, *, by: Actor, reason: str = "", unit: str | None = None, uid: str = ""
) -> ActProposed:
    """Write a proposal into the log; BadInput if nobody has proved who they are, or the same is proposed already."""
    subject = SUBJECT_OF[type(act)]
    check_may_propose(store, type(act), by)
    title = act_title(act).en
    for each in read_proposals(store).values():
        if each.state == "open" and each.document.title == title:
            raise BadInput(f"{title}: it is proposed already, by {each.document.by}; it waits for another person")
    document = sealed(store, ActProposed(
        run="", t_ns=time.time_ns(), uid=uid or uuid4().hex, subject=subject.value, title=title,
        content=msgspec.json.encode(act).decode(), by=by.name, identity=by.identity, reason=reason, unit=unit,
    ))  # fmt: skip
    record_documents(store, [document], role=_ROLE, place=_PLACE, builds_lake=True)
    return document


def open_proposal(store: Store, uid: str) -> Proposal:
    """The open proposal with that uid, or a beginning of it that only one has."""
    found = [each for each in read_proposals(store).values() if uid and each.document.uid.startswith(uid)]
    if not found:
        raise NotFound(f"there is no proposal {uid!r} in {store.folder}; `gyrofleet proposal list` has those that wait")
    if len(found) > 1:
        raise NotFound(
            f"{len(found)} proposals begin with {uid!r}; give more of the id: `gyrofleet proposal list --all` has them"
        )
    (proposal,) = found
    if proposal.ended_by is not None:
        by = getattr(proposal.ended_by, "by", "")
        raise BadInput(f"{proposal.document.title}: it is {proposal.state} already, by {by}")
    return proposal


def check_approver(proposal: Proposal, by: Actor) -> None:
    """Raise BadInput if somebody may not approve a proposal."""
    if (reason := reason_against_approver(proposal, by)) is not None:
        raise BadInput(f"{proposal.document.title}: {reason}")


def carried_out(proposal: Proposal, act: CarriedOut, by: Actor, *, not_before_ns: int = 0) -> CarriedOut:
    """The document of an act as another person approves it."""
    return msgspec.structs.replace(
        act, t_ns=max(time.time_ns(), proposal.document.t_ns + 1, not_before_ns), uid=uuid4().hex, by=by.name,
        identity=by.identity, proposal=proposal.document.uid, proposed_by=proposal.document.identity,
    )  # fmt: skip


def reject(store: Store, uid: str, *, by: Actor, reason: str) -> ProposalRejected:
    """Reject an open proposal, or withdraw one's own."""
    proposal = open_proposal(store, uid)
    if not reason.strip():
        raise BadInput("the reason is empty; say why it is rejected")
    document = sealed(store, ProposalRejected(
        run="", t_ns=max(time.time_ns(), proposal.document.t_ns + 1), proposal=proposal.document.uid, by=by.name,
        identity=by.identity, reason=reason.strip(), unit=proposal.document.unit,
    ))  # fmt: skip
    record_documents(store, [document], role=_ROLE, place=_PLACE, builds_lake=True)
    return document
