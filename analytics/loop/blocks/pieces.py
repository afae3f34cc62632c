"""Pieces of stored signals, of which blocks consist: a second of a rollup, or a thirty-second part of a block."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from analytics.loop.blocks.run_blocks import SECOND_NS
from storage.sql.catalog import Catalog
from storage.sql.columns import numbers
from stream.batch import FloatArray, IntArray

NumberArray = npt.NDArray[Any]


class SignalKey(NamedTuple):
    """A stored signal of one run."""

    unit: str
    signal: str
    run: str


@dataclass(frozen=True)
class Grid:
    """Blocks of a run: block b begins at t0_ns + b*block_ns; samples from first_ns to last_ns count."""

    t0_ns: int
    first_ns: int
    last_ns: int


@dataclass(frozen=True)
class Pieces:
    """Pieces of a signal of one run in the order of time; each shape (pieces,), times in ns."""

    start_ns: IntArray  # of the piece, or its first sample
    t_ns: IntArray  # mean time of its samples, see `_of_grid`
    end_ns: IntArray  # its last sample
    n: IntArray  # samples in each
    mean: FloatArray
    m2: FloatArray  # sum of squares about the mean
    lo: FloatArray
    hi: FloatArray


_WANTED = """join (
    select unnest($units) as unit, unnest($signals) as signal, unnest($runs) as run, unnest($numbers) as number,
      unnest($t0) as t0_ns, unnest($first) as first_ns, unnest($last) as last_ns
  ) w on s.unit = w.unit and s.signal = w.signal and s.run = w.run
where list_contains($all_units, s.unit) and list_contains($all_signals, s.signal) and list_contains($all_runs, s.run)"""
"""The conditions on the lists repeat what the join says, so that only the files that have these signals are read."""
_SAMPLING = """
select unit, signal, run, t_first_ns, t_last_ns, round(sample_interval_s * 1e9)::bigint from signals
where list_contains($units, unit) and list_contains($signals, signal) and list_contains($runs, run) and not irregular
"""
_ON_GRID = 0.1  # of an interval by which the last sample may leave the grid of the first

_ROLLED_UP = """
select w.number, s.t_ns as start_ns, s.t_ns + 500000000 as t_ns, s.t_ns + 1000000000 * (s.n - 1) // s.n as end_ns,
  s.n, s.mean, s.m2, s.lo, s.hi
from internal.rollup_1s_in($paths) s WANTED and s.t_ns + 1000000000 > w.first_ns and s.t_ns <= w.last_ns
"""
READINGS = """
select w.number, s.t_ns, s.value from internal.samples_in($paths) s WANTED
and s.t_ns between w.first_ns and w.last_ns and isfinite(s.value)
"""
_FROM_SAMPLES = """
select w.number, min(s.t_ns) as start_ns, avg(s.t_ns - w.t0_ns)::bigint + any_value(w.t0_ns) as t_ns,
  max(s.t_ns) as end_ns, count(*) as n, avg(s.value) as mean, var_pop(s.value) * count(*) as m2,
  min(s.value) as lo, max(s.value) as hi
