"""Reads the channels of a run and joins each to the blocks of a signal, in the way that its readings allow."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from analytics.loop.blocks.angles import AngleBlocks, polled_angle, without_aliases
from analytics.loop.blocks.channels import (
    Readings,
    interpolated,
    is_far_outside,
    joined_blocks,
    joined_readings,
    ranges,
    readings_of,
    standard_unit,
)
from analytics.loop.blocks.means import SECOND_NS, Blocks, Grid, block_means
from analytics.loop.blocks.motion import RateSeries, motion, moves
from analytics.loop.blocks.records import is_rolled_up
from analytics.loop.blocks.run_blocks import Channel
from analytics.loop.blocks.sources import Source
from storage.sql.catalog import Catalog
from stream.batch import BoolArray, FloatArray, IntArray

_DENSE = 4  # readings a block from which on block means are taken
_BESIDE = 4  # blocks beside a stretch of time from which readings are taken, too
_MOST_EXTREMES = 30
_TOLERATED = 1.05  # of the interval between readings


class Joined(NamedTuple):
    """A channel at the blocks of a signal.

    Parameters
    ----------
    channel, with_far: Without and with the readings that lie far outside.
    is_far: shape (blocks,); blocks in which such readings are.
    far, farthest: How many there are, blocks or readings, and the farthest in the stored unit.
    reading: shape (blocks,); the far reading of each block in the stored unit.
    """

    channel: Channel
    with_far: Channel
    is_far: BoolArray
    far: int = 0
    farthest: float = 0.0
    reading: FloatArray | None = None


class ChannelJoiner:
    """Joins channels to blocks; what was reduced of an instrument is kept for the next unit of its run.

    Parameters
    ----------
    catalog: The store.
    block_s: Length of a block, seconds.
    tolerance_s: How far from a reading a channel is still believed; by default a block, or the channel's own interval
        where that is longer.
    """

    def __init__(self, catalog: Catalog, block_s: float, tolerance_s: float | None = None) -> None:
        self._catalog = catalog
        self._block_s = block_s
        self._block_ns = max(1, round(block_s * SECOND_NS))
        self._tolerance_s = tolerance_s
        self._known: dict[tuple[str, str, str, Grid], Blocks | None] = {}
        self._sampled: dict[str, tuple[float, int]] = {}
        self._far: dict[tuple[str, str, str, Grid], tuple[int, float]] = {}
        self._extremes: dict[tuple[str, str, str, int], tuple[FloatArray, ...]] = {}

    def prepare(
        self,
        sources: Mapping[str, Sequence[Source]],
        grids: Mapping[str, Grid],
        sampled: Mapping[str, tuple[float, int]],
    ) -> None:
        """Reduce the channels of several runs, each channel in one query for all runs.

        Parameters
        ----------
        sources, grids: By run: the channels, and where the blocks lie.
        sampled: By run: interval of the signal's samples in seconds, and the moment of the first.
        """
        self._sampled.update(sampled)
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

    def far(self, source: Source, grid: Grid) -> tuple[int, float] | None:
        """How much of a channel that was joined was left out as far outside, and the farthest reading."""
        return self._far.get(_key(source, grid))

    def forget(self, unit: str) -> None:
        """Let go of what belongs to a unit: no other unit asks for it."""
        self._known = {key: each for key, each in self._known.items() if key[0] != unit}
        self._far = {key: each for key, each in self._far.items() if key[0] != unit}

    def channels(
        self, sources: Sequence[Source], signal: Blocks, grid: Grid, own: RateSeries | None
    ) -> tuple[dict[str, Channel], BoolArray]:
        """The channels of a run, which were prepared, at the blocks of the signal, by name; where the signal is far.

        Readings that lie far outside are left out, but for motion that other rates show, the signal itself included.

        Parameters
        ----------
        sources: The channels.
        signal, grid: The blocks.
        own: The signal, where it is an angular rate.
        """
        joined = {each.name: self._joined(each, signal, grid) for each in sources}
        rates = {
            name: RateSeries(
                each.with_far.mean,
                each.is_far,
                np.full(len(signal.slot), np.nan) if each.reading is None else each.reading,
            )
            for name, each in joined.items()
            if each.with_far.unit_of_measure == "deg/s"
        }
        is_far = signal.is_far.copy()
        if own is not None:
            rates[""] = own
        moving = np.zeros(len(signal.slot), dtype=np.bool_)
        if any(each.is_far.any() for each in joined.values()) or is_far.any():
            shown = motion(rates)
            is_far &= ~shown.pop("", np.zeros_like(is_far))
            for name, rate in rates.items():
                turned = shown.get(name, np.zeros_like(is_far))
                moving |= moves(rate.value) & (turned | ~rate.is_far)
            shown |= {name: moving for name, each in joined.items() if each.channel.unit_of_measure == "deg/s^2"}
            for source in sources:
                joined[source.name] = self._with_motion(source, grid, joined[source.name], shown.get(source.name))
        found = {name: each.channel for name, each in joined.items()}
        table = found.get("table_rate")
        if table is not None:
            by_name = {each.name: each for each in sources}
            for name, angle in found.items():
                if angle.phasors is not None:
                    polled = self._polled(by_name[name], by_name["table_rate"], signal, grid)
                    found[name] = polled or without_aliases(angle, table.mean, by_name[name].interval_s)
        return found, is_far

    def _polled(self, angle: Source, rate: Source, signal: Blocks, grid: Grid) -> Channel | None:
        """An angle that is read too seldom for means, by the table's rate; None where that is not read as often."""
        if (
            angle.interval_s * _DENSE <= self._block_s
            or rate.interval_s > _TOLERATED * angle.interval_s
            or rate.kept_raw < rate.samples
        ):
            return None
        turned, rates = (readings_of(self._readings(each, grid), grid) for each in (angle, rate))
        if not len(rates.t_s):
            return None
        degrees = turned.value * standard_unit(angle.name, angle.unit_of_measure)[1]
        about = interpolated(turned.t_s, rates, _TOLERATED * angle.interval_s)
        per_s = standard_unit(rate.name, rate.unit_of_measure)[1]
        return polled_angle(signal.slot, self._block_s, turned.t_s, degrees, about * per_s)

    def _with_motion(self, source: Source, grid: Grid, joined: Joined, shown: BoolArray | None) -> Joined:
        """The channel with the outliers that are motion; what else is far is counted."""
        if not joined.is_far.any():
            return joined
        left = joined.is_far if shown is None else joined.is_far & ~shown
        if left.any():
            count = joined.far if left.sum() == joined.is_far.sum() else int(left.sum())
            self._far[_key(source, grid)] = count, joined.farthest
        if shown is None or not shown.any():
            return joined
        one, other = joined.channel, joined.with_far
        mean, spread = np.where(shown, other.mean, one.mean), np.where(shown, other.spread, one.spread)
        return joined._replace(channel=replace(one, mean=mean, spread=spread))

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

    def _joined(self, source: Source, signal: Blocks, grid: Grid) -> Joined:
        none = np.zeros(len(signal.slot), dtype=np.bool_)
        unit = standard_unit(source.name, source.unit_of_measure)
        is_raw = source.kept_raw == source.samples
        empty = Channel(np.full(len(signal.slot), np.nan), np.zeros(len(signal.slot)), unit[0])
        if source.is_angle and not is_raw:  # means of what wraps would be wrong
            return Joined(empty, empty, none)
        if source.is_angle:
            angle = AngleBlocks(grid, self._block_ns, unit[1])
            for batch in self._readings(source, grid):
                angle.take(batch.column("t_ns").to_numpy(), batch.column("value").to_numpy())
            turned = angle.channel(signal.slot)
            return Joined(turned, turned, none)
        if self._is_dense(source):
            blocks = self._known.get(_key(source, grid))
            if blocks is None:
                return Joined(empty, empty, none)
            tolerance_s = self._tolerance(source.interval_s)
            raw = joined_blocks(signal.slot, signal.centre_s, blocks, unit, tolerance_s)
            if not blocks.is_far.any():
                return Joined(raw, raw, none)
            without = replace(blocks, mean=np.where(blocks.is_far, np.nan, blocks.mean))
            clean = joined_blocks(signal.slot, signal.centre_s, without, unit, tolerance_s)
            far = np.isin(signal.slot, blocks.slot[blocks.is_far])
            reading = _at(signal.slot, blocks.slot[blocks.is_far], blocks.far_reading[blocks.is_far])
            return Joined(clean, raw, far, int(blocks.is_far.sum()), blocks.farthest, reading)
        readings = readings_of(self._readings(source, grid), grid)
        intervals = np.diff(readings.t_s)
        tolerance_s = self._tolerance(float(np.median(intervals)) if len(intervals) else 0.0)
        raw = joined_readings(signal.centre_s, readings, unit, tolerance_s)
        is_far = is_far_outside(readings.value)
        if not is_far.any():
            return Joined(raw, raw, none)
        farthest = readings.value[is_far][np.abs(readings.value[is_far]).argmax()]
        clean = joined_readings(
            signal.centre_s, Readings(readings.t_s[~is_far], readings.value[~is_far]), unit, tolerance_s
        )
        far_slots = np.floor(readings.t_s[is_far] / self._block_s).astype(np.int64)
        reading = _at(signal.slot, far_slots, readings.value[is_far])
        return Joined(clean, raw, np.isfinite(reading), int(is_far.sum()), float(farthest), reading)

    def _is_dense(self, source: Source) -> bool:
        """Whether its readings are averaged over each block: there are many, or they are taken with the samples."""
        if source.kept_raw < source.samples or 0.0 < source.interval_s * _DENSE <= self._block_s:
            return True
        return source.is_in_step(*self._sampled[source.run])

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


def _at(slot: IntArray, known: IntArray, value: FloatArray) -> FloatArray:
    """Values of some blocks at these blocks; NaN at the others."""
    found = np.full(len(slot), np.nan)
    _, at, row = np.intersect1d(slot, known, return_indices=True)
    found[at] = value[row]
    return found


def _key(source: Source, grid: Grid) -> tuple[str, str, str, Grid]:
    return source.unit, source.signal, source.run, grid
