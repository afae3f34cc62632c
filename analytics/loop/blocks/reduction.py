"""From the store to blocks: runs of a unit as block means of its signal, with the channels of unit and station."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from analytics.loop.blocks.checks import Note, check_channels, check_clocks, check_runs, clock_offsets, in_runs
from analytics.loop.blocks.derived import (
    commanded_in,
    is_table,
    kept,
    middle_ns,
    source_of_input_rate,
    split_at_power_ons,
    supposed_axis,
    unresolved,
    with_motion,
    with_times,
)
from analytics.loop.blocks.join import ChannelJoiner
from analytics.loop.blocks.labels import check_labels
from analytics.loop.blocks.left_out import FAR_OUTSIDE, FEW_SAMPLES, NOT_RESOLVED, LeftOut, Loss, left_out
from analytics.loop.blocks.means import Blocks, block_means
from analytics.loop.blocks.motion import RateSeries
from analytics.loop.blocks.notes import (
    LEAST_SHARE,
    apart,
    far_outside,
    no_scatter,
    not_finite,
    not_resolved,
    partial,
    positions,
)
from analytics.loop.blocks.outliers import outlier_notes
from analytics.loop.blocks.records import Record, is_rolled_up, reach, records_of
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.blocks.sources import Source, sources_of
from analytics.loop.blocks.step_channels import Step, position_numbers, read_steps, step_rows
from storage.sql.catalog import Catalog
from stream.batch import BoolArray
from stream.errors import BadInput, NotFound
from stream.quantities import conversion, is_angular_rate, report_unit

BLOCK_S = 30.0
_FEWEST_BLOCKS = 2
_MOST_SLOTS = 10_000_000
_LONGEST_S = 1e9


@dataclass(frozen=True)
class Reduction:
    """What came of a unit's record.

    Parameters
    ----------
    runs: In the order of time.
    notes: What was left out, converted, supposed or looks wrong.
    left_out: What was left out, with its share of blocks, runs, steps and excitation.
    """

    runs: tuple[RunBlocks, ...]
    notes: tuple[Note, ...] = ()
    left_out: tuple[LeftOut, ...] = ()

    @property
    def limits(self) -> tuple[str, ...]:
        """The notes that limit what can be concluded, as sentences."""
        return tuple(note.text for note in self.notes if note.is_limit)


@dataclass(frozen=True)
class _Losses:
    """Blocks of each run that are left out, by reason."""

    far: dict[str, BoolArray] = field(default_factory=dict)
    partial: dict[str, BoolArray] = field(default_factory=dict)
    unresolved: dict[str, BoolArray] = field(default_factory=dict)

    def both(self, run: str) -> BoolArray:
        """Those that the signal itself costs."""
        return np.asarray(self.far[run] | self.partial[run])

    def named(self) -> tuple[Loss, ...]:
        """With their reasons."""
        return (Loss(FAR_OUTSIDE, self.far), Loss(FEW_SAMPLES, self.partial), Loss(NOT_RESOLVED, self.unresolved))


class BlockReducer:
    """Reduces units of a store one after the other; of the station's channels it does so once for all units of a run.

    Parameters
    ----------
    catalog: The store.
    signal: Which signal; an angular rate comes out in deg/h, another in its own unit.
    block_s: Length of a block, seconds. Whole seconds are read from rollups, others from the samples.
    runs: Which runs; all that have the signal where none are named.
    since_ns, until_ns: Only samples from one moment to another.
    tolerance_s: How far from a reading a channel is still believed; by default a block, or the channel's own interval
        where that is longer.
    channels: Other outputs of the units that are to be channels all the same.

    Raises
    ------
    BadInput: If the length of a block or the tolerance is no positive number.

    Notes
    -----
    What each block's mean stands for and how sure it is: see `block_means`. A channel with four readings or more a
    block, or read at the moments of the samples, is its mean over the block's readings; one with fewer is interpolated
    at the middle of the signal's samples,
    between readings at most two tolerances apart, else it is the nearest within the tolerance, else NaN.
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
        """The runs of a unit as blocks, and what is to be said of them.

        Raises
        ------
        NotFound: If the store has nothing of the signal in that time, or not the runs.
        BadInput: If the runs have the signal in units of measure that cannot be brought together.
        """
        records = records_of(self._catalog, unit, self._signal, self._wanted)
        found = self._means(unit, records)
        order = [run for run in records if run in found]
        whole_time = self._since_ns is None and self._until_ns is None
        if not order:
            raise NotFound(
                f"unit {unit}, signal {self._signal}: no sample lies in the time that was asked for; the record "
                f"reaches {reach(records)}"
            )
        sources, notes = sources_of(self._catalog, unit, self._signal, order, self._channels)
        if self._clock_offsets is None:
            self._clock_offsets = clock_offsets(self._catalog)
        instruments = sorted({(run, each.unit) for run in order for each in sources[run] if each.unit != unit})
        notes += not_finite(found, records) if whole_time else []
        units = {run: records[run].unit_of_measure for run in order}
        notes += outlier_notes(self._catalog, unit, self._signal, {run: records[run] for run in order})
        notes += apart({run: records[run] for run in order}, self._block_s)
        notes += check_clocks(self._clock_offsets, unit, self._signal, instruments)
        grids = {run: records[run].grid(self._since_ns, self._until_ns) for run in order}
        sampled = {run: (records[run].interval_s, records[run].first_ns) for run in order}
        self._joiner.prepare(sources, grids, sampled)
        losses = _Losses()
        runs = []
        for run in order:
            joined, is_far = self._run(unit, run, records[run], found[run], sources[run])
            runs.append(joined)
            losses.far[run] = is_far
            losses.partial[run] = found[run].n < LEAST_SHARE * np.median(found[run].n)
        far = {run: (int(rows.sum()), found[run].farthest) for run, rows in losses.far.items() if rows.any()}
        notes += far_outside(self._signal, far, units, len(order))
        notes += partial(losses.partial)
        for name in sorted({each.name for run in order for each in sources[run]}):
            own = {run: each for run in order for each in sources[run] if each.name == name}
            parts = {run: told for run, each in own.items() if (told := self._joiner.far(each, grids[run]))}
            notes += far_outside(name, parts, {run: each.unit_of_measure for run, each in own.items()}, len(order))
        self._joiner.forget(unit)
        runs, more, lost = self._derived(unit, runs, records, found, sources, losses)
        notes += more
        if not runs:
            raise NotFound(
                f"unit {unit}, signal {self._signal}: no block is left: {'; '.join(note.text for note in notes)}"
            )
        notes += [*no_scatter(runs), *check_runs(runs), *check_channels(runs), *check_labels(runs)]
        return Reduction(tuple(runs), tuple(notes), lost)

    def _means(self, unit: str, records: Mapping[str, Record]) -> dict[str, Blocks]:
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
        found: dict[str, Blocks] = {}
        for rolled_up in (False, True):
            grids = {
                run: record.grid(self._since_ns, self._until_ns)
                for run, record in records.items()
                if is_rolled_up(record.interval_s, record.samples, record.kept_raw) is rolled_up
            }
            found |= block_means(self._catalog, unit, self._signal, grids, self._block_s, rolled_up=rolled_up)
        return found

    def _run(
        self, unit: str, run: str, record: Record, found: Blocks, sources: Sequence[Source]
    ) -> tuple[RunBlocks, BoolArray]:
        """All blocks of a run with their channels, and in which of them the signal is that of no measurement."""
        result_unit, factor = report_unit(record.unit_of_measure)
        grid = record.grid(self._since_ns, self._until_ns)
        own = None
        if is_angular_rate(record.unit_of_measure):
            own = RateSeries(
                found.mean * conversion(record.unit_of_measure, "deg/s")[0], found.is_far, found.far_reading
            )
        channels, is_far = self._joiner.channels(sources, found, grid, own)
        joined = RunBlocks(
            unit=unit,
            run=run,
            signal=self._signal,
            slot=found.slot,
            block_s=self._block_s,
            t0_ns=grid.t0_ns,
            value=found.mean * factor,
            n=found.n,
            white_variance=found.white_variance * factor**2,
            unit_of_measure=result_unit,
            channels=channels,
            is_date_known=record.is_date_known,
        )
        return joined, is_far

    def _derived(
        self,
        unit: str,
        runs: Sequence[RunBlocks],
        records: Mapping[str, Record],
        found: Mapping[str, Blocks],
        sources: Mapping[str, Sequence[Source]],
        losses: "_Losses",
    ) -> tuple[list[RunBlocks], list[Note], tuple[LeftOut, ...]]:
        """The runs with what the record gives beside its channels, each power-on as a run of its own."""
        steps = read_steps(self._catalog, unit)
        turns, notes = supposed_axis(steps, runs)
        numbers = position_numbers(self._catalog)
        power_ons, first_day_ns = self._power_ons(unit), self._first_day(unit)
        moved: list[RunBlocks] = []
        done: list[RunBlocks] = []
        split: list[str] = []
        for run in runs:
            own_steps, on_ns = steps.get(run.run, ()), power_ons.get(run.run, [])
            moving = with_motion(run, found[run.run], own_steps, turns, numbers)
            moved.append(moving)
            losses.unresolved[run.run] = self._unresolved(
                moving, found[run.run], sources[run.run], own_steps, losses.both(run.run)
            )
            clean = kept(moving, ~(losses.both(run.run) | losses.unresolved[run.run]))
            counted_from = on_ns or ([] if is_table(run) else [records[run.run].first_ns])
            parts = split_at_power_ons(with_times(clean, counted_from, first_day_ns), on_ns, _FEWEST_BLOCKS)
            if any(part.run != run.run for part in parts):
                split.append(run.run)
            done.extend(part for part in parts if len(part) > 0)
        notes += source_of_input_rate(runs, moved)
        notes += positions(runs, steps, numbers)
        if unknown := [run.run for run in runs if run.run not in power_ons and not _tells_power_on(run)]:
            where = f"any of {len(runs)} runs" if len(unknown) == len(runs) > 1 else in_runs(unknown, len(runs))[3:]
            text = f"no power-on is recorded in {where}: time_since_power_on counts from the first sample"
            notes.append(Note("no_power_on", text, "time_since_power_on", tuple(unknown), is_limit=True))
        notes += not_resolved(losses.unresolved, self._interval_s(sources), self._block_s)
        if split:
            where = in_runs(split, len(runs))
            text = f"the unit was powered on several times {where}: each power-on counts as a run, RUN#1, RUN#2, ..."
            notes.append(Note("power_ons", text, runs=tuple(split)))
        in_steps = {
            (run.run, name): rows
            for run in moved
            for name, rows in step_rows(steps.get(run.run, ()), middle_ns(run)).items()
        }
        return _without_rest(done, sources), notes, left_out(moved, losses.named(), in_steps)

    def _unresolved(
        self, run: RunBlocks, found: Blocks, sources: Sequence[Source], steps: Sequence[Step], gone: BoolArray
    ) -> BoolArray:
        """Blocks whose reference rate its readings do not resolve."""
        source = _reference(sources)
        if source is None:
            return np.zeros(len(run), dtype=np.bool_)
        changes = self._joiner.changes(source, run.slot, run.t0_ns)
        return unresolved(run, changes, source.interval_s, commanded_in(run, found, steps), gone)

    def _interval_s(self, sources: Mapping[str, Sequence[Source]]) -> float:
        """Longest interval between readings of the reference rate."""
        found = [_reference(own) for own in sources.values()]
        return max((each.interval_s for each in found if each is not None), default=0.0)

    def _power_ons(self, unit: str) -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        sql = "select run, t_ns from events where kind = 'PowerOn' and unit = $unit order by t_ns"
        for run, t_ns in self._catalog.rows(sql, {"unit": unit}):
            found.setdefault(str(run), []).append(int(t_ns))
        return found

    def _first_day(self, unit: str) -> int | None:
        """First moment of the unit in the store whose date is known: whichever runs are chosen, days count from it."""
        rows = self._catalog.rows(
            "select min(s.t_first_ns) from signals s left join runs r using (run) "
            "where s.unit = $unit and coalesce(r.date_known, true)",
            {"unit": unit},
        )
        return None if rows[0][0] is None else int(rows[0][0])


def _reference(sources: Sequence[Source]) -> Source | None:
    by_name = {each.name: each for each in sources}
    return by_name.get("input_rate", by_name.get("table_rate"))


def _without_rest(runs: Sequence[RunBlocks], sources: Mapping[str, Sequence[Source]]) -> list[RunBlocks]:
    """Runs without a table's acceleration that was derived, and is nowhere other than 0."""
    name = "table_acceleration"
    if any(each.name == name for own in sources.values() for each in own):
        return list(runs)
    if any(np.nan_to_num(run.mean(name)).any() for run in runs if name in run.channels):
        return list(runs)
    return [replace(run, channels={key: each for key, each in run.channels.items() if key != name}) for run in runs]


def _tells_power_on(run: RunBlocks) -> bool:
    """Whether the time since power-on is recorded, or has no meaning."""
    return "time_since_power_on" in run.channels or is_table(run)
