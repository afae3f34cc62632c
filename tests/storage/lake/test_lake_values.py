"""A lake whose values were changed, and whose hashes were made to fit, is found: its rows are compared with the log."""

import errno
import os
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from storage.check import lake_values
from storage.check.lake_values import value_findings
from storage.check.verify_lake import lake_problems
from storage.lake.builder import builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from storage.lake.tables import footer_digest
from storage.manifests.lake import read_manifest, write_manifest
from storage.manifests.part import read_part, write_part
from storage.segments.disk import sha256_of
from storage.store import Store
from tests.storage.conftest import Filler, fill_days
from tests.storage.lake.exported_views import LATER_NS
from tests.storage.lake.test_compaction import add_documents
from tests.storage.lake.test_compaction import documented as documented

# of each table a change that an answer would show
CHANGES: dict[str, tuple[str, float | str]] = {
    "samples": ("above", 50), "channels": ("scale", 0.25), "rollup_1s": ("mean", 1e-3), "rollup_10s": ("lo", -1.0),
    "events": ("document", "NoteAdded"), "estimates": ("value", 0.01), "clocks": ("delay_least_ns", 1),
}  # fmt: skip


def forge(store: Store, part: str, table: str, change: Callable[[pa.Table], pa.Table]) -> None:
    """Write a table of a part again, with the hashes that belong to it."""
    folder = store.lake / part
    path = folder / f"{table}.parquet"
    pq.write_table(change(pq.read_table(path)), path, compression="zstd")
    with path.open("rb") as file:
        footer = footer_digest(file)

    def with_file(described: Any) -> Any:
        fitting = {"bytes": path.stat().st_size, "sha256": sha256_of(path), "footer": footer}
        files = described.files | {path.name: msgspec.structs.replace(described.files[path.name], **fitting)}
        return msgspec.structs.replace(described, files=files)

    write_part(folder, with_file(read_part(folder)))
    manifest = read_manifest(store, with_sources=True)
    parts = tuple(with_file(each) if each.name == part else each for each in manifest.parts)
    write_manifest(store, msgspec.structs.replace(manifest, parts=parts))


