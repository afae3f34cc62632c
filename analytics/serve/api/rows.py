"""Rows of statements as answers, moments, and pages of long lists."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Protocol, TypeVar

import msgspec
import pyarrow as pa

from ingest.moment import moment_ns
from stream.bounds import MAX_MOMENT_NS, MIN_MOMENT_NS
from stream.errors import BadInput

Row = TypeVar("Row")

MOST_ROWS = 10_000
Limit = Annotated[int, msgspec.Meta(ge=1, le=MOST_ROWS, description="Rows of one page.")]
Name = Annotated[str, msgspec.Meta(max_length=256)]
T_NS = Annotated[int, msgspec.Meta(description="Nanoseconds since 1970-01-01 UTC.")]


class Views(Protocol):
    """Views that answer the project's own statements."""

    def batches(self, sql: str, parameters: object = None) -> Iterator[pa.RecordBatch]:
        """The batches of a statement's result."""

    def rows(self, sql: str, parameters: object = None) -> list[tuple[Any, ...]]:
        """All rows of a statement's result."""

    def named_rows(self, sql: str, parameters: object = None) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Names of the columns of a statement's result and all rows."""


class Paged(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A page of a long list: `limit` rows, those after the key `after`, which the page before it names."""

    limit: Limit = 200
    after: Name = ""


def dictionaries(catalog: Views, sql: str, parameters: object = None) -> list[dict[str, Any]]:
    """Rows of a statement as dictionaries."""
    names, rows = catalog.named_rows(sql, parameters)
    return [dict(zip(names, row, strict=True)) for row in rows]


def page_of(rows: Sequence[Row], limit: int) -> tuple[list[Row], bool]:
    """The rows of a page, of one more than it has, and whether there are more.

    >>> page_of([1, 2, 3], 2), page_of([1, 2], 2)
    (([1, 2], True), ([1, 2], False))
    """
    return list(rows[:limit]), len(rows) > limit


def iso(t_ns: int | None) -> str | None:
    """A moment as ISO 8601 in UTC, with all its digits.

    >>> iso(1_795_255_200_000_000_001), iso(1_795_255_200_000_000_000), iso(None)
    ('2026-11-21T10:00:00.000000001Z', '2026-11-21T10:00:00Z', None)
    """
    if t_ns is None:
        return None
    seconds, rest = divmod(t_ns, 10**9)
    text = datetime.fromtimestamp(seconds, UTC).isoformat()[:19]  # without its zone
    return f"{text}.{rest:09d}".rstrip("0") + "Z" if rest else f"{text}Z"


def moment(text: str | None, name: str) -> int | None:
    """A moment of a request: nanoseconds, or ISO 8601 with a time zone; BadInput if it is neither.

    >>> moment("1795255200000000000", "from") == moment("2026-11-21T18:00:00+08:00", "from")
    True
    """
    if text is None or text == "":
        return None
    try:
        found = int(text)
    except ValueError:
        # a plus sign that was not escaped arrives as a blank
        found = moment_ns(text.replace(" ", "+") if text.count(" ") == 1 and "T" in text else text, name)
    if not MIN_MOMENT_NS <= found <= MAX_MOMENT_NS:
        raise BadInput(f"{name} {text!r} is not a moment between 1897 and 2116")
    return found
