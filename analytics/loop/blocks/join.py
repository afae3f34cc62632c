"""Reads the channels of a run and joins each to the blocks of a signal, by the method that its readings allow."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import NamedTuple

import numpy as np

from analytics.loop.blocks.outliers import RateSeries, is_far_outside, motion, moves
from analytics.loop.blocks.pieces import Grid, SignalKey
from analytics.loop.blocks.reading.channels import (
    AngleBlocks,
    Readings,
    interpolated,
    joined_blocks,
    joined_readings,
    polled_angle,
    standard_unit,
    without_aliases,
)
from analytics.loop.blocks.reading.stored_readings import MOST_READINGS, StoredReadings
from analytics.loop.blocks.reading.stored_signals import REFERENCE_RATES, ChannelSource
from analytics.loop.blocks.reference_edges import Motion, bends, held, ranges
from analytics.loop.blocks.run_blocks import SECOND_NS, Channel
from analytics.loop.blocks.signal_blocks import SignalBlocks, block_means
from storage.sql.catalog import Catalog
from stream.batch import BoolArray, FloatArray, IntArray

_DENSE, _DENSE_OF_RATE = 4, 1  # readings a block from which on block means are taken; a rate swings between them
_BESIDE = 4  # blocks beside a time range from which readings are taken, too
_TOLERATED = 1.05  # of the interval between readings


class Outliers(NamedTuple):
    """Blocks or readings of a signal that are left out as outliers, and the farthest in the stored unit."""

    number: int
    farthest: float


class _Joined(NamedTuple):
    """A channel at the blocks of a signal, without and with outliers; the blocks that contain outliers."""

    channel: Channel
    with_far: Channel
    is_far: BoolArray
    reading: FloatArray  # outlier of each block in the stored unit; NaN where there is none
    outliers: Outliers = Outliers(0, 0.0)


class ChannelJoiner:
    """Joins channels to blocks, see `BlockReducer`; blocks of an instrument are reused for the next unit of its run."""

    def __init__(self, catalog: Catalog, block_s: float, tolerance_s: float | None = None) -> None:
        self._catalog = catalog
        self._block_s = block_s
        self._block_ns = max(1, round(block_s * SECOND_NS))
        self._tolerance_s = tolerance_s
        self._known: dict[tuple[SignalKey, Grid], SignalBlocks | None] = {}
        self._sampled: dict[str, tuple[float, int]] = {}
        self._expected_means: dict[tuple[SignalKey, Grid], ChannelSource] = {}
        self._expected_readings: list[tuple[ChannelSource, Grid]] = []
        self._stored = StoredReadings(catalog)

    def expect(
        self,
        sources: Mapping[str, Sequence[ChannelSource]],
        grids: Mapping[str, Grid],
        sampled: Mapping[str, tuple[float, int]],
    ) -> None:
        """Announce the channels of a unit's runs, of which `channels` follow; those of several units are read together.

        `sampled` is the interval of the signal's samples in seconds and the time of the first, by run.
        """
        self._sampled.update(sampled)
        for run, own in sources.items():
            self._expected_means |= {
                (each.key, grids[run]): each
                for each in own
                if self._is_dense(each) and not each.is_angle and (each.key, grids[run]) not in self._known
            }
            self._expected_readings += [
                (each, self._wide(grids[run])) for each in own if self._is_read_singly(each, own)
            ]

    def read_expected(self) -> None:
        """Read the channels that were announced, many by one statement."""
        expected = {each: grid for (_, grid), each in self._expected_means.items()}
        readings = self._expected_readings
        self.forget_expected()
        for group in _groups(list(expected)):
            wide = {each.key: self._wide(expected[each]) for each in group}
            found = block_means(self._catalog, wide, self._block_s, rolled_up=group[0].is_rolled_up)
            self._known |= {(each.key, expected[each]): found.get(each.key) for each in group}
        self._stored.read_ahead(readings)

    def forget(self, unit: str) -> None:
        """Drop the blocks and readings of a unit, which no other unit needs."""
        self._stored.forget(unit)
        self._known = {key: each for key, each in self._known.items() if key[0].unit != unit}

    def forget_expected(self) -> None:
        """Read nothing of what was announced."""
        self._expected_means, self._expected_readings = {}, []

    def forget_readings(self) -> None:
        """Drop all single readings."""
        self._stored.forget()

    def channels(
        self, sources: Sequence[ChannelSource], signal: SignalBlocks, grid: Grid, own: RateSeries | None
    ) -> tuple[dict[str, Channel], dict[str, Outliers], BoolArray]:
        """Prepared channels of a run without outliers, these by channel, and the blocks with one of the signal itself.

        An outlier that another rate shows as well, the signal included, is motion and kept; `own` is the signal if it
        is an angular rate.
        """
        joined = {each.name: self._joined(each, signal, grid) for each in sources}
        is_far, outliers = signal.is_far.copy(), {}
        if any(each.is_far.any() for each in joined.values()) or is_far.any():
            shown, signal_shown = _motion(joined, own, len(signal.slot))
            is_far &= ~signal_shown
            for name, each in joined.items():
                if each.is_far.any():
                    joined[name] = _with_motion(each, shown.get(name, np.zeros_like(is_far)))
            outliers = {name: each.outliers for name, each in joined.items() if each.outliers.number}
        found = {name: each.channel for name, each in joined.items()}
        by_name = {each.name: each for each in sources}
        if (table := found.get("table_rate")) is not None:
            for name, angle in found.items():
                if angle.phasors is not None:
                    polled = self._polled(by_name[name], by_name["table_rate"], signal, grid)
                    found[name] = polled or without_aliases(angle, table.mean, by_name[name].interval_s)
        return found, outliers, is_far

    def motion(self, source: ChannelSource, slot: IntArray, t0_ns: int) -> Motion:
        """What a rate does about each block."""
        factor = abs(standard_unit(source.name, source.unit_of_measure).factor)
        read = slot, self._block_s, *self._stored.extremes(source, t0_ns)
        bent = bends(*read, source.interval_s, is_moved=not source.is_in_step(*self._sampled[source.run]))
        return Motion(ranges(*read) * factor, bent * factor, source.interval_s)

    def held_s(self, source: ChannelSource, t0_ns: int) -> float:
        """How long a channel that steps stays where it is, in whole seconds, see `held`."""
        return held(*self._stored.extremes(source, t0_ns))

    def expect_motion(self, wanted: Sequence[tuple[ChannelSource, int]]) -> None:
        """Announce the channels, with the begin of slot 0, whose `motion` will be asked for."""
        self._stored.expect_extremes(wanted)

    def _joined(self, source: ChannelSource, signal: SignalBlocks, grid: Grid) -> _Joined:
        if source.is_angle:
            return _plain(self._angle(source, signal, grid))
        return self._means(source, signal, grid) if self._is_dense(source) else self._readings(source, signal, grid)

    def _angle(self, source: ChannelSource, signal: SignalBlocks, grid: Grid) -> Channel:
        unit = standard_unit(source.name, source.unit_of_measure)
        if source.kept_raw != source.samples:  # means of an angle that wraps would be wrong
            return _empty(signal, unit.name)
        angle = AngleBlocks(grid, self._block_ns, unit.factor)
        for t_ns, value in self._stored.pieces(source, self._wide(grid)):
            angle.update(t_ns, value)
        return angle.channel(signal.slot)

    def _means(self, source: ChannelSource, signal: SignalBlocks, grid: Grid) -> _Joined:
        """A channel by the means of its own blocks."""
        unit, blocks = standard_unit(source.name, source.unit_of_measure), self._known.get((source.key, grid))
        if blocks is None:
            return _plain(_empty(signal, unit.name))
        tolerance_s = self._tolerance(source.interval_s)
        raw, below = joined_blocks(signal, blocks, unit, tolerance_s), unit.is_impossible(blocks.lowest)
        far = blocks.is_far | below
        if not far.any():
            return _plain(raw)
        clean = joined_blocks(signal, replace(blocks, mean=np.where(far, np.nan, blocks.mean)), unit, tolerance_s)
        readings = np.where(below, blocks.lowest, blocks.far_reading)
        reading = _at(signal.slot, blocks.slot[far], readings[far])
        is_far = np.isin(signal.slot, blocks.slot[far])
        farthest = min(blocks.lowest[below].min(), blocks.farthest) if below.any() else blocks.farthest
        return _Joined(clean, raw, is_far, reading, Outliers(int(far.sum()), float(farthest)))

    def _readings(self, source: ChannelSource, signal: SignalBlocks, grid: Grid) -> _Joined:
        """A channel by its single readings."""
        unit = standard_unit(source.name, source.unit_of_measure)
        readings = self._stored.of(source, self._wide(grid))
        intervals = np.diff(readings.t_s)
        tolerance_s = self._tolerance(float(np.median(intervals)) if len(intervals) else 0.0)
        raw = joined_readings(signal, readings, unit, tolerance_s)
        below = unit.is_impossible(readings.value)
        far = is_far_outside(readings.value) | below
        if not far.any():
            return _plain(raw)
        clean = joined_readings(signal, Readings(readings.t_s[~far], readings.value[~far]), unit, tolerance_s)
        far_slots, values = np.floor(readings.t_s[far] / self._block_s).astype(np.int64), readings.value[far]
        reading = _at(signal.slot, far_slots, values)
        farthest = float(values[np.abs(values).argmax()])
        return _Joined(clean, raw, np.isfinite(reading), reading, Outliers(len(values), farthest))

    def _polled(self, angle: ChannelSource, rate: ChannelSource, signal: SignalBlocks, grid: Grid) -> Channel | None:
        """An angle with too few readings for means, by the table's rate; None where that is read less often."""
        if not self._is_polled(angle, rate):
            return None
        turned, rates = (self._stored.of(each, self._wide(grid)) for each in (angle, rate))
        if not len(rates.t_s):
            return None
        degrees = turned.value * standard_unit(angle.name, angle.unit_of_measure).factor
        about = interpolated(turned.t_s, rates, _TOLERATED * angle.interval_s)
        per_s = standard_unit(rate.name, rate.unit_of_measure).factor
        return polled_angle(signal.slot, self._block_s, Readings(turned.t_s, degrees), about * per_s)

    def _is_polled(self, angle: ChannelSource, rate: ChannelSource) -> bool:
        is_sparse = angle.interval_s * _DENSE > self._block_s
        return is_sparse and rate.interval_s <= _TOLERATED * angle.interval_s and rate.kept_raw >= rate.samples

    def _is_read_singly(self, source: ChannelSource, beside: Sequence[ChannelSource]) -> bool:
        """Whether a channel is joined by its single readings, among those of its run."""
        if source.is_angle:
            return source.kept_raw == source.samples
        continues = source.name == "table_rate" and any(
            each.is_angle and self._is_polled(each, source) for each in beside
        )
        return continues or not self._is_dense(source)

    def _is_dense(self, source: ChannelSource) -> bool:
        """Whether its readings are averaged over each block: there are many, or they are taken with the samples."""
        dense = _DENSE_OF_RATE if source.name in REFERENCE_RATES else _DENSE
        if source.kept_raw < source.samples or 0.0 < source.interval_s * dense <= self._block_s:
            return True
        return source.is_in_step(*self._sampled[source.run])

    def _tolerance(self, interval_s: float) -> float:
        return max(self._block_s, _TOLERATED * interval_s) if self._tolerance_s is None else self._tolerance_s

    def _wide(self, grid: Grid) -> Grid:
        beside_ns = _BESIDE * self._block_ns
        return Grid(grid.t0_ns, grid.first_ns - beside_ns, grid.last_ns + beside_ns)


