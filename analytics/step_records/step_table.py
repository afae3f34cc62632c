"""The table `step_means`: reduced once for each run, kept in the store, updated where a run has changed."""

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

import pyarrow as pa

from analytics.step_records import FOLDER
from analytics.step_records.reduction import COLUMNS, reduce_runs
from storage.sql.catalog import Catalog, NotKept
from storage.sql.columns import distinct_pairs
from storage.sql.parquet_content import ParquetContent
from stream.files.atomic_file import replacement

FILE = "steps.parquet"
# Increased when the reduction gives other records than before.
_VERSION = "20"
_PRINT = "fingerprint"
_SQL = files("analytics.step_records").joinpath("step_means.sql").read_text()
_INPUTS = files("analytics.step_records").joinpath("run_inputs.sql").read_text()
_MARK = b"gyrofleet.written"

Progress = Callable[[int, int], None]
# records of some runs, see `records_of`
Reduce = Callable[[Catalog, list[str], Mapping[str, str], Progress | None], pa.Table]


def step_means(catalog: Catalog, progress: Progress | None = None) -> pa.Table:
    """Records of all completed steps of a store; those of unchanged runs are read from the kept file.

    `progress` is called with how many of how many runs have been reduced. The columns are those of ``step_means.sql``
    and `fingerprint`, the hash of what a run's records were made from.
    """
    return step_records(catalog, progress).reader().read_all()


def step_records(catalog: Catalog, progress: Progress | None = None, reduce: Reduce | None = None) -> ParquetContent:
    """The same as the content of the kept file: all records of a fleet take much more memory.

    Those of changed runs are made by `reduce`, by default `records_of`.
    """
    reduce = reduce or records_of
    prints = run_fingerprints(catalog)
    kept = kept_steps(catalog.kept)
    known = {} if kept is None else kept_prints(kept)
    fresh = {run for run, mark in known.items() if prints.get(run) == mark}
    stale = [run for run in prints if run not in fresh]
    if kept is not None and not stale and len(fresh) == len(known):
        return kept
    if catalog.frozen and (prints or kept is not None):
        raise NotKept
    tables = []
    if kept is not None and fresh:
        table = kept.reader().read_all()
        tables.append(table.filter(pa.compute.is_in(table["run"], value_set=pa.array(sorted(fresh), pa.string()))))
    if stale:
        tables.append(reduce(catalog, stale, prints, progress))
    table = pa.concat_tables(tables, promote_options="default") if tables else records_of(catalog, [], {}, None)
    table = table.sort_by([(name, "ascending") for name in ("unit", "run", "signal", "index")]).combine_chunks()
    content = ParquetContent.of(table.replace_schema_metadata({_MARK: _mark(table.schema)}))
    if not catalog.frozen:
        write_kept_content(catalog.kept / FOLDER / FILE, content.content)
    return content


def run_fingerprints(catalog: Catalog) -> dict[str, str]:
    """Hash of what the records of each run with a completed step depend on: its samples and its documents."""
    return {
        run: hashlib.sha256(f"{_VERSION}/{samples}/{documents}/{n}".encode()).hexdigest()[:32]
        for run, samples, documents, n in catalog.rows(_INPUTS)
    }


def kept_prints(kept: ParquetContent) -> dict[str, str]:
    """Fingerprints of the runs in kept records."""
    return dict(distinct_pairs(kept.file.read(columns=["run", _PRINT]), "run", _PRINT))


def records_of(catalog: Catalog, runs: Sequence[str], prints: Mapping[str, str], progress: Progress | None) -> pa.Table:
    """Records of runs, whose fingerprints are given."""
    reduced = [COLUMNS.empty_table()]
    done = 0
    for count, records in reduce_runs(catalog, runs):
        reduced.append(records)
        done += count
        if progress is not None:
            progress(done, len(runs))
    catalog.put("reduced", pa.concat_tables(reduced))
    catalog.put("reduced_runs", pa.table({"run": pa.array(runs, pa.string())}))
    table = catalog.table(_SQL)
    marks = pa.array([prints[run] for run in table["run"].to_pylist()], pa.string())
    return table.append_column(_PRINT, marks)


def kept_steps(folder: Path) -> ParquetContent | None:
    """Records kept below a folder; None where there are none of this version."""
    kept = open_kept(folder / FOLDER / FILE)
    return kept if kept is not None and kept.metadata.get(_MARK) == _mark(kept.schema) else None


def _mark(schema: pa.Schema) -> bytes:
    """Hash of the version, the SQL and the columns of the records."""
    text = f"{_VERSION}/{_SQL}/{schema.remove_metadata().to_string()}"
    return hashlib.sha256(text.encode()).hexdigest().encode()


def hash_path(path: Path) -> Path:
    """Where the hash of a kept file is."""
    return path.with_name(f"{path.name}.sha256")


def open_kept(path: Path) -> ParquetContent | None:
    """A derived table kept in the store; None where there is none, or it disagrees with its hash."""
    with suppress(OSError, pa.ArrowException):
        content = path.read_bytes()
        if hash_path(path).read_text() == hashlib.sha256(content).hexdigest():
            return ParquetContent(pa.py_buffer(content))
    return None


def read_kept(path: Path) -> pa.Table | None:
    """The same as a table, with its metadata."""
    kept = open_kept(path)
    return None if kept is None else kept.file.read()


def write_kept(path: Path, table: pa.Table) -> None:
    """Keep a table; if that fails it is recomputed the next time."""
    write_kept_content(path, ParquetContent.of(table).content)


def write_kept_content(path: Path, content: pa.Buffer) -> None:
    """Keep a table of which this is the file."""
    with suppress(OSError):
        path.parent.mkdir(exist_ok=True)
        # a reader in between finds the hash of another file, and recomputes
        _write(path, content)
        _write(hash_path(path), hashlib.sha256(content).hexdigest().encode())


def _write(path: Path, content: bytes | pa.Buffer) -> None:
    with replacement(path, path.with_name(f"{path.name}.{os.getpid()}.part")) as fresh:
        fresh.write_bytes(content)
