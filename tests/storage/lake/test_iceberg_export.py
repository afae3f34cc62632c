"""The lake as Iceberg tables: the same rows as pyiceberg reads them, brought up to date, with compaction in between."""

from collections.abc import Callable
from pathlib import Path

import duckdb
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from pyiceberg.catalog.sql import SqlCatalog
from pyiceberg.table import Table

from storage.lake.builder import builder_lock
from storage.lake.compaction import compact
from storage.lake.iceberg_export import Export, export_iceberg
from storage.lake.lake import Lake
from storage.lake.tables import TABLES
from storage.manifests.lake import read_manifest
from storage.store import Store
from stream.errors import BadInput, StoreError
from stream.events import NoteAdded
from tests.conftest import Outcome
from tests.storage.conftest import DAY_NS, START_NS, Filler
from tests.storage.lake.exported_views import LATER_NS


def read(warehouse: Path, name: str) -> Table:
    """A table as another program opens it."""
    return SqlCatalog("gyrofleet", uri=f"sqlite:///{warehouse / 'catalog.db'}").load_table(f"gyrofleet.{name}")


def own(store: Store, table: str) -> pa.Table:
    """Rows of a table from the lake's files, by DuckDB."""
    files = [str(store.lake / part.name / f"{table}.parquet") for part in read_manifest(store).parts]
    return duckdb.read_parquet(files).to_arrow_table()


def ordered(table: pa.Table, name: str) -> pa.Table:
    keys = [(column, "ascending") for column in TABLES[name].names]
    return table.select(TABLES[name].names).cast(TABLES[name]).sort_by(keys).combine_chunks()


def counts(found: Export) -> dict[str, tuple[int, int, int]]:
    return {each.table: (each.rows, each.added, each.removed) for each in found.tables}


@pytest.fixture
def filled(days: Filler) -> Filler:
    days.document(NoteAdded(run="r1", t_ns=START_NS, text="a note"))
    days.seal()
    days.build()
    return days


def test_tables_have_the_rows_of_the_lake(filled: Filler, tmp_path: Path) -> None:
    found = export_iceberg(filled.store, tmp_path / "W")
    assert counts(found)["samples"] == (3 * 4 * 2525, 12, 0)
    for name in ("samples", "channels", "events", "rollup_1s", "rollup_10s", "clocks"):
        table, rows = read(tmp_path / "W", name), own(filled.store, name)
        assert rows.num_rows > 0
        assert ordered(table.scan().to_arrow(), name).equals(ordered(rows, name)), name
    samples = read(tmp_path / "W", "samples").scan().to_arrow()
    assert samples.schema.field("t_ns").type == pa.int64()
    assert pc.min(samples["t_ns"]).as_py() == START_NS + 5 * 10**8  # nanoseconds, where doubles would round to 256
    assert read(tmp_path / "W", "estimates").scan().to_arrow().num_rows == 0
    assert not list((tmp_path / "W").rglob("*.parquet"))  # nothing is copied


@pytest.mark.long
def test_what_other_engines_compute_by_unit_is_the_same(filled: Filler, tmp_path: Path) -> None:
    export_iceberg(filled.store, tmp_path / "W")
    tables = {name: read(tmp_path / "W", name).scan().to_arrow() for name in ("samples", "channels")}
    samples, channels = tables["samples"], tables["channels"]
    sql = """
    select c.unit, c.signal, count(*) as n, sum(s.base + s.above)::hugeint as total, min(s.t_ns) as first_ns,
      max(s.t_ns) as last_ns, min(s.base + s.above) as lo, max(s.base + s.above) as hi
    from samples s join (select distinct channel, unit, signal from channels) c using (channel)
    group by all order by all
    """
    theirs = duckdb.execute(sql).fetchall()
    samples, channels = own(filled.store, "samples"), own(filled.store, "channels")
    assert samples.num_rows == 3 * 4 * 2525
    assert channels.num_rows == 24
    assert duckdb.execute(sql).fetchall() == theirs
    assert [row[:3] for row in theirs] == [("U1", "rate", 30_000), ("U1", "temperature", 300)]


