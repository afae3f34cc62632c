"""Tables of samples: CSV and Parquet files that keep the import contract, in two passes.

The first pass checks every row and finds the sampling of each signal; the second delivers batches and steps. Neither
holds more than a few blocks of the file; the one block of a small file is kept for the second, while there is room.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from uuid import UUID

import numpy as np

from ingest.tables.batches import Batcher, SignalHead, by_time, splits_at_gaps, usual_batch_samples
from ingest.tables.checks import GoodRows, Owner, RowFilter
from ingest.tables.columns import TableOptions, read_header
from ingest.tables.parquet_chunks import ParquetTable
from ingest.tables.rows import BadRows, CellBlock, NumberCells
from ingest.tables.sample_file import FileStamp, Keep, Progress, SignalChunk, SignalSummary, TableSummary
from ingest.tables.steps import StepTracker
from ingest.tables.text.csv_chunks import CsvTable
from ingest.tables.times import RunClock
from ingest.tables.timing.grid import SignalGrids
from ingest.tables.timing.time_remarks import (
    coarse_times_remark,
    even_losses_remarks,
    future_remark,
    rate_change_remarks,
    repeated_hour_advice,
    repeated_hour_remark,
    repeated_times_advice,
    unset_clock_remark,
)
from ingest.tables.units import COUNT_UNITS
from stream.batch import FloatArray, IntArray, SampleBatch
from stream.errors import BadInput
from stream.events import StepEnded, StepStarted

CSV_SUFFIXES = frozenset({".csv", ".tsv", ".txt"})
PARQUET_SUFFIXES = frozenset({".parquet", ".pq"})
_MANY_MISSING = 0.01  # of the samples of its record

_INT32 = np.iinfo(np.int32)
_EXACT = 2.0**53

_WORKBOOKS = frozenset({".xls", ".xlsx", ".xlsm", ".xlsb", ".et", ".ods"})
_COMPRESSED = frozenset({".gz", ".bz2", ".xz", ".zst", ".zip", ".7z"})


class TableFile:
    r"""A CSV or Parquet file that keeps the import contract; raises BadInput if the file cannot be read or its header
    does not keep the contract.

    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name) / "drift.csv"
    >>> _ = path.write_text("time[s],rate[deg/s]\n0.00,1.5\n0.01,1.6\n")
    >>> table = TableFile(path, TableOptions(unit="FOG-0231"))
    >>> table.check().signals[0].sampling.dt_ns
    10000000
    >>> [batch.value_array.tolist() for batch in table.batches(lambda unit, run: UUID(int=1))]
    [[1.5, 1.6]]
    >>> folder.cleanup()
    """

    def __init__(self, path: Path, options: TableOptions) -> None:
        self._path, self._options = path, options
        self._reader = _open(path)
        self._columns = read_header(
            path, self._reader.titles, options, self._reader.stamp_titles, self._reader.duration_units,
            self._reader.unsuited, self._reader.first_cells, self._reader.sample_cells, self._reader.blank_titles,
        )  # fmt: skip
        self._reader.bind(self._columns, options.time_zone or "UTC")
        self._stamp = FileStamp(path)
        self._summary: TableSummary | None = None
        self._kept: CellBlock | None = None  # all rows of a small file, once they are checked
        self._new_filter()  # the names that the options give are checked before anything is read

    def check(self, progress: Progress | None = None) -> TableSummary:
        """Read the whole file and check every row; `progress` is called with the fraction that is read, 0 to 1.

        Raises BadRows, with the bad rows, unless `skip_bad` is set; BadInput if the file as a whole cannot be used.
        """
        rows = self._new_filter()
        grids = SignalGrids()
        may_be_counts = {
            signal.name: signal.unit_of_measure in COUNT_UNITS or signal.title in self._reader.integer_titles
            for signal in self._columns.signals
        }
        whole = {name for name, may_be in may_be_counts.items() if may_be}
        rounded: Counter[str] = Counter()  # whole numbers that float64 cannot tell from their neighbours, by signal
        in_thousandths: dict[str, bool] = {}  # of counts, whether all that are not whole have three decimals
        tracker = StepTracker()
        procedures: set[str | None] = set()
        for good in self._good_rows(rows, progress):
            grids.add(good)
            for name in filter(whole.__contains__, good.signals):
                _, values = _samples(good.times_ns, good.signals[name])
                if len(values) and not _are_int32(values):
                    may_be_counts[name] = False
                    rounded[name] += int(np.count_nonzero(np.abs(values) >= _EXACT))
                    broken = values[values != np.rint(values)]
                    if len(broken):
                        in_thousandths[name] = in_thousandths.get(name, True) and _are_thousandths(broken)
            for begin, end, words in good.stretches:
                first_ns, last_ns = int(good.times_ns[begin]), int(good.times_ns[end - 1])
                _, started = tracker.follow(*good.owner, words, first_ns=first_ns, last_ns=last_ns)
                if started is not None:
                    procedures.add(started.words.procedure)
        if rows.bad_rows and not self._options.skip_bad:
            advice = repeated_times_advice(self._time_title, rows.repeated_times, rows.rows)
            if (zone := self._reader.local_zone) is not None:
                advice = advice or repeated_hour_advice(rows.late_ns, rows.late_times, zone)
            if not advice and (back := rows.clock_back()):
                advice = f"{back}; correct the file, or leave these rows out with --skip-bad"
            raise BadRows(self._path, tuple(rows.bad), rows.bad_rows, advice)
        found = grids.finish()
        if not found:
            raise BadInput(f"{self._path}: {rows.rows} rows, {rows.bad_rows} of them bad, and not one sample")
        units = {signal.name: signal.unit_of_measure for signal in self._columns.signals}
        signals = tuple(
            SignalSummary(owner.unit, owner.run, name, units[name], may_be_counts[name], sampling)
            for (owner, name), sampling in found.items()
        )
        is_known = any("separates thousands" in each for each in self._reader.remarks)
        remarks = (
            *self._columns.remarks, *self._reader.remarks,
            *self._remarks_on_times(signals, rows.clock),
            *(f"warning: {back}; they are left out" for back in filter(None, [rows.clock_back()])),
            *(rounded_remark(name, count) for name, count in rounded.items() if count),
            *(thousands_remark(name, units[name]) for name, is_so in in_thousandths.items() if is_so and not is_known),
        )  # fmt: skip
        self._summary = TableSummary(
            rows=rows.rows, bad_rows=rows.bad_rows, bad=tuple(rows.bad), date_known=rows.clock.date_known,
            steps=tracker.finish(), signals=signals, remarks=remarks,
            words=self._options.words, procedures=frozenset(procedures),
            is_run_by_name=self._options.run is None and self._columns.run is None,
        )  # fmt: skip
        return self._summary

    def _remarks_on_times(self, signals: Sequence[SignalSummary], clock: RunClock) -> Iterator[str]:
        first_ns = min(each.sampling.t_first_ns for each in signals)
        last_ns = max(each.sampling.t_last_ns for each in signals)
        found = [future_remark(last_ns) if clock.date_known else None]
        found += [unset_clock_remark(first_ns) if clock.is_utc else None]
        if (zone := self._reader.local_zone) is not None:
            found.append(repeated_hour_remark(first_ns, last_ns, zone))
        yield from filter(None, found)
        yield from rate_change_remarks(signals)
        yield from even_losses_remarks(signals, self._time_title)
        coarse = Counter(
            (each.sampling.step_ns, each.sampling.dt_ns, each.sampling.missing_share > _MANY_MISSING)
            for each in signals if each.sampling.step_ns
        )  # fmt: skip
        for (step_ns, dt_ns, has_gaps), count in coarse.items():
            yield coarse_times_remark(self._time_title, step_ns, dt_ns, count, has_gaps=has_gaps)

    @property
    def _time_title(self) -> str:
        return self._columns.time.title if self._columns.time is not None else ""

    def chunks(self, progress: Progress | None = None) -> Iterator[SignalChunk]:
        """Every sample of the good rows, signal by signal and block by block; runs `check` first, raises as it."""
        counts = self._counts()
        for good in self._good_rows(self._new_filter(), progress):
            for name, cells in good.signals.items():
                times_ns, data = _samples(good.times_ns, cells)
                if len(times_ns):
                    yield SignalChunk(*good.owner, name, times_ns, data.astype(np.int32) if counts[name] else data)

    def batches(
        self, epoch_of: Callable[[str, str], UUID], keep: Keep | None = None, progress: Progress | None = None
    ) -> Iterator[SampleBatch | StepStarted | StepEnded]:
        """Batches of samples and the steps around them, in time order for each unit and run.

        A batch lies in one step. Samples of each signal are numbered from 0 as they are delivered. Raises BadInput as
        `check`, which runs first if it has not run; and if the file has changed since. `keep` makes a mask of the
        samples to deliver of unit, run, signal and times in nanoseconds; steps are always delivered.
        """
        try:
            yield from self._delivered(epoch_of, keep, progress)
        except BadInput as error:
            raise error if str(self._path) in str(error) else BadInput(f"{self._path}: {error}") from error

    def _delivered(
        self, epoch_of: Callable[[str, str], UUID], keep: Keep | None, progress: Progress | None
    ) -> Iterator[SampleBatch | StepStarted | StepEnded]:
        counts = self._counts()
        batchers = self._batchers(epoch_of)
        tracker = StepTracker()
        for good in self._good_rows(self._new_filter(), progress):
            mine = batchers.setdefault(good.owner, {})
            for begin, end, words in good.stretches:
                if not tracker.is_open(*good.owner, words):
                    yield from _flushed(mine)
                first_ns, last_ns = int(good.times_ns[begin]), int(good.times_ns[end - 1])
                yield from filter(None, tracker.follow(*good.owner, words, first_ns=first_ns, last_ns=last_ns))
                pushed = []
                for name, cells in good.signals.items():
                    times_ns, data = _samples(good.times_ns[begin:end], cells.at(slice(begin, end)))
                    if keep is not None and len(times_ns):
                        kept = keep(*good.owner, name, times_ns)
                        times_ns, data = times_ns[kept], data[kept]
                    if len(times_ns):
                        pushed.append(mine[name].push(times_ns, data.astype(np.int32) if counts[name] else data))
                yield from by_time(pushed)
        if self._kept is not None:
            self._options.room.give(self._kept.bytes)
            self._kept = None
        for owner, mine in batchers.items():
            yield from _flushed(mine)
            yield from filter(None, [tracker.close(*owner)])

    def _good_rows(self, rows: RowFilter, progress: Progress | None) -> Iterator[GoodRows]:
        self._stamp.check()
        blocks, block = 0, None
        for block in self._reader.blocks() if self._kept is None else [self._kept]:
            blocks += 1
            yield from rows.good(block)
            if progress is not None:
                progress(block.done)
        self._stamp.check()
        if self._kept is None and block is not None and blocks == 1 and not rows.bad_rows:
            self._kept = block if self._options.room.take(block.bytes) else None

    def _new_filter(self) -> RowFilter:
        return RowFilter(self._path, self._columns, self._options)

    def _checked(self) -> TableSummary:
        return self._summary if self._summary is not None else self.check()

    def _counts(self) -> dict[str, bool]:
        return {summary.signal: summary.is_counts for summary in self._checked().signals}

    def _batchers(self, epoch_of: Callable[[str, str], UUID]) -> dict[Owner, dict[str, Batcher]]:
        batchers: dict[Owner, dict[str, Batcher]] = {}
        for found in self._checked().signals:
            sampling = found.sampling
            head = SignalHead(
                unit=found.unit, signal=found.signal, run=found.run, epoch=epoch_of(found.unit, found.run),
                dt_ns=sampling.dt_ns, unit_of_measure=found.unit_of_measure, irregular=sampling.irregular,
            )  # fmt: skip
            most = self._options.batch_samples or usual_batch_samples(sampling.dt_ns)
            batcher = Batcher(head, most, splits_at_gaps=splits_at_gaps(sampling))
            batchers.setdefault(Owner(found.unit, found.run), {})[found.signal] = batcher
        return batchers


def _open(path: Path) -> CsvTable | ParquetTable:
    suffix = path.suffix.lower()
    try:
        size = path.stat().st_size
        if path.is_dir():
            raise BadInput(f"{path}: a directory; give a file")
        if not path.is_file():
            raise BadInput(f"{path}: a pipe or a device, and it is read twice; give a file")
        if suffix not in CSV_SUFFIXES | PARQUET_SUFFIXES:
            known = " ".join(sorted(CSV_SUFFIXES | PARQUET_SUFFIXES))
            advice = "; decompress it first" if suffix in _COMPRESSED else ""
            advice = "; in Excel, save it as CSV UTF-8" if suffix in _WORKBOOKS else advice
            raise BadInput(f"{path}: unknown kind of file {suffix!r}; tables are {known}{advice}")
        if size == 0:
            raise BadInput(f"{path}: the file is empty")
        return CsvTable(path) if suffix in CSV_SUFFIXES else ParquetTable(path)
    except FileNotFoundError as error:
        raise BadInput(f"{path}: no such file") from error
    except OSError as error:
        raise BadInput(f"{path}: cannot be opened ({error.strerror or error})") from error


def _samples(times_ns: IntArray, cells: NumberCells) -> tuple[IntArray, FloatArray]:
    if cells.valid is None:
        return times_ns, cells.values
    return times_ns[cells.valid], cells.values[cells.valid]


def rounded_remark(signal: str, samples: int) -> str:
    """A warning that whole numbers are too large for values of 64-bit floats.

    >>> rounded_remark("angle", 2)
    'warning: 2 whole numbers of signal angle are beyond 2**53: they are rounded to the nearest 64-bit float'
    """
    number = "1 whole number" if samples == 1 else f"{samples} whole numbers"
    verb = "is beyond 2**53: it is" if samples == 1 else "are beyond 2**53: they are"
    return f"warning: {number} of signal {signal} {verb} rounded to the nearest 64-bit float"


def thousands_remark(signal: str, unit: str) -> str:
    """A warning that a signal in counts has parts of a count, and all of them in thousandths."""
    return (
        f"warning: signal {signal} in {unit} has numbers with three decimals, as 1.234: if the mark separates "
        "thousands, write the file without it"
    )


def _are_thousandths(values: FloatArray) -> bool:
    """Whether all values are from 1 to 1000 with at most three decimals, and most have three."""
    sizes = np.abs(values)
    off_3, off_2 = (np.abs(sizes * scale - np.rint(sizes * scale)) > 1e-6 for scale in (1000.0, 100.0))
    return bool((sizes > 1.0).all() and (sizes < 1000.0).all() and not off_3.any() and off_2.mean() > 0.5)


def _are_int32(values: FloatArray) -> bool:
    in_range = bool(values.min() >= _INT32.min) and bool(values.max() <= _INT32.max)
    return in_range and bool((values == np.rint(values)).all())


def _flushed(batchers: dict[str, Batcher]) -> Iterator[SampleBatch]:
    yield from by_time([batcher.flush() for batcher in batchers.values()])
