"""Samples of one signal from the lake in the order of time: all of them, or an error."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from uuid import UUID

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from storage.lake.tables import SAMPLES_FILE, damaged
from storage.sql.catalog import Catalog
from storage.sql.columns import numbers, rows_with
from storage.sql.footers import UNREADABLE, Footer
from storage.sql.lake_source import LakeSource
from storage.store import Store
from stream.batch import FloatArray, IntArray, SampleBatch
from stream.errors import NotFound

if TYPE_CHECKING:
    import pyarrow.parquet as pq

_ROWS = 122_880  # DuckDB's row group
MOST_GROUPS = 5  # of which a look at a record reads some rows
_RECORDS = "select s.run, s.unit_of_measure, s.samples, s.irregular, s.kept_raw, count(*) over () from signals s"
_LONGEST = f"""
{_RECORDS} left join runs r on r.run = s.run anti join exclusions x on x.run = s.run and x.unit = s.unit
where s.unit = $unit and s.signal = $signal
order by s.t_last_ns - s.t_first_ns desc,
  case when coalesce(r.date_known, true) then s.t_last_ns else s.arrival_first_ns end desc,
  s.arrival_first_ns desc, s.t_first_ns desc limit 1
"""
# which has nothing to choose, and asks nothing of the runs
_OF_RUN = f"{_RECORDS} where s.unit = $unit and s.signal = $signal and s.run = $run"

_BETWEEN = """
select t_ns, value from internal.samples_in($paths)
where unit = $unit and signal = $signal and run = $run and t_ns between $first and $last order by t_ns
"""


@dataclass(frozen=True)
class SignalRecord:
    """One stored signal of one run; `runs` is the number of runs that it was chosen from."""

    unit: str
    signal: str
    run: str
    unit_of_measure: str
    samples: int
    irregular: bool
    kept_raw: int | None = None
    runs: int = 1


class Asked(Protocol):
    """A catalogue, or a store that is asked through its door."""

    @property
    def store(self) -> Store:
        """The store."""

    def rows(self, sql: str, parameters: object = None, /) -> list[tuple[Any, ...]]:
        """All rows of a statement's result."""


def find_signal(catalog: Asked, unit: str, signal: str, run: str | None = None) -> SignalRecord:
    """The record of a signal; without `run` the longest one that is not excluded, of equally long ones the last.

    A run of unknown date counts as measured when it was recorded. NotFound lists what the store holds.
    """
    given = {"unit": unit, "signal": signal} | ({} if run is None else {"run": run})
    rows = catalog.rows(_LONGEST if run is None else _OF_RUN, given)
    if not rows:
        _check_held(catalog, "unit", unit, "", {})
        _check_held(catalog, "signal", signal, f" of unit {unit}", {"unit": unit})
        of = f" of unit {unit}, signal {signal}"
        if run is not None:
            _check_held(catalog, "run", run, of, {"unit": unit, "signal": signal})
        elif excluded := excluded_runs(catalog, unit):
            raise NotFound(
                f"every run{of} is excluded from evaluation: {format_excluded(excluded)}; name one with --run, or "
                "include one again with `gyrofleet runs include`"
            )
        raise NotFound(f"a record{of} came to {catalog.store.label} at this moment; ask again")
    row = rows[0]
    return SignalRecord(unit, signal, str(row[0]), str(row[1]), int(row[2]), bool(row[3]), int(row[4]), int(row[5]))


def excluded_runs(catalog: Asked, unit: str) -> dict[str, str]:
    """Why runs of a unit are excluded from evaluation, by run."""
    return dict(catalog.rows("select run, reason from exclusions where unit = $unit order by run", {"unit": unit}))


def format_excluded(reasons: Mapping[str, str]) -> str:
    """Excluded runs and why, for people.

    >>> format_excluded({"r1": "table kicked", "r2": "wrong axis"})
    'r1 (table kicked), r2 (wrong axis)'
    """
    listed = [f"{run} ({reason})" for run, reason in reasons.items()]
    return ", ".join(listed[:4]) + (f" and {len(listed) - 4} more" if len(listed) > 4 else "")


