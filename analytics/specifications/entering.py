"""Entering specifications into the log of a store: revisions are checked, added, revised, withdrawn, never changed."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from analytics.metric_registry.registry import alike
from analytics.specifications.checking import checked_specification
from storage.recording.acts.proposing import carried_out, has_to_be_proposed, propose
from storage.recording.acts.two_persons import Proposal, changed_since
from storage.specifications import specification
from storage.specifications.chain import Chain, append_document, read_chain
from storage.specifications.copies import FOLDER, write_copy
from storage.specifications.specification import Specification
from storage.specifications.validity import in_force, periods_of
from storage.store import Store, only_one
from stream.errors import BadInput, NotFound
from stream.events import ActProposed, SpecificationAction, SpecificationEntered
from stream.security.actor import Actor

_NOBODY = Actor("")


class _Signed(NamedTuple):
    """Who enters it and why, and the proposal that they approve."""

    by: Actor
    reason: str
    approved: Proposal | None = None


class Entered(NamedTuple):
    """A specification, whether it is new, and the proposal where another person has to approve it."""

    specification: Specification
    is_new: bool
    proposal: ActProposed | None = None


def add_specification(
    store: Store, path: Path, *, by: Actor = _NOBODY, reason: str = "", is_revision: bool = False,
    rejudges: bool = False,
) -> Entered:  # fmt: skip
    """Enter a specification file into a store's log, or propose it.

    `is_revision`: whether its name has to be in the store already. `rejudges`: whether earlier runs are judged again by
    what holds from now on. The same content again is not new, and is entered again only with `rejudges`. Raises
    BadInput if it is not right, contradicts another one, or has the revision of one with other content; StoreError if
    the store cannot be written.
    """
    content = specification.read_specification(path)
    return _add(store, content, str(path), _Signed(by, reason), is_revision=is_revision, rejudges=rejudges)


def _add(store: Store, content: bytes, source: str, signed: _Signed, *, is_revision: bool, rejudges: bool) -> Entered:
    found = checked_specification(content, source)
    with only_one(store.folder / FOLDER / ".lock", "gyrofleet limits"):
        chain = _whole_chain(store)
        held = in_force(chain.links)
        names = {each.name for each in held}
        if is_revision and found.name not in names:
            raise BadInput(
                f"specification {source}: there is no {found.name!r} to revise; "
                f"{alike(found.name, names, 'there are')}; `gyrofleet limits add` enters a new one"
            )
        is_new = _is_new(chain, held, found, content, source)
        if not is_new and not rejudges:
            return Entered(found, is_new=False)
        periods_of([*(each for each in held if each.label != found.label), found])
        action = SpecificationAction.REVISED if found.name in names else SpecificationAction.ADDED
        entered = _enter(store, chain, action, signed, found, content=content.decode(), rejudges=rejudges)
        if isinstance(entered, ActProposed):
            return Entered(found, is_new, entered)
        write_copy(store, entered)
    return Entered(found, is_new)


def withdraw_specification(
    store: Store, label: str, *, by: Actor, reason: str, rejudges: bool = False
) -> SpecificationEntered | ActProposed:
    """Take a revision out of force, or propose it: runs recorded from then on are not judged by it.

    Raises NotFound if no revision in force has that label; BadInput if those that hold again without it contradict each
    other; StoreError if the store cannot be written.
    """
    return _withdraw(store, label, _Signed(by, reason), rejudges=rejudges)


def _withdraw(store: Store, label: str, signed: _Signed, *, rejudges: bool) -> SpecificationEntered | ActProposed:
    with only_one(store.folder / FOLDER / ".lock", "gyrofleet limits"):
        chain = _whole_chain(store)
        held = {each.label: each for each in in_force(chain.links)}
        if label not in held:
            raise NotFound(f"no revision {label!r} is in force; {alike(label, held, 'there are')}")
        try:
            periods_of([each for name, each in held.items() if name != label])
        except BadInput as error:
            why = f"since without it {error}; withdraw one of these first"
            raise BadInput(f"{label} cannot be withdrawn, {why}") from error
        return _enter(store, chain, SpecificationAction.WITHDRAWN, signed, held[label], rejudges=rejudges)


def settle_chain(store: Store, *, by: Actor, reason: str) -> tuple[list[str], ActProposed | None]:
    """Accept that the chain of documents is broken, or propose to; returns a sentence for each break, and the proposal.

    Raises BadInput if it is whole; StoreError if the store cannot be written.
    """
    breaks, entered = _settle(store, _Signed(by, reason))
    return breaks, entered if isinstance(entered, ActProposed) else None


def _settle(store: Store, signed: _Signed) -> tuple[list[str], SpecificationEntered | ActProposed]:
    with only_one(store.folder / FOLDER / ".lock", "gyrofleet limits"):
        chain = read_chain(store)
        if not chain.breaks:
            raise BadInput("the chain of specification documents is whole: there is nothing to settle")
        settles = tuple(each.at for each in chain.breaks)
        entered = _enter(store, chain, SpecificationAction.SETTLED, signed, settles=settles)
    return [each.what for each in chain.breaks], entered


def carry_out(store: Store, proposal: Proposal, by: Actor) -> SpecificationEntered:
    """Enter what was proposed, as another person who approves it; BadInput if it cannot be entered any more."""
    act = proposal.act
    assert isinstance(act, SpecificationEntered)
    signed = _Signed(by, act.reason, proposal)
    label = f"{act.name}-{act.revision}"
    match act.action:
        case SpecificationAction.WITHDRAWN:
            _withdraw(store, label, signed, rejudges=act.rejudges)
        case SpecificationAction.SETTLED:
            _settle(store, signed)
        case _:
            is_revision = act.action is SpecificationAction.REVISED
            # the name is that of the file that was proposed, where the content has none
            _add(store, act.content.encode(), f"{label}.toml", signed, is_revision=is_revision, rejudges=act.rejudges)
    return next(
        link.document for link in reversed(read_chain(store).links) if link.document.proposal == proposal.document.uid
    )


def _enter(
    store: Store, chain: Chain, action: SpecificationAction, signed: _Signed, of: Specification | None = None,
    **words: Any,
) -> SpecificationEntered | ActProposed:  # fmt: skip
    """Append a document to the chain, or propose it."""
    by, approved = signed.by, signed.approved
    document = SpecificationEntered(
        run="", t_ns=max([time.time_ns(), *(link.document.t_ns + 1 for link in chain.links[-1:])]), action=action,
        name="" if of is None else of.name, revision="" if of is None else of.revision, previous=chain.head,
        by=by.name, identity=by.identity, reason=signed.reason, **words,
    )  # fmt: skip
    if approved is not None:
        document = carried_out(approved, document, by, not_before_ns=document.t_ns)
        if reason := changed_since(approved, document):
            raise BadInput(f"{approved.document.title}: {reason}")
    elif has_to_be_proposed(store, SpecificationEntered):
        return propose(store, document, by=by, reason=signed.reason)
    append_document(store, document)
    return document


def _is_new(chain: Chain, held: Sequence[Specification], found: Specification, content: bytes, source: str) -> bool:
    """Whether a revision is not in force; one that was entered with other content is refused."""
    known = {link.label: link.document.content.encode() for link in chain.links if link.document.content}
    if known.get(found.label, content) != content:
        raise BadInput(
            f"specification {source}: revision {found.revision} of {found.name} is in the store with other content "
            "(`gyrofleet limits show --toml`); what was judged by it must stay traceable: give the new content another "
            "revision"
        )
    return found.label not in {each.label for each in held}


def _whole_chain(store: Store) -> Chain:
    """The chain of documents, which must not be broken where it is continued."""
    chain = read_chain(store)
    if chain.breaks:
        raise BadInput(
            f"the chain of specification documents in {store.log} is broken: {chain.breaks[0].what}; `gyrofleet "
            "verify` has the details: restore the log from a copy, or accept it by `gyrofleet limits settle`"
        )
    return chain
