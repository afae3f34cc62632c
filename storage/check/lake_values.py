"""The values of the lake compared with the log: each part is built again from its segments, outside the store."""

import filecmp
import secrets
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import duckdb
import pyarrow as pa

from storage.findings import Finding, Severity
from storage.lake.part import build_part
from storage.lake.tables import COLUMNS_VERSION, SAMPLES_FILE, TABLES, open_table
from storage.manifests.lake import read_manifest
from storage.manifests.part import Part
from storage.sql.sandbox.guard import plain_message
from storage.store import Store
from stream.errors import StoreError

# sums may differ in their last bits between two computers
_SUMS = {"mean", "m2"}
_RELATIVE = 1e-9
# of a channel that several segments have, one row is made of theirs; the rest of its columns says what it is
_MERGED = {
    "samples": "sum", "seq_first": "min", "seq_next": "max", "t_first_ns": "min", "t_last_ns": "max",
    "arrival_first_ns": "min", "arrival_last_ns": "max", "irregular": "bool_or", "dt_ns": "min",
}  # fmt: skip
_NOT_OF_SEGMENTS = {"overlapping"}  # what two segments together show
_AGAIN = "repair that, and run `gyrofleet verify --values` again"
_REMEDY = "build the lake from the log again: `gyrofleet rebuild`"


def value_findings(store: Store, progress: Callable[[float], None] = lambda _done: None) -> Iterator[Finding]:
    """Parts of the lake whose rows are not those that this version makes of their segments.

    It takes as long as building the lake, and as much space in the folder for temporary files as its largest part.
    Parts whose segments the log no longer has are noted. Where it has them, and they cannot be built, as on a full
    disk, the store is not sound.
    """
    parts = read_manifest(store, with_sources=True).parts
    with duckdb.connect() as connection:
        connection.execute("set threads = 1; set preserve_insertion_order = false; set enable_object_cache = false")
        for number, part in enumerate(parts):
            yield from _findings_of(store, part, connection)
            progress((number + 1) / len(parts))


def _findings_of(store: Store, part: Part, connection: duckdb.DuckDBPyConnection) -> Iterator[Finding]:
    where = store.lake / part.name
    with tempfile.TemporaryDirectory(prefix="gyrofleet-verify-") as folder:
        try:
            without = None if part.dropped is None else part.dropped.document
            fresh = [
                build_part(
                    store.log / f"{segment}.mcap", Path(folder) / segment, segment, store=store.identity,
                    without_raw=without,
                ).folder
                for segment in part.segments
            ]  # fmt: skip
        except (StoreError, OSError) as error:
            what = f"its values were not compared with the log: {error}"
            is_there = all((store.log / f"{segment}.mcap").exists() for segment in part.segments)
            severity = Severity.UNFINISHED if is_there else Severity.NOTE
            yield Finding("lake_not_compared", severity, str(where), what, _AGAIN if is_there else "")
            return
        for name in TABLES:
            file = f"{name}.parquet"
            if file == SAMPLES_FILE and part.dropped is not None:
                continue
            try:
                paths = [each / file for each in fresh]
                lacking, others = _other_columns(where / file, name)
                if others or (lacking and part.columns >= COLUMNS_VERSION):
                    what = f"its columns are others ({', '.join(lacking + others)}): its file was written again since"
                    yield Finding("lake_differs", Severity.DAMAGE, str(where / file), what, _REMEDY)
                    continue
                if lacking:
                    what = (
                        f"it has no column {', '.join(lacking)}, as one of an earlier version: the others are compared"
                    )
                    yield Finding("lake_not_compared", Severity.NOTE, str(where / file), what)
                differing = _differing(connection, where / file, paths, name)
            except (duckdb.Error, pa.ArrowException, OSError) as error:
                what = f"its values were not compared with the log: {plain_message(error)}"
                yield Finding("lake_not_compared", Severity.DAMAGE, str(where / file), what, _REMEDY)
                continue
            if differing:
                what = f"{differing:,} of its rows are not those that the log gives: its files were written again since"
                yield Finding("lake_differs", Severity.DAMAGE, str(where / file), what, _REMEDY)


