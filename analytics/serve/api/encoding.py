"""Forms of an answer: JSON, an Arrow stream, CSV, Parquet."""

import csv
import io
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable
from urllib.parse import quote

import pyarrow as pa
import pyarrow.parquet as pq

from analytics.serve.answer_cache import Answer
from analytics.serve.api.table import Table
from analytics.serve.problems import NotAcceptable
from stream.errors import BadInput
from stream.terminal.console import csv_text, json_text


class Form(StrEnum):
    """A form of an answer, as in ``?format=csv``."""

    JSON = "json"
    ARROW = "arrow"
    CSV = "csv"
    PARQUET = "parquet"

    @property
    def media_type(self) -> str:
        """Its media type."""
        return _MEDIA_TYPES[self]


_MEDIA_TYPES = {
    Form.JSON: "application/json",
    Form.ARROW: "application/vnd.apache.arrow.stream",
    Form.CSV: "text/csv; charset=utf-8",
    Form.PARQUET: "application/vnd.apache.parquet",
}


_IN_ADDRESS = "/?&=%:+,;@~!$'()*"


@runtime_checkable
class SelfEncoded(Protocol):
    """An answer that knows its forms."""

    def encoded(self, form: Form) -> Answer:
        """The answer in a form."""


def form_of(accept: str, named: str | None, forms: Sequence[Form]) -> Form:
    """The form that a client wants: the one that ``format`` names, else the first of its Accept that there is.

    Of its Accept those with the greatest ``q`` come first (RFC 9110, 12.5.1), and ``q=0`` is not accepted.

    >>> form_of("text/html, application/vnd.apache.arrow.stream;q=0.9", None, list(Form)).value
    'arrow'
    >>> form_of("application/json;q=0.1, text/csv", None, list(Form)).value
    'csv'
    >>> form_of("*/*", None, list(Form)).value
    'json'
    """
    if named is not None:
        if named not in {each.value for each in forms}:
            raise BadInput(f"format {named!r} is not one of {', '.join(forms)}")
        return Form(named)
    by_type = {each.media_type.partition(";")[0]: each for each in forms}
    wanted = accepted(accept)
    found = next((by_type[each] for each in wanted if each in by_type), None)
    if found is None and accept and not any(each in {"*/*", "application/*", "text/html", "text/*"} for each in wanted):
        raise NotAcceptable(f"the answer comes as {', '.join(by_type)}; not as {accept}")
    return found or Form.JSON


def accepted(header: str) -> list[str]:
    """What a header such as Accept or Accept-Encoding lists, the most wanted first, without what it refuses.

    >>> accepted("text/csv;q=0.5, application/json, gzip;q=0")
    ['application/json', 'text/csv']
    """
    found: list[tuple[float, str]] = []
    for each in header.split(","):
        name, *parameters = (part.strip().lower() for part in each.split(";"))
        given = next((part.partition("=")[2] for part in parameters if part.startswith("q=")), "1")
        try:
            weight = float(given)
        except ValueError:
            weight = 1.0
        if name and weight > 0.0:
            found.append((weight, name))
    return [name for _, name in sorted(found, key=lambda each: -each[0])]


def encoded(answer: Any, form: Form, table: str | None) -> Answer:
    """An answer in a form; `table` is the field that has its rows, see `Operation`."""
    if isinstance(answer, SelfEncoded):
        return answer.encoded(form)
    if form is Form.JSON:
        return Answer(json_text(answer).encode(), form.media_type)
    found, more = Table(answer, table or ""), _more(answer)
    if form is Form.CSV:
        return Answer(_csv(found.columns), form.media_type, more)
    sink, arrow = io.BytesIO(), found.arrow
    if form is Form.PARQUET:
        pq.write_table(arrow, sink, compression="zstd")
        return Answer(sink.getvalue(), form.media_type, more)
    with pa.ipc.new_stream(sink, arrow.schema) as writer:
        writer.write_table(arrow)
    return Answer(sink.getvalue(), form.media_type, more)


def _more(answer: Any) -> tuple[tuple[str, str], ...]:
    """The address of the next page, as a header (RFC 8288): a table has no room for it."""
    following = getattr(answer, "next", None)
    return (("Link", f'<{quote(following, safe=_IN_ADDRESS)}>; rel="next"'),) if following else ()


def _csv(columns: Mapping[str, Sequence[Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow(_cell(each) for each in row)
    return text.getvalue().encode()


def _cell(value: Any) -> Any:
    if isinstance(value, list | bool):
        return csv_text(json_text(value))
    return csv_text(value) if isinstance(value, str) else value
