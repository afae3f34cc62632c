"""SQL over a fleet store: the tables of every plant's store, with the plant as their first column.

Each plant has a catalogue file of its own, made from its store alone: the views of its lake, and the tables of layers
as tables in the schema `fleet`. So nothing that is computed for one plant sees another one, and equal names of units
and runs in two plants stay apart. (A view of an attached file would look for tables without a schema here first.)
"""

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

import duckdb
import msgspec

from storage.sql.catalog import Catalog
from storage.sql.deferred import DeferredDefinitions
from storage.sql.sandbox.guard import plain_message
from storage.sql.views import VIEWS, conversion_macros
from storage.store import Store
from stream.errors import StoreError

_ADEV = """
create macro adev(wanted_unit, wanted_signal) as table
select plant, run, tau_s, value, lo, hi, unit_of_measure, edf, n, "time", final, 'strided' as overlap
from estimates
where unit = wanted_unit and signal = wanted_signal and estimator = 'allan_deviation' and reason is null
qualify t_ns = max(t_ns) over (partition by plant, run)
order by plant, run, tau_s
"""


class PlantFile(msgspec.Struct, frozen=True):
    """The catalogue file of a plant: where it is, the lake that it reads, and notes on what it lacks."""

    plant: str
    file: str
    lake: str
    notes: tuple[str, ...] = ()


class FleetCatalog(Catalog):
    """A catalogue of all plants of a fleet store, from their files; users' statements only.

    Parameters
    ----------
    folder : Path
        The fleet store.
    plants : sequence of PlantFile
        At least one.
    tables : sequence of str
        Tables of layers that the files have.
    memory_bytes : int or None
        See `Catalog`.
    """

    def __init__(
        self, folder: Path, plants: Sequence[PlantFile], tables: Sequence[str], *, memory_bytes: int | None = None
    ) -> None:  # fmt: skip
        self.store, self.progress, self.kept, self.frozen = Store(folder, ""), None, folder, True
        self.parts, self._unfilled, self._live, self._has_views = (), [], None, True
        self._deferred, self._defining = DeferredDefinitions(self._run_definition), threading.RLock()
        self._notes, self._known_to_read = tuple(note for each in plants for note in each.notes), set()
        self._connection = duckdb.connect(":memory:")
        try:
            self._define(plants, {**dict.fromkeys(VIEWS, "main"), **dict.fromkeys(tables, "fleet")})
        except duckdb.Error as error:
            self._connection.close()
            raise StoreError(f"the catalogues of {folder} cannot be read: {plain_message(error)}") from error
        lakes = ", ".join(_quoted(each.lake) for each in plants)
        self._connection.execute(f"set allowed_directories = [{lakes}]")
        if memory_bytes is not None:
            self._connection.execute(f"set memory_limit = '{memory_bytes}B'; set temp_directory = ''")
        self._connection.execute("set enable_external_access = false; set python_enable_replacements = false")
        self._connection.execute("set lock_configuration = true")

    def prepare(self, sql: str) -> tuple[str, ...]:
        """Check a user's statement; returns notes on what the plants' lakes lack."""
        super().prepare(sql)
        return self._notes

    def _define(self, plants: Sequence[PlantFile], tables: Mapping[str, str]) -> None:
        """`tables` are names, each with its schema in the files."""
        connection = self._connection
        connection.execute("set timezone = 'UTC'")
        for number, each in enumerate(plants):
            connection.execute(f"attach {_quoted(each.file)} as plant_{number} (read_only)")
        for table, schema in tables.items():
            selects = (
                f'select {_quoted(each.plant)} as plant, * from plant_{number}.{schema}."{table}"'  # noqa: S608
                for number, each in enumerate(plants)
            )
            connection.execute(f'create view "{table}" as {" union all by name ".join(selects)}')
        comments = connection.execute(
            "select view_name, comment from duckdb_views() where database_name = 'plant_0' and schema_name = 'main' "
            "union all select table_name, comment from duckdb_tables() where database_name = 'plant_0' and "
            "schema_name = 'main'"
        ).fetchall()
        for name, comment in comments:
            if name in tables and comment:
                connection.execute(f'comment on view "{name}" is {_quoted(comment)}')
        units = " union ".join(
            f"select unit_of_measure from plant_{number}.internal.lake_channels"  # noqa: S608
            for number in range(len(plants))
        )
        connection.execute(conversion_macros(unit for (unit,) in connection.execute(units).fetchall()))
        connection.execute(_ADEV)


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