def _motion(
    joined: Mapping[str, _Joined], own: RateSeries | None, blocks: int
) -> tuple[dict[str, BoolArray], BoolArray]:
    """Outliers of the channels, and those of the signal, that are motion; an acceleration moves with any rate."""
    rates = {
        name: RateSeries(each.with_far.mean, each.is_far, each.reading)
        for name, each in joined.items()
        if each.with_far.unit_of_measure == "deg/s"
    }
    if own is not None:
        rates[""] = own
    shown = motion(rates)
    of_signal = shown.pop("", np.zeros(blocks, dtype=np.bool_))
    moving = np.zeros(blocks, dtype=np.bool_)
    for name, rate in rates.items():
        moving |= moves(rate.value) & (shown.get(name, np.zeros_like(moving)) | ~rate.is_far)
    shown |= {name: moving for name, each in joined.items() if each.channel.unit_of_measure == "deg/s^2"}
    return shown, of_signal


def _with_motion(joined: _Joined, shown: BoolArray) -> _Joined:
    """The channel with the outliers that are motion; the others are counted."""
    left = int((joined.is_far & ~shown).sum())
    count = joined.outliers.number if left == joined.is_far.sum() else left
    one, other = joined.channel, joined.with_far
    mean, spread = np.where(shown, other.mean, one.mean), np.where(shown, other.spread, one.spread)
    outliers = Outliers(count if left else 0, joined.outliers.farthest)
    return joined._replace(channel=replace(one, mean=mean, spread=spread), outliers=outliers)


