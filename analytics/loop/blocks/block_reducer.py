"""From the store to blocks: runs of a unit as block means of its signal, with the channels of unit and station."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from analytics.loop.blocks import derived
from analytics.loop.blocks.join import ChannelJoiner
from analytics.loop.blocks.notes import reduction_notes as notes_on
from analytics.loop.blocks.notes.left_out import LeftOut
from analytics.loop.blocks.notes.reduction_notes import LEAST_SHARE, Note
from analytics.loop.blocks.outliers import RateSeries
from analytics.loop.blocks.pieces import Grid, SignalKey
from analytics.loop.blocks.reading.stored_signals import ChannelSource, RecordedSignal, reach, records_of, sources_of
from analytics.loop.blocks.record_checks import (
    check_channels,
    check_labels,
    check_runs,
    clock_offsets,
    copied_runs,
    copies_left_out,
)
from analytics.loop.blocks.reference_edges import unresolved
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.blocks.signal_blocks import SignalBlocks, block_means
from analytics.loop.blocks.step_channels import position_numbers, read_steps
from analytics.loop.blocks.unit_run import UnitRun, left_out_of, notes_on_samples
from storage.sql.catalog import Catalog
from stream.errors import BadInput, GyrofleetError, NotFound
from stream.quantities import conversion, is_angular_rate, report_unit

BLOCK_S = 30.0
_FEWEST_BLOCKS = 2
_MOST_SLOTS = 10_000_000
_LONGEST_S = 1e9
_MOST_ROWS = 1_000_000  # of the signal that are read together of several units


@dataclass(frozen=True)
class Reduction:
    """Runs in the order of time, notes on them, and what was left out with its share of the record."""

    runs: tuple[RunBlocks, ...]
    notes: tuple[Note, ...] = ()
    left_out: tuple[LeftOut, ...] = ()

    @property
    def limits(self) -> tuple[str, ...]:
        """The notes that limit what can be concluded, as sentences."""
        return tuple(note.text for note in self.notes if note.is_limit)


class _Ahead(NamedTuple):
    """What was read of a unit: the records and blocks of its signal by run, and its channels with notes on them."""

    records: Mapping[str, RecordedSignal]
    blocks: Mapping[str, SignalBlocks]
    sources: tuple[dict[str, list[ChannelSource]], list[Note]]


@dataclass
class BlockReducer:
    """Reduces units of a store one after the other; the station's channels are reduced once for all units of a run.

    For the mean of a block and its uncertainty see `block_means`. A channel with four or more readings a block, or read
    at the times of the samples, is its mean over the block's readings; one with fewer is interpolated at the mean time
    of the signal's samples between readings at most two tolerances apart, else it is the nearest within the tolerance,
    else NaN.
    """

    catalog: Catalog
    signal: str  # an angular rate is returned in deg/h, another signal in its own unit
    _: KW_ONLY
    block_s: float = BLOCK_S  # whole seconds are read from rollups, others from the samples
    runs: Collection[str] | None = None  # by default all that have the signal
    since_ns: int | None = None
    until_ns: int | None = None
    tolerance_s: float | None = None  # of a channel's readings; by default a block, or their interval if longer
    channels: Collection[str] = ()  # other outputs of the units that are to be channels
    positions: Mapping[str, float] | None = None  # see `position_numbers`, by default those of the catalogue

    def __post_init__(self) -> None:
        if not 0 < self.block_s <= _LONGEST_S:
            raise BadInput(f"blocks of {self.block_s:g} s: give a positive number of seconds, {_LONGEST_S:g} at most")
        if self.tolerance_s is not None and not (np.isfinite(self.tolerance_s) and self.tolerance_s > 0):
            raise BadInput(f"a tolerance of {self.tolerance_s:g} s: give a positive number of seconds")
        self._joiner = ChannelJoiner(self.catalog, self.block_s, self.tolerance_s)
        self._ahead: dict[str, _Ahead] = {}

    @cached_property
    def _clock_offsets(self) -> dict[tuple[str, str], dict[str, float]]:
        return clock_offsets(self.catalog)

    def reduce_each(self, units: Sequence[str]) -> Iterator[Reduction | GyrofleetError]:
        """Each unit as by `reduce`, or why it cannot be reduced; units of few rows are read together."""
        waiting = list(units)
        while waiting:
            batch = self._read_ahead(waiting)
            for unit in batch:
                try:
                    yield self._reduced(unit)
                except GyrofleetError as error:
                    yield error
            del waiting[: len(batch)]
        self._joiner.forget_readings()

    def reduce(self, unit: str) -> Reduction:
        """Runs of a unit as blocks, with notes on the reduction.

        NotFound if the store lacks the signal in that time range, or a named run; BadInput if the runs have the signal
        in incompatible units of measure.
        """
        found = self._reduced(unit)
        self._joiner.forget_readings()
        return found

    def _read_ahead(self, units: Sequence[str]) -> Sequence[str]:
        """Read the first units, as many as have few rows; those whose signal or channels cannot be read are left."""
        records: dict[str, dict[str, RecordedSignal]] = {}
        rows, count = 0.0, 0
        for unit in units:
            with suppress(GyrofleetError):  # found again by who reduces the unit
                own = records_of(self.catalog, unit, self.signal, self.runs)
                rows += sum(each.rows for each in own.values())
                if records and rows > _MOST_ROWS:
                    break
                self._check_blocks(unit, own)
                records[unit] = own
            count += 1
        if len(records) > 1:
            try:
                self._ahead = self._read_together(records)
            except GyrofleetError:
                self._joiner.forget_expected()
        return units[:count]

    def _read_together(self, records: Mapping[str, Mapping[str, RecordedSignal]]) -> dict[str, "_Ahead"]:
        means = self._means(records)
        found: dict[str, _Ahead] = {}
        for unit, own in records.items():
            blocks = {run: means[key] for run in own if (key := SignalKey(unit, self.signal, run)) in means}
            if not blocks:
                continue
            own = {run: each for run, each in own.items() if run in blocks}
            sources = sources_of(self.catalog, unit, self.signal, list(own), self.channels)
            self._joiner.expect(sources[0], *self._grids_of(own))
            found[unit] = _Ahead(own, blocks, sources)
        self._joiner.read_expected()
        return found

    def _read(self, unit: str) -> "_Ahead":
        records = records_of(self.catalog, unit, self.signal, self.runs)
        self._check_blocks(unit, records)
        found = self._read_together({unit: records}).get(unit)
        if found is None:
            raise NotFound(
                f"unit {unit}, signal {self.signal}: no sample lies in the time that was asked for; the record "
                f"reaches {reach(records)}"
            )
        return found

    def _reduced(self, unit: str) -> Reduction:
        records, found, (sources, notes) = self._ahead.pop(unit, None) or self._read(unit)
        runs = self._joined(unit, records, found, sources)
        is_whole = self.since_ns is None and self.until_ns is None
        notes += notes_on_samples(self.catalog, runs, self._clock_offsets, is_whole=is_whole)
        notes += self._derive(runs)
        parts = self._parts(unit, runs)
        split = [each.name for each, own in zip(runs, parts, strict=True) if any(part.run != each.name for part in own)]
        notes += notes_on.power_ons(split, len(runs))
        blocks = [part for own in parts for part in own if len(part) > 0]
        if not any(source.name == "table_acceleration" for each in runs for source in each.sources):
            blocks = derived.without_rest(blocks)
        if not blocks:
            raise NotFound(
                f"unit {unit}, signal {self.signal}: no block is left: {'; '.join(note.text for note in notes)}"
            )
        left_out = left_out_of(runs)
        if copies := copied_runs(blocks):
            left_out = (*left_out, copies_left_out(copies, len({each.run for each in blocks})))
            blocks = [each for each in blocks if (each.unit, each.run) not in copies]
        notes += [*notes_on.no_scatter(blocks), *check_runs(blocks), *check_channels(blocks), *check_labels(blocks)]
        return Reduction(tuple(blocks), tuple(notes), left_out)

    def _check_blocks(self, unit: str, records: Mapping[str, RecordedSignal]) -> None:
        """Refuse blocks that are too short for the records."""
        longest_s = max((record.last_ns - record.first_ns) / 1e9 for record in records.values())
        shortest_s = max(longest_s / _MOST_SLOTS, 1e-6)
        if self.block_s < shortest_s:
            raise BadInput(
                f"unit {unit}, signal {self.signal}: blocks of {self.block_s:g} s in runs of up to {longest_s:g} s; "
                f"give blocks from {shortest_s:.2g} s on, 30 s where in doubt"
            )
        gone = [run for run, record in records.items() if record.kept_raw < record.samples]
        if gone and self.block_s % 1.0:
            raise BadInput(
                f"unit {unit}, signal {self.signal}, run {', '.join(gone)}: raw samples were dropped, what is kept "
                f"are seconds: give blocks of whole seconds, not {self.block_s:g} s"
            )

    def _means(self, records: Mapping[str, Mapping[str, RecordedSignal]]) -> dict[SignalKey, SignalBlocks]:
        """Blocks of the signal by unit and run, without runs that have none in the time range."""
        found: dict[SignalKey, SignalBlocks] = {}
        for rolled_up in (False, True):
            grids = {
                SignalKey(unit, self.signal, run): self._grid(each)
                for unit, own in records.items()
                for run, each in own.items()
                if each.is_rolled_up is rolled_up
            }
            found |= block_means(self.catalog, grids, self.block_s, rolled_up=rolled_up)
        return found

    def _grids_of(self, records: Mapping[str, RecordedSignal]) -> tuple[dict[str, Grid], dict[str, tuple[float, int]]]:
        """Grid of each run, and the interval and first of its samples."""
        return (
            {run: self._grid(record) for run, record in records.items()},
            {run: (record.interval_s, record.first_ns) for run, record in records.items()},
        )

    def _grid(self, record: RecordedSignal) -> Grid:
        return record.grid(self.since_ns, self.until_ns)

    def _joined(
        self,
        unit: str,
        records: Mapping[str, RecordedSignal],
        found: Mapping[str, SignalBlocks],
        sources: Mapping[str, list[ChannelSource]],
    ) -> list[UnitRun]:
        """The runs with their recorded channels."""
        grids, sampled = self._grids_of(records)
        self._joiner.expect(sources, grids, sampled)
        self._joiner.read_expected()
        steps, power_ons = read_steps(self.catalog, unit), self._power_ons(unit)
        runs = []
        for name, record in records.items():
            blocks = found[name]
            own = None
            if is_angular_rate(record.unit_of_measure):
                factor = conversion(record.unit_of_measure, "deg/s")[0]
                own = RateSeries(blocks.mean * factor, blocks.is_far, blocks.far_reading)
            channels, outliers, is_far = self._joiner.channels(sources[name], blocks, grids[name], own)
            result_unit, factor = report_unit(record.unit_of_measure)
            run = RunBlocks(
                unit=unit,
                run=name,
                signal=self.signal,
                slot=blocks.slot,
                block_s=self.block_s,
                t0_ns=grids[name].t0_ns,
                value=blocks.mean * factor,
                n=blocks.n,
                white_variance=blocks.white_variance * factor**2,
                unit_of_measure=result_unit,
                channels=channels,
                is_date_known=record.is_date_known,
            )
            runs.append(
                UnitRun(
                    name=name,
                    record=record,
                    found=blocks,
                    sources=sources[name],
                    steps=steps.get(name, []),
                    power_on_ns=power_ons.get(name, []),
                    blocks=run,
                    outliers=outliers,
                    is_far=is_far,
                    is_partial=blocks.n < LEAST_SHARE * np.median(blocks.n),
                    is_unresolved=np.zeros(len(run), dtype=np.bool_),
                )
            )
        self._joiner.forget(unit)
        return runs

    def _derive(self, runs: Sequence[UnitRun]) -> list[Note]:
        """Add the channels that follow from the record, mark the blocks that they do not resolve, and note both."""
        recorded = [run.blocks for run in runs]
        numbers = position_numbers(self.catalog) if self.positions is None else dict(self.positions)
        turns, notes = derived.assumed_axis({run.name: run.steps for run in runs}, recorded)
        references = [(source, run.blocks.t0_ns) for run in runs if (source := run.reference) is not None]
        self._joiner.expect_motion(references)
        for run in runs:
            run.blocks = derived.with_motion(run.blocks, run.found, run.steps, turns, numbers)
            if (source := run.reference) is not None:
                motion = self._joiner.motion(source, run.blocks.slot, run.blocks.t0_ns)
                commanded = derived.commanded_in(run.blocks, run.found, run.steps)
                hidden_s = notes_on.hidden_delay_s(source.interval_s, float(np.median(run.found.interval_s)))
                run.blocks = replace(run.blocks, hidden_delay_s=hidden_s)
                run.is_unresolved = unresolved(run.blocks, motion, run.sample_variance, commanded, run.is_lost)
        notes += derived.source_of_input_rate(recorded, [run.blocks for run in runs])
        notes += notes_on.positions({step.position for run in runs for step in run.steps if step.position}, numbers)
        notes += notes_on.no_power_on([run.name for run in runs if not run.has_power_on], len(runs))
        interval_s = max((run.reference.interval_s for run in runs if run.reference is not None), default=0.0)
        lossy = [(run.reference, run.blocks.t0_ns) for run in runs if run.is_unresolved.any()]
        held_s = [self._joiner.held_s(source, t0_ns) for source, t0_ns in lossy if source is not None]
        rows = {run.name: run.is_unresolved for run in runs}
        notes += notes_on.not_resolved(rows, interval_s, self.block_s, float(np.median(held_s)) if held_s else 0.0)
        swinging = [run for run in runs if run.reference is not None and run.is_swinging]
        if swinging:
            signal_s = float(np.median(np.concatenate([run.found.interval_s for run in swinging])))
            notes += notes_on.two_rates(interval_s, signal_s, self.block_s)
        return notes

    def _parts(self, unit: str, runs: Sequence[UnitRun]) -> list[list[RunBlocks]]:
        """The blocks of each run that are kept, each power-on as a run of its own."""
        rows = self.catalog.rows(
            "select min(s.t_first_ns) from signals s left join runs r using (run) "
            "where s.unit = $unit and coalesce(r.date_known, true)",
            {"unit": unit},
        )
        first_day_ns = None if rows[0][0] is None else int(rows[0][0])  # the same whichever runs are chosen
        parts = []
        for run in runs:
            clean = run.blocks.part(~run.is_lost)
            counted_from = run.power_on_ns or ([] if run.blocks.is_table else [run.record.first_ns])
            timed = derived.with_times(clean, counted_from, first_day_ns)
            parts.append(derived.split_at_power_ons(timed, run.power_on_ns, _FEWEST_BLOCKS))
        return parts

    def _power_ons(self, unit: str) -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        sql = "select run, t_ns from events where kind = 'PowerOn' and unit = $unit order by t_ns"
        for run, t_ns in self.catalog.rows(sql, {"unit": unit}):
            found.setdefault(str(run), []).append(int(t_ns))
        return found
