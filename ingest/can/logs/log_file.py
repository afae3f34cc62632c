"""A CAN log as a file of samples: a first pass finds the sampling of each signal, a second delivers batches."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from uuid import UUID

import numpy as np

from ingest.can.frames import ids_text
from ingest.can.logs.can_log import CanLog
from ingest.can.mapping import CanMapping
from ingest.can.plan import CanPlan, SignalPlan
from ingest.can.samples import CanSamples, SignalPiece
from ingest.can.stream import nominal_interval_ns
from ingest.can.summary import CanSummary, remarks
from ingest.tables.batches import Batcher, splits_at_gaps
from ingest.tables.sample_file import FileStamp, Keep, Progress, SignalChunk, SignalSummary
from ingest.tables.steps import StepTracker
from ingest.tables.times import RunClock
from ingest.tables.timing.grid import SamplingGrid
from ingest.tables.timing.time_remarks import even_losses_remarks, rate_change_remarks
from stream.batch import IntArray, SampleBatch
from stream.errors import BadInput
from stream.events import StepEnded, StepStarted, StepWords
from stream.identity import check_name

_BATCH_SAMPLES = 1000
_FEW_FRAMES = 10
_SAME_WITHIN = 0.05

_Name = tuple[str, str]


class CanLogFile:
    """A CAN log (.blf, .asc, .trc, .log or .mf4) and the plan of its decoding.

    Its `run` is by default the file's name; `start_ns` its zero, nanoseconds UTC, if its times count from it. Each unit
    is in a step of the `words` all the time. `intervals` are nominal ones in nanoseconds by unit, run and signal in
    earlier logs; this one adds its own. `time_zone` is that of a time of day that states none. Raises BadInput if the
    log cannot be opened, or cannot name a run.
    """

    def __init__(
        self, path: Path, plan: CanPlan | CanMapping, run: str | None = None, start_ns: int | None = None,
        words: StepWords | None = None, intervals: dict[tuple[str, str, str], int] | None = None,
        time_zone: str | None = None,
    ) -> None:  # fmt: skip
        self._path = path
        self._log = CanLog(path, time_zone)
        self._plan = plan if isinstance(plan, CanPlan) else plan.plan(self._occurring)
        self._run, self._is_run_by_name = check_name("run", path.stem if run is None else run), run is None
        self._start_ns, self._words = start_ns, words
        self._intervals = {} if intervals is None else intervals
        self._stamp = FileStamp(path)
        self._summary: CanSummary | None = None

    def check(self, progress: Progress | None = None) -> CanSummary:
        """Read and decode the whole log; raises BadInput if it gives no sample."""
        samples, clock = CanSamples(self._plan, finds_pairs=True), RunClock(self._start_ns)
        grids: dict[_Name, SamplingGrid] = {}
        plans: dict[_Name, SignalPlan] = {}
        for piece in self._pieces(samples, clock, progress):
            name = (piece.route.unit, piece.plan.signal)
            if name not in grids:
                plans[name] = piece.plan
                grids[name] = SamplingGrid(partial(self._nominal_ns, piece))
            grids[name].add(piece.times_ns)
        counts = samples.counts
        if not grids:
            damage = f" ({self._log.damage})" if self._log.damage else ""
            unknown = f"ids that are not in the database: {ids_text(counts.unknown)}; " if counts.unknown else ""
            none = f"{counts.frames} frames{damage} and not one sample of what is mapped"
            if not counts.frames and self._path.suffix.lower() == ".mf4":
                none += ": of an MF4 file only frames of a bus are read; export measured signals as CSV or Parquet"
            raise BadInput(f"{self._path}: {none}; {unknown}see `gyrofleet can scan`")
        for each in counts.messages:
            if each.seen is not None and each.seen.is_wrong:
                where = f"{self._path}: message {each.message} of unit {each.unit}"
                raise BadInput(each.seen.sentence(where, "the mapping"))
            if each.frames > _FEW_FRAMES and each.late + each.retimed > each.frames / 2:
                where = f"{self._path}: message {each.message} of unit {each.unit}"
                raise BadInput(
                    f"{where}: of {each.frames} frames {each.late} lie before one that came earlier, and "
                    f"{each.retimed} at its time: the times are differences from frame to frame, or one is far ahead; "
                    "write the log with times of day, or take that frame out"
                )
        signals = []
        for (unit, signal), grid in grids.items():
            plan = plans[unit, signal]
            found = SignalSummary(unit, self._run, signal, plan.unit_of_measure, plan.is_counts, grid.finish())
            signals.append(found)
            self._intervals.setdefault((unit, self._run, signal), found.sampling.dt_ns)
        steps = StepTracker()
        for unit, first_ns, last_ns in self._stretches(signals):
            steps.follow(unit, self._run, self._words, first_ns=first_ns, last_ns=last_ns)
        self._summary = CanSummary(
            rows=counts.frames, bad_rows=0, bad=(), date_known=clock.date_known,
            steps=steps.finish(), signals=tuple(signals),
            counted="frames", damage=self._log.damage,
            remarks=(*filter(None, [self._log.note]), *self._plan.remarks, *remarks(counts, self._log.counts),
                     *rate_change_remarks(signals), *even_losses_remarks(signals)),
            frames=counts, words=self._words, is_run_by_name=self._is_run_by_name,
        )  # fmt: skip
        return self._summary

    def chunks(self, progress: Progress | None = None) -> Iterator[SignalChunk]:
        """Values of every sample, signal by signal and block by block."""
        for piece in self._pieces(CanSamples(self._plan), RunClock(self._start_ns), progress):
            values = np.asarray(piece.data, np.float64)
            if piece.plan.is_counts:
                values = values * piece.plan.layout.scale + piece.plan.layout.offset
            yield SignalChunk(piece.route.unit, self._run, piece.plan.signal, piece.times_ns, values)

    def batches(
        self, epoch_of: Callable[[str, str], UUID], keep: Keep | None = None, progress: Progress | None = None
    ) -> Iterator[SampleBatch | StepStarted | StepEnded]:
        """Batches, numbered from 0 per signal, and the step of each unit around them; runs `check` first."""
        try:
            yield from self._batches(epoch_of, keep, progress)
        except BadInput as error:
            raise error if str(self._path) in str(error) else BadInput(f"{self._path}: {error}") from error

    def _batches(
        self, epoch_of: Callable[[str, str], UUID], keep: Keep | None, progress: Progress | None
    ) -> Iterator[SampleBatch | StepStarted | StepEnded]:
        summary = self._summary if self._summary is not None else self.check()
        found = {(each.unit, each.signal): each for each in summary.signals}
        batchers: dict[_Name, Batcher] = {}
        steps = StepTracker()
        for unit, first_ns, last_ns in self._stretches(summary.signals):
            yield from filter(None, steps.follow(unit, self._run, self._words, first_ns=first_ns, last_ns=last_ns))
        for piece in self._pieces(CanSamples(self._plan), RunClock(self._start_ns), progress):
            name = (piece.route.unit, piece.plan.signal)
            times_ns, data = piece.times_ns, piece.data
            if keep is not None:
                kept = keep(piece.route.unit, self._run, piece.plan.signal, times_ns)
                times_ns, data = times_ns[kept], data[kept]
            if not len(times_ns):
                continue
            if name not in batchers:
                sampling = found[name].sampling
                epoch = epoch_of(piece.route.unit, self._run)
                head = piece.head(self._run, epoch, sampling.dt_ns, irregular=sampling.irregular)
                batchers[name] = Batcher(head, _BATCH_SAMPLES, splits_at_gaps=splits_at_gaps(sampling))
            yield from batchers[name].push(times_ns, data)
        for batcher in batchers.values():
            yield from batcher.flush()
        for unit, _, _ in self._stretches(summary.signals):
            yield from filter(None, [steps.close(unit, self._run)])

    def _stretches(self, signals: Sequence[SignalSummary]) -> Iterator[tuple[str, int, int]]:
        """First and last sample of each unit, nanoseconds; none without step words."""
        if self._words is None:
            return
        for unit in dict.fromkeys(each.unit for each in signals):
            samplings = [each.sampling for each in signals if each.unit == unit]
            yield unit, min(each.t_first_ns for each in samplings), max(each.t_last_ns for each in samplings)

    def _nominal_ns(self, piece: SignalPiece, intervals_ns: IntArray, measured_ns: int) -> int:
        """One interval in all files of a run if they agree within 5 %, as estimators need it."""
        message = piece.route.message
        if message.interval_ns is not None:
            return message.interval_ns
        known = self._intervals.get((piece.route.unit, self._run, piece.plan.signal))
        if known is not None and abs(measured_ns - known) <= _SAME_WITHIN * known:
            return known
        return nominal_interval_ns(intervals_ns, measured_ns, message.cycle_ns)

    def _pieces(self, samples: CanSamples, clock: RunClock, progress: Progress | None) -> Iterator[SignalPiece]:
        self._stamp.check()
        for block in self._log.blocks(progress):
            if clock.is_utc is None and len(block):
                clock.settle(int(block.t_ns[0]))
            yield from samples.take(replace(block, t_ns=clock.place(block.t_ns)))
        self._stamp.check()

    def _occurring(self) -> set[int]:
        return {int(each) for block in self._log.blocks() for each in np.unique(block.arbitration_id)}
