"""Entering specifications into the log of a store: revisions are checked, added, revised, withdrawn, never changed."""

import math
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from analytics.metric_registry.registry import alike, check_metrics, metrics
from storage.specifications import specification
from storage.specifications.chain import Chain, append_document, read_chain
from storage.specifications.copies import FOLDER, write_copy
from storage.specifications.specification import Specification, SpecificationLimit
from storage.specifications.validity import in_force, periods_of
from storage.store import Store, only_one
from stream.errors import BadInput, NotFound, UnknownUnit
from stream.events import SpecificationAction, SpecificationEntered
from stream.quantities import check_result_unit, result_factor
from stream.security.actor import Actor

_NOBODY = Actor("")


def add_specification(
    store: Store,
    path: Path,
    *,
    by: Actor = _NOBODY,
    reason: str = "",
    is_revision: bool = False,
    rejudges: bool = False,
) -> tuple[Specification, bool]:
    """Enter a specification file into a store's log.

    `is_revision`: whether its name has to be in the store already. `rejudges`: whether earlier runs are judged again by
    what holds from now on. Returns the specification, and whether it is new; the same content again is not, and is
    entered again only with `rejudges`. Raises BadInput if it is not right, contradicts another one, or has the revision
    of one with other content; StoreError if the store cannot be written.
    """
    content = specification.read_specification(path)
    found = checked_specification(content, str(path))
    with only_one(store.folder / FOLDER / ".lock", "gyrofleet limits"):
        chain = _whole_chain(store)
        held = in_force(chain.links)
        names = {each.name for each in held}
        if is_revision and found.name not in names:
            raise BadInput(
                f"specification {path}: there is no {found.name!r} to revise; {alike(found.name, names, 'there are')}; "
                "`gyrofleet limits add` enters a new one"
            )
        is_new = _is_new(chain, held, found, content, path)
        if not is_new and not rejudges:
            return found, False
        periods_of([*(each for each in held if each.label != found.label), found])
        action = SpecificationAction.REVISED if found.name in names else SpecificationAction.ADDED
        words = {"reason": reason, "content": content.decode(), "rejudges": rejudges}
        write_copy(store, _append(store, chain, action, by, words, found))
    return found, is_new


def withdraw_specification(
    store: Store, label: str, *, by: Actor, reason: str, rejudges: bool = False
) -> SpecificationEntered:
    """Take a revision out of force: runs recorded from now on are not judged by it.

    Raises NotFound if no revision in force has that label; BadInput if those that hold again without it contradict each
    other; StoreError if the store cannot be written.
    """
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
        words = {"reason": reason, "rejudges": rejudges}
        return _append(store, chain, SpecificationAction.WITHDRAWN, by, words, held[label])


def settle_chain(store: Store, *, by: Actor, reason: str) -> list[str]:
    """Accept that the chain of documents is broken; returns a sentence for each break.

    Raises BadInput if it is whole; StoreError if the store cannot be written.
    """
    with only_one(store.folder / FOLDER / ".lock", "gyrofleet limits"):
        chain = read_chain(store)
        if not chain.breaks:
            raise BadInput("the chain of specification documents is whole: there is nothing to settle")
        settles = tuple(each.at for each in chain.breaks)
        _append(store, chain, SpecificationAction.SETTLED, by, {"reason": reason, "settles": settles})
    return [each.what for each in chain.breaks]


def _append(
    store: Store, chain: Chain, action: SpecificationAction, by: Actor, words: Mapping[str, Any],
    of: Specification | None = None,
) -> SpecificationEntered:  # fmt: skip
    """Append a document to the chain."""
    document = SpecificationEntered(
        run="", t_ns=max([time.time_ns(), *(link.document.t_ns + 1 for link in chain.links[-1:])]), action=action,
        name="" if of is None else of.name, revision="" if of is None else of.revision, previous=chain.head,
        by=by.name, identity=by.identity, **words,
    )  # fmt: skip
    append_document(store, document)
    return document


def _is_new(chain: Chain, held: Sequence[Specification], found: Specification, content: bytes, path: Path) -> bool:
    """Whether a revision is not in force; one that was entered with other content is refused."""
    known = {link.label: link.document.content.encode() for link in chain.links if link.document.content}
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


def checked_specification(content: bytes, source: str) -> Specification:
    """Read a specification and check it against the metrics.

    The `source` it comes from is for messages, and for its name where the file gives none. Raises BadInput if anything
    in it is not right: an unknown metric or standard, a unit of measure that does not fit, limits that repeat each
    other; the message names the file, the line and the key.
    """
    found = specification.parse_specification(content, source)
    where = f"specification {source}"
    specification.check_names(found, where)
    _check_limits(found, content, where)
    return found


def _check_limits(found: Specification, content: bytes, where: str) -> None:
    lines = [at for at, line in enumerate(content.decode().splitlines(), 1) if re.match(r"\s*\[\[\s*limit", line)]
    for at, limit in enumerate(found.limits):
        line = f"line {lines[at]}, " if at < len(lines) else ""
        place = f"{where}: {line}$.limit[{at}] ({limit.metric})"
        _check_limit(limit, found, place)
        if (first := next((i for i in range(at) if found.limits[i].meets(limit)), None)) is not None:
            same = f"$.limit[{first}] limits the same; keep one, or tell them apart by their parameters"
            raise BadInput(f"{place}: {same}")


def _check_limit(limit: SpecificationLimit, found: Specification, place: str) -> None:
    check_metrics([limit.metric], place)
    header = metrics()[limit.metric].header
    _check_unit(limit, header.unit, place)
    for name in limit.parameters:
        if name not in header.parameters:
            known = alike(name, header.parameters, "its parameters are")
            raise BadInput(f"{place}: no value of {limit.metric} has a parameter {name!r}; {known}")
    if limit.lower is None and limit.upper is None:
        raise BadInput(f"{place}: it has neither lower nor upper")
    for key, number in (("lower", limit.lower), ("upper", limit.upper)):
        if number is not None and not math.isfinite(number):
            raise BadInput(f"{place}: {key} is {number}; leave it out where there is no such limit")
    if limit.lower is not None and limit.upper is not None and limit.lower > limit.upper:
        raise BadInput(f"{place}: lower {limit.lower:g} lies above upper {limit.upper:g}")
    if limit.standard is not None:
        of_metric = list(dict.fromkeys(source.standard for source in header.sources))
        if limit.standard not in of_metric:
            raise BadInput(f"{place}: standard {limit.standard!r} is not one of the metric's: {', '.join(of_metric)}")
    if limit.product is not None and found.products and limit.product not in found.products:
        raise BadInput(
            f"{place}: product {limit.product!r} has no [product.NAME] in this file; "
            f"{alike(limit.product, found.products, 'those that have are')}"
        )


def _check_unit(limit: SpecificationLimit, unit: str, place: str) -> None:
    try:
        check_result_unit(limit.unit_of_measure)
    except UnknownUnit as error:
        raise BadInput(f"{place}: unit_of_measure: {error}") from error
    # what a metric's header names may depend on the output, as "output/(deg/s)": then it is known with the value
    with suppress(UnknownUnit):
        check_result_unit(unit)
        try:
            result_factor(unit, limit.unit_of_measure)
        except UnknownUnit as error:
            raise BadInput(f"{place}: unit_of_measure: {error}; {limit.metric} is in {unit}") from error