def _check_held(catalog: Asked, column: str, wanted: str, of: str, given: dict[str, str]) -> None:
    where = " and ".join(["true", *(f"{name} = ${name}" for name in given)])
    sql = f"select distinct {column} from signals where {where} order by 1"  # noqa: S608
    held = [str(row[0]) for row in catalog.rows(sql, given)]
    if wanted not in held:
        listed = ", ".join(held[:12]) + (f" and {len(held) - 12} more" if len(held) > 12 else "")
        raise NotFound(f"{column} {wanted!r}{of} is not in {catalog.store.label}; it holds {listed or 'nothing yet'}")


def read_signal(catalog: Catalog, record: SignalRecord) -> Iterator[SampleBatch]:
    """Batches of a signal in the order of time; NotFound if some raw rows were dropped."""
    if record.kept_raw is not None and record.kept_raw < record.samples:
        raise _gone(catalog, record.unit, record.signal, record.run, record.samples - record.kept_raw, record.samples)
    channels = catalog.rows(
        'select channel, epoch, dt_ns, is_counts, scale, "offset", irregular from internal.lake_channels '
        "where unit = $unit and signal = $signal and run = $run order by t_first_ns",
        {"unit": record.unit, "signal": record.signal, "run": record.run},
    )
    for channel, epoch, dt_ns, is_counts, scale, offset, irregular in channels:
        for table in _channel_rows(catalog, channel, "counts" if is_counts else "value"):
            t_ns = numbers(table.column(1))
            data = numbers(table.column(2))
            is_exact = not irregular and bool(np.all(np.diff(t_ns) == dt_ns))
            yield SampleBatch(
                unit=record.unit, signal=record.signal, run=record.run, epoch=UUID(epoch),
                seq=table.column(0)[0].as_py(), t0_ns=int(t_ns[0]), dt_ns=dt_ns,
                unit_of_measure=record.unit_of_measure, counts=data if is_counts else None,
                values=None if is_counts else data, times_ns=None if is_exact else t_ns, irregular=irregular,
                scale=scale, offset=offset,
            )  # fmt: skip


def _channel_rows(catalog: Catalog, channel: int, column: str) -> Iterator[pa.RecordBatch]:
    """Numbers, times and data of a channel in the order of its numbers."""
    sql = (
        "select seq_first, seq_next, filename from internal.lake_channel_parts "
        "where channel = $channel order by seq_first"
    )
    stretches = catalog.rows(sql, {"channel": channel})
    if all(seq_next <= after for (_, seq_next, _), (after, _, _) in itertools.pairwise(stretches)):
        for _, _, path in stretches:
            yield from _part_rows(catalog, f"{path.rpartition('/')[0]}/{SAMPLES_FILE}", channel, column)
        return
    # a segment that was recovered later has numbers between those of another part
    sql = (
        "select seq, t_ns, base + above as counts, value from internal.lake_samples "
        "where channel = $channel order by seq"
    )
    for batch in catalog.batches(sql, {"channel": channel}, _ROWS):
        yield batch.select(["seq", "t_ns", column])


def _part_rows(catalog: Catalog, path: str, channel: int, column: str) -> Iterator[pa.RecordBatch]:
    columns = ["base", "above"] if column == "counts" else ["value"]
    file, footer = catalog.source.open_table(path)
    with file:
        try:
            own = footer.groups_with(channel)
            for is_shared, groups in itertools.groupby(own, key=lambda each: each[1]):
                extra = ["channel"] if is_shared else []
                for batch in file.iter_batches(_ROWS, [i for i, _ in groups], [*extra, "seq", "t_ns", *columns]):
                    rows = rows_with(batch, "channel", channel) if is_shared else batch
                    data = rows.column(columns[0])
                    if column == "counts":
                        import pyarrow.compute as pc

                        data = pc.add(data, rows.column("above"))
                    numbered = [rows.column("seq"), rows.column("t_ns"), data]
                    yield pa.RecordBatch.from_arrays(numbered, ["seq", "t_ns", column])
        except UNREADABLE as error:
            raise damaged(Path(path), error) from error


