"""The lake as tables of Apache Iceberg, for other engines: its own Parquet files, and nothing copied."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

from pyiceberg.catalog import Catalog, load_catalog
from pyiceberg.catalog.sql import SqlCatalog
from pyiceberg.exceptions import CommitFailedException, NoSuchTableError
from pyiceberg.io.pyarrow import parquet_file_to_data_file
from pyiceberg.manifest import DataFile
from pyiceberg.table import Table, TableProperties
from sqlalchemy.exc import SQLAlchemyError

from storage.lake.tables import TABLES, statistics_columns
from storage.manifests.lake import Manifest, read_manifest
from storage.store import Store
from stream.errors import BadInput, StoreError

CATALOG_FILE = "catalog.db"
_METRICS = "write.metadata.metrics."
_STORE, _LAKE = "gyrofleet.store", "gyrofleet.lake-number"


class ExportedTable(NamedTuple):
    """A table after an export: what it holds, and what was done to it."""

    table: str
    files: int
    rows: int
    bytes: int
    added: int  # files
    removed: int  # files of parts that were replaced, or of raw samples that were dropped
    snapshot: int | None  # the newest one; None of a table that never had a row


class Export(NamedTuple):
    """The tables of an export."""

    catalog: str
    tables: tuple[ExportedTable, ...]

    @property
    def is_changed(self) -> bool:
        """Whether a table has changed."""
        return any(each.added or each.removed for each in self.tables)


def export_iceberg(
    store: Store, warehouse: Path, *, namespace: str = "gyrofleet", catalog: str | None = None
) -> Export:
    """Bring the tables of Iceberg up to the lake as it is now; one snapshot for each table that has changed.

    Parameters
    ----------
    store : Store
        Whose lake it is; its Parquet files become files of the tables, by their full paths.
    warehouse : Path
        Folder of the metadata, and of the catalogue ``catalog.db``.
    namespace : str
        Of the tables in the catalogue.
    catalog : str | None
        Name of a catalogue in the configuration of pyiceberg, instead of the one in the warehouse.

    Raises
    ------
    BadInput
        The tables are those of another store, or the folder cannot be written.
    StoreError
        Another export runs, or a file of the lake is not as its manifest says.
    """
    warehouse = warehouse.resolve()
    if warehouse.is_relative_to(store.lake.resolve()):
        raise BadInput(f"--warehouse {warehouse} lies in the lake of the store: name a folder outside of it")
    manifest = read_manifest(store)
    with _writable(warehouse):
        warehouse.mkdir(parents=True, exist_ok=True)
        opened = _catalog(warehouse, catalog)
        opened.create_namespace_if_not_exists(namespace)
        exported = tuple(_export_table(store, manifest, opened, namespace, name) for name in TABLES)
    return Export(catalog or f"sqlite:///{warehouse / CATALOG_FILE}", exported)


@contextmanager
def _writable(warehouse: Path) -> Iterator[None]:
    try:
        yield
    except CommitFailedException as error:
        raise StoreError(f"another export writes the tables in {warehouse}: repeat this one ({error})") from error
    except (OSError, SQLAlchemyError) as error:
        raise BadInput(
            f"the tables in {warehouse} cannot be written: {error}; give --warehouse another folder"
        ) from error


def _catalog(warehouse: Path, name: str | None) -> Catalog:
    if name is not None:
        try:
            return load_catalog(name)
        except ValueError as error:
            raise BadInput(f"--catalog {name} is not configured: {error}; see pyiceberg's .pyiceberg.yaml") from error
    return SqlCatalog("gyrofleet", uri=f"sqlite:///{warehouse / CATALOG_FILE}", warehouse=warehouse.as_uri())


def _export_table(store: Store, manifest: Manifest, catalog: Catalog, namespace: str, name: str) -> ExportedTable:
    table = _table(store, catalog, f"{namespace}.{name}", name)
    wanted = _files_of(store, manifest, name)
    there = {_path_of(each.file_path): each for each in _data_files(table)}
    gone = [each for path, each in there.items() if path not in wanted]
    fresh = [path for path in wanted if path not in there]
    if lost := next((path for path in fresh if not path.exists()), None):
        raise StoreError(f"{lost} is missing in the lake; `gyrofleet verify` lists its damage")
    if gone or fresh:
        _commit(table, gone, fresh, {_LAKE: str(manifest.number)})
    held = list(_data_files(table))
    found = {_path_of(each.file_path): int(each.record_count) for each in held}
    if found != wanted:
        unlike = sorted(path for path in {*found, *wanted} if found.get(path) != wanted.get(path))
        raise StoreError(
            f"{unlike[0]} has {found.get(unlike[0])} rows, the lake's manifest says {wanted.get(unlike[0])}; "
            "`gyrofleet verify` lists damage of the lake"
        )
    snapshot = table.current_snapshot()
    return ExportedTable(
        name, len(held), sum(found.values()), sum(int(each.file_size_in_bytes) for each in held), len(fresh), len(gone),
        None if snapshot is None else snapshot.snapshot_id,
    )  # fmt: skip


def _table(store: Store, catalog: Catalog, identifier: str, name: str) -> Table:
    try:
        table = catalog.load_table(identifier)
    except NoSuchTableError:
        # files are the lake's: no engine may remove them with a table or an old snapshot
        properties = {_STORE: store.identity, "gc.enabled": "false", _METRICS + "default": "none"}
        properties |= {f"{_METRICS}column.{column}": "full" for column in statistics_columns(name)}
        table = catalog.create_table(identifier, TABLES[name], properties=properties)
    if (owner := table.properties.get(_STORE)) != store.identity:
        raise BadInput(
            f"{identifier} holds the lake of another store ({owner}): give --warehouse another folder, or --namespace "
            "another name"
        )
    if table.name_mapping() is None or table.schema().column_names != TABLES[name].names:  # also of an older gyrofleet
        with table.transaction() as change:
            with change.update_schema() as columns:
                columns.union_by_name(TABLES[name])
            mapping = change.table_metadata.schema().name_mapping.model_dump_json()
            change.set_properties({TableProperties.DEFAULT_NAME_MAPPING: mapping})  # the files number no fields
    return table


def _files_of(store: Store, manifest: Manifest, table: str) -> dict[Path, int]:
    """Files of a table in the lake that have rows, and how many."""
    name = f"{table}.parquet"
    lake = store.lake.resolve()
    return {
        lake / part.name / name: part.files[name].rows
        for part in manifest.parts
        if name in part.files and part.files[name].rows
    }


def _data_files(table: Table) -> Iterator[DataFile]:
    return (each.file for each in table.scan().plan_files())


def _path_of(uri: str) -> Path:
    return Path(unquote(urlsplit(uri).path))


def _commit(table: Table, gone: list[DataFile], fresh: list[Path], properties: Mapping[str, str]) -> None:
    """One snapshot, in which files are replaced at once; a reader sees all of it or nothing."""
    paths = [each.as_uri() for each in fresh]
    if not gone:
        table.add_files(paths, snapshot_properties=dict(properties), check_duplicate_files=False)
        return
    with table.transaction() as change, change.update_snapshot(dict(properties)).overwrite() as snapshot:
        for each in gone:
            snapshot.delete_data_file(each)
        for path in paths:
            snapshot.append_data_file(parquet_file_to_data_file(table.io, change.table_metadata, path))
