"""Reduction of runs: the samples of each step and signal become one row of statistics."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pyarrow as pa

from analytics.step_records.evaluated_signal import SECOND_NS, EvaluatedSignal
from analytics.step_records.integrated_output import is_integrated, rate_statistics
from analytics.step_records.raw_looks import RawLooks
from analytics.step_records.series_statistics import SeriesStatistics, series_statistics
from storage.sql.catalog import Catalog
from stream.batch import FloatArray, IntArray

_ROWS_AT_ONCE = 5_000_000
_RUNS_AT_ONCE = 50
# a statement that reads several runs also reads what lies between the steps of each
_LEAST_EVALUATED = 0.5

_TEXT, _WHOLE, _REAL = pa.string(), pa.int64(), pa.float64()
_AVERAGES = {
    f"{name}_{s}s": kind for s in (1, 10, 100) for name, kind in (("n", _WHOLE), ("sd", _REAL), ("freedom", _REAL))
}
COLUMNS = pa.schema({
    "run": _TEXT, "unit": _TEXT, "signal": _TEXT, "t_from_ns": _WHOLE, "t_to_ns": _WHOLE, "unit_of_measure": _TEXT,
    "n": _WHOLE, "expected": _WHOLE, "whole_seconds": _WHOLE,
    "mean": _REAL, "sd": _REAL, "sd_freedom": _REAL, "standard_uncertainty": _REAL, "freedom": _REAL,
    "n_effective": _REAL, "white": _REAL, "flicker": _REAL, "walk": _REAL, "still": _REAL,
    "outliers": _WHOLE, "outlier_excess": _REAL, "piled": _REAL, "piled_at": _REAL, "repeated": _REAL,
    **_AVERAGES, "reason": _TEXT,
})  # fmt: skip

T = TypeVar("T")


def reduce_runs(catalog: Catalog, runs: Sequence[str]) -> Iterator[tuple[int, pa.Table]]:
    """Reduce every completed step of runs; yields how many runs are done, and their records.

    A step's own signals are those of its unit; signals of units without steps (chamber, table, supply) are reduced over
    the stretches of all steps of the run. A stretch of more than `MOST_RAW` samples, or of irregular ones over at least
    `SHORT_NS`, is evaluated from its first to its last whole second of the source's clock; not one of an integrated
    output, whose record is of its rate. One row of `COLUMNS` for each signal and stretch; `reason` where it holds no
    sample.
    """
    for begin in range(0, len(runs), _RUNS_AT_ONCE):
        some = runs[begin : begin + _RUNS_AT_ONCE]
        signals = _signals(catalog, some)
        for together in _filled((run, _rows_of_run(signals[run])) for run in some):
            yield len(together), _reduce(catalog, [each for run in together for each in signals[run]])


def _reduce(catalog: Catalog, signals: Sequence[EvaluatedSignal]) -> pa.Table:
    rows: list[dict[str, Any]] = []
    for is_raw in (True, False):
        for group in _filled((each, each.rows) for each in signals if each.is_raw == is_raw):
            found = _fetched(catalog, group, is_raw=is_raw)
            with nullcontext() if is_raw else RawLooks(catalog, group) as looks:
                for each in group:
                    rows.extend(_reduced(each, found.get((each.run, each.unit, each.signal)), looks))
    rows.sort(key=lambda row: (row["run"], row["unit"], row["signal"], row["t_from_ns"], row["t_to_ns"]))
    return pa.Table.from_pylist(rows, schema=COLUMNS)


def _signals(catalog: Catalog, runs: Sequence[str]) -> defaultdict[str, list[EvaluatedSignal]]:
    """Signals by run."""
    # in order, and each once: steps may be alike
    windows: defaultdict[str, dict[str, dict[tuple[int, int], None]]] = defaultdict(dict)
    for run, unit, start, end in catalog.rows(
        "select run, unit, t_start_ns + round(coalesce(settle, 0) * 1e9)::bigint, t_end_ns from steps "
        "where run in $runs and outcome = 'completed' and excluded is null order by run, unit, t_start_ns",
        {"runs": runs},
    ):
        windows[run].setdefault(unit, {})[start, end] = None
    everywhere = {run: sorted({window for each in own.values() for window in each}) for run, own in windows.items()}
    found: defaultdict[str, list[EvaluatedSignal]] = defaultdict(list)
    for run, unit, signal, unit_of_measure, interval_s, irregular, samples, kept_raw, is_counts, scale in catalog.rows(
        "select run, unit, signal, unit_of_measure, sample_interval_s, irregular, samples, kept_raw, is_counts, scale "
        "from signals where run in $runs order by run, unit, signal",
        {"runs": runs},
    ):
        found[run] += EvaluatedSignal(
            run, unit, signal, unit_of_measure, round((interval_s or 0.0) * 1e9), bool(irregular), samples, kept_raw,
            abs(scale) if is_counts and scale else 0.0, tuple(windows[run].get(unit, everywhere.get(run, ()))),
        ).halves()  # fmt: skip
    return found


def _rows_of_run(signals: Sequence[EvaluatedSignal]) -> float:
    """Rows of a run for reading it together with others: as many as fit where little of it is evaluated."""
    within, whole = sum(each.rows for each in signals), sum(each.all_rows for each in signals)
    return whole if within >= _LEAST_EVALUATED * whole else _ROWS_AT_ONCE


def _filled(sized: Iterable[tuple[T, float]]) -> Iterator[list[T]]:
    """Neighbours that fit into memory together, by the numbers of their rows; whole units where they do."""
    group: list[T] = []
    rows = 0.0
    for each, size in sized:
        if group and rows + size > _ROWS_AT_ONCE:
            yield group
            group, rows = [], 0.0
        group.append(each)
        rows += size
    if group:
        yield group


class _Blocks(NamedTuple):
    """Samples, or means of seconds, by time: when each begins, its samples, their mean, sum of squares and extremes."""

    start_ns: IntArray
    n: IntArray
    mean: FloatArray
    m2: FloatArray
    lo: FloatArray
    hi: FloatArray

    def within(self, rows: slice) -> "_Blocks":
        """Some of them."""
        return _Blocks(self.start_ns[rows], self.n[rows], self.mean[rows], self.m2[rows], self.lo[rows], self.hi[rows])


_WITHIN = """
where run in $runs and unit between $lower and $upper and unit in $units and signal in $signals
  and t_ns between $first and $last"""
_RAW = f"""
select run, unit, signal, t_ns, 1::bigint as n, value as mean, 0.0::double as m2
from internal.samples_in($paths) {_WITHIN} order by run, unit, signal, t_ns, seq
"""  # noqa: S608
# not sorted: the lake has them in order but for runs in several parts, and sorting takes as long as reading
_SECONDS = f"select run, unit, signal, t_ns, n, mean, m2, lo, hi from internal.rollup_1s_in($paths) {_WITHIN}"  # noqa: S608


def _fetched(catalog: Catalog, group: list[EvaluatedSignal], *, is_raw: bool) -> dict[tuple[str, str, str], _Blocks]:
    """Samples, or means of seconds, of each run, unit and signal by time."""
    sql, margin_ns = (_RAW, 0) if is_raw else (_SECONDS, SECOND_NS)
    runs, units = (sorted({getattr(each, name) for each in group}) for name in ("run", "unit"))
    parameters = {
        "paths": catalog.checked_paths_of(runs, sql),
        "runs": runs,
        "units": units,
        # by which row groups of other units are not read
        "lower": units[0],
        "upper": units[-1],
        "signals": sorted({each.signal for each in group}),
        "first": min(each.windows[0][0] for each in group) - margin_ns,
        "last": max(end for each in group for _, end in each.windows),
    }
    table = catalog.reader(sql, parameters).read_all().combine_chunks()
    if table.num_rows == 0:
        return {}
    names = [table[name].combine_chunks().dictionary_encode() for name in ("run", "unit", "signal")]
    changes = np.logical_or.reduce([np.diff(np.asarray(each.indices)) != 0 for each in names])
    columns = [table[name].to_numpy() for name in ("t_ns", "n", "mean", "m2", "lo", "hi") if name in table.column_names]
    stretches: dict[tuple[str, str, str], list[tuple[int, int]]] = {}
    edges = np.flatnonzero(np.r_[True, changes, True])
    for start, end in pairwise(edges.tolist()):
        run, unit, signal = (each[start].as_py() for each in names)
        stretches.setdefault((run, unit, signal), []).append((start, end))
    found = {}
    for name, own in stretches.items():
        parts = [[each[start:end] for start, end in own] for each in columns]
        rows = [each[0] if len(each) == 1 else np.concatenate(each) for each in parts]
        if not is_raw and (np.diff(rows[0]) <= 0).any():
            order = np.lexsort((rows[2], rows[1], rows[0]))  # also of blocks of the same time, as after a power cycle
            rows = [each[order] for each in rows]
        lo, hi = (rows[2], rows[2]) if is_raw else rows[4:]
        found[name] = _Blocks(rows[0], rows[1], rows[2], rows[3], lo, hi)
    return found


def _reduced(signal: EvaluatedSignal, blocks: _Blocks | None, looks: RawLooks | None) -> Iterator[dict[str, Any]]:
    is_raw = looks is None
    base_ns = max(signal.dt_ns, 1) if is_raw else SECOND_NS
    per_block = 1.0 if is_raw else SECOND_NS / max(signal.dt_ns, 1)
    for window in signal.windows:
        row: dict[str, Any] = {"run": signal.run, "unit": signal.unit, "signal": signal.signal, "n": 0}
        measure = f"{signal.unit_of_measure}/s" if is_integrated(signal.signal) else signal.unit_of_measure
        row |= {"t_from_ns": window[0], "t_to_ns": window[1], "unit_of_measure": measure}
        # a block has the time of its beginning: that of the last whole one, whose last sample may be the window's end
        begins = window if is_raw else (window[0], window[1] + signal.dt_ns - SECOND_NS)
        row["expected"] = None if signal.irregular or not signal.dt_ns else _expected(begins, base_ns, per_block)
        row["whole_seconds"] = None if is_raw else max(_seconds_begun(begins), 0)
        within = slice(0, 0)
        if blocks is not None:
            first = int(np.searchsorted(blocks.start_ns, begins[0]))
            last = int(np.searchsorted(blocks.start_ns, begins[1], side="right"))
            within = slice(first, max(first, last))
        if blocks is None or within.start == within.stop:
            settled = "no sample in the evaluated part of the step"
            yield row | {"reason": settled if window[0] <= window[1] else "the step ended before its settle time"}
            continue
        start_ns, n, mean, m2, lo, hi = blocks.within(within)
        if is_integrated(signal.signal):
            yield row | _of_rate(start_ns, n, mean, signal)
            continue
        found = series_statistics(
            start_ns, n, mean, m2, base_ns=base_ns, samples_per_block=per_block, window_ns=begins, step=signal.step,
            samples=mean if looks is None else looks.samples(signal, window, lo, hi),
            look=None if looks is None else looks.beginnings(signal, window),
        )  # fmt: skip
        yield row | _numbers(found)


def _expected(begins: tuple[int, int], base_ns: int, per_block: float) -> int:
    """Samples of blocks of `base_ns` that begin within two moments, if none is missing."""
    if base_ns == SECOND_NS and per_block > 1.0:
        blocks = _seconds_begun(begins)
    else:
        blocks = (begins[1] - begins[0]) // base_ns + 1
    return max(round(blocks * per_block), 0)


def _seconds_begun(begins: tuple[int, int]) -> int:
    """Whole seconds that begin within two moments, both included."""
    return begins[1] // SECOND_NS + -begins[0] // SECOND_NS + 1


def _of_rate(start_ns: IntArray, n: IntArray, angles: FloatArray, signal: EvaluatedSignal) -> dict[str, Any]:
    """Statistics of the rate of an integrated output."""
    found = rate_statistics(start_ns, angles, signal.unit_of_measure, signal.step)
    if found is None:
        return {"reason": "one sample of an angle, of which no rate can be made"}
    return _numbers(found._replace(n=int(n.sum())))


def _numbers(found: SeriesStatistics) -> dict[str, Any]:
    row = found._asdict()
    for average, each in zip((1, 10, 100), row.pop("averages"), strict=True):
        row |= {f"{name}_{average}s": value for name, value in each._asdict().items()}
    return {name: None if isinstance(value, float) and np.isnan(value) else value for name, value in row.items()}
