"""Columns of a result as NumPy arrays."""

from typing import Any

import duckdb
import numpy as np
import numpy.typing as npt
import pyarrow as pa


def numbers(column: pa.ChunkedArray | pa.Array) -> npt.NDArray[Any]:
    """Values of a column of numbers; where there are nulls, as floats with NaN in their place.

    `to_numpy` of pyarrow gives the same, but imports pandas first if that is installed.

    >>> numbers(pa.array([1.5, None])), numbers(pa.chunked_array([[1], [2]]))
    (array([1.5, nan]), array([1, 2]))
    """
    chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
    if column.null_count:
        chunks = [_with_nan(each) for each in chunks]
    parts = [np.from_dlpack(each) for each in chunks]
    if len(parts) == 1:
        return parts[0]
    return np.concatenate(parts) if parts else np.empty(0, column.type.to_pandas_dtype())


def _with_nan(chunk: pa.Array) -> pa.Array:
    """Values as floats, with NaN in place of nulls."""
    import pyarrow.compute as pc

    known = numbers(pc.cast(pc.is_valid(chunk), pa.uint8()))
    floats = pc.cast(chunk, pa.float64())
    value = pa.Array.from_buffers(pa.float64(), len(floats), [None, floats.buffers()[1]], offset=floats.offset)
    filled = np.where(known, np.from_dlpack(value), np.nan)
    return pa.Array.from_buffers(pa.float64(), len(filled), [None, pa.py_buffer(filled)])


def rows_with(batch: pa.RecordBatch, column: str, value: int) -> pa.RecordBatch:
    """The rows of a batch in which a column of numbers without nulls has this value.

    A comparison with `pyarrow.compute` gives the same, but imports pandas first if that is installed.

    >>> rows_with(pa.record_batch({"a": [1, 2, 2]}), "a", 2).num_rows
    2
    """
    marks = np.packbits(numbers(batch.column(column)) == value, bitorder="little")
    return batch.filter(pa.Array.from_buffers(pa.bool_(), batch.num_rows, [None, pa.py_buffer(marks)]))


def distinct_pairs(table: pa.Table, one: str, other: str) -> list[tuple[str, str]]:
    """The different pairs of two columns of text without nulls, in their order.

    `group_by` of pyarrow gives the same, but imports pandas first if that is installed.

    >>> distinct_pairs(pa.table({"a": ["x", "x", "y"], "b": ["1", "1", "1"]}), "a", "b")
    [('x', '1'), ('y', '1')]
    """
    left, right = (table[name].combine_chunks().dictionary_encode() for name in (one, other))
    firsts, seconds = left.dictionary.to_pylist(), right.dictionary.to_pylist()
    codes = np.unique(numbers(left.indices).astype(np.int64) * len(seconds) + numbers(right.indices))
    return [(firsts[code // len(seconds)], seconds[code % len(seconds)]) for code in codes.tolist()]


def rows_of(cursor: duckdb.DuckDBPyConnection, sql: str, parameters: object) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Names of the columns of a statement's result and all rows.

    >>> with duckdb.connect() as connection:
    ...     rows_of(connection, "select 1 as a, null as b where $x", {"x": True})
    (['a', 'b'], [(1, None)])
    """
    cursor.execute(sql, parameters)
    return [str(column[0]) for column in cursor.description or ()], cursor.fetchall()