def _plain(channel: Channel) -> _Joined:
    blocks = len(channel.mean)
    return _Joined(channel, channel, np.zeros(blocks, dtype=np.bool_), np.full(blocks, np.nan))


def _empty(signal: SignalBlocks, unit_of_measure: str) -> Channel:
    return Channel(np.full(len(signal.slot), np.nan), np.zeros(len(signal.slot)), unit_of_measure)


def _at(slot: IntArray, known: IntArray, value: FloatArray) -> FloatArray:
    """Values of some blocks at these blocks; NaN at the others."""
    found = np.full(len(slot), np.nan)
    _, at, row = np.intersect1d(slot, known, return_indices=True)
    found[at] = value[row]
    return found


def _groups(sources: Sequence[ChannelSource]) -> list[list[ChannelSource]]:
    """Channels that are read together: all runs of a signal, and several signals that have few readings."""
    ordered = sorted(sources, key=lambda each: (each.is_rolled_up, each.unit, each.signal))
    groups: list[list[ChannelSource]] = []
    readings = 0.0
    for (rolled_up, *_), signal in groupby(ordered, key=lambda each: (each.is_rolled_up, each.unit, each.signal)):
        own = list(signal)
        more = sum(each.rows for each in own)
        if groups and groups[-1][0].is_rolled_up is rolled_up and readings + more <= MOST_READINGS:
            groups[-1] += own
            readings += more
        else:
            groups.append(own)
            readings = more
    return groups