def rows_between(
    source: LakeSource, path: str, channel: int, column: str, between: tuple[int, int], columns: Sequence[str]
) -> tuple[npt.NDArray[Any], ...]:
    """Columns of the rows of a channel in a file of the lake whose `column` is in a half-open range.

    Nulls are NaN. As `column`, statistics of the file need to have it.
    """
    file, footer = source.open_table(path)
    first, stop = between
    names = list(dict.fromkeys(["channel", column, *columns]))
    with file:
        try:
            rows = file.read_row_groups(footer.groups_between(channel, column, first, stop), names, use_threads=False)
        except UNREADABLE as error:
            raise damaged(Path(path), error) from error
    found = {name: numbers(rows.column(name)) for name in names}
    inside = (found["channel"] == channel) & (found[column] >= first) & (found[column] < stop)
    return tuple(found[name][inside] for name in columns)


def rows_at_beginnings(
    file: "pq.ParquetFile", footer: Footer, channel: int, columns: Sequence[str], windows: Sequence[tuple[int, int]],
    rows: int, dt_ns: int,
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """Times of a channel in an open file of samples, and the sum of some columns: the beginning of each window.

    That is about `rows`, `dt_ns` apart, shared out to at most `MOST_GROUPS` row groups in the window: they are decoded
    from their beginning to the last row that is wanted.
    """
    begins, ends = footer.bounds("t_ns")
    until_ns: dict[int, int] = {}
    size = rows
    for first, last in windows:
        groups = footer.groups_between(channel, "t_ns", first, last + 1)
        groups = groups[:: -(-len(groups) // MOST_GROUPS) or 1]
        for group in groups:
            each = max(rows // len(groups), 1)
            stop = min(max(int(begins[group]), first) + (each - 1) * dt_ns, int(ends[group]))
            until_ns[group], size = max(until_ns.get(group, 0), stop), min(size, each)
    times, found = [np.empty(0, np.int64)], [np.empty(0)]
    for group, stop in until_ns.items():
        for batch in file.iter_batches(size, [group], ["channel", "t_ns", *columns], use_threads=False):
            own, t_ns, *data = (numbers(each) for each in batch.columns)
            values = data[0] + data[1] if len(data) > 1 else data[0]
            is_own = slice(None) if own[0] == own[-1] == channel else own == channel
            times.append(t_ns[is_own])
            found.append(values[is_own])
            if times[-1].size and times[-1][-1] >= stop:
                break
    return np.concatenate(times), np.concatenate(found, dtype=np.float64)


def _gone(catalog: Catalog, unit: str, signal: str, run: str, gone: int, of: int) -> NotFound:
    return NotFound(
        f"unit {unit}, signal {signal}, run {run}: raw samples were dropped from {catalog.store.label} to make room "
        f"({gone:,} of {of:,}; the documents raw_rows_dropped in the view events say when and why); what is kept of "
        f"them is in rollup_1s, rollup_10s and estimates, and in the log: `gyrofleet replay {run}`"
    )


def stored_between(
    catalog: Catalog, unit: str, signal: str, run: str, first_ns: int, last_ns: int, *, is_checked: bool = False
) -> tuple[IntArray, FloatArray]:
    """Times (ns, ascending) and values of a signal between two times, inclusive; NotFound if raw rows were dropped.

    What is stated is to be checked: whole files are compared with their hashes then.
    """
    where: dict[str, Any] = {"unit": unit, "signal": signal, "run": run, "first": first_ns, "last": last_ns}
    (dropped,) = catalog.rows(
        "select coalesce(sum(samples), 0)::bigint, count(*) from internal.lake_channels_dropped where unit = $unit and "
        "signal = $signal and run = $run and t_first_ns <= $last and t_last_ns >= $first",
        where,
    )
    if dropped[1]:
        raise _gone(catalog, unit, signal, run, dropped[0], dropped[0])
    paths = catalog.checked_paths_of([run], _BETWEEN) if is_checked else catalog.paths_of([run])
    table = catalog.reader(_BETWEEN, {"paths": paths, **where}).read_all()
    return numbers(table.column(0)), numbers(table.column(1))
