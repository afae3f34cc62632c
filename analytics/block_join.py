"""Reads the channels of a run and joins each to the blocks of a signal, in the way that its readings allow."""

from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa

from analytics.block_angles import AngleBlocks, without_aliases
from analytics.block_channels import joined_blocks, joined_readings, ranges, readings_of, standard_unit
from analytics.block_means import SECOND_NS, Blocks, Grid, block_means
from analytics.block_records import is_rolled_up
from analytics.block_sources import Source
from analytics.run_blocks import Channel
from storage.catalog import Catalog
from stream.batch import FloatArray, IntArray

_DENSE = 4  # readings a block from which on block means are taken
_BESIDE = 4  # blocks beside a stretch of time from which readings are taken, too
_MOST_KEPT = 1000
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

    def channels(self, sources: Sequence[Source], signal: Blocks, grid: Grid) -> dict[str, Channel]:
        """The channels of a run at the blocks of the signal, by name."""
        found = {each.name: self._channel(each, signal, grid) for each in sources}
        rate = found.get("table_rate")
        if rate is None:
            return found
        intervals = {each.name: each.interval_s for each in sources}
        return {name: without_aliases(each, rate.mean, intervals[name]) for name, each in found.items()}

    def changes(self, source: Source, slot: IntArray, t0_ns: int) -> FloatArray:
        """By how much a channel changes about each block, in its standard unit, see `ranges`."""
        table = self._catalog.reader(
            "select (t_ns - $t0) / 1e9 as t_s, lo, hi from rollup_1s "
            "where unit = $unit and signal = $signal and run = $run order by t_ns",
            {"unit": source.unit, "signal": source.signal, "run": source.run, "t0": t0_ns},
        ).read_all()
        t_s, lo, hi = (table.column(name).to_numpy() for name in ("t_s", "lo", "hi"))
        factor = standard_unit(source.name, source.unit_of_measure)[1]
        return ranges(slot, self._block_s, t_s, lo, hi) * abs(factor)

    def _channel(self, source: Source, signal: Blocks, grid: Grid) -> Channel:
        unit = standard_unit(source.name, source.unit_of_measure)
        is_raw = source.kept_raw == source.samples
        if source.is_angle and is_raw:
            angle = AngleBlocks(grid, self._block_ns, unit[1])
            for batch in self._readings(source, grid):
                angle.take(batch.column("t_ns").to_numpy(), batch.column("value").to_numpy())
            return angle.channel(signal.slot)
        if not is_raw or 0.0 < source.interval_s * _DENSE <= self._block_s:
            blocks = self._blocks(source, grid)
            if blocks is None:
                return Channel(np.full(len(signal.slot), np.nan), np.zeros(len(signal.slot)), unit[0])
            return joined_blocks(signal.slot, signal.centre_s, blocks, unit, self._tolerance(source.interval_s))
        readings = readings_of(self._readings(source, grid), grid)
        intervals = np.diff(readings.t_s)
        tolerance_s = self._tolerance(float(np.median(intervals)) if len(intervals) else 0.0)
        return joined_readings(signal.centre_s, readings, unit, tolerance_s)

    def _tolerance(self, interval_s: float) -> float:
        return max(self._block_s, _TOLERATED * interval_s) if self._tolerance_s is None else self._tolerance_s

    def _wide(self, grid: Grid) -> Grid:
        beside_ns = _BESIDE * self._block_ns
        return Grid(grid.t0_ns, grid.first_ns - beside_ns, grid.last_ns + beside_ns)

    def _blocks(self, source: Source, grid: Grid) -> Blocks | None:
        key = (source.unit, source.signal, source.run, grid)
        if key not in self._known:
            found = block_means(
                self._catalog,
                source.unit,
                source.signal,
                {source.run: self._wide(grid)},
                self._block_s,
                rolled_up=is_rolled_up(source.interval_s, source.samples, source.kept_raw),
            )
            self._known[key] = found.get(source.run)
            while len(self._known) > _MOST_KEPT:
                self._known.pop(next(iter(self._known)))
        return self._known[key]

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
