"""Comparison of a file with the store: equal samples are left out, others at the same time refused."""

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ingest.importing.other_names import other_names
from ingest.importing.shifted_copies import Shift, shift_of, shift_of_all
from ingest.importing.tested_units import may_be_output
from ingest.tables.sample_file import SampleFile, SignalChunk, SignalSummary, TableSummary
from storage.recording.knowledge import Knowledge
from stream.batch import BoolArray, CountArray, FloatArray, IntArray
from stream.errors import BadInput

_Name = tuple[str, str, str]
_FEWEST_TWINS = 3


class StoredSamples:
    """The samples that a store and a file have in common."""

    def __init__(self, knowledge: Knowledge, path: Path, summary: TableSummary) -> None:
        self._knowledge, self._path, self._summary = knowledge, path, summary
        self._signals: dict[_Name, SignalSummary] = {(s.unit, s.run, s.signal): s for s in summary.signals}
        names = sorted({s.run for s in summary.signals})
        self.known_signals = knowledge.signals(names)
        self._stored = {
            (known.unit, known.run, known.signal): (known.unit_of_measure, known.t_first_ns, known.t_last_ns)
            for known in self.known_signals
        }
        self.known = knowledge.runs(names)
        self.runs, self.open_runs = self.known.dated, set(self.known.open)

    def check(self, file: SampleFile) -> Counter[_Name]:
        """Compare the file with the store sample by sample; returns how many of each signal are stored already.

        Raises BadInput if a signal is stored in another unit of measure, a run has another clock, or a sample lies
        where the store has a different one.
        """
        for name, summary in self._signals.items():
            self._check_alike(name, summary)
        if not any(self._overlaps(name) for name in self._signals):
            return Counter()
        common: Counter[_Name] = Counter()
        for chunk in file.chunks():
            name = (chunk.unit, chunk.run, chunk.signal)
            if self._overlaps(name):
                common[name] += self._check_chunk(chunk)
        return common

    def shifted(self, file: SampleFile, owner: tuple[str, str]) -> Shift | None:
        """How all outputs of a unit in a run are stored at other times; None if one is not, or none is of a gyro."""
        known = {(each.unit, each.run, each.signal): each for each in self.known_signals}
        outputs = [name for name, own in self._signals.items() if name[:2] == owner and may_be_output(own)]
        if not outputs or not all(name in known for name in outputs):
            return None
        return shift_of_all(self._knowledge, {name: known[name] for name in outputs}, file)

    def under_other_names(self, file: SampleFile) -> list[str]:
        """Warnings on signals of the file that are stored under another name."""
        return other_names(self._knowledge, self.known_signals, self._summary.signals, file)

    def new(self, unit: str, run: str, signal: str, times_ns: IntArray) -> BoolArray:
        """Mask of the samples that are not stored; `check` has found the others equal."""
        if not self._overlaps((unit, run, signal)):
            return np.ones(len(times_ns), np.bool_)
        stored_ns, _ = self._knowledge.samples(unit, signal, run, int(times_ns[0]), int(times_ns[-1]))
        return ~np.isin(times_ns, stored_ns, assume_unique=True)

    def _check_alike(self, name: _Name, summary: SignalSummary) -> None:
        unit, run, signal = name
        if self.runs.get(run, self._summary.date_known) != self._summary.date_known:
            has, remedy = ("a", "give --start") if self.runs[run] else ("no", "give times from 0 without --start")
            raise BadInput(
                f"{self._path}: run {run} is stored with {has} date, and this file comes the other way; {remedy}, or "
                f"import it as another run with --run"
            )
        stored = self._stored.get(name)
        if stored is not None and stored[0] != summary.unit_of_measure:
            raise BadInput(
                f"{self._path}: {signal} of unit {unit}, run {run} is stored in {stored[0]}, this file has it in "
                f"{summary.unit_of_measure}; convert the file, or give it another --run"
            )

    def _overlaps(self, name: _Name) -> bool:
        stored, sampling = self._stored.get(name), self._signals[name].sampling
        if stored is None:
            return False
        return sampling.t_first_ns - sampling.dt_ns <= stored[2] and stored[1] <= sampling.t_last_ns + sampling.dt_ns

    def _check_chunk(self, chunk: SignalChunk) -> int:
        sampling = self._signals[chunk.unit, chunk.run, chunk.signal].sampling
        times_ns = chunk.times_ns
        stored_ns, stored = self._knowledge.samples(
            chunk.unit, chunk.signal, chunk.run, int(times_ns[0]) - sampling.dt_ns, int(times_ns[-1]) + sampling.dt_ns
        )
        if len(stored_ns) == 0:
            return 0
        after = np.minimum(np.searchsorted(stored_ns, times_ns), len(stored_ns) - 1)
        before = np.maximum(after - 1, 0)
        same_time = stored_ns[after] == times_ns
        differs = same_time & (stored[after] != chunk.data)
        if not sampling.irregular:
            # a sample between two stored ones belongs to another recording of the same moment
            nearest_ns = np.minimum(np.abs(stored_ns[after] - times_ns), np.abs(times_ns - stored_ns[before]))
            differs |= ~same_time & (2 * nearest_ns <= sampling.dt_ns)
        else:
            self._check_twins(chunk, ~same_time, stored_ns, stored, (before, after))
        if differs.any():
            at = int(np.flatnonzero(differs)[0])
            value, moment_ns = stored[after][at], int(stored_ns[after][at])
            moment = "" if moment_ns == times_ns[at] else f" at {self.moment(moment_ns)}"
            known = next(
                each for each in self.known_signals
                if (each.unit, each.run, each.signal) == (chunk.unit, chunk.run, chunk.signal)
            )  # fmt: skip
            shift = shift_of(self._knowledge, known, chunk)
            advice = "If it is another recording, give --run" if shift is None else (
                f"The store has {shift}: the same recording, with another --start or --time-zone"
            )  # fmt: skip
            raise BadInput(
                f"{self._path}: overlaps what is stored of unit {chunk.unit}, signal {chunk.signal}, run {chunk.run} "
                f"with other values: at {self.moment(times_ns[at])} the file has {chunk.data[at]:.9g}, the store "
                f"{value:.9g}{moment} ({int(differs.sum())} such samples in this stretch); nothing was imported. "
                f"{advice}"
            )
        return int(same_time.sum())

    def _check_twins(
        self, chunk: SignalChunk, others: BoolArray, stored_ns: IntArray, stored: FloatArray | CountArray,
        beside: tuple[IntArray, IntArray],
    ) -> None:  # fmt: skip
        """Refuse irregular samples that are stored with the same values a little earlier or later."""
        before, after = beside
        times_ns, dt_ns = chunk.times_ns, self._signals[chunk.unit, chunk.run, chunk.signal].sampling.dt_ns
        is_later = np.abs(stored_ns[after] - times_ns) < np.abs(times_ns - stored_ns[before])
        nearest = np.where(is_later, after, before)
        twins = others & (stored[nearest] == chunk.data) & (4 * np.abs(stored_ns[nearest] - times_ns) <= dt_ns)
        count = int(twins.sum())
        if count >= _FEWEST_TWINS and count > others.sum() / 2:
            at = int(np.flatnonzero(twins)[0])
            raise BadInput(
                f"{self._path}: unit {chunk.unit}, signal {chunk.signal}, run {chunk.run}: {count} samples of this "
                f"stretch are stored with the same values at slightly other times, as at "
                f"{self.moment(int(stored_ns[nearest][at]))} for {self.moment(int(times_ns[at]))}: the file is "
                "probably the same record with other digits; nothing was imported. If it is another recording, "
                "give --run"
            )

    def moment(self, t_ns: int) -> str:
        """A time of the file."""
        if self._summary.date_known:
            return datetime.fromtimestamp(int(t_ns) / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f UTC")
        return f"{int(t_ns) / 1e9:.9g} s"
