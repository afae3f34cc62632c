"""The table of an answer: its columns with the types that the answer's type declares, however many rows a page has."""

import types
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Protocol, Union, get_args, get_origin, get_type_hints, runtime_checkable

import msgspec
import pyarrow as pa

from stream.terminal.console import json_text

Columns = Mapping[str, Sequence[Any]]

_SIMPLE: dict[Any, pa.DataType] = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
_UNIONS = (Union, types.UnionType)


@runtime_checkable
class Columnar(Protocol):
    """An answer that has its table as columns."""

    def columns(self) -> Columns:
        """The columns."""

    def column_types(self) -> Mapping[str, type]:
        """What their values are: ``int``, ``float``, ``str``."""


class Table:
    """Columns with their types; `name` is the field of the answer that has the rows, where it has no columns itself."""

    def __init__(self, answer: Any, name: str) -> None:
        if isinstance(answer, Columnar):
            self.types = {column: _SIMPLE[kind] for column, kind in answer.column_types().items()}
            columns = answer.columns()
            self.columns: Columns = {column: columns[column] for column in self.types}
            return
        rows = msgspec.to_builtins(getattr(answer, name))
        self.types = _types(type(answer), name)
        self.columns = {
            column: [_cell(row.get(column), kind) for row in rows] for column, kind in self.types.items()
        }  # fmt: skip

    @property
    def arrow(self) -> pa.Table:
        """The table in Arrow."""
        schema = pa.schema(list(self.types.items()))
        return pa.table([pa.array(self.columns[name], kind) for name, kind in self.types.items()], schema=schema)


def _types(answer: type, name: str) -> dict[str, pa.DataType]:
    """Columns of a field that is a list of structures or dictionaries with declared keys."""
    (row,) = get_args(get_type_hints(answer)[name])
    return {column: arrow_type(hint) for column, hint in get_type_hints(row, include_extras=True).items()}


def arrow_type(hint: Any) -> pa.DataType:
    """The type of a column; what is nested is text, as JSON.

    >>> str(arrow_type(float | None)), str(arrow_type(list[str])), str(arrow_type(dict[str, int]))
    ('double', 'list<item: string>', 'string')
    """
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return arrow_type(parts[0])
    if origin in _UNIONS:
        kinds = {arrow_type(each) for each in parts if each is not type(None)}
        if kinds == {pa.int64(), pa.float64()}:
            return pa.float64()
        return kinds.pop() if len(kinds) == 1 else pa.string()
    if origin in (list, tuple) and parts and parts[0] in _SIMPLE:
        return pa.list_(_SIMPLE[parts[0]])
    return _SIMPLE.get(hint, pa.string())


def _cell(value: Any, kind: pa.DataType) -> Any:
    """A value; what is nested, or of no one type, becomes JSON."""
    is_text = kind == pa.string()
    return json_text(value) if is_text and value is not None and not isinstance(value, str) else value
