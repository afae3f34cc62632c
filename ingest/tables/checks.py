"""Rows of a table checked against the contract: names, times, step words; good rows are grouped by unit and run."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ingest.tables.columns import Columns, TableOptions
from ingest.tables.rows import BAD_ROWS_KEPT, BadRow, CellBlock, NumberCells, TextCells
from ingest.tables.steps import cell_text, step_words, with_common_words
from ingest.tables.times import RunClock, ns_from_index, seconds_text, stamp_text
from stream.batch import IntArray
from stream.errors import BadInput
from stream.events import StepWords
from stream.identity import NAME_RULE, check_name

IndexArray = npt.NDArray[np.intp]

_NEVER_NS = np.iinfo(np.int64).min
_MOST_OWNERS = 10_000
_LONGEST_S = 1e8
_ROWS_OF_A_CLOCK = 3  # at least, before times that the file has already, for each place at which times go back


class Owner(NamedTuple):
    """Unit and run of rows."""

    unit: str
    run: str


@dataclass(frozen=True)
class GoodRows:
    """Rows of one unit and run that keep the contract, in time order."""

    owner: Owner
    times_ns: IntArray  # shape (n,); strictly increasing, on the run's clock
    signals: dict[str, NumberCells]  # by name of the signal, shape (n,) each
    stretches: list[tuple[int, int, StepWords | None]]  # consecutive stretches of rows (from, to, words of their step)
    done: float  # fraction of the file that is read, 0 to 1


class ClockBack(NamedTuple):
    """A row whose time is earlier than that of the row before, and by how much it is before the one expected."""

    place: str
    number: int
    by_ns: int


class RowFilter:
    """Selects the good rows of a file, block by block, and logs the bad ones."""

    def __init__(self, path: Path, columns: Columns, options: TableOptions) -> None:
        self._path, self._columns = path, columns
        self._rate_hz = options.sample_rate_hz
        self._common_words = options.words
        self._unit = None if columns.unit else check_name("unit", options.unit or "")
        self._run = None if columns.run else _run_name(path, options.run)
        self._last_ns: dict[Owner, int] = {}
        self._seen: dict[Owner, int] = {}
        self.clock = RunClock(
            options.start_ns,
            is_stamps=columns.time is not None and columns.time.is_stamp,
            is_durations=columns.time is not None and columns.time.is_duration,
        )
        self.rows = self.bad_rows = self.late_times = 0
        self.repeated_times = 0  # of the late ones, those with the time of the row before
        self.late_ns: tuple[int, int] | None = None  # the first and last of them
        self.backs = 0  # how often a time is earlier than that of the row before
        self.first_back: ClockBack | None = None
        self._row_ns: dict[Owner, int] = {}  # the time of the last row, good or late
        self.bad: list[BadRow] = []  # the first of them

    def good(self, block: CellBlock) -> list[GoodRows]:
        """Good rows of the next block, by unit and run."""
        units = self._names(block, "unit", self._columns.unit)
        runs = self._names(block, "run", self._columns.run)
        words = [_read_texts(block, column.title, column.read) for column in self._columns.words]
        found = []
        owned = list(self._owned(units, runs, len(block.numbers)))
        written_ns = self._written_times(block, owned)
        self._settle_clock(block, written_ns)
        times_ns = self.clock.place(written_ns)
        for owner, rows in owned:
            rows = self._in_order(block, owner, rows[~block.sieve.bad[rows]], times_ns)
            if not len(rows):
                continue
            mine_ns, signals = times_ns, block.signals
            if len(rows) < len(block.numbers):
                mine_ns, signals = times_ns[rows], {name: cells.at(rows) for name, cells in signals.items()}
            found.append(GoodRows(owner, mine_ns, signals, self._stretches(rows, words), block.done))
        self.rows += len(block.numbers)
        self.bad_rows += int(block.sieve.bad.sum())
        self.bad += block.sieve.reasons()[: BAD_ROWS_KEPT - len(self.bad)]
        return found

    def _names(self, block: CellBlock, kind: str, title: str | None) -> TextCells | None:
        if title is None:
            return None

        def read(cell: object) -> str:
            name = cell_text(cell)
            if not name:
                raise BadInput(f"the name of a {kind}")
            try:
                return check_name(kind, name)
            except BadInput as error:
                raise BadInput(f"a name: {NAME_RULE}") from error

        names = _read_texts(block, title, read)
        block.sieve.refuse(np.flatnonzero(names.codes < 0), _unreadable(block, title, "", f"the name of a {kind}"))
        return names

    def _owned(self, units: TextCells | None, runs: TextCells | None, n: int) -> Iterator[tuple[Owner, IndexArray]]:
        if n == 0:
            return
        if units is None and runs is None:
            assert self._unit is not None
            assert self._run is not None
            yield Owner(self._unit, self._run), np.arange(n)
            return
        unit_names = [self._unit] if units is None else units.values
        run_names = [self._run] if runs is None else runs.values
        unit_codes = np.zeros(n, np.int64) if units is None else units.codes.astype(np.int64)
        run_codes = np.zeros(n, np.int64) if runs is None else runs.codes.astype(np.int64)
        keys = np.where((unit_codes < 0) | (run_codes < 0), -1, unit_codes * len(run_names) + run_codes)
        order = np.argsort(keys, kind="stable")
        found, begins = np.unique(keys[order], return_index=True)
        for key, rows in zip(found.tolist(), np.split(order, begins[1:]), strict=True):
            if key >= 0:
                unit, run = divmod(key, len(run_names))
                yield Owner(str(unit_names[unit]), str(run_names[run])), rows

    def _written_times(self, block: CellBlock, owned: list[tuple[Owner, IndexArray]]) -> IntArray:
        if block.times_ns is not None:
            return block.times_ns
        assert self._rate_hz is not None
        times_ns = np.zeros(len(block.numbers), np.int64)
        for owner, rows in owned:
            first = self._seen.get(owner, 0)
            if (first + len(rows)) / self._rate_hz >= _LONGEST_S:
                raise BadInput(f"{self._path}: at {self._rate_hz} Hz it lasts over 3 years; is --sample-rate right?")
            times_ns[rows] = ns_from_index(np.arange(first, first + len(rows), dtype=np.int64), self._rate_hz)
            self._seen[owner] = first + len(rows)
        return times_ns

    def _settle_clock(self, block: CellBlock, written_ns: IntArray) -> None:
        if block.times_ns is None:
            self.clock.is_utc = False
            return
        if self.clock.is_utc is None:
            good = np.flatnonzero(~block.sieve.bad)
            if not len(good):
                return
            try:
                self.clock.settle(int(written_ns[good[0]]))
            except BadInput as error:
                raise BadInput(f"{self._path}: {error}") from error
        expected = self.clock.expected
        rows = np.flatnonzero(self.clock.misplaced(written_ns))
        block.sieve.refuse(rows, lambda row: self._bad_time(block, row, int(written_ns[row]), expected))

    def _in_order(self, block: CellBlock, owner: Owner, rows: IndexArray, times_ns: IntArray) -> IndexArray:
        if not len(rows):
            return rows
        if owner not in self._last_ns and len(self._last_ns) >= _MOST_OWNERS:
            raise BadInput(f"{self._path}: more than {_MOST_OWNERS} units and runs; does column 'unit' hold names?")
        times = times_ns[rows]
        # a late row is never the latest: the running maximum of all rows is that of the good ones
        latest = np.maximum.accumulate(np.concatenate([[self._last_ns.get(owner, _NEVER_NS)], times]))
        self._last_ns[owner] = int(latest[-1])
        late = times <= latest[:-1]
        self._follow_clock(block, owner, rows, times)
        if not late.any():
            return rows
        self.repeated_times += int(np.count_nonzero(times == latest[:-1]))
        self.late_times += int(np.count_nonzero(late))
        ends = int(times[late].min()), int(times[late].max())
        self.late_ns = ends if self.late_ns is None else (min(ends[0], self.late_ns[0]), max(ends[1], self.late_ns[1]))
        before = dict(zip(rows[late].tolist(), latest[:-1][late].tolist(), strict=True))

        def why(row: int) -> BadRow:
            last_ns, found_ns = (self.clock.as_written(each) for each in (before[row], int(times_ns[row])))
            expected = f"a time after {self._time_text(last_ns)} (unit {owner.unit}, run {owner.run})"
            return self._bad_time(block, row, found_ns, expected)

        block.sieve.refuse(rows[late], why)
        return rows[~late]

    def _follow_clock(self, block: CellBlock, owner: Owner, rows: IndexArray, times_ns: IntArray) -> None:
        """Count the rows at which times go back."""
        before = np.concatenate([[self._row_ns.get(owner, _NEVER_NS)], times_ns[:-1]])
        self._row_ns[owner] = int(times_ns[-1])
        back = np.flatnonzero(times_ns < before)
        self.backs += len(back)
        if len(back) and self.first_back is None:
            at = int(back[0])
            interval_ns = max(0, int(times_ns[at - 1] - times_ns[at - 2])) if at > 1 else 0
            by_ns = int(before[at] - times_ns[at]) + interval_ns
            self.first_back = ClockBack(block.place, int(block.numbers[rows[at]]), by_ns)

    def clock_back(self) -> str:
        """A sentence on a clock that went back, and the rows at times that were there already; empty if none did."""
        found, late, ends = self.first_back, self.late_times, self.late_ns
        if found is None or ends is None or late - self.repeated_times < _ROWS_OF_A_CLOCK * self.backs:
            return ""
        first, last = (
            stamp_text(each) if self.clock.date_known else seconds_text(self.clock.as_written(each)) for each in ends
        )
        more = f", the first of {self.backs} such places" if self.backs > 1 else ""
        return (
            f"the clock goes back by {seconds_text(found.by_ns)} at {found.place} {found.number}{more}: {late} rows "
            f"from {first} to {last} lie at or before times that the file has already"
        )

    def _bad_time(self, block: CellBlock, row: int, time_ns: int, expected: str) -> BadRow:
        title = self._columns.time.title if self._columns.time is not None else ""
        return BadRow(block.place, int(block.numbers[row]), title, self._time_text(time_ns), expected)

    def _time_text(self, written_ns: int) -> str:
        """A time as the file writes it; of a stamp its moment in UTC."""
        time = self._columns.time
        return stamp_text(written_ns) if time is not None and time.is_stamp else seconds_text(written_ns)

    def _stretches(self, rows: IndexArray, words: list[TextCells]) -> list[tuple[int, int, StepWords | None]]:
        codes = [cells.codes[rows] for cells in words]
        changed = np.zeros(len(rows) - 1, np.bool_)
        for column in codes:
            changed |= column[1:] != column[:-1]
        edges = [0, *(np.flatnonzero(changed) + 1).tolist(), len(rows)]
        stretches = []
        for begin, end in pairwise(edges):
            coded = zip(words, codes, strict=True)
            values = [cells.values[code[begin]] if code[begin] >= 0 else None for cells, code in coded]
            own = step_words(self._columns.words, values)
            stretches.append((begin, end, with_common_words(own, self._common_words)))
        return stretches


def _run_name(path: Path, run: str | None) -> str:
    if run is not None:
        return check_name("run", run)
    try:
        return check_name("run", path.stem)
    except BadInput as error:
        raise BadInput(f"{path}: the file's name cannot name the run; give --run R ({error})") from error


def _read_texts(block: CellBlock, title: str, read: Callable[[object], Any]) -> TextCells:
    """Read every distinct cell once; equal meanings share a code, empty and unreadable cells have -1."""
    cells = block.texts[title]
    meanings: dict[Any, int] = {}
    codes = np.full(len(cells.values) + 1, -1, np.int32)
    for code, cell in enumerate(cells.values):
        try:
            meaning = read(cell)
        except BadInput as error:
            rows = np.flatnonzero(cells.codes == code)
            block.sieve.refuse(rows, _unreadable(block, title, str(cell), str(error)))
        else:
            if meaning is not None:
                codes[code] = meanings.setdefault(meaning, len(meanings))
    # code -1 (empty) finds the last place
    return TextCells(codes[cells.codes], list(meanings))


def _unreadable(block: CellBlock, title: str, found: str, expected: str) -> Callable[[int], BadRow]:
    return lambda row: BadRow(block.place, int(block.numbers[row]), title, found, expected)
