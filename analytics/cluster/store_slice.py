"""Slices of a store: units with all that their results depend on, and the parts of the lake that hold it."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from storage.manifests.part import Part
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import StoreError

UNITS_A_TASK = 100
# so many tasks for each that runs at the same time: more end together, but each opens its parts again
_ROUNDS = 2

# Which part has something of which unit in which run; '' stands for what is of no unit, or of no run.
_PLACES = """
create or replace table internal.unit_places as
select unit, run, filename, sum(samples)::bigint as samples from internal.lake_channel_parts group by all
union all
select coalesce(unit, ''), coalesce(run, ''), filename, 0 from internal.lake_events group by all
"""
_ALL_RUNS = "select distinct run from internal.unit_places where run <> ''"
# Instruments, the units without steps of their own, belong to all units of their runs.
_SLICES = """
create or replace table internal.slice_runs as
select distinct s.task, p.run from internal.sliced s join internal.unit_places p using (unit)
where p.run in (select run from internal.sliced_runs);
create or replace table internal.slice_seen as
select task, unit from internal.sliced
union
select r.task, p.unit from internal.slice_runs r join internal.unit_places p using (run)
where p.unit <> ''
  and (p.run, p.unit) not in (select (run, unit) from steps where outcome = 'completed' and excluded is null);
"""
_PARTS_OF_RUNS = "select r.task, p.filename from internal.unit_places p join internal.slice_runs r using (run)"
_PARTS = """
select r.task, p.filename from internal.unit_places p join internal.slice_runs r using (run)
where p.unit = '' or (r.task, p.unit) in (select (task, unit) from internal.slice_seen)
union
select s.task, p.filename from internal.unit_places p join internal.sliced s using (unit) where p.run = ''
"""
# Units that share runs follow each other.
_SIZES = """
select s.unit, coalesce(sum(p.samples) filter (p.run in (select run from internal.sliced_runs)), 0)::bigint as samples
from internal.sliced s left join internal.unit_places p using (unit) group by s.unit order by min(p.run), s.unit
"""


@dataclass(frozen=True)
class StoreSlice:
    """Some units of a store, as a task opens it.

    Parameters
    ----------
    folder, identity : str
        Of the store; the folder is the same on all machines.
    parts : tuple[Part, ...]
        Of the lake, as it was when the slice was made.
    units : tuple[str, ...]
        Whose results are computed.
    seen : tuple[str, ...] | None
        These, and the instruments of their runs; None for all units of the runs.
    runs : tuple[str, ...]
        Of these units.
    """

    folder: str
    identity: str
    parts: tuple[Part, ...]
    units: tuple[str, ...]
    seen: tuple[str, ...] | None
    runs: tuple[str, ...]

    def open(self) -> Catalog:
        """A catalogue of the slice, which reads with one thread and writes nothing."""
        store = Store.open(Path(self.folder))
        if store.identity != self.identity:
            raise StoreError(
                f"{self.folder} is another store ({store.identity}) than the one that was asked ({self.identity}): "
                "mount the same folder there"
            )
        return Catalog(store, parts=self.parts, units=self.seen, threads=1)


def sliced(
    catalog: Catalog, units: Collection[str], slots: int, *, runs: Collection[str] | None = None,
    most: int = UNITS_A_TASK, rounds: int = _ROUNDS, sees_all: bool = False,
) -> list[StoreSlice]:  # fmt: skip
    """Slices of at most `most` units for tasks of which `slots` run at the same time, the largest first.

    Of the units only what these `runs` hold is in the slices, by default all. With `sees_all` a slice has all units of
    its runs in view, for what depends on those beside.
    """
    catalog.define(_PLACES)
    catalog.put("sliced_runs", catalog.table(_ALL_RUNS) if runs is None else _names("run", runs))
    catalog.put("sliced", _numbered([sorted(units)]))
    groups = _groups({str(unit): int(samples) for unit, samples in catalog.rows(_SIZES)}, slots, most, rounds)
    catalog.put("sliced", _numbered(groups))
    catalog.define(_SLICES)
    statements = ("from internal.slice_runs", "from internal.slice_seen", _PARTS_OF_RUNS if sees_all else _PARTS)
    of_runs, seen, files = (_by_task(catalog.rows(sql)) for sql in statements)
    parts = {part.name: part for part in catalog.parts}
    store = catalog.store
    return [
        StoreSlice(
            str(store.folder.resolve()), store.identity,
            tuple(parts[name] for name in sorted({Path(file).parent.name for file in files[number]})),
            tuple(group), None if sees_all else tuple(sorted(seen[number])), tuple(sorted(of_runs[number])),
        )
        for number, group in enumerate(groups)
    ]  # fmt: skip


def _groups(sizes: Mapping[str, int], slots: int, most: int, rounds: int) -> list[list[str]]:
    """Neighbouring units, up to a share of all samples; a unit is never split.

    >>> _groups({"a": 1, "b": 1, "c": 8, "d": 1}, slots=1, most=100, rounds=4)
    [['c'], ['a', 'b'], ['d']]
    """
    share = sum(sizes.values()) / (slots * rounds)
    groups: list[list[str]] = []
    filled = 0.0
    for unit, samples in sizes.items():
        if not groups or len(groups[-1]) == most or filled + samples > share:
            groups.append([])
            filled = 0.0
        groups[-1].append(unit)
        filled += samples
    return sorted(groups, key=lambda group: -sum(sizes[unit] for unit in group))


def _by_task(rows: Iterable[tuple[int, str]]) -> defaultdict[int, set[str]]:
    found: defaultdict[int, set[str]] = defaultdict(set)
    for task, name in rows:
        found[task].add(name)
    return found


def _numbered(groups: Iterable[Iterable[str]]) -> pa.Table:
    pairs = [(number, unit) for number, group in enumerate(groups) for unit in group]
    numbers, units = [number for number, _ in pairs], [unit for _, unit in pairs]
    return pa.table({"task": pa.array(numbers, pa.int64()), "unit": pa.array(units, pa.string())})


def _names(column: str, names: Iterable[str]) -> pa.Table:
    return pa.table({column: pa.array(sorted(names), pa.string())})