@pytest.mark.long
def test_a_second_export_adds_only_what_is_new(filled: Filler, tmp_path: Path) -> None:
    first = export_iceberg(filled.store, tmp_path / "W")
    again = export_iceberg(filled.store, tmp_path / "W")
    assert not again.is_changed
    assert [each.snapshot for each in again.tables] == [each.snapshot for each in first.tables]
    filled.counts("rate", START_NS + 5 * DAY_NS, 100)
    filled.seal()
    filled.build()
    third = counts(export_iceberg(filled.store, tmp_path / "W"))
    assert third["samples"] == (3 * 4 * 2525 + 100, 1, 0)
    assert third["events"] == (1, 0, 0)


@pytest.mark.long
def test_parts_that_were_joined_are_replaced_in_one_snapshot(filled: Filler, tmp_path: Path) -> None:
    export_iceberg(filled.store, tmp_path / "W")
    before = ordered(read(tmp_path / "W", "samples").scan().to_arrow(), "samples")
    with builder_lock(filled.store):
        list(compact(Lake(filled.store), now_ns=LATER_NS))
        Lake(filled.store).purge(grace_s=0)
    found = counts(export_iceberg(filled.store, tmp_path / "W"))
    assert found["samples"] == (3 * 4 * 2525, 3, 12)
    table = read(tmp_path / "W", "samples")
    assert ordered(table.scan().to_arrow(), "samples").equals(before)
    assert [each.summary.operation.value for each in table.snapshots() if each.summary] == ["append", "overwrite"]
    assert len(table.inspect.files()) == 3


@pytest.mark.long
def test_raw_samples_that_were_dropped_leave_the_table(filled: Filler, tmp_path: Path) -> None:
    export_iceberg(filled.store, tmp_path / "W")
    with builder_lock(filled.store):
        lake = Lake(filled.store)
        lake.drop_raw(dict.fromkeys(lake.manifest.segments, "a document"))
    found = counts(export_iceberg(filled.store, tmp_path / "W"))
    assert found["samples"] == (0, 0, 12)
    assert found["rollup_1s"][0] > 0


@pytest.mark.long
def test_tables_of_another_store_are_refused(filled: Filler, tmp_path: Path) -> None:
    export_iceberg(filled.store, tmp_path / "W")
    other = Store.create(tmp_path / "other")
    with pytest.raises(BadInput, match="holds the lake of another store"):
        export_iceberg(other, tmp_path / "W")
    assert {each.rows for each in export_iceberg(other, tmp_path / "W", namespace="other").tables} == {0}
    with pytest.raises(BadInput, match="lies in the lake"):
        export_iceberg(filled.store, filled.store.lake / "W")


def test_a_file_that_is_not_as_the_manifest_says_is_named(filled: Filler, tmp_path: Path) -> None:
    part = read_manifest(filled.store).parts[0].name
    path = filled.store.lake / part / "samples.parquet"
    other = filled.store.lake / part / "rollup_1s.parquet"
    path.unlink()
    with pytest.raises(StoreError, match=str(path)):
        export_iceberg(filled.store, tmp_path / "W")
    assert other.exists()


@pytest.mark.long
def test_the_command(filled: Filler, tmp_path: Path, gyrofleet: Callable[..., Outcome]) -> None:
    arguments = ("export-iceberg", "--store", filled.store.folder, "--warehouse", tmp_path / "W W")
    first = gyrofleet(*arguments, "--json")
    assert (first.code, first.err) == (0, "")
    assert first.json["changed"] is True
    assert {each["table"]: each["rows"] for each in first.json["tables"]}["samples"] == 3 * 4 * 2525
    assert read(tmp_path / "W W", "samples").scan().to_arrow().num_rows == 3 * 4 * 2525
    (tmp_path / "file").write_text("no folder")
    refused = gyrofleet("export-iceberg", "--store", filled.store.folder, "--warehouse", tmp_path / "file")
    assert refused.code == 1
    assert "give --warehouse another folder" in refused.err


@pytest.mark.long
def test_the_command_says_that_nothing_is_new(
    filled: Filler, tmp_path: Path, gyrofleet: Callable[..., Outcome]
) -> None:
    arguments = ("export-iceberg", "--store", filled.store.folder, "--warehouse", tmp_path / "W W")
    assert gyrofleet(*arguments, "--json").json["changed"] is True
    assert gyrofleet(*arguments, "--json").json["changed"] is False
    assert "0 tables changed" in gyrofleet(*arguments).out
    assert read(tmp_path / "W W", "samples").scan().to_arrow().num_rows == 3 * 4 * 2525
