"""From the store to blocks: runs of a unit as block means of its signal, with the channels of unit and station."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from analytics.curves.isolated_outliers import isolated_outliers
from analytics.loop.blocks import reduction_notes as notes_on
from analytics.loop.blocks.derived import (
    assumed_axis,
    commanded_in,
    source_of_input_rate,
    split_at_power_ons,
    with_motion,
    with_times,
    without_rest,
)
from analytics.loop.blocks.join import ChannelJoiner, Outliers
from analytics.loop.blocks.left_out import LeftOut, Loss, left_out
from analytics.loop.blocks.outliers import RateSeries
from analytics.loop.blocks.rate_edges import unresolved
from analytics.loop.blocks.record_checks import check_channels, check_clocks, check_labels, check_runs, clock_offsets
from analytics.loop.blocks.reduction_notes import LEAST_SHARE, Note
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.blocks.signal_blocks import Grid, SignalBlocks, block_means
from analytics.loop.blocks.step_channels import Step, position_numbers, read_steps, step_rows
from analytics.loop.blocks.stored_signals import ChannelSource, RecordedSignal, reach, records_of, sources_of
from storage.sql.catalog import Catalog
from storage.sql.reading import find_signal
from stream.batch import BoolArray
from stream.errors import BadInput, NotFound
from stream.quantities import conversion, is_angular_rate, report_unit

BLOCK_S = 30.0
_FEWEST_BLOCKS = 2
_MOST_SLOTS = 10_000_000
_LONGEST_S = 1e9


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


@dataclass
class _Run:
    """A run of the unit between the store and its blocks.

    Parameters
    ----------
    blocks: All blocks with their channels: first those recorded, then with those derived.
    outliers: Of the channels.
    is_far, is_partial, is_unresolved: Blocks to leave out: with an outlier of the signal, too few samples, an edge.
    """

    name: str
    record: RecordedSignal
    found: SignalBlocks
    sources: list[ChannelSource]
    steps: list[Step]
    power_on_ns: list[int]
    blocks: RunBlocks
    outliers: dict[str, Outliers]
    is_far: BoolArray
    is_partial: BoolArray
    is_unresolved: BoolArray

    @property
    def reference(self) -> ChannelSource | None:
        """The recorded reference rate."""
        by_name = {each.name: each for each in self.sources}
        return by_name.get("input_rate", by_name.get("table_rate"))

    @property
    def has_power_on(self) -> bool:
        """Whether the time since power-on is known, or has no meaning."""
        return bool(self.power_on_ns) or "time_since_power_on" in self.blocks.channels or self.blocks.is_table


class BlockReducer:
    """Reduces units of a store one after the other; the station's channels are reduced once for all units of a run.

    Parameters
    ----------
    catalog: The store.
    signal: Name of the signal; an angular rate is returned in deg/h, another signal in its own unit.
    block_s: Length of a block, seconds. Whole seconds are read from rollups, others from the samples.
    runs: Runs to reduce; by default all that have the signal.
    since_ns, until_ns: Time range of the samples.
    tolerance_s: Longest time from a reading at which a channel is valid; by default a block, or the channel's own
        interval where that is longer.
    channels: Other outputs of the units that are to be channels.

    Notes
    -----
    For the mean of a block and its uncertainty see `block_means`. A channel with four or more readings a block, or read
    at the times of the samples, is its mean over the block's readings; one with fewer is interpolated at the mean time
    of the signal's samples between readings at most two tolerances apart, else it is the nearest within the tolerance,
    else NaN.
    """

    def __init__(
        self,
        catalog: Catalog,
        signal: str,
        *,
        block_s: float = BLOCK_S,
        runs: Collection[str] | None = None,
        since_ns: int | None = None,
        until_ns: int | None = None,
        tolerance_s: float | None = None,
        channels: Collection[str] = (),
    ) -> None:
        if not 0 < block_s <= _LONGEST_S:
            raise BadInput(f"blocks of {block_s:g} s: give a positive number of seconds, {_LONGEST_S:g} at most")
        if tolerance_s is not None and not (np.isfinite(tolerance_s) and tolerance_s > 0):
            raise BadInput(f"a tolerance of {tolerance_s:g} s: give a positive number of seconds")
        self._catalog = catalog
        self._signal = signal
        self._block_s = block_s
        self._wanted = runs
        self._channels = channels
        self._since_ns, self._until_ns = since_ns, until_ns
        self._joiner = ChannelJoiner(catalog, block_s, tolerance_s)
        self._clock_offsets: dict[tuple[str, str], dict[str, float]] | None = None

    def reduce(self, unit: str) -> Reduction:
        """Runs of a unit as blocks, with notes on the reduction.

        Raises
        ------
        NotFound: If the store lacks the signal in that time range, or a named run.
        BadInput: If the runs have the signal in incompatible units of measure.
        """
        records = records_of(self._catalog, unit, self._signal, self._wanted)
        found = self._means(unit, records)
        if not found:
            raise NotFound(
                f"unit {unit}, signal {self._signal}: no sample lies in the time that was asked for; the record "
                f"reaches {reach(records)}"
            )
        records = {run: each for run, each in records.items() if run in found}
        sources, notes = sources_of(self._catalog, unit, self._signal, list(records), self._channels)
        runs = self._joined(unit, records, found, sources)
        notes += self._notes_on_samples(unit, runs)
        notes += self._derive(runs)
        parts = self._parts(unit, runs)
        split = [each.name for each, own in zip(runs, parts, strict=True) if any(part.run != each.name for part in own)]
        notes += notes_on.power_ons(split, len(runs))
        blocks = [part for own in parts for part in own if len(part) > 0]
        if not any(source.name == "table_acceleration" for each in runs for source in each.sources):
            blocks = without_rest(blocks)
        if not blocks:
            raise NotFound(
                f"unit {unit}, signal {self._signal}: no block is left: {'; '.join(note.text for note in notes)}"
            )
        notes += [*notes_on.no_scatter(blocks), *check_runs(blocks), *check_channels(blocks), *check_labels(blocks)]
        return Reduction(tuple(blocks), tuple(notes), _left_out(runs))

    def _means(self, unit: str, records: Mapping[str, RecordedSignal]) -> dict[str, SignalBlocks]:
        """Blocks of the signal by run, without runs that have none in the time range."""
        longest_s = max((record.last_ns - record.first_ns) / 1e9 for record in records.values())
        shortest_s = max(longest_s / _MOST_SLOTS, 1e-6)
        if self._block_s < shortest_s:
            raise BadInput(
                f"unit {unit}, signal {self._signal}: blocks of {self._block_s:g} s in runs of up to {longest_s:g} s; "
                f"give blocks from {shortest_s:.2g} s on, 30 s where in doubt"
            )
        gone = [run for run, record in records.items() if record.kept_raw < record.samples]
        if gone and self._block_s % 1.0:
            raise BadInput(
                f"unit {unit}, signal {self._signal}, run {', '.join(gone)}: raw samples were dropped, what is kept "
                f"are seconds: give blocks of whole seconds, not {self._block_s:g} s"
            )
        found: dict[str, SignalBlocks] = {}
        for rolled_up in (False, True):
            grids = {run: self._grid(each) for run, each in records.items() if each.is_rolled_up is rolled_up}
            found |= block_means(self._catalog, unit, self._signal, grids, self._block_s, rolled_up=rolled_up)
        return found

    def _grid(self, record: RecordedSignal) -> Grid:
        return record.grid(self._since_ns, self._until_ns)

    def _joined(
        self,
        unit: str,
        records: Mapping[str, RecordedSignal],
        found: Mapping[str, SignalBlocks],
        sources: Mapping[str, list[ChannelSource]],
    ) -> list[_Run]:
        """The runs with their recorded channels."""
        grids = {run: self._grid(record) for run, record in records.items()}
        sampled = {run: (record.interval_s, record.first_ns) for run, record in records.items()}
        self._joiner.prepare(sources, grids, sampled)
        steps, power_ons = read_steps(self._catalog, unit), self._power_ons(unit)
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
                signal=self._signal,
                slot=blocks.slot,
                block_s=self._block_s,
                t0_ns=grids[name].t0_ns,
                value=blocks.mean * factor,
                n=blocks.n,
                white_variance=blocks.white_variance * factor**2,
                unit_of_measure=result_unit,
                channels=channels,
                is_date_known=record.is_date_known,
            )
            runs.append(
                _Run(
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

    def _notes_on_samples(self, unit: str, runs: Sequence[_Run]) -> list[Note]:
        """Notes on samples that are not finite, outliers, far apart or on another clock, and on partial blocks."""
        if self._clock_offsets is None:
            self._clock_offsets = clock_offsets(self._catalog)
        notes = []
        if self._since_ns is None and self._until_ns is None:
            notes += notes_on.not_finite({run.name: run.record.samples - int(run.found.n.sum()) for run in runs})
        isolated = {
            run.name: found
            for run in runs
            if not run.record.is_rolled_up  # else a sample hardly changes its block
            and (
                found := isolated_outliers(self._catalog, find_signal(self._catalog, unit, self._signal, run.name))
            ).is_worth_a_word
        }
        notes += notes_on.isolated(self._signal, isolated, len(runs))
        notes += notes_on.apart({run.name: run.record.interval_s for run in runs}, self._block_s)
        instruments = sorted({(run.name, each.unit) for run in runs for each in run.sources if each.unit != unit})
        notes += check_clocks(self._clock_offsets, unit, self._signal, instruments)
        far = {run.name: (int(run.is_far.sum()), run.found.farthest) for run in runs if run.is_far.any()}
        units = {run.name: run.record.unit_of_measure for run in runs}
        notes += notes_on.far_outside(self._signal, far, units, len(runs))
        notes += notes_on.partial({run.name: run.is_partial for run in runs})
        for name in sorted({each.name for run in runs for each in run.sources}):
            units = {run.name: each.unit_of_measure for run in runs for each in run.sources if each.name == name}
            outliers = {run.name: run.outliers[name] for run in runs if name in run.outliers}
            notes += notes_on.far_outside(name, outliers, units, len(runs))
        return notes

    def _derive(self, runs: Sequence[_Run]) -> list[Note]:
        """Add the channels that follow from the record, mark the blocks that they do not resolve, and note both."""
        recorded = [run.blocks for run in runs]
        numbers = position_numbers(self._catalog)
        turns, notes = assumed_axis({run.name: run.steps for run in runs}, recorded)
        for run in runs:
            run.blocks = with_motion(run.blocks, run.found, run.steps, turns, numbers)
            if (source := run.reference) is not None:
                changes = self._joiner.changes(source, run.blocks.slot, run.blocks.t0_ns)
                commanded = commanded_in(run.blocks, run.found, run.steps)
                lost = np.asarray(run.is_far | run.is_partial)
                run.is_unresolved = unresolved(run.blocks, changes, source.interval_s, commanded, lost)
        notes += source_of_input_rate(recorded, [run.blocks for run in runs])
        notes += notes_on.positions({step.position for run in runs for step in run.steps if step.position}, numbers)
        notes += notes_on.no_power_on([run.name for run in runs if not run.has_power_on], len(runs))
        interval_s = max((run.reference.interval_s for run in runs if run.reference is not None), default=0.0)
        notes += notes_on.not_resolved({run.name: run.is_unresolved for run in runs}, interval_s, self._block_s)
        return notes

    def _parts(self, unit: str, runs: Sequence[_Run]) -> list[list[RunBlocks]]:
        """The blocks of each run that are kept, each power-on as a run of its own."""
        rows = self._catalog.rows(
            "select min(s.t_first_ns) from signals s left join runs r using (run) "
            "where s.unit = $unit and coalesce(r.date_known, true)",
            {"unit": unit},
        )
        first_day_ns = None if rows[0][0] is None else int(rows[0][0])  # the same whichever runs are chosen
        parts = []
        for run in runs:
            clean = run.blocks.part(~(run.is_far | run.is_partial | run.is_unresolved))
            counted_from = run.power_on_ns or ([] if run.blocks.is_table else [run.record.first_ns])
            timed = with_times(clean, counted_from, first_day_ns)
            parts.append(split_at_power_ons(timed, run.power_on_ns, _FEWEST_BLOCKS))
        return parts

    def _power_ons(self, unit: str) -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        sql = "select run, t_ns from events where kind = 'PowerOn' and unit = $unit order by t_ns"
        for run, t_ns in self._catalog.rows(sql, {"unit": unit}):
            found.setdefault(str(run), []).append(int(t_ns))
        return found


def _left_out(runs: Sequence[_Run]) -> tuple[LeftOut, ...]:
    """What the blocks that are left out mean."""
    losses = (
        Loss(
            "a reading of the signal lies far outside of those before and after it",
            {run.name: run.is_far for run in runs},
        ),
        Loss("they hold but a few samples", {run.name: run.is_partial for run in runs}),
        Loss(
            "the reference rate changes within them faster than its readings show",
            {run.name: run.is_unresolved for run in runs},
        ),
    )
    in_steps = {
        (run.name, name): rows for run in runs for name, rows in step_rows(run.steps, run.blocks.middle_ns).items()
    }
    return left_out([run.blocks for run in runs], losses, in_steps)
