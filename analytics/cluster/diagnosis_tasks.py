"""Diagnosis of a fleet by many tasks: units are read, and then traced, wherever there is a free core."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Generic, TypeVar

from analytics.cluster.engine import Done, Engine
from analytics.cluster.process_engine import ProcessEngine
from analytics.cluster.store_slice import UNITS_A_TASK, StoreSlice, sliced
from analytics.loop.tracing.processors import MOST_PROCESSES
from analytics.loop.unit_reduction import Progress, Question, Read, ReadUnits, read_units, silent
from storage.sql.catalog import Catalog
from storage.store import Store

T = TypeVar("T")
R = TypeVar("R")

_ROUNDS = 4  # tasks for each that runs at the same time
_FEWEST_UNITS = 8  # fewer do not repay the start of processes


@dataclass(frozen=True)
class ReadTask:
    """Reads the units of a slice as blocks."""

    of: StoreSlice
    question: Question
    positions: Mapping[str, float]


def read_slice(task: ReadTask) -> ReadUnits:
    """Units of a slice as blocks."""
    with task.of.open() as catalog:
        for view in ("signals", "runs", "units", "steps"):
            catalog.hold(view)
        catalog.hold("events", task.of.units)
        return read_units(catalog, task.of.units, task.question, task.positions, silent)


@dataclass(frozen=True)
class _Each(Generic[T, R]):
    """Does work on each item of a task."""

    work: Callable[[T], R]

    def __call__(self, items: Sequence[T]) -> list[R]:
        return [self.work(item) for item in items]


class ClusterTracing:
    """Units read and traced by the tasks of an engine.

    Parameters
    ----------
    engine : Engine
        Runs the tasks.
    reading, tracing : Done
        Called with how many of how many units are read, and are traced.
    """

    def __init__(self, engine: Engine, reading: Done, tracing: Done) -> None:
        self._engine, self._reading, self._tracing = engine, reading, tracing

    def read(
        self, catalog: Catalog, units: Sequence[str], question: Question, positions: Mapping[str, float], _: Progress
    ) -> ReadUnits:
        """Units as blocks, see `read_units`."""
        slices = sliced(catalog, units, self._engine.slots, rounds=_ROUNDS, sees_all=True)
        tasks = [ReadTask(each, question, positions) for each in slices]
        found = self._engine.map(read_slice, tasks, [len(each.units) for each in slices], self._reading)
        reduced = {unit: each for part in found for unit, each in part.units.items()}
        models = {unit: each for part in found for unit, each in part.models.items()}
        errors = {unit: each for part in found for unit, each in part.errors.items()}
        return ReadUnits(
            {unit: reduced[unit] for unit in units if unit in reduced},
            {unit: models[unit] for unit in units if unit in models},
            {unit: errors[unit] for unit in units if unit in errors},
        )

    def spread(self, work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        """Results of work on each item, in their order."""
        size = min(UNITS_A_TASK, max(1, len(items) // (self._engine.slots * _ROUNDS)))
        tasks = [items[first : first + size] for first in range(0, len(items), size)]
        yield from chain.from_iterable(
            self._engine.map(_Each(work), tasks, [len(each) for each in tasks], self._tracing)
        )


def local_reading(store: Store, units: int, processes: int, report: Callable[[str], None]) -> Read:
    """Reads so many units of a store: by processes of this machine where that is quicker, with the same result."""
    processes = min(processes, MOST_PROCESSES)
    if units < _FEWEST_UNITS or processes < 2 or not store.is_local:
        return read_units

    def reading(done: int, total: int) -> None:
        report(f"reading: {done:,} of {total:,} units")

    report(f"reading {units:,} units by {processes} processes")
    return ClusterTracing(ProcessEngine(processes), reading, reading).read