def _other_columns(kept: Path, table: str) -> tuple[list[str], list[str]]:
    """Columns that a file should have and has not, and those that it has beyond them; in these letters."""
    with open_table(kept) as file:
        found = list(file.schema_arrow.names)
    known = list(TABLES[table].names)
    return [name for name in known if name not in found], [name for name in found if name not in known]


def _differing(connection: duckdb.DuckDBPyConnection, kept: Path, fresh: list[Path], table: str) -> int:
    """How many rows of a table are in one of both alone, at least; 0 where none is."""
    if len(fresh) == 1 and filecmp.cmp(kept, fresh[0], shallow=False):  # a statement on each takes much longer
        return 0
    connection.execute("drop view if exists kept; drop view if exists fresh")
    for name, paths in (("kept", [kept]), ("fresh", fresh)):
        files = ", ".join("'" + str(each).replace("'", "''") + "'" for each in paths)
        connection.execute(f"create or replace view {name}_rows as from read_parquet([{files}], union_by_name = true)")
    named = {column for column, *_ in connection.execute("describe kept_rows").fetchall()}
    columns = [column for column in TABLES[table].names if column in named]  # an older part has fewer
    for name in ("kept", "fresh"):
        rows = _rows(table, columns, f"{name}_rows", is_merged=len(fresh) > 1)
        connection.execute(f"create view {name} as {rows}")
    if table in {"rollup_1s", "rollup_10s"}:
        return _differing_sums(connection, columns)
    # a sum over rows in any order, under a number that nobody knows before: no other rows are made to have it
    salt = secrets.randbits(62)
    sums = ", ".join(
        f"(select (count(*), sum(hash({salt}, r)::hugeint)) from {name} r)"  # noqa: S608
        for name in ("kept", "fresh")
    )
    before, after = connection.execute(f"select {sums}").fetchone() or (None, None)
    if before == after:
        return 0
    found = connection.execute(
        "select greatest((select count(*) from (from kept except all from fresh)),"
        " (select count(*) from (from fresh except all from kept)))"
    ).fetchone()
    assert found is not None
    return int(found[0])


def _rows(table: str, columns: list[str], source: str, *, is_merged: bool) -> str:
    """The statement of a table's rows in the form in which they are compared."""
    if table == "samples":
        kept = ", ".join(column for column in columns if column not in {"base", "above"})
        return f"select {kept}, base + above as counts from {source}"  # noqa: S608
    if table != "channels" or not is_merged:
        return f"select {', '.join(map(_quoted, columns))} from {source}"  # noqa: S608
    about = [_quoted(column) for column in columns if column not in _MERGED.keys() | _NOT_OF_SEGMENTS]
    merged = [f"{how}({column}) as {column}" for column, how in _MERGED.items() if column in columns]
    return f"select {', '.join([*about, *merged])} from {source} group by {', '.join(about)}"  # noqa: S608


def _quoted(column: str) -> str:
    return f'"{column}"'


def _differing_sums(connection: duckdb.DuckDBPyConnection, columns: list[str]) -> int:
    """Rows of rollups without a like one on the other side, in which only the last bits of sums differ."""
    same = [column for column in columns if column not in _SUMS]
    left, right = (
        f"select *, row_number() over (partition by {', '.join(same)} order by mean, m2) as place from {side}"  # noqa: S608
        for side in ("kept", "fresh")
    )
    near = " and ".join(
        f"(k.{each} is not distinct from f.{each} or abs(k.{each} - f.{each}) <= {_RELATIVE} * greatest(abs(k.{each}), "
        f"abs(f.{each}), {_scale(each)}))"
        for each in sorted(_SUMS)
    )
    keys = ", ".join([*same, "place"])
    found = connection.execute(
        f"select count(*) from ({left}) k full join ({right}) f using ({keys}) where not coalesce({near}, false)"  # noqa: S608
    ).fetchone()
    assert found is not None
    return int(found[0])


def _scale(column: str) -> str:
    """What the rounding of a sum goes by, where the sum itself is small beside what was added."""
    span = "greatest(abs(k.lo), abs(k.hi))"
    return span if column == "mean" else f"k.n * {span} * {span} * 1e-6"
