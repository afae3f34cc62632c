"""The two-person rule: which acts of a store need it, what is proposed, and whether an act may be recorded."""

from collections.abc import Iterable
from typing import NamedTuple

import msgspec

from storage.log.store_documents import is_sealed
from storage.log.tail import documents_beyond
from storage.recording.acts.signed_rules import read_signed_rules
from storage.store import Store, writer_security
from stream.decoding import decode_json
from stream.errors import BusError
from stream.events import (
    ActProposed,
    AnyDocument,
    ApprovedAct,
    CertificateIssued,
    ModelActivated,
    ProposalRejected,
    SpecificationEntered,
)
from stream.security.access import AccessList
from stream.security.actor import Actor
from stream.security.credentials import load_credentials, process_security
from stream.security.site_rules import RULES_FILE, Subject, read_site_rules

SUBJECT_OF: dict[type[ApprovedAct], Subject] = {
    ModelActivated: Subject.MODELS,
    SpecificationEntered: Subject.SPECIFICATIONS,
    CertificateIssued: Subject.CERTIFICATES,
}
_KINDS = ("ActProposed", "ProposalRejected", *(each.__name__ for each in SUBJECT_OF))
_SQL = "select document from internal.lake_documents where list_contains($kinds, kind)"
_OFF = "off"
# what differs between the document that was proposed and the one that carries it out
_OF_APPROVAL = ("t_ns", "uid", "by", "identity", "proposal", "proposed_by", "previous", "store", "seal")


class Proposal(NamedTuple):
    """A proposal, and the document that ended it; None while it is open."""

    document: ActProposed
    ended_by: ApprovedAct | ProposalRejected | None = None

    @property
    def state(self) -> str:
        """``open``, ``approved`` or ``rejected``."""
        if self.ended_by is None:
            return "open"
        return "rejected" if isinstance(self.ended_by, ProposalRejected) else "approved"

    @property
    def by(self) -> Actor:
        """Who proposed it."""
        return Actor(self.document.by, self.document.identity)

    @property
    def act(self) -> AnyDocument:
        """The document that is proposed."""
        found: AnyDocument = decode_json(self.document.content, AnyDocument)
        return found


def needs_two(store: Store, access: AccessList | None = None) -> frozenset[Subject]:
    """What two persons are needed for, by the site's signed rules or by ``site.toml`` in the store's folder.

    The signed rules are those in `access`, else in the access list of this process, else of the store's recorder, and
    those that a recorder has left in the store. BadInput if a file is wrong.
    """
    asked = set(read_site_rules(store.folder / RULES_FILE).two_persons)
    asked |= set(read_signed_rules(store.folder).two_persons)
    if access is None:
        access = _access_of(store)
    return frozenset(asked | set(access.rules.two_persons if access is not None else ()))


def _access_of(store: Store) -> AccessList | None:
    credentials = process_security().credentials
    if credentials is not None:
        return credentials.access
    recorder = writer_security(store.folder)
    try:
        return None if recorder is None else load_credentials(recorder).access
    except BusError:
        return None  # then its recorder cannot be reached either


def read_proposals(store: Store) -> dict[str, Proposal]:
    """All proposals of a store by uid, in the order of their times; those without its seal do not count."""
    return proposals_among(store, read_documents(store))


def read_documents(store: Store) -> list[AnyDocument]:
    """Proposals, acts and rejections in the log of a store, those not yet in the lake included."""
    from storage.sql.catalog import Catalog

    found: dict[str, AnyDocument] = {}
    with Catalog(store) as catalog:
        for (text,) in catalog.rows(_SQL, {"kinds": list(_KINDS)}):
            document: AnyDocument = decode_json(text, AnyDocument)
            found[document.uid] = document
        in_lake = {segment for part in catalog.parts for segment in part.segments}
    for document, _ in documents_beyond(store, in_lake):
        if type(document).__name__ in _KINDS:
            found.setdefault(document.uid, document)
    return sorted(found.values(), key=lambda each: each.t_ns)


def proposals_among(store: Store, documents: Iterable[AnyDocument]) -> dict[str, Proposal]:
    """The proposals among documents, in their order, each with what ended it first."""
    found: dict[str, Proposal] = {}
    for each in documents:
        if isinstance(each, ActProposed):
            if is_sealed(store, each):
                found[each.uid] = Proposal(each)
        elif isinstance(each, ApprovedAct) or (isinstance(each, ProposalRejected) and is_sealed(store, each)):
            known = found.get(each.proposal)
            if known is not None and known.ended_by is None:
                found[each.proposal] = known._replace(ended_by=each)
    return found


def reason_against(store: Store, access: AccessList | None, document: AnyDocument) -> str | None:
    """Why an act may not be recorded: the site needs two persons for it; None if it may."""
    if not isinstance(document, ApprovedAct):
        return None
    subject = SUBJECT_OF[type(document)]
    if subject not in needs_two(store, access):
        return None
    if isinstance(document, ModelActivated) and document.stage == _OFF:
        return None  # one person is enough to take a model out of use
    documents = [each for each in read_documents(store) if each.uid != document.uid]  # it may be sent again
    if isinstance(document, ModelActivated) and not document.proposal and _returns(document, documents):
        return None
    needed = f"the site needs two persons for {subject}"
    if not document.proposal:
        return f"{needed}, and it names no proposal"
    proposal = proposals_among(store, documents).get(document.proposal)
    if proposal is None:
        return f"{needed}, and the log has no proposal {document.proposal[:80]}"
    if proposal.state != "open":
        return f"{needed}, and the proposal {document.proposal} is {proposal.state} already"
    if (reason := reason_against_approver(proposal, Actor(document.by, document.identity))) is not None:
        return f"{needed}, and {reason}"
    if document.proposed_by != proposal.document.identity or changed_since(proposal, document):
        return f"{needed}, and it is not what was proposed"
    if isinstance(document, ModelActivated) and not is_sealed(store, document):
        return f"{needed}, and it lacks the seal of the store"
    return None


def reason_against_approver(proposal: Proposal, by: Actor) -> str | None:
    """Why somebody may not approve a proposal: nobody by proof, or who proposed it; None if they may."""
    if not by.is_authenticated or not by.identity:
        return f"{by.name or 'who approves'} is not authenticated"
    if by.is_same_person(proposal.document.identity):
        return f"{by.identity} has proposed it: another person has to approve"
    return None


def changed_since(proposal: Proposal, document: AnyDocument) -> str | None:
    """Why a document is not what was proposed; None if it is."""
    given, proposed = _essence(document), _essence(proposal.act)
    different = sorted(name for name in given.keys() | proposed.keys() if given.get(name) != proposed.get(name))
    return f"{', '.join(different)} would differ from what was proposed: propose it again" if different else None


def _essence(document: AnyDocument) -> dict[str, object]:
    return {name: each for name, each in msgspec.structs.asdict(document).items() if name not in _OF_APPROVAL}


def _returns(document: ModelActivated, documents: Iterable[AnyDocument]) -> bool:
    """Whether a roll back puts back a version that was live: the document before takes another one out of use."""
    of_signal = [
        each for each in documents
        if isinstance(each, ModelActivated) and (each.unit, each.signal) == (document.unit, document.signal)
    ]  # fmt: skip
    was_live = any((each.model, each.stage) == (document.model, document.stage) for each in of_signal)
    return document.stage == "live" and was_live and of_signal[-1].stage == _OFF
