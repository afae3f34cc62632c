"""Users' statements over all plants of a fleet store, and the catalogue files that they read.

A file is kept in the folder `catalogue` of the fleet store, and made again once the plant's lake, its log or the
program has changed.
"""

import hashlib
import os
import re
import tempfile
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import msgspec

from storage.fleet_store import FleetStore, Replica
from storage.log.files import sealed_segments
from storage.manifests.lake import read_manifest
from storage.sql.catalog import Catalog, Layer, layers
from storage.sql.door import QueryLimits, Result, SqlDoor
from storage.sql.fleet.fleet_catalog import FleetCatalog, PlantFile
from storage.store import Store
from stream.errors import GyrofleetError, StoreError
from stream.files.atomic_file import replacement

_FOLDER = "catalogue"
_UNFINISHED_S = 86_400.0


class FleetDoor(SqlDoor):
    """Runs users' statements on all plants, each as its lake is when a statement first needs its tables."""

    def __init__(self, fleet: FleetStore, limits: QueryLimits | None = None) -> None:
        self.fleet = fleet
        self.store, self.limits, self.is_enforced = Store(fleet.folder, ""), limits or QueryLimits(), None
        self._landlock, self._scratch, self._process = True, None, None
        self._files: list[PlantFile] | None = None
        self._layers: list[Layer] = []

    def ask(self, statement: str, parameters: object = None) -> Result:
        """Run one statement with its parameters; see `SqlDoor.ask`."""
        wanted = [each for each in layers() if each in self._layers or _is_named(each, statement)]
        if self._files is None or wanted != self._layers:
            self._end()
            self._layers, self._files = wanted, self._made(wanted)
        return super().ask(statement, parameters)

    def _made(self, wanted: list[Layer]) -> list[PlantFile]:
        try:
            return plant_files(self.fleet, wanted)
        except OSError:  # a fleet store that cannot be written
            self._scratch = self._scratch or tempfile.TemporaryDirectory(prefix="gyrofleet-sql-")
            return plant_files(self.fleet, wanted, Path(self._scratch.name))

    def _setup(self) -> dict[str, object]:
        folders = [self.fleet.folder, *(Path(each.file).parent for each in self._files or ())]
        return {
            "folder": str(self.fleet.folder.resolve()), "plants": msgspec.to_builtins(self._files),
            "tables": _tables(self._layers), "readable": sorted({str(each.resolve()) for each in folders}),
        }  # fmt: skip


def opened_fleet_catalog(fleet: FleetStore) -> FleetCatalog:
    """A catalogue of all tables of all plants, in this process."""
    return FleetCatalog(fleet.folder, plant_files(fleet, layers()), _tables(layers()))


def plant_files(fleet: FleetStore, wanted: Sequence[Layer], folder: Path | None = None) -> list[PlantFile]:
    """The catalogue files of all plants with the tables of these layers, made where they are not up to date.

    StoreError if there is no plant yet; the error of a plant names it.
    """
    replicas = fleet.replicas()
    if not replicas:
        raise StoreError(f"{fleet.folder} has no plant yet; `gyrofleet replicate --from PLANT --to {fleet.folder}`")
    kept = fleet.folder / _FOLDER if folder is None else folder
    kept.mkdir(exist_ok=True)
    return [_plant_file(each, kept, wanted) for each in replicas]


def _plant_file(replica: Replica, kept: Path, wanted: Sequence[Layer]) -> PlantFile:
    name, store = replica.plant.name, replica.store
    manifest = read_manifest(store)
    sealed = {path.stem for path in sealed_segments(store)}
    state = f"{store.folder.resolve()}/{manifest.number}/{len(sealed)}/{_program()}"
    kind = "views" if not wanted else "tables" + "".join(str(layers().index(each)) for each in wanted)
    path = kept / f"{name}-{kind}-{hashlib.sha256(state.encode()).hexdigest()[:16]}.duckdb"
    if not path.exists():
        for old in _others(kept, name, kind):
            with suppress(OSError):
                old.unlink()
        own = kept / f".{path.name}.{os.getpid()}.part"  # another process may make the same
        try:
            with replacement(path, own) as fresh, Catalog(store, fresh, parts=manifest.parts) as catalog:
                catalog.define_views()
                _put_tables(catalog, _tables(wanted))
        except GyrofleetError as error:
            raise type(error)(f"plant {name}: {error}") from error
    behind = len(sealed - manifest.segments)
    notes = (f"plant {name}: {behind} segments are not in its lake yet, their rows are not shown",) if behind else ()
    return PlantFile(name, str(path.resolve()), str(store.lake.resolve()), notes)


def _put_tables(catalog: Catalog, tables: Iterable[str]) -> None:
    for number, table in enumerate(tables):
        catalog.rows(f"select 1 from {table} limit 0")  # noqa: S608  fills its layer
        made = "" if number else "create schema fleet;"
        catalog.define(f'{made} create table fleet."{table}" as from main."{table}"')


def _tables(wanted: Iterable[Layer]) -> list[str]:
    return [table for layer in wanted for table in layer.tables]


def _is_named(layer: Layer, statement: str) -> bool:
    return not set(layer.tables).isdisjoint(re.findall(r"\w+", statement.lower()))


def _others(kept: Path, name: str, kind: str) -> Iterable[Path]:
    """Files of the plant that are out of date, or were left unfinished a day ago."""
    pattern = re.compile(rf"{re.escape(name)}-{kind}-[0-9a-f]{{16}}\.duckdb")
    left = (path for path in kept.glob(".*.part*") if time.time() - path.stat().st_mtime > _UNFINISHED_S)
    return [*(path for path in kept.iterdir() if pattern.fullmatch(path.name)), *left]


@cache
def _program() -> str:
    """Changes with the files of the program that define tables."""
    digest = hashlib.sha256()
    for package in sorted({"storage", *(type(layer).__module__.partition(".")[0] for layer in layers())}):
        spec = find_spec(package)
        for root in spec.submodule_search_locations or () if spec is not None else ():
            for path in sorted(Path(root).rglob("*")):
                if path.suffix in {".py", ".sql", ".toml"}:
                    status = path.stat()
                    digest.update(f"{path}/{status.st_size}/{status.st_mtime_ns}".encode())
    return digest.hexdigest()
