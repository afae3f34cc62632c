"""When each revision of a specification is valid, and what was known of that at any time."""

from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from itertools import combinations, pairwise
from typing import NamedTuple

from storage.specifications.chain import Link, read_chain
from storage.specifications.specification import Specification, parse_specification
from storage.store import Store
from stream.errors import BadInput, NotFound
from stream.events import SpecificationAction, SpecificationEntered

EVER = -(2**63)
NEVER = 2**63 - 1


class Period(NamedTuple):
    """A specification and when it is valid; without an end of its own it ends where the next revision begins."""

    specification: Specification
    from_ns: int
    until_ns: int

    @property
    def text(self) -> str:
        """The time as text."""
        begin = format_moment(None if self.from_ns == EVER else self.from_ns) or "ever"
        end = format_moment(None if self.until_ns == NEVER else self.until_ns)
        return f"from {begin}" if end is None else f"from {begin} until {end} (not included)"


class Edition(NamedTuple):
    """A period and the number of revisions as known for a time, until documents ended or withdrew it."""

    period: Period
    revisions: int
    known_from_ns: int
    known_until_ns: int


def in_force(links: Iterable[Link]) -> list[Specification]:
    """Specifications that were added and not withdrawn, in that order; BadInput if one of them cannot be read."""
    found: dict[str, SpecificationEntered] = {}
    for link in links:
        _apply(link, found)
    return [_specification(each) for each in found.values()]


def withdrawn_labels(links: Iterable[Link]) -> list[str]:
    """Revisions that were withdrawn and not entered again."""
    found = {link.label: link.document.action for link in links if link.document.name}
    return [label for label, action in found.items() if action is SpecificationAction.WITHDRAWN]


def stored_specifications(store: Store) -> list[Specification]:
    """Specifications in force in a store; StoreError if the lake or the log is damaged."""
    return in_force(read_chain(store).links)


def specification_named(links: Sequence[Link], label: str) -> tuple[Period, str]:
    """Period and TOML of a ``NAME-REVISION``, withdrawn or not, or of the last revision of a name; else NotFound."""
    contents = {link.label: link.document for link in links if link.document.content}
    periods = ordered_periods(in_force(links))
    if label in contents.keys() - {each.specification.label for each in periods}:
        periods += ordered_periods([_specification(contents[label])])
    named = [each for each in periods if label in {each.specification.label, each.specification.name}]
    revisions = [each for each in withdrawn_labels(links) if each.rpartition("-")[0] == label]
    if not named and revisions:
        raise NotFound(
            f"no revision of {label!r} is in force: {', '.join(revisions)} {'is' if len(revisions) == 1 else 'are'} "
            f"withdrawn; `gyrofleet limits show {revisions[-1]}` shows it"
        )
    if not named:
        known = ", ".join(contents) or "none; `gyrofleet limits add FILE` adds one"
        raise NotFound(f"there is no specification {label!r}; there are {known}")
    period = max(named, key=lambda each: (each.specification.label == label, each.from_ns))
    return period, contents[period.specification.label].content


def editions_of(links: Sequence[Link]) -> list[Edition]:
    """What was known of each period, and when; a document that rejudges replaces all that was known before it."""
    begin = max((at for at, link in enumerate(links) if link.document.rejudges), default=0)
    closed: list[Edition] = []
    known: dict[tuple[str, int, int, int], Edition] = {}
    found: dict[str, SpecificationEntered] = {}
    for at, link in enumerate(links):
        _apply(link, found)
        if at < begin:
            continue
        periods = ordered_periods(map(_specification, found.values()))
        revisions = Counter(each.specification.name for each in periods)
        held = {}
        for each in periods:
            number = revisions[each.specification.name]
            key = (each.specification.label, each.from_ns, each.until_ns, number)
            held[key] = Edition(each, number, link.known_ns, NEVER)
        closed += [each._replace(known_until_ns=link.known_ns) for key, each in known.items() if key not in held]
        known = {key: known.get(key, each) for key, each in held.items()}
    return [*closed, *known.values()]


def periods_of(specifications: Sequence[Specification]) -> list[Period]:
    """When each is valid, by name and begin; BadInput if revisions overlap, or two names limit the same at one time."""
    for each, after in pairwise(sorted(specifications, key=_place)):
        if each.name == after.name:
            _check_after(each, after)
    periods = ordered_periods(specifications)
    for one, other in combinations(periods, 2):
        if one.specification.name != other.specification.name:
            _check_beside(one, other)
    return periods


def ordered_periods(specifications: Iterable[Specification]) -> list[Period]:
    """When each of them is valid, by name and begin; contradictions between them are not checked."""
    periods = []
    for each, after in pairwise([*sorted(specifications, key=_place), None]):
        assert each is not None
        until = NEVER if each.until_ns is None else each.until_ns
        if after is not None and after.name == each.name:
            until = min(until, _begin(after))
        periods.append(Period(each, _begin(each), until))
    return periods


def format_moment(t_ns: int | None) -> str | None:
    """A moment as ``2026-11-21`` or ``2026-11-21T10:00:00Z``.

    >>> format_moment(0), format_moment(3_600_000_000_000)
    ('1970-01-01', '1970-01-01T01:00:00Z')
    """
    if t_ns is None:
        return None
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=t_ns // 1000)
    return moment.strftime("%Y-%m-%d") if t_ns % (86_400 * 10**9) == 0 else moment.strftime("%Y-%m-%dT%H:%M:%SZ")


@lru_cache(maxsize=1000)
def _specification(document: SpecificationEntered) -> Specification:
    name, revision = document.name, document.revision
    return parse_specification(document.content, f"{name}-{revision}.toml")._replace(name=name, revision=revision)


def _apply(link: Link, found: dict[str, SpecificationEntered]) -> None:
    if link.document.action is SpecificationAction.WITHDRAWN:
        found.pop(link.label, None)
    elif link.document.action is not SpecificationAction.SETTLED:
        found[link.label] = link.document


def _place(specification: Specification) -> tuple[str, int]:
    return specification.name, _begin(specification)


def _begin(specification: Specification) -> int:
    return EVER if specification.from_ns is None else specification.from_ns


def _check_after(each: Specification, after: Specification) -> None:
    if _begin(after) == _begin(each):
        raise BadInput(
            f"specification {each.name}: revisions {each.revision} and {after.revision} begin to be valid at "
            f"the same time ({format_moment(each.from_ns) or 'ever'}); give the later one its valid_from; where "
            f"{each.revision} is wrong, withdraw it (`gyrofleet limits withdraw {each.label} --reason ...`), "
            f"then enter {after.revision} by `gyrofleet limits add ... --rejudge`"
        )
    if each.until_ns is not None and each.until_ns > _begin(after):
        raise BadInput(
            f"specification {each.name}: revision {each.revision} is valid until {format_moment(each.until_ns)} "
            f"(not included), but {after.revision} begins at {format_moment(after.from_ns)}: give it a later one"
        )


def _check_beside(one: Period, other: Period) -> None:
    if one.until_ns <= other.from_ns or other.until_ns <= one.from_ns:
        return
    first, second = one.specification, other.specification
    both = f"{first.label} and {second.label} hold at one time"
    for mine in first.limits:
        for theirs in second.limits:
            if mine.meets(theirs):
                raise BadInput(
                    f"specifications {both} and both limit {mine.subject} of {mine.product or 'any product'}"
                )
    for name in first.products.keys() & second.products.keys():
        if first.products[name] != second.products[name]:
            raise BadInput(f"specifications {both} and have different numbers of product {name}")
