"""A run of a unit between the store and its blocks, notes on its samples, and what it loses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from analytics.curves.isolated_outliers import isolated_outliers
from analytics.loop.blocks.derived import AT_REST_DEG_PER_S
from analytics.loop.blocks.join import Outliers
from analytics.loop.blocks.notes import reduction_notes as notes_on
from analytics.loop.blocks.notes.left_out import FAR_OUTSIDE, FEW_SAMPLES, NOT_RESOLVED, LeftOut, Loss, left_out
from analytics.loop.blocks.notes.reduction_notes import Note
from analytics.loop.blocks.reading.stored_signals import ChannelSource, RecordedSignal
from analytics.loop.blocks.record_checks import check_clocks
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.blocks.signal_blocks import SignalBlocks
from analytics.loop.blocks.step_channels import Step, step_rows
from storage.sql.catalog import Catalog
from storage.sql.reading import SignalRecord
from stream.batch import BoolArray
from stream.quantities import conversion, report_unit

_SWINGS = 0.02  # of the range of the means: the scatter within a block


@dataclass
class UnitRun:
    """A run of the unit between the store and its blocks."""

    name: str
    record: RecordedSignal
    found: SignalBlocks
    sources: list[ChannelSource]
    steps: list[Step]
    power_on_ns: list[int]
    blocks: RunBlocks  # all, with the channels recorded, later those derived as well
    outliers: dict[str, Outliers]  # of the channels
    is_far: BoolArray  # left out: blocks with an outlier of the signal
    is_partial: BoolArray  # left out: too few samples
    is_unresolved: BoolArray  # left out: across an edge

    @property
    def is_lost(self) -> BoolArray:
        """Blocks to leave out for any reason."""
        return np.asarray(self.is_far | self.is_partial | self.is_unresolved)

    @property
    def is_swinging(self) -> bool:
        """Whether the reference rate moves within most blocks."""
        rate = self.blocks.channels.get("input_rate")
        if rate is None or not (mean := rate.mean[np.isfinite(rate.mean)]).size:
            return False
        least = AT_REST_DEG_PER_S / conversion(rate.unit_of_measure, "deg/s")[0]
        # of blocks with one reading or none their changes show it
        moved = max(float(np.median(rate.spread)), float(np.median(np.abs(np.diff(mean)))) if mean.size > 1 else 0.0)
        return bool(moved > max(_SWINGS * np.ptp(mean), least))

    @property
    def sample_variance(self) -> float:
        """Variance of a sample's white noise, less any ramp; NaN if unknown."""
        return self.found.steady_variance * report_unit(self.record.unit_of_measure)[1] ** 2

    @property
    def reference(self) -> ChannelSource | None:
        """The recorded reference rate."""
        by_name = {each.name: each for each in self.sources}
        return by_name.get("input_rate", by_name.get("table_rate"))

    @property
    def stored_signal(self) -> SignalRecord:
        """The signal as it is stored."""
        unit, signal, record = self.blocks.unit, self.blocks.signal, self.record
        measure = record.unit_of_measure
        return SignalRecord(unit, signal, self.name, measure, record.samples, record.irregular, record.kept_raw)

    @property
    def is_turned(self) -> bool:
        """Whether the unit is turned within the run, so that its rate leaves its neighbours without being wrong."""
        turns = {(step.position, step.rate_command_deg_per_s, step.axis) for step in self.steps}
        if len(turns) > 1:
            return True
        for name in ("input_rate", "table_rate"):
            if (rate := self.blocks.channels.get(name)) is not None:
                mean = rate.mean[np.isfinite(rate.mean)] * conversion(rate.unit_of_measure, "deg/s")[0]
                if mean.size and np.ptp(mean) > AT_REST_DEG_PER_S:
                    return True
        return False

    @property
    def has_power_on(self) -> bool:
        """Whether the time since power-on is known, or has no meaning."""
        return bool(self.power_on_ns) or "time_since_power_on" in self.blocks.channels or self.blocks.is_table


def notes_on_samples(
    catalog: Catalog, runs: Sequence[UnitRun], offsets: Mapping[tuple[str, str], Mapping[str, float]], *, is_whole: bool
) -> list[Note]:
    """Notes on samples that are not finite, outliers, far apart or on another clock, and on partial blocks.

    `is_whole` says whether all samples of the runs were read.
    """
    unit, signal, block_s = runs[0].blocks.unit, runs[0].blocks.signal, runs[0].blocks.block_s
    notes = []
    if is_whole:
        notes += notes_on.not_finite({run.name: run.record.samples - int(run.found.n.sum()) for run in runs})
    isolated = {
        run.name: found
        for run in runs
        if not run.record.is_rolled_up  # else a sample hardly changes its block
        and not run.is_turned
        and (found := isolated_outliers(catalog, run.stored_signal)).is_worth_a_word
    }
    notes += notes_on.isolated(signal, isolated, len(runs))
    notes += notes_on.apart({run.name: run.record.interval_s for run in runs}, block_s)
    instruments = sorted({(run.name, each.unit) for run in runs for each in run.sources if each.unit != unit})
    notes += check_clocks(offsets, unit, signal, instruments)
    far = {run.name: (int(run.is_far.sum()), run.found.farthest) for run in runs if run.is_far.any()}
    units = {run.name: run.record.unit_of_measure for run in runs}
    notes += notes_on.far_outside(signal, far, units, len(runs))
    notes += notes_on.partial({run.name: run.is_partial for run in runs})
    for name in sorted({each.name for run in runs for each in run.sources}):
        units = {run.name: each.unit_of_measure for run in runs for each in run.sources if each.name == name}
        outliers = {run.name: run.outliers[name] for run in runs if name in run.outliers}
        notes += notes_on.far_outside(name, outliers, units, len(runs))
    return notes


def left_out_of(runs: Sequence[UnitRun]) -> tuple[LeftOut, ...]:
    """What the blocks that are left out mean."""
    losses = (
        Loss(FAR_OUTSIDE, {run.name: run.is_far for run in runs}),
        Loss(FEW_SAMPLES, {run.name: run.is_partial for run in runs}),
        Loss(NOT_RESOLVED, {run.name: run.is_unresolved for run in runs}),
    )
    in_steps = {
        (run.name, name): rows for run in runs for name, rows in step_rows(run.steps, run.blocks.middle_ns).items()
    }
    return left_out([run.blocks for run in runs], losses, in_steps)