def changed(table: pa.Table, *, column: str, by: float | str) -> pa.Table:
    """The table with another value in a row of that column."""
    values = table.column(column).to_pylist()
    at = next(index for index in range(len(values) // 2, len(values)) if values[index] is not None)
    values[at] = values[at].replace(by, "x") if isinstance(by, str) else values[at] + by
    place = table.schema.get_field_index(column)
    return table.set_column(place, table.schema.field(place), pa.array(values, table.schema.field(place).type))


def added(table: pa.Table, column: str) -> pa.Table:
    """The table with another column, without values."""
    return table.append_column(column, pa.nulls(table.num_rows, pa.int64()))


def part_with(store: Store, table: str) -> str:
    """The first part that has rows of a table."""
    return next(each.name for each in read_manifest(store).parts if each.files[f"{table}.parquet"].rows)


def merged_of(filler: Filler) -> Store:
    """A store whose days are one part each."""
    filler.build()
    with builder_lock(filler.store):
        list(compact(Lake(filler.store), now_ns=LATER_NS))
    return filler.store


@pytest.fixture(scope="module")
def merged_store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Made once; tests change copies of it."""
    filler = add_documents(fill_days(Filler(tmp_path_factory.mktemp("merged") / "store"), 4))
    store = merged_of(filler)
    filler.release()
    return store


@pytest.fixture
def merged(merged_store: Store, tmp_path: Path) -> Store:
    return Store.open(shutil.copytree(merged_store.folder, tmp_path / "merged"))


def test_a_lake_that_was_not_touched_has_the_values_of_the_log(documented: Filler) -> None:
    documented.build()
    assert list(value_findings(documented.store)) == []
    store = merged_of(documented)
    for table in CHANGES:
        forge(store, part_with(store, table), table, lambda rows: rows)
    assert list(value_findings(store)) == [], "the same rows in other files"


@pytest.mark.in_gate("all")
@pytest.mark.parametrize("tables", [tuple(CHANGES), *((each,) for each in CHANGES)], ids=["all", *CHANGES])
def test_a_changed_value_is_found_in_each_table(merged: Store, tables: tuple[str, ...]) -> None:
    """In all of them at once; in the long form in each alone."""
    paths = set()
    for table in tables:
        part = part_with(merged, table)
        column, by = CHANGES[table]
        forge(merged, part, table, partial(changed, column=column, by=by))
        paths.add(str(merged.lake / part / f"{table}.parquet"))
    assert list(lake_problems(merged)) == [], "the hashes fit"
    found = list(value_findings(merged))
    assert sorted((each.kind, each.where) for each in found) == sorted(("lake_differs", path) for path in paths)
    assert all(each.what.startswith(("1 of its rows", "2 of its rows")) for each in found)


@pytest.mark.in_gate("events")
@pytest.mark.parametrize("table", ["samples", "events", "rollup_1s"])
def test_a_row_that_is_lost_or_there_twice_is_found(merged: Store, table: str) -> None:
    part = part_with(merged, table)
    forge(merged, part, table, lambda rows: rows.slice(1))
    assert [each.kind for each in value_findings(merged)] == ["lake_differs"]
    forge(merged, part, table, lambda rows: pa.concat_tables([rows, rows.slice(rows.num_rows - 1)]))
    assert [each.kind for each in value_findings(merged)] == ["lake_differs"]


@pytest.mark.long
def test_two_values_exchanged_are_found(merged: Store) -> None:
    part = read_manifest(merged).parts[0].name

    def exchanged(rows: pa.Table) -> pa.Table:
        above = np.array(rows.column("above"))
        first, second = 100, 100 + int(np.argmax(above[100:] != above[100]))
        above[[first, second]] = above[[second, first]]
        place = rows.schema.get_field_index("above")
        return rows.set_column(place, rows.schema.field(place), pa.array(above, pa.int32()))

    forge(merged, part, "samples", exchanged)
    (finding,) = value_findings(merged)
    assert "2 of its rows" in finding.what


def test_the_command_says_what_was_compared(merged: Store, gyrofleet: Any) -> None:
    forge(merged, read_manifest(merged).parts[0].name, "samples", partial(changed, column="above", by=50))
    plain = gyrofleet("verify", "--store", merged.folder)
    assert plain.code == 0
    assert "its values not compared with the log: --values" in plain.out
    done = gyrofleet("verify", "--store", merged.folder, "--values", "--json")
    assert (done.code, done.json["sound"], done.json["has_values"]) == (1, False, True)
    assert [each["kind"] for each in done.json["findings"]] == ["lake_differs"]


TAKEN = {"channels": "scale", "events": "document", "samples": "flags"}  # from each table a column


def test_a_column_that_is_taken_away_is_found(merged: Store) -> None:
    """A part of this version has all columns; one of a version before is compared in those that it has."""
    parts = {table: part_with(merged, table) for table in TAKEN}

    def found() -> dict[str, str]:
        findings = list(value_findings(merged))
        assert len(findings) == len(TAKEN)
        return {Path(each.where).stem: each.what for each in findings}

    for table, column in TAKEN.items():
        forge(merged, parts[table], table, partial(pa.Table.drop_columns, columns=[column]))
    others = found()
    assert others.keys() == TAKEN.keys()
    assert all(others[table].startswith(f"its columns are others ({column})") for table, column in TAKEN.items())
    for table, column in TAKEN.items():
        forge(merged, parts[table], table, partial(added, column=column.upper()))
    others = found()  # SQL reads it whatever its case
    assert others.keys() == TAKEN.keys()
    for table, column in TAKEN.items():
        assert others[table].startswith(f"its columns are others ({column}, {column.upper()})")


def test_a_flag_of_a_channel_is_compared_where_a_part_is_of_one_segment(documented: Filler) -> None:
    documented.build()
    store, part = documented.store, read_manifest(documented.store).parts[0].name
    place = pa.array([True])

    def flipped(rows: pa.Table) -> pa.Table:
        at = rows.schema.get_field_index("overlapping")
        flags = pa.concat_arrays([place, rows.column("overlapping").combine_chunks()[1:]])
        return rows.set_column(at, rows.schema.field(at), flags)

    for table in CHANGES:
        forge(store, part, table, lambda rows: rows)
    assert list(value_findings(store)) == [], "the same rows in other files"
    forge(store, part, "channels", flipped)
    assert [each.kind for each in value_findings(store)] == ["lake_differs"]


def test_a_part_that_cannot_be_built_is_not_called_sound(merged: Store, monkeypatch: pytest.MonkeyPatch) -> None:

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(lake_values, "build_part", full)
    found = list(value_findings(merged))
    assert {(each.kind, each.severity.value) for each in found} == {("lake_not_compared", "unfinished")}
    assert len(found) == len(read_manifest(merged).parts)


def test_parts_without_raw_rows_or_segments_are_compared_as_far_as_they_go(merged: Store) -> None:
    first, *_ = read_manifest(merged).parts
    (merged.log / f"{first.segments[0]}.mcap").rename(merged.folder / "away")
    kinds = [(each.kind, each.severity.value) for each in value_findings(merged)]
    assert kinds == [("lake_not_compared", "note")]
    assert Path(merged.folder / "away").exists()
