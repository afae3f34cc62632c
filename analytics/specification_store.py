"""The specifications of a store: immutable copies, one file a revision, whose times do not contradict each other."""

import os
from collections.abc import Sequence
from itertools import combinations, pairwise
from pathlib import Path
from typing import NamedTuple

from analytics.metrics.product_files import FOLDER
from analytics.specification import Specification, parse_specification
from analytics.specification_dates import told_moment
from storage.store import Store, only_one, sync_folder
from stream.errors import BadInput, NotFound, StoreError

EVER = -(2**63)
NEVER = 2**63 - 1


class Period(NamedTuple):
    """A specification with the time in which it holds; without an end of its own it ends where the next begins."""

    specification: Specification
    from_ns: int
    until_ns: int

    @property
    def told(self) -> str:
        """The time for people."""
        begin = told_moment(None if self.from_ns == EVER else self.from_ns) or "ever"
        end = told_moment(None if self.until_ns == NEVER else self.until_ns)
        return f"from {begin}" if end is None else f"from {begin} until {end} (not included)"


def add_specification(store: Store, path: Path) -> tuple[Specification, bool]:
    """Keep a specification in a store.

    Returns
    -------
    tuple
        The specification, and whether it is new; the same content again is not.

    Raises
    ------
    BadInput
        If it is not right, contradicts one that is there, or has the revision of one with other content.
    StoreError
        If the store cannot be written.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(f"specification {path}: cannot be read ({error.strerror or error})") from error
    found = parse_specification(content, str(path))
    folder = store.folder / FOLDER
    with only_one(folder / ".lock", "gyrofleet limits add"):
        kept = folder / f"{found.label}.toml"
        if kept.exists():
            if kept.read_bytes() == content:
                return found, False
            raise BadInput(
                f"specification {path}: revision {found.revision} of {found.name} is in the store with other content "
                f"({kept}); what was judged by it must stay traceable: give the new content another revision"
            )
        periods_of([*stored_specifications(store), found])
        _write(kept, content)
    return found, True


def stored_specifications(store: Store) -> list[Specification]:
    """All specifications of a store.

    Raises
    ------
    BadInput
        If a file there is not right.
    """
    try:
        return [
            parse_specification(path.read_bytes(), str(path)) for path in sorted((store.folder / FOLDER).glob("*.toml"))
        ]
    except OSError as error:
        raise StoreError(f"the specifications in {store.folder / FOLDER} cannot be read: {error}") from error


def specification_named(store: Store, label: str) -> tuple[Period, bytes]:
    """A specification of a store by ``NAME-REVISION``, or by its name: the revision that was valid last.

    Raises
    ------
    NotFound
        If there is none.
    """
    periods = periods_of(stored_specifications(store))
    named = [each for each in periods if label in {each.specification.label, each.specification.name}]
    if not named:
        known = ", ".join(each.specification.label for each in periods) or "none; `gyrofleet limits add FILE` adds one"
        raise NotFound(f"there is no specification {label!r}; there are {known}")
    period = max(named, key=lambda each: (each.specification.label == label, each.from_ns))
    return period, (store.folder / FOLDER / f"{period.specification.label}.toml").read_bytes()


def periods_of(specifications: Sequence[Specification]) -> list[Period]:
    """When each of them holds, by name and begin.

    Raises
    ------
    BadInput
        If two revisions of one name hold at one time, or two names limit the same at one time.
    """
    ordered = sorted(specifications, key=lambda each: (each.name, EVER if each.from_ns is None else each.from_ns))
    periods = []
    for each, after in pairwise([*ordered, None]):
        assert each is not None
        begin = EVER if each.from_ns is None else each.from_ns
        until = NEVER if each.until_ns is None else each.until_ns
        if after is not None and after.name == each.name:
            next_begin = EVER if after.from_ns is None else after.from_ns
            if next_begin == begin:
                raise BadInput(
                    f"specification {each.name}: revisions {each.revision} and {after.revision} begin to be valid at "
                    f"the same time ({told_moment(each.from_ns) or 'ever'}); give the later one its valid_from"
                )
            if each.until_ns is not None and each.until_ns > next_begin:
                raise BadInput(
                    f"specification {each.name}: revision {each.revision} is valid until {told_moment(each.until_ns)} "
                    f"(not included), but {after.revision} begins at {told_moment(after.from_ns)}: give it a later one"
                )
            until = min(until, next_begin)
        periods.append(Period(each, begin, until))
    for one, other in combinations(periods, 2):
        if one.specification.name != other.specification.name:
            _check_beside(one, other)
    return periods


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


def _write(path: Path, content: bytes) -> None:
    fresh = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with fresh.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        fresh.chmod(0o444)
        fresh.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        raise StoreError(
            f"cannot write {path}: {error}; free the disk or mend its permissions and try again"
        ) from error
    finally:
        fresh.unlink(missing_ok=True)
