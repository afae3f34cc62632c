"""Forms of an answer: JSON, an Arrow stream, CSV, Parquet."""

import csv
import io
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable
from urllib.parse import quote

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from analytics.serve.answer_cache import Answer
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
class Columnar(Protocol):
    """An answer that has its table as columns."""

    def columns(self) -> Mapping[str, Sequence[Any]]:
        """The columns."""


@runtime_checkable
class SelfEncoded(Protocol):
    """An answer that knows its forms."""

    def encoded(self, form: Form) -> Answer:
        """The answer in a form."""


def form_of(accept: str, named: str | None, forms: Sequence[Form]) -> Form:
    """The form that a client wants: the one that ``format`` names, else the first of its Accept that there is.

    >>> form_of("text/html, application/vnd.apache.arrow.stream;q=0.9", None, list(Form)).value
    'arrow'
    >>> form_of("*/*", None, list(Form)).value
    'json'
    """
    if named is not None:
        if named not in {each.value for each in forms}:
            raise BadInput(f"format {named!r} is not one of {', '.join(forms)}")
        return Form(named)
    by_type = {each.media_type.partition(";")[0]: each for each in forms}
    wanted = [each.partition(";")[0].strip().lower() for each in accept.split(",")]
    found = next((by_type[each] for each in wanted if each in by_type), None)
    if found is None and accept and not any(each in {"*/*", "application/*", "text/html", "text/*"} for each in wanted):
        raise NotAcceptable(f"the answer comes as {', '.join(by_type)}; not as {accept}")
    return found or Form.JSON


def encoded(answer: Any, form: Form, table: str | None) -> Answer:
    """An answer in a form; `table` is the field that has its rows, see `Operation`."""
    if isinstance(answer, SelfEncoded):
        return answer.encoded(form)
    if form is Form.JSON:
        return Answer(json_text(answer).encode(), form.media_type)
    columns, more = _columns(answer, table), _more(answer)
    if form is Form.CSV:
        return Answer(_csv(columns), form.media_type, more)
    sink = io.BytesIO()
    arrow = pa.table({name: _array(values) for name, values in columns.items()})
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


def _columns(answer: Any, table: str | None) -> Mapping[str, Sequence[Any]]:
    if isinstance(answer, Columnar):
        return answer.columns()
    rows = msgspec.to_builtins(getattr(answer, table or ""))
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: [_flat(row.get(name)) for row in rows] for name in names}


def _flat(value: Any) -> Any:
    """A cell; what is nested becomes JSON."""
    if isinstance(value, dict) or (isinstance(value, list) and any(isinstance(each, dict | list) for each in value)):
        return json_text(value)
    return value


def _array(values: Sequence[Any]) -> pa.Array:
    try:
        return pa.array(values)
    except (pa.ArrowInvalid, pa.ArrowTypeError):  # numbers beside texts
        return pa.array([None if each is None else json_text(each) for each in values], pa.string())


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
