"""Rollups of several parts are sorted by channel and time, and none is lost."""

import itertools
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.lake.builder import builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from storage.lake.rows_by_channel import rows_by_channel
from storage.manifests.lake import read_manifest
from tests.storage.conftest import Filler
from tests.storage.lake.exported_views import LATER_NS
from tests.stream.examples import examples

Row = tuple[int, int, int]
KEY = ("channel", "bucket")
# channel and bucket; the groups of a file in any order, as in parts that nobody sorted
FILES = st.lists(
    st.lists(
        st.lists(st.tuples(st.integers(-3, 3), st.integers(0, 9)), min_size=1, max_size=12), min_size=1, max_size=4
    ),
    min_size=1,
    max_size=4,
)


def written(folder: Path, files: Sequence[Sequence[Sequence[tuple[int, int]]]]) -> list[Row]:
    """Write files with the given row groups; their rows, each with a number of its own."""
    rows: list[Row] = []
    for place, groups in enumerate(files):
        tables = []
        for group in groups:
            numbered = [(*each, len(rows) + at) for at, each in enumerate(group)]
            rows += numbered
            tables.append(pa.table(dict(zip(("channel", "bucket", "n"), zip(*numbered, strict=True), strict=True))))
        with pq.ParquetWriter(folder / f"{place}.parquet", tables[0].schema) as writer:
            for table in tables:
                writer.write_table(table)
    return rows


def read(folder: Path, count: int, group_rows: int, most_waiting: int) -> list[list[Row]]:
    with ExitStack() as stack:
        files = [stack.enter_context(pq.ParquetFile(folder / f"{place}.parquet")) for place in range(count)]
        tables = list(rows_by_channel(files, group_rows=group_rows, most_waiting=most_waiting))
    return [
        list(zip(*(table[name].to_pylist() for name in ("channel", "bucket", "n")), strict=True)) for table in tables
    ]


@examples(25, 100, FILES, st.integers(1, 8))
def test_rows_are_in_order_and_tables_end_between_channels(
    files: list[list[list[tuple[int, int]]]], group_rows: int
) -> None:
    with TemporaryDirectory() as name:
        rows = written(Path(name), files)
        tables = read(Path(name), len(files), group_rows, 10**6)
    found = [row for table in tables for row in table]
    assert sorted(found) == sorted(rows)
    assert [row[:2] for row in found] == sorted(row[:2] for row in rows)
    assert all(len(table) >= group_rows for table in tables[:-1])
    assert all(before[-1][0] < after[0][0] for before, after in itertools.pairwise(tables))


@pytest.mark.long
@settings(deadline=None)
@given(FILES, st.integers(1, 8), st.integers(1, 20))
def test_no_row_is_lost_where_few_may_wait(
    files: list[list[list[tuple[int, int]]]], group_rows: int, most_waiting: int
) -> None:
    with TemporaryDirectory() as name:
        rows = written(Path(name), files)
        tables = read(Path(name), len(files), group_rows, most_waiting)
    assert sorted(row for table in tables for row in table) == sorted(rows)
    for table in tables:
        assert [row[:2] for row in table] == sorted(row[:2] for row in table)


@examples(25, 100, FILES, st.integers(1, 8), st.integers(1, 20))
def test_what_was_sorted_piece_by_piece_is_in_order_the_next_time(
    files: list[list[list[tuple[int, int]]]], group_rows: int, most_waiting: int
) -> None:
    with TemporaryDirectory() as name, ExitStack() as stack:
        rows = written(Path(name), files)
        opened = [stack.enter_context(pq.ParquetFile(Path(name) / f"{place}.parquet")) for place in range(len(files))]
        first = list(rows_by_channel(opened, group_rows=group_rows, most_waiting=most_waiting))
        with pq.ParquetWriter(Path(name) / "first.parquet", first[0].schema) as writer:
            for table in first:
                writer.write_table(table)
        again = stack.enter_context(pq.ParquetFile(Path(name) / "first.parquet"))
        second = list(rows_by_channel([again], group_rows=group_rows))
    keys = [pair for table in second for pair in zip(*(table[name].to_pylist() for name in KEY), strict=True)]
    assert keys == sorted(row[:2] for row in rows)


@pytest.mark.parametrize("most_waiting", [10**6, 40])
def test_a_compacted_part_has_each_channel_in_one_place(
    days: Filler, most_waiting: int, monkeypatch: pytest.MonkeyPatch
) -> None:

    def of_few(files: Sequence[pq.ParquetFile]) -> Iterator[pa.Table]:
        # the second pass, of one file, needs no memory for rows in the order of time
        return rows_by_channel(files, group_rows=4, most_waiting=most_waiting if len(files) > 1 else 10**6)

    monkeypatch.setattr("storage.lake.compaction.rows_by_channel", of_few)
    days.build()
    store = days.store
    with builder_lock(store):
        assert list(compact(Lake(store), now_ns=LATER_NS))
    for part in read_manifest(store).parts:
        for name in ("rollup_1s", "rollup_10s"):
            table = pq.read_table(store.lake / part.name / f"{name}.parquet")
            keys = np.column_stack([table["channel"].to_numpy(), table["bucket"].to_numpy()])
            assert keys.tolist() == sorted(keys.tolist())
