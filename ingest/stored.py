"""What a store already has of a file: the same samples are left out, others at the same time are refused."""

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ingest.instruments.table_summary import SignalChunk, SignalSummary, TableSummary
from ingest.sample_file import SampleFile
from storage.catalog import Catalog
from storage.reading import stored_between
from stream.batch import BoolArray, IntArray
from stream.errors import BadInput

_Name = tuple[str, str, str]


class StoredSamples:
    """The samples that a store and a file have in common.

    Parameters
    ----------
    catalog : Catalog
        The store.
    path : Path
        The file, for messages.
    summary : TableSummary
        What the first pass found in it.
    """

    def __init__(self, catalog: Catalog, path: Path, summary: TableSummary) -> None:
        self._catalog = catalog
        self._path = path
        self._summary = summary
        self._signals: dict[_Name, SignalSummary] = {(s.unit, s.run, s.signal): s for s in summary.signals}
        self._stored: dict[_Name, tuple[str, int, int]] = {}
        for unit, run, signal, unit_of_measure, first_ns, last_ns in catalog.rows(
            "select unit, run, signal, unit_of_measure, t_first_ns, t_last_ns from signals"
        ):
            if (unit, run, signal) in self._signals:
                self._stored[unit, run, signal] = (unit_of_measure, first_ns, last_ns)
        rows = catalog.rows("select run, date_known, outcome = 'open' from runs")
        self.runs = {str(run): bool(known) for run, known, _ in rows}
        self.open_runs = {str(run) for run, _, is_open in rows if is_open}

    def check(self, file: SampleFile) -> Counter[_Name]:
        """Compare the file with the store sample by sample; returns how many of each signal the store has already.

        Raises
        ------
        BadInput
            If a signal comes in another unit of measure than it is stored in, a run's clock is another one, or a
            sample lies where the store has a different one.
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

    def new(self, unit: str, run: str, signal: str, times_ns: IntArray) -> BoolArray:
        """Mask of the samples that the store does not have; `check` has found the others equal."""
        if not self._overlaps((unit, run, signal)):
            return np.ones(len(times_ns), np.bool_)
        stored_ns, _ = stored_between(self._catalog, unit, signal, run, int(times_ns[0]), int(times_ns[-1]))
        return ~np.isin(times_ns, stored_ns, assume_unique=True)

    def epochs(self, name: _Name) -> set[str]:
        """Epochs of the stored samples that lie within the file's time of a signal."""
        unit, run, signal = name
        sampling = self._signals[name].sampling
        rows = self._catalog.rows(
            "select distinct epoch from samples where unit = $unit and run = $run and signal = $signal "
            "and t_ns between $first and $last",
            {"unit": unit, "run": run, "signal": signal, "first": sampling.t_first_ns, "last": sampling.t_last_ns},
        )
        return {str(epoch) for (epoch,) in rows}

    def _check_alike(self, name: _Name, summary: SignalSummary) -> None:
        unit, run, signal = name
        if self.runs.get(run, self._summary.date_known) != self._summary.date_known:
            has, remedy = ("a", "give --start") if self.runs[run] else ("no", "leave --start out")
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
        stored_ns, stored = stored_between(
            self._catalog,
            chunk.unit,
            chunk.signal,
            chunk.run,
            int(times_ns[0]) - sampling.dt_ns,
            int(times_ns[-1]) + sampling.dt_ns,
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
        if differs.any():
            self._refuse(chunk, int(np.flatnonzero(differs)[0]), int(differs.sum()), stored_ns[after], stored[after])
        return int(same_time.sum())

    def _refuse(
        self,
        chunk: SignalChunk,
        at: int,
        count: int,
        stored_ns: IntArray,
        stored: np.ndarray[tuple[int], np.dtype[np.float64]],
    ) -> None:
        has = f"{stored[at]:.9g}" + (
            "" if stored_ns[at] == chunk.times_ns[at] else f" at {self._moment(stored_ns[at])}"
        )
        raise BadInput(
            f"{self._path}: overlaps what is stored of unit {chunk.unit}, signal {chunk.signal}, run {chunk.run} with "
            f"other values: at {self._moment(chunk.times_ns[at])} the file has {chunk.data[at]:.9g}, the store {has} "
            f"({count} such samples in this stretch); nothing was imported. If it is another recording, give --run"
        )

    def _moment(self, t_ns: int) -> str:
        if self._summary.date_known:
            return datetime.fromtimestamp(int(t_ns) / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f UTC")
        return f"{int(t_ns) / 1e9:.9g} s"
