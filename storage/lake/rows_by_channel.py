"""Rows of several files of rollups, sorted by channel and time, read row group by row group."""

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa

from stream.batch import IntArray

if TYPE_CHECKING:
    import pyarrow.parquet as pq

GROUP_ROWS = 65_536  # of whole channels, that make a row group: who asks for one channel reads few rows of others
MOST_WAITING = 4_000_000  # rows in memory, about 65 bytes each
_LEAST = -(2**63)


class _RowGroup(NamedTuple):
    least_channel: int
    file: int
    number: int


def rows_by_channel(
    files: Sequence["pq.ParquetFile"], *, group_rows: int = GROUP_ROWS, most_waiting: int = MOST_WAITING
) -> Iterator[pa.Table]:
    """Rows by channel and bucket, in tables of whole channels of at least `group_rows`, but for the last.

    Row groups are read in the order of their least channel; rows are yielded once no later row group can have their
    channel. Where more than `most_waiting` rows would have to wait, as of files that are in the order of time, they are
    yielded before, and a channel is in several places: the rows of what is written so come by channel the next time.
    """
    groups = sorted(_row_groups(files))
    waiting: list[pa.Table] = []
    rows, enough = 0, 2 * group_rows
    for at, group in enumerate(groups):
        waiting.append(files[group.file].read_row_group(group.number, use_threads=False))
        rows += waiting[-1].num_rows
        is_last = at + 1 == len(groups)
        if not is_last and rows < enough and rows <= most_waiting:
            continue
        table = _sorted(waiting)
        channels = _numbers(table, "channel")
        complete = rows if is_last else int(np.searchsorted(channels, groups[at + 1].least_channel))
        if rows - complete > most_waiting:
            complete, is_last = rows, True
        done = 0
        for begin, end in itertools.pairwise([0, *_borders(channels[:complete], group_rows, is_last=is_last)]):
            yield table.slice(begin, end - begin)
            done = end
        waiting, rows = [table.slice(done)], rows - done
        enough = max(2 * group_rows, 2 * rows)  # so that no row is sorted again and again


def _row_groups(files: Sequence["pq.ParquetFile"]) -> Iterator[_RowGroup]:
    for place, file in enumerate(files):
        for number in range(file.metadata.num_row_groups):
            group = file.metadata.row_group(number)
            if group.num_rows:
                statistics = group.column(0).statistics
                yield _RowGroup(_LEAST if statistics is None else statistics.min, place, number)


def _sorted(tables: Sequence[pa.Table]) -> pa.Table:
    table = pa.concat_tables(tables).combine_chunks()
    order = np.lexsort((_numbers(table, "bucket"), _numbers(table, "channel")))
    return table.take(pa.array(order)).combine_chunks()


def _numbers(table: pa.Table, name: str) -> IntArray:
    return np.asarray(table.column(name).to_numpy(), np.int64)


def _borders(channels: IntArray, group_rows: int, *, is_last: bool) -> Iterator[int]:
    """Where tables of whole channels end; what is left of less than a row group is no table but at the end."""
    begin = 0
    for end in (*(np.flatnonzero(np.diff(channels)) + 1).tolist(), len(channels)):
        if end - begin >= group_rows or (is_last and end == len(channels) > begin):
            yield end
            begin = end
