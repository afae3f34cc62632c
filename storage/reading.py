"""Samples of one signal read back from the lake, in the order of their time."""

from collections.abc import Iterator
from dataclasses import dataclass
from uuid import UUID

import numpy as np

from storage.catalog import Catalog
from stream.batch import FloatArray, IntArray, SampleBatch
from stream.errors import NotFound

_ROWS = 122_880  # DuckDB's row group


@dataclass(frozen=True)
class SignalRecord:
    """One signal of one run as the store holds it."""

    unit: str
    signal: str
    run: str
    unit_of_measure: str
    samples: int
    irregular: bool


def find_signal(catalog: Catalog, unit: str, signal: str, run: str | None = None) -> SignalRecord:
    """The record of a signal; of the run recorded last where no run is named.

    Raises
    ------
    NotFound
        If the store does not hold it; the message lists what it does hold.
    """
    _check_held(catalog, "unit", unit, "", {})
    _check_held(catalog, "signal", signal, f" of unit {unit}", {"unit": unit})
    if run is not None:
        _check_held(catalog, "run", run, f" of unit {unit}, signal {signal}", {"unit": unit, "signal": signal})
    row = catalog.rows(
        "select run, unit_of_measure, samples, irregular from signals "
        "where unit = $unit and signal = $signal and (run = $run or $run is null) "
        "order by arrival_first_ns desc, t_first_ns desc limit 1",
        {"unit": unit, "signal": signal, "run": run},
    )[0]
    return SignalRecord(unit, signal, str(row[0]), str(row[1]), int(str(row[2])), bool(row[3]))


def _check_held(catalog: Catalog, column: str, wanted: str, of: str, given: dict[str, str]) -> None:
    where = " and ".join(["true", *(f"{name} = ${name}" for name in given)])
    sql = f"select distinct {column} from signals where {where} order by 1"  # noqa: S608
    held = [str(row[0]) for row in catalog.rows(sql, given)]
    if wanted not in held:
        listed = ", ".join(held[:12]) + (f" and {len(held) - 12} more" if len(held) > 12 else "")
        raise NotFound(f"{column} {wanted!r}{of} is not in {catalog.store.folder}; it holds {listed or 'nothing yet'}")


def read_signal(catalog: Catalog, record: SignalRecord) -> Iterator[SampleBatch]:
    """Batches of a signal in the order of time, read piece by piece."""
    channels = catalog.rows(
        'select channel, epoch, dt_ns, is_counts, scale, "offset", irregular from lake_channels '
        "where unit = $unit and signal = $signal and run = $run order by t_first_ns",
        {"unit": record.unit, "signal": record.signal, "run": record.run},
    )
    for channel, epoch, dt_ns, is_counts, scale, offset, irregular in channels:
        column = "counts" if is_counts else "value"
        # the lake's files are in the order of the log and each channel's rows in that of its numbers: no sort needed
        sql = f"select seq, t_ns, {column} from lake_samples where channel = $channel"  # noqa: S608
        for table in catalog.batches(sql, {"channel": channel}, _ROWS):
            if table.num_rows == 0:
                continue
            t_ns = table.column(1).to_numpy()
            data = table.column(2).to_numpy()
            dt = int(str(dt_ns))
            is_exact = not irregular and bool(np.all(np.diff(t_ns) == dt))
            yield SampleBatch(
                unit=record.unit,
                signal=record.signal,
                run=record.run,
                epoch=UUID(str(epoch)),
                seq=int(table.column(0)[0].as_py()),
                t0_ns=int(t_ns[0]),
                dt_ns=dt,
                unit_of_measure=record.unit_of_measure,
                counts=data if is_counts else None,
                values=None if is_counts else data,
                times_ns=None if is_exact else t_ns,
                irregular=bool(irregular),
                scale=float(str(scale)),
                offset=float(str(offset)),
            )


def stored_between(
    catalog: Catalog, unit: str, signal: str, run: str, first_ns: int, last_ns: int
) -> tuple[IntArray, FloatArray]:
    """Times (ns, ascending) and values of a signal's samples between two moments, both inclusive."""
    table = catalog.reader(
        'select s.t_ns, coalesce(s.value, s.counts * c.scale + c."offset") as value '
        "from lake_samples s join lake_channels c using (channel) "
        "where c.unit = $unit and c.signal = $signal and c.run = $run and s.t_ns between $first and $last "
        "order by s.t_ns",
        {"unit": unit, "signal": signal, "run": run, "first": first_ns, "last": last_ns},
    ).read_all()
    return table.column(0).to_numpy(), table.column(1).to_numpy()
