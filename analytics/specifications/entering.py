"""The specifications of a store: documents in its log, which are added, revised and withdrawn, never changed."""

import time
from collections.abc import Sequence
from pathlib import Path

from analytics.metric_registry.registry import alike
from analytics.specifications.periods import Period, in_force, ordered_periods, periods_of, specification_of
from analytics.specifications.specification import Specification, parse_specification
from storage.specifications.chain import Chain, Link, append_document, read_chain
from storage.specifications.copies import FOLDER, write_copy
from storage.store import Store, only_one
from stream.errors import BadInput, NotFound
from stream.events import SpecificationAction, SpecificationEntered

_LOCK = ".lock"
_COMMAND = "gyrofleet limits"


def add_specification(
    store: Store, path: Path, *, by: str = "", reason: str = "", is_revision: bool = False, rejudges: bool = False
) -> tuple[Specification, bool]:
    """Enter a specification into a store's log.

    Parameters
    ----------
    store: Which store.
    path: The file.
    by, reason: Who enters it, and why.
    is_revision: Whether its name has to be there already.
    rejudges: Whether what was recorded before is judged anew by what holds from now on.

    Returns
    -------
    tuple
        The specification, and whether it is new; the same content again is not, and is entered once more only if
        it judges anew.

    Raises
    ------
    BadInput: If it is not right, contradicts one that is there, or has the revision of one with other content.
    StoreError: If the store cannot be written.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(f"specification {path}: cannot be read ({error.strerror or error})") from error
    found = parse_specification(content, str(path))
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
        document = SpecificationEntered(
            run="",
            t_ns=_now_ns(chain),
            action=SpecificationAction.REVISED if found.name in names else SpecificationAction.ADDED,
            name=found.name,
            revision=found.revision,
            content=content.decode(),
            by=by,
            reason=reason,
            previous=chain.head,
            rejudges=rejudges,
        )
        append_document(store, document)
        write_copy(store, document)
    return found, is_new


def withdraw_specification(
    store: Store, label: str, *, by: str, reason: str, rejudges: bool = False
) -> SpecificationEntered:
    """Take a revision out of force: what is recorded from now on is not judged by it.

    Raises
    ------
    NotFound: If no revision in force is called that.
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
        document = SpecificationEntered(
            run="",
            t_ns=_now_ns(chain),
            action=SpecificationAction.WITHDRAWN,
            name=held[label].name,
            revision=held[label].revision,
            by=by,
            reason=reason,
            previous=chain.head,
            rejudges=rejudges,
        )
        append_document(store, document)
    return document


def settle_chain(store: Store, *, by: str, reason: str) -> list[str]:
    """Accept that the chain of documents is broken; what is wrong with it, a sentence for each break.

    Raises
    ------
    BadInput: If it is whole.
    StoreError: If the store cannot be written.
    """
    with only_one(store.folder / FOLDER / _LOCK, _COMMAND):
        chain = read_chain(store)
        if not chain.breaks:
            raise BadInput("the chain of specification documents is whole: there is nothing to settle")
        document = SpecificationEntered(
            run="",
            t_ns=_now_ns(chain),
            action=SpecificationAction.SETTLED,
            name="",
            revision="",
            by=by,
            reason=reason,
            previous=chain.head,
            settles=tuple(each.at for each in chain.breaks),
        )
        append_document(store, document)
    return [each.what for each in chain.breaks]


def stored_specifications(store: Store) -> list[Specification]:
    """Specifications that are in force, that is, added and not withdrawn.

    Raises
    ------
    StoreError: If the lake or the log is damaged.
    """
    return in_force(read_chain(store).links)


def specification_named(store: Store, label: str) -> tuple[Period, bytes]:
    """A specification of a store by ``NAME-REVISION``, withdrawn or not; by its name, the revision that begins last.

    Raises
    ------
    NotFound: If there is none.
    """
    links = read_chain(store).links
    every = {link.label: specification_of(link.document) for link in links if link.document.content}
    periods = ordered_periods(in_force(links))
    periods += [each for each in ordered_periods(every.values()) if each.specification.label == label]
    named = [each for each in periods if label in {each.specification.label, each.specification.name}]
    if not named:
        known = ", ".join(every) or "none; `gyrofleet limits add FILE` adds one"
        raise NotFound(f"there is no specification {label!r}; there are {known}")
    period = max(named, key=lambda each: (each.specification.label == label, each.from_ns))
    (content,) = {link.document.content for link in links if link.document.content and _is(link, period)}
    return period, content.encode()


def _is(link: Link, period: Period) -> bool:
    return link.label == period.specification.label


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


def _now_ns(chain: Chain) -> int:
    return max([time.time_ns(), *(link.document.t_ns + 1 for link in chain.links[-1:])])
