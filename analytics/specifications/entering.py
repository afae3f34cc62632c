"""Entering specifications into the log of a store: revisions are checked, added, revised, withdrawn, never changed."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from analytics.metric_registry.registry import alike
from analytics.specifications.checks import checked_specification
from storage.specifications.chain import Chain, Link, append_document, read_chain
from storage.specifications.copies import FOLDER, write_copy
from storage.specifications.specification import Specification, read_specification
from storage.specifications.validity import in_force, periods_of
from storage.store import Store, only_one
from stream.errors import BadInput, NotFound
from stream.events import SpecificationAction, SpecificationEntered

_LOCK = ".lock"
_COMMAND = "gyrofleet limits"


def add_specification(
    store: Store, path: Path, *, by: str = "", reason: str = "", is_revision: bool = False, rejudges: bool = False
) -> tuple[Specification, bool]:
    """Enter a specification file into a store's log.

    Parameters
    ----------
    store: Which store.
    path: The file.
    by, reason: Who enters it, and why.
    is_revision: Whether its name has to be in the store already.
    rejudges: Whether earlier runs are judged again by what holds from now on.

    Returns
    -------
    tuple
        The specification, and whether it is new; the same content again is not, and is entered again only with
        `rejudges`.

    Raises
    ------
    BadInput: If it is not right, contradicts another one, or has the revision of one with other content.
    StoreError: If the store cannot be written.
    """
    content = read_specification(path)
    found = checked_specification(content, str(path))
    with only_one(store.folder / FOLDER / _LOCK, _COMMAND):
        chain = _whole_chain(store)
        held = in_force(chain.links)
        names = {each.name for each in held}
        if is_revision and found.name not in names:
            raise BadInput(
                f"specification {path}: there is no {found.name!r} to revise; {alike(found.name, names, 'there are')}; "
                "`gyrofleet limits add` enters a new one"
            )
        is_new = _is_new(chain.links, held, found, content, path)
        if not is_new and not rejudges:
            return found, False
        periods_of([*(each for each in held if each.label != found.label), found])
        action = SpecificationAction.REVISED if found.name in names else SpecificationAction.ADDED
        words = {"by": by, "reason": reason, "content": content.decode(), "rejudges": rejudges}
        write_copy(store, _append(store, chain, action, words, found))
    return found, is_new


def withdraw_specification(
    store: Store, label: str, *, by: str, reason: str, rejudges: bool = False
) -> SpecificationEntered:
    """Take a revision out of force: runs recorded from now on are not judged by it.

    Raises
    ------
    NotFound: If no revision in force has that label.
    BadInput: If those that hold again without it contradict each other.
    StoreError: If the store cannot be written.
    """
    with only_one(store.folder / FOLDER / _LOCK, _COMMAND):
        chain = _whole_chain(store)
        held = {each.label: each for each in in_force(chain.links)}
        if label not in held:
            raise NotFound(f"no revision {label!r} is in force; {alike(label, held, 'there are')}")
        try:
            periods_of([each for name, each in held.items() if name != label])
        except BadInput as error:
            raise BadInput(
                f"{label} cannot be withdrawn, since without it {error}; withdraw one of these first"
            ) from error
        words = {"by": by, "reason": reason, "rejudges": rejudges}
        return _append(store, chain, SpecificationAction.WITHDRAWN, words, held[label])


def settle_chain(store: Store, *, by: str, reason: str) -> list[str]:
    """Accept that the chain of documents is broken; returns a sentence for each break.

    Raises
    ------
    BadInput: If it is whole.
    StoreError: If the store cannot be written.
    """
    with only_one(store.folder / FOLDER / _LOCK, _COMMAND):
        chain = read_chain(store)
        if not chain.breaks:
            raise BadInput("the chain of specification documents is whole: there is nothing to settle")
        settles = tuple(each.at for each in chain.breaks)
        _append(store, chain, SpecificationAction.SETTLED, {"by": by, "reason": reason, "settles": settles})
    return [each.what for each in chain.breaks]


def _append(
    store: Store, chain: Chain, action: SpecificationAction, words: Mapping[str, Any], of: Specification | None = None
) -> SpecificationEntered:
    """Append a document to the chain."""
    document = SpecificationEntered(
        run="",
        t_ns=max([time.time_ns(), *(link.document.t_ns + 1 for link in chain.links[-1:])]),
        action=action,
        name="" if of is None else of.name,
        revision="" if of is None else of.revision,
        previous=chain.head,
        **words,
    )
    append_document(store, document)
    return document


def _is_new(
    links: Sequence[Link], held: Sequence[Specification], found: Specification, content: bytes, path: Path
) -> bool:
    """Whether a revision is not in force; one that was entered with other content is refused."""
    known = {link.label: link.document.content.encode() for link in links if link.document.content}
    if known.get(found.label, content) != content:
        raise BadInput(
            f"specification {path}: revision {found.revision} of {found.name} is in the store with other content "
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
