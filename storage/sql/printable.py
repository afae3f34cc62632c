"""The result of a statement in types that JSON, CSV and people can read."""

import re
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from stream.errors import QueryError
from stream.terminal.console import csv_text, json_text

if TYPE_CHECKING:
    import pyarrow as pa

    from storage.sql.door import Result

_QUOTED = re.compile('[",\r\n]')


def printable_batches(result: "Result") -> "Iterator[pa.RecordBatch]":
    """Some rows at a time, with distinct names; times are text, since Python's datetime has no nanoseconds."""
    import pyarrow as pa

    for batch in result.batches:
        names = batch.schema.names
        columns = [_printable(name, column) for name, column in zip(names, batch.columns, strict=True)]
        yield pa.RecordBatch.from_arrays(columns, names=distinct_names(names))


def distinct_names(names: list[str]) -> list[str]:
    """Names of columns, a repeated one with its position.

    >>> distinct_names(["a", "b", "a"])
    ['a', 'b', 'a_3']
    """
    return [name if names.index(name) == i else f"{name}_{i + 1}" for i, name in enumerate(names)]


def csv_lines(columns: "Iterable[pa.Array]") -> str:
    r"""Lines of CSV (RFC 4180): nothing between commas is null, ``""`` an empty text, ``nan`` a NaN.

    Text that a spreadsheet would take for a formula is led by an apostrophe.

    >>> import pyarrow as pa
    >>> csv_lines([pa.array(["a,b", "", None]), pa.array([1.5, float("nan"), None])])
    '"a,b",1.5\r\n"",nan\r\n,\r\n'
    """
    cells = [_csv_cells(column) for column in columns]
    return "".join(f"{','.join(row)}\r\n" for row in zip(*cells, strict=True))


def _csv_cells(column: "pa.Array") -> list[str]:
    import pyarrow as pa

    values = column.to_pylist()
    if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        return ["" if value is None else repr(value) for value in values]
    return ["" if value is None else _csv_cell(value) for value in values]


def _csv_cell(value: object) -> str:
    text = _csv_text(value)
    return '"' + text.replace('"', '""') + '"' if text == "" or _QUOTED.search(text) else text


def _csv_text(value: object) -> str:
    if isinstance(value, list | dict):
        return csv_text(json_text(value))
    if isinstance(value, str):
        return csv_text(value)
    return value.hex() if isinstance(value, bytes) else str(value)


def _printable(name: str, column: "pa.Array") -> "pa.Array":
    import pyarrow as pa

    try:
        if pa.types.is_interval(column.type):
            return pa.array([None if each is None else _interval(each) for each in column.to_pylist()], pa.string())
        kind = _printable_type(column.type)
        return column if kind == column.type else column.cast(kind)
    except pa.ArrowException as error:
        raise QueryError(
            f"column {name} of type {column.type} cannot be printed; cast it with {name}::varchar in the statement"
        ) from error


def _printable_type(kind: "pa.DataType") -> "pa.DataType":
    import pyarrow as pa

    if pa.types.is_date(kind) or pa.types.is_time(kind) or pa.types.is_timestamp(kind) or pa.types.is_dictionary(kind):
        return pa.string()
    if pa.types.is_list(kind):
        return pa.list_(_printable_type(kind.value_type))
    if pa.types.is_struct(kind):
        return pa.struct([pa.field(field.name, _printable_type(field.type)) for field in kind])
    return kind


def _interval(value: "pa.MonthDayNano") -> str:
    return f"{value.months} months {value.days} days {value.nanoseconds / 1e9:.9g} s"
