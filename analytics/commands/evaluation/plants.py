"""What a command asks of one store, asked of every plant of a fleet store."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from stream.errors import BadInput, NotFound

if TYPE_CHECKING:
    from storage.sql.catalog import Catalog
    from storage.store import Store

T = TypeVar("T")
Row = dict[str, Any]


def of_plants(at: "Path | Store", ask: "Callable[[Catalog], T]", *, quiet: bool) -> list[tuple[str, T]]:
    """The answer of a store, with an empty name; of a fleet store that of each plant, computed from it alone.

    NotFound of a plant is raised only if every plant raises it.
    """
    from analytics.commands.evaluation.metrics import opened_catalog
    from storage.fleet_store import FleetStore, is_fleet

    if not isinstance(at, Path) or not is_fleet(at):
        with opened_catalog(at, quiet=quiet) as catalog:
            return [("", ask(catalog))]
    found: list[tuple[str, T]] = []
    missing = []
    for replica in FleetStore.open(at).replicas():
        with opened_catalog(replica.store.folder, quiet=quiet) as catalog:
            try:
                found.append((replica.plant.name, ask(catalog)))
            except NotFound as error:
                missing.append(f"plant {replica.plant.name}: {error}")
    if missing and not found:
        raise NotFound("; ".join(missing))
    return found


def with_plant(plant: str, rows: Iterable[Row]) -> list[Row]:
    """Rows with their plant as the first column; unchanged where they are of a store alone.

    >>> with_plant("a", [{"unit": "U1"}]), with_plant("", [{"unit": "U1"}])
    ([{'plant': 'a', 'unit': 'U1'}], [{'unit': 'U1'}])
    """
    return [{"plant": plant, **row} for row in rows] if plant else list(rows)


def named(row: Row, column: str) -> str:
    """A name for people, with the plant where the row has one.

    >>> named({"plant": "a", "unit": "U1"}, "unit"), named({"unit": "U1"}, "unit")
    ('a/U1', 'U1')
    """
    return f"{row['plant']}/{row[column]}" if "plant" in row else str(row[column])


def check_one_store(at: "Path | Store", option: str) -> None:
    """Refuse an option that is of one store, for a fleet store."""
    from storage.fleet_store import is_fleet

    if isinstance(at, Path) and is_fleet(at):
        raise BadInput(f"{option} asks one store: --store {at}/plants/NAME")