from internal.samples_in($paths) s WANTED and s.t_ns between w.first_ns and w.last_ns and isfinite(s.value)
group by w.number, (s.t_ns - w.t0_ns) // $piece_ns
"""


def pieces_of(
    catalog: Catalog, grids: Mapping[SignalKey, Grid], block_ns: int, *, rolled_up: bool
) -> Iterator[tuple[SignalKey, Pieces]]:
    """Pieces of several signals, read by one statement; signals without any are left out.

    Not `rolled_up` are signals of few samples, which are put together here: to group them in SQL takes longer than to
    read them.
    """
    piece_ns = max(1, block_ns // 32)
    if not rolled_up:
        for key, columns in rows_of(catalog, READINGS, grids, "t_ns"):
            yield key, _of_readings(columns["t_ns"], columns["value"], grids[key].t0_ns, piece_ns)
        return
    whole = block_ns % SECOND_NS == 0 and all(grid.t0_ns % SECOND_NS == 0 for grid in grids.values())
    parameters = {} if whole else {"piece_ns": piece_ns}
    sampling = _sampling(catalog, grids) if whole else {}
    for key, columns in rows_of(catalog, _ROLLED_UP if whole else _FROM_SAMPLES, grids, "start_ns", parameters):
        if key in sampling:
            columns["t_ns"] = _of_grid(columns["start_ns"], columns["n"], *sampling[key])
        yield key, Pieces(**columns)


def _sampling(catalog: Catalog, keys: Iterable[SignalKey]) -> dict[SignalKey, tuple[int, int]]:
    """First sample and interval of signals whose samples lie on one grid, in ns."""
    wanted = set(keys)
    names = ("units", "signals", "runs")
    asked = {name: sorted(set(each)) for name, each in zip(names, zip(*wanted, strict=True), strict=True)}
    found = {}
    for unit, signal, run, first_ns, last_ns, interval_ns in catalog.rows(_SAMPLING, asked):
        key = SignalKey(unit, signal, run)
        if key in wanted and interval_ns:
            off = (last_ns - first_ns) / interval_ns
            if abs(off - round(off)) <= _ON_GRID:
                found[key] = int(first_ns), int(interval_ns)
    return found


def _of_grid(start_ns: IntArray, n: IntArray, first_ns: int, interval_ns: int) -> IntArray:
    """Mean times of the samples in seconds of a rollup: of those on the grid, or of half a second where some lack.

    >>> _of_grid(np.array([0, SECOND_NS]), np.array([10, 9]), 0, SECOND_NS // 10).tolist()
    [450000000, 1500000000]
    """
    before_ns = (first_ns - start_ns) % interval_ns
    full = (SECOND_NS - 1 - before_ns) // interval_ns + 1
    middle = before_ns + (n - 1) * interval_ns // 2
    return np.asarray(start_ns + np.where(n == full, middle, SECOND_NS // 2), np.int64)


def _of_readings(t_ns: IntArray, value: FloatArray, t0_ns: int, piece_ns: int) -> Pieces:
    """Pieces of readings in the order of time.

    >>> found = _of_readings(np.array([0, 3, 4, 12]), np.array([1.0, 3.0, 7.0, 7.0]), 0, 4)
    >>> found.n.tolist(), found.t_ns.tolist(), found.mean.tolist(), found.m2.tolist()
    ([2, 1, 1], [2, 4, 12], [2.0, 7.0, 7.0], [2.0, 0.0, 0.0])
    """
    piece = (t_ns - t0_ns) // piece_ns
    first = np.flatnonzero(np.diff(piece, prepend=piece[:1] - 1))
    if first.size == t_ns.size:
        one = np.ones(t_ns.size, np.int64)
        return Pieces(t_ns, t_ns, t_ns, one, value, np.zeros(t_ns.size), value, value)
    n = np.diff(first, append=t_ns.size)
    mean = np.add.reduceat(value, first) / n
    m2 = np.add.reduceat((value - np.repeat(mean, n)) ** 2, first)
    start = t_ns[first]
    about = np.add.reduceat(t_ns - np.repeat(start, n), first) / n
    lo, hi = np.minimum.reduceat(value, first), np.maximum.reduceat(value, first)
    return Pieces(start, start + np.round(about).astype(np.int64), t_ns[first + n - 1], n, mean, m2, lo, hi)


def rows_of(
    catalog: Catalog,
    sql: str,
    grids: Mapping[SignalKey, Grid],
    order: str,
    parameters: Mapping[str, object] = MappingProxyType({}),
) -> Iterator[tuple[SignalKey, dict[str, NumberArray]]]:
    """Rows of several signals, read by one statement, by signal; signals without any are left out.

    Parameters
    ----------
    sql: Selects ``w.number`` and other numbers of a table ``s``; its ``WANTED`` is the join with the signals ``w``.
    order: The column by which the rows of a signal are ordered.
    """
    keys = list(grids)
    wanted = {
        "paths": catalog.checked_paths_of((key.run for key in keys), sql),
        "units": [key.unit for key in keys],
        "signals": [key.signal for key in keys],
        "runs": [key.run for key in keys],
        "all_units": sorted({key.unit for key in keys}),
        "all_signals": sorted({key.signal for key in keys}),
        "all_runs": sorted({key.run for key in keys}),
        "numbers": list(range(len(keys))),
        "t0": [grids[key].t0_ns for key in keys],
        "first": [grids[key].first_ns for key in keys],
        "last": [grids[key].last_ns for key in keys],
    }
    table = catalog.reader(sql.replace("WANTED", _WANTED), {**wanted, **parameters}).read_all()
    columns = {name: numbers(table.column(name)) for name in table.column_names}
    number = columns.pop("number")
    ordered = np.argsort(number, kind="stable")
    edges = np.searchsorted(number[ordered], np.arange(len(keys) + 1))
    for at, key in enumerate(keys):
        rows = ordered[edges[at] : edges[at + 1]]
        if rows.size:
            rows = rows[np.argsort(columns[order][rows], kind="stable")]  # quick on what is nearly in order
            yield key, {name: column[rows] for name, column in columns.items()}
