"""Rows of a channel by the footers of files: those that DuckDB finds, in parts of any row groups."""

from functools import partial
from pathlib import Path
from typing import BinaryIO

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage.lake.tables import ROLLUP_COLUMNS, part_writers
from storage.manifests.part import Part
from storage.sql.footers import Footers, open_local_table
from storage.sql.lake_source import LocalLake
from storage.sql.reading import rows_between
from storage.store import Store
from stream.errors import StoreError


def _opened(path: Path) -> BinaryIO:
    return path.open("rb")


@pytest.fixture
def source(tmp_path: Path) -> LocalLake:
    return LocalLake(Store.create(tmp_path / "store"), ())


def rollups(seed: int, channels: int = 40, most: int = 300) -> pa.Table:
    """Rows of channels of different lengths, each in the order of time."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, most, channels)
    channel = np.repeat(np.sort(rng.integers(-(2**63), 2**63 - 1, channels)), lengths)
    bucket = np.concatenate([np.sort(rng.choice(10_000, n, replace=False)) for n in lengths])
    mean = rng.normal(size=channel.size)
    columns = [channel, bucket, rng.integers(1, 9, channel.size), mean, np.abs(mean), mean - 1.0, mean + 1.0]
    return pa.Table.from_arrays(
        [*map(pa.array, columns), pa.array(np.zeros(channel.size, bool))], schema=ROLLUP_COLUMNS
    )


@pytest.mark.parametrize("group_rows", [1, 7, 100, 1_000_000])
def test_rows_are_those_of_a_statement(tmp_path: Path, source: LocalLake, group_rows: int) -> None:
    table = rollups(group_rows, channels=12, most=40)
    path = tmp_path / "rollup_1s.parquet"
    pq.write_table(table, path, row_group_size=group_rows, write_page_checksum=True)
    for channel in table.column("channel").unique().to_pylist()[::4]:
        for first, stop in ((0, 10_000), (2_000, 2_001), (4_000, 7_000), (9_999, 20_000), (5, 5)):
            found = rows_between(source, str(path), channel, "bucket", (first, stop), ("bucket", "n", "mean"))
            rows = list(zip(*(column.tolist() for column in found), strict=True))
            assert (
                rows
                == duckdb.execute(
                    "select bucket, n, mean from read_parquet($path) where channel = $channel and bucket >= $first "
                    "and bucket < $stop order by bucket",
                    {"path": str(path), "channel": channel, "first": first, "stop": stop},
                ).fetchall()
            )


def test_a_part_has_rollups_in_row_groups_of_few_channels(tmp_path: Path) -> None:
    table = rollups(3, channels=300, most=1_000)
    with part_writers(tmp_path) as writer:
        writer("rollup_1s").write_all([table])
    _, footer = open_local_table(tmp_path / "rollup_1s.parquet")
    assert footer.groups == -(-table.num_rows // 16_384) > 1
    channel = table.column("channel")[0].as_py()
    assert [group for group, _ in footer.groups_with(channel)] == [0]


def test_another_file_in_its_place_has_a_footer_of_its_own(tmp_path: Path, source: LocalLake) -> None:
    path = tmp_path / "rollup_1s.parquet"
    for seed in (1, 2):
        table = rollups(seed)
        pq.write_table(table, tmp_path / "new.parquet")
        (tmp_path / "new.parquet").rename(path)
        channel = table.column("channel")[-1].as_py()
        (n,) = rows_between(source, str(path), channel, "bucket", (0, 10_000), ("n",))
        assert n.size == sum(each == channel for each in table.column("channel").to_pylist())


@pytest.mark.parametrize("at", [0.3, 0.999])
def test_damage_of_a_file_whose_footer_is_known_is_found(tmp_path: Path, source: LocalLake, at: float) -> None:
    path = tmp_path / "rollup_1s.parquet"
    table = rollups(5)
    pq.write_table(table, path, write_page_checksum=True)
    channel = table.column("channel")[0].as_py()
    columns = ("bucket", "n", "mean", "m2", "lo", "hi")
    assert rows_between(source, str(path), channel, "bucket", (0, 10_000), columns)
    content = bytearray(path.read_bytes())
    content[int(at * len(content))] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(StoreError, match="gyrofleet verify"):
        rows_between(source, str(path), channel, "bucket", (0, 10_000), columns)
    path.unlink()
    with pytest.raises(StoreError, match="gyrofleet verify"):
        rows_between(source, str(path), channel, "bucket", (0, 10_000), columns)


def test_no_more_footers_are_kept_than_there_is_room_for(tmp_path: Path) -> None:
    kept, opened = Footers(most_groups=100), 0
    paths = [tmp_path / f"{number}.parquet" for number in range(5)]
    for number, path in enumerate(paths):
        pq.write_table(rollups(number, channels=2, most=41), path, row_group_size=1)
    for path in (*paths, *paths):
        table, footer = kept.open_table(path, path, partial(Path, path), partial(_opened, path), "")
        assert table.num_row_groups == footer.groups > 0
        opened += footer.groups
        assert kept._groups <= 100
        assert kept._groups == sum(each.groups for each in kept._kept.values())
    assert opened > 100


@pytest.mark.parametrize("places", [60, pytest.param(None, marks=pytest.mark.long)])
def test_no_changed_byte_of_a_footer_leaves_rows_out(tmp_path: Path, places: int | None) -> None:
    store = Store.create(tmp_path / "store")
    folder = store.lake / "00000001"
    folder.mkdir(parents=True)
    table = rollups(9, channels=12, most=40)
    with part_writers(folder) as writer:
        file = writer("rollup_1s").write_all([table])
    parts = [Part(name="00000001", segments=("a",), files={"rollup_1s.parquet": file}, samples=1)]
    path = folder / "rollup_1s.parquet"
    content = path.read_bytes()
    length = int.from_bytes(content[-8:-4], "little")
    assert file.footer
    channel = table.column("channel")[0].as_py()
    rng = np.random.default_rng(4)
    for at in rng.choice(length + 8, length + 8 if places is None else places, replace=False):
        damage = bytearray(content)
        damage[-1 - at] ^= 1 << rng.integers(8)
        path.write_bytes(damage)
        with pytest.raises(StoreError, match=r"rollup_1s\.parquet cannot be read"):
            rows_between(LocalLake(store, parts), str(path), channel, "bucket", (0, 10_000), ("bucket", "n"))
