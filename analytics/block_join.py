"""Reads the channels of a run and joins each to the blocks of a signal, in the way that its readings allow."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa

from analytics.block_angles import AngleBlocks, without_aliases
from analytics.block_channels import (
    Readings,
    is_far_outside,
    joined_blocks,
    joined_readings,
    ranges,
    readings_of,
    standard_unit,
)
from analytics.block_means import SECOND_NS, Blocks, Grid, block_means
from analytics.block_records import is_rolled_up
from analytics.block_sources import Source
from analytics.run_blocks import Channel
from storage.catalog import Catalog
from stream.batch import FloatArray, IntArray

_DENSE = 4  # readings a block from which on block means are taken
_BESIDE = 4  # blocks beside a stretch of time from which readings are taken, too
_MOST_EXTREMES = 30
_TOLERATED = 1.05  # of the interval between readings


class ChannelJoiner:
    """Joins channels to blocks; what was reduced of an instrument is kept for the next unit of its run.

    Parameters
    ----------
    catalog : Catalog
        The store.
    block_s : float
        Length of a block, seconds.
    tolerance_s : float, optional
        How far from a reading a channel is still believed; by default a block, or the channel's own interval where that
        is longer.
    """

    def __init__(self, catalog: Catalog, block_s: float, tolerance_s: float | None = None) -> None:
        self._catalog = catalog
        self._block_s = block_s
        self._block_ns = max(1, round(block_s * SECOND_NS))
        self._tolerance_s = tolerance_s
        self._known: dict[tuple[str, str, str, Grid], Blocks | None] = {}
        self._far: dict[tuple[str, str, str, Grid], tuple[int, float]] = {}
        self._extremes: dict[tuple[str, str, str, int], tuple[FloatArray, ...]] = {}

    def prepare(self, sources: Mapping[str, Sequence[Source]], grids: Mapping[str, Grid]) -> None:
        """Reduce the channels of several runs, each channel in one query for all runs."""
        wanted: dict[tuple[str, str, bool], dict[str, Grid]] = {}
        for run, own in sources.items():
            for each in own:
                if self._is_dense(each) and not each.is_angle and _key(each, grids[run]) not in self._known:
                    rolled_up = is_rolled_up(each.interval_s, each.samples, each.kept_raw)
                    wanted.setdefault((each.unit, each.signal, rolled_up), {})[run] = grids[run]
        for (unit, signal, rolled_up), of_runs in wanted.items():
            wide = {run: self._wide(grid) for run, grid in of_runs.items()}
            found = block_means(self._catalog, unit, signal, wide, self._block_s, rolled_up=rolled_up)
            for run, grid in of_runs.items():
                blocks = found.get(run)
                self._known[unit, signal, run, grid] = blocks
                if blocks is not None and blocks.is_far.any():
                    self._far[unit, signal, run, grid] = int(blocks.is_far.sum()), blocks.farthest
                    without = np.where(blocks.is_far, np.nan, blocks.mean)
                    self._known[unit, signal, run, grid] = replace(blocks, mean=without)

    def far(self, source: Source, grid: Grid) -> tuple[int, float] | None:
        """How much of a channel that was joined lies far outside, blocks or readings, and the farthest reading."""
        return self._far.get(_key(source, grid))

    def forget(self, unit: str) -> None:
        """Let go of what belongs to a unit: no other unit asks for it."""
        self._known = {key: each for key, each in self._known.items() if key[0] != unit}
        self._far = {key: each for key, each in self._far.items() if key[0] != unit}

    def channels(self, sources: Sequence[Source], signal: Blocks, grid: Grid) -> dict[str, Channel]:
        """The channels of a run, which were prepared, at the blocks of the signal, by name."""
        found = {each.name: self._channel(each, signal, grid) for each in sources}
        rate = found.get("table_rate")
        if rate is None:
            return found
        intervals = {each.name: each.interval_s for each in sources}
        return {name: without_aliases(each, rate.mean, intervals[name]) for name, each in found.items()}

    def changes(self, source: Source, slot: IntArray, t0_ns: int) -> FloatArray:
        """By how much a channel changes about each block, in its standard unit, see `ranges`."""
        key = (source.unit, source.signal, source.run, t0_ns)
        if key not in self._extremes:
            table = self._catalog.reader(
                "select (t_ns - $t0) / 1e9 as t_s, lo, hi from rollup_1s "
                "where unit = $unit and signal = $signal and run = $run order by t_ns",
                {"unit": source.unit, "signal": source.signal, "run": source.run, "t0": t0_ns},
            ).read_all()
            while len(self._extremes) >= _MOST_EXTREMES:
                self._extremes.pop(next(iter(self._extremes)))
            self._extremes[key] = tuple(table.column(name).to_numpy() for name in ("t_s", "lo", "hi"))
        t_s, lo, hi = self._extremes[key]
        factor = standard_unit(source.name, source.unit_of_measure)[1]
        return ranges(slot, self._block_s, t_s, lo, hi) * abs(factor)

    def _channel(self, source: Source, signal: Blocks, grid: Grid) -> Channel:
        unit = standard_unit(source.name, source.unit_of_measure)
        is_raw = source.kept_raw == source.samples
        if source.is_angle and not is_raw:  # means of what wraps would be wrong
            return Channel(np.full(len(signal.slot), np.nan), np.zeros(len(signal.slot)), unit[0])
        if source.is_angle:
            angle = AngleBlocks(grid, self._block_ns, unit[1])
            for batch in self._readings(source, grid):
                angle.take(batch.column("t_ns").to_numpy(), batch.column("value").to_numpy())
            return angle.channel(signal.slot)
        if self._is_dense(source):
            blocks = self._known.get(_key(source, grid))
            if blocks is None:
                return Channel(np.full(len(signal.slot), np.nan), np.zeros(len(signal.slot)), unit[0])
            return joined_blocks(signal.slot, signal.centre_s, blocks, unit, self._tolerance(source.interval_s))
        readings = readings_of(self._readings(source, grid), grid)
        is_far = is_far_outside(readings.value)
        if is_far.any():
            farthest = readings.value[is_far][np.abs(readings.value[is_far]).argmax()]
            self._far[_key(source, grid)] = int(is_far.sum()), float(farthest)
            readings = Readings(readings.t_s[~is_far], readings.value[~is_far])
        intervals = np.diff(readings.t_s)
        tolerance_s = self._tolerance(float(np.median(intervals)) if len(intervals) else 0.0)
        return joined_readings(signal.centre_s, readings, unit, tolerance_s)

    def _is_dense(self, source: Source) -> bool:
        return source.kept_raw < source.samples or 0.0 < source.interval_s * _DENSE <= self._block_s

    def _tolerance(self, interval_s: float) -> float:
        return max(self._block_s, _TOLERATED * interval_s) if self._tolerance_s is None else self._tolerance_s

    def _wide(self, grid: Grid) -> Grid:
        beside_ns = _BESIDE * self._block_ns
        return Grid(grid.t0_ns, grid.first_ns - beside_ns, grid.last_ns + beside_ns)

    def _readings(self, source: Source, grid: Grid) -> Iterator[pa.RecordBatch]:
        wide = self._wide(grid)
        return self._catalog.batches(
            "select t_ns, value from samples where unit = $unit and signal = $signal and run = $run "
            "and t_ns between $first and $last and isfinite(value) order by t_ns",
            {
                "unit": source.unit,
                "signal": source.signal,
                "run": source.run,
                "first": wide.first_ns,
                "last": wide.last_ns,
            },
        )


def _key(source: Source, grid: Grid) -> tuple[str, str, str, Grid]:
    return source.unit, source.signal, source.run, grid
