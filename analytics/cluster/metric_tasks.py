"""Step records and metrics by many tasks: what one task does, and how the results become those of the fleet."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import pyarrow as pa

from analytics.cluster.arrow_bytes import from_bytes, to_bytes
from analytics.cluster.engine import Done, Engine
from analytics.cluster.store_slice import StoreSlice, sliced
from analytics.evaluation.evaluation import COLUMNS, define_views, evaluate, of_units, tables_of_store
from analytics.metric_registry.registry import metrics
from analytics.step_records.step_table import Progress, records_of
from storage.sql.catalog import Catalog

# A task of metrics plans all their statements, which takes longer than to run them for a hundred units.
_UNITS_OF_VALUES = 1000


@dataclass(frozen=True)
class RecordsTask:
    """Step records of a slice: of those of its runs whose fingerprints are given."""

    of: StoreSlice
    prints: Mapping[str, str]


@dataclass(frozen=True)
class ValuesTask:
    """Metrics of a slice from its step records, and what these ask of the whole store (see `tables_of_store`)."""

    of: StoreSlice
    names: tuple[str, ...]
    steps: bytes
    of_store: Mapping[str, bytes]


def compute_records(task: RecordsTask) -> bytes:
    """Step records of a slice's units."""
    with task.of.open() as catalog:
        return to_bytes(of_units(records_of(catalog, list(task.prints), task.prints, None), task.of.units))


def compute_values(task: ValuesTask) -> bytes:
    """Metrics of a slice's units."""
    with task.of.open() as catalog, catalog.suspended_layers():
        define_views(catalog, from_bytes(task.steps), {n: from_bytes(each) for n, each in task.of_store.items()})
        return to_bytes(of_units(evaluate(catalog, [metrics()[name] for name in task.names]), task.of.units))


T = TypeVar("T", RecordsTask, ValuesTask)


def _steps_of(catalog: Catalog, units: Sequence[str]) -> bytes:
    catalog.put("units_of_task", pa.table({"unit": pa.array(units, pa.string())}))
    return to_bytes(catalog.table("from internal.step_records where unit in (from internal.units_of_task)"))


class ClusterComputation:
    """Step records and metrics by the tasks of an engine; see `Computation`.

    Parameters
    ----------
    engine : Engine
        Runs the tasks.
    on_done : Done
        Called with how many of how many units are done.
    """

    def __init__(self, engine: Engine, on_done: Done) -> None:
        self._engine, self._on_done = engine, on_done

    def records(
        self, catalog: Catalog, runs: list[str], prints: Mapping[str, str], _progress: Progress | None
    ) -> pa.Table:
        """Step records of runs; a task has at most 100 units, and of the lake the parts that have these runs."""
        catalog.put("records_runs", pa.table({"run": pa.array(runs, pa.string())}))
        sql = (
            "select distinct unit from steps where outcome = 'completed' and excluded is null "
            "and run in (select run from internal.records_runs)"
        )
        units = [unit for (unit,) in catalog.rows(sql)]
        slices = sliced(catalog, units, self._engine.slots, runs=runs)
        tasks = [RecordsTask(each, {run: prints[run] for run in each.runs if run in prints}) for each in slices]
        found = self._map(compute_records, tasks)
        return pa.concat_tables(found) if found else records_of(catalog, [], {}, None)

    def values(self, catalog: Catalog, units: list[str], names: Collection[str]) -> pa.Table:
        """These metrics of units; a task has at most 1000."""
        of_store = {name: to_bytes(table) for name, table in tables_of_store(catalog).items()}
        tasks = [
            ValuesTask(each, tuple(sorted(names)), _steps_of(catalog, each.units), of_store)
            for each in sliced(catalog, units, self._engine.slots, most=_UNITS_OF_VALUES, rounds=1)
        ]
        return pa.concat_tables([COLUMNS.empty_table(), *self._map(compute_values, tasks)])

    def _map(self, work: Callable[[T], bytes], tasks: Sequence[T]) -> list[pa.Table]:
        sizes = [len(each.of.units) for each in tasks]
        return [from_bytes(each) for each in self._engine.map(work, tasks, sizes, self._on_done)]
