"""Parquet files by the contract, good and bad."""

from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from ingest.tables.parquet_chunks import ParquetTable
from ingest.tables.rows import BadRows
from stream.batch import SampleBatch
from stream.errors import BadInput

Tool = Callable[..., Any]
G1 = TableOptions(unit="G1")


def kinds(table: TableFile) -> dict[str, bool]:
    return {found.signal: found.is_counts for found in table.check().signals}


@pytest.mark.parametrize(
    "type_", [pl.Int8, pl.Int64, pl.Float16, pl.UInt16, pl.UInt64, pl.Float32, pl.Float64, pl.Decimal(10, 2)], ids=str
)
def test_numbers_of_any_type(write: Tool, deliver: Tool, samples: Tool, type_: Any) -> None:
    rate = pl.Series([1, None, 3], dtype=type_)
    path = write({"time[s]": [0.0, 0.5, 1.0], "rate[deg/s]": rate}, "r.parquet")
    assert samples(deliver(TableFile(path, G1)))["G1", "r", "rate"] == [(0, 1.0), (10**9, 3.0)]


def test_decimals_are_the_nearest_numbers(write: Tool, deliver: Tool, samples: Tool) -> None:
    values = [Decimal(str(round(each, 9))) for each in np.random.default_rng(1).normal(0, 1e6, 5000)]
    rate = pa.array(values, pa.decimal128(20, 9))
    path = write({"time[s]": [i / 100 for i in range(5000)], "rate[deg/s]": rate}, "r.parquet")
    read = samples(deliver(TableFile(path, G1)))["G1", "r", "rate"]
    assert [value for _, value in read] == [float(each) for each in values]


@pytest.mark.parametrize(
    "times",
    [
        pl.Series([1763683200000000001, 1763683200000000002]),
        pl.Series([1763683200000000001, 1763683200000000002], dtype=pl.UInt64),
        pl.Series([Decimal(1763683200000000001), Decimal(1763683200000000002)]),
    ],
)
def test_integer_nanoseconds_stay_exact(write: Tool, deliver: Tool, samples: Tool, times: pl.Series) -> None:
    path = write({"time[ns]": times, "rate[deg/s]": [1.0, 2.0]}, "r.parquet")
    found = samples(deliver(TableFile(path, G1)))["G1", "r", "rate"]
    assert [time for time, _ in found] == [1763683200000000001, 1763683200000000002]


@pytest.mark.parametrize("unit", ["ns", "us", "ms"])
@pytest.mark.parametrize(("title", "new"), [("time", ""), ("time[s]", ""), ("Timestamp", ""), ("elapsed", "time")])
def test_durations_are_times_since_the_start(
    write: Tool, deliver: Tool, samples: Tool, unit: Any, title: str, new: str
) -> None:
    elapsed = pl.Series([0, 500, 1500]).cast(pl.Duration("ms")).cast(pl.Duration(unit))
    path = write({title: elapsed, "rate[deg/s]": [1.0, 2.0, 3.0]}, "r.parquet")
    table = TableFile(path, TableOptions(unit="G1", renames=((title, new),) if new else ()))
    assert samples(deliver(table))["G1", "r", "rate"] == [(0, 1.0), (500_000_000, 2.0), (1_500_000_000, 3.0)]


def test_durations_of_years_are_no_dates(write: Tool, deliver: Tool, samples: Tool) -> None:
    elapsed = pl.Series([99_999_999, 100_000_000, 100_000_001]).cast(pl.Int64) * 1_000_000
    path = write({"time": elapsed.cast(pl.Duration("us")), "rate[deg/s]": [1.0, 2.0, 3.0]}, "r.parquet")
    times = [time for time, _ in samples(deliver(TableFile(path, G1)))["G1", "r", "rate"]]
    assert times == [99_999_999 * 10**9, 100_000_000 * 10**9, 100_000_001 * 10**9]


def test_durations_elsewhere_are_refused_with_what_to_do(write: Tool) -> None:
    lag = pl.Series([1, 2]).cast(pl.Duration("us"))
    with pytest.raises(BadInput, match="holds durations: give --rename 'elapsed=time'"):
        TableFile(write({"elapsed": lag, "rate[deg/s]": [1.0, 2.0]}, "a.parquet"), G1)
    with pytest.raises(BadInput, match=r"or leave it out: --rename 'lag\[s\]='"):
        TableFile(write({"time[s]": [0.0, 1.0], "lag[s]": lag, "rate[deg/s]": [1.0, 2.0]}, "b.parquet"), G1)


@pytest.mark.parametrize(
    ("title", "values", "held"),
    [
        ("time", pa.array([1, 2], pa.time64("us")), "times of day without a date (time64[us]), which begin again at"),
        ("time[s]", pa.array([1, 2], pa.time32("ms")).dictionary_encode(), "times of day without a date (time32[ms])"),
        ("clock", pa.array([1, 2], pa.date32()), "dates without a time of day (date32[day])"),
        ("Timestamp", pa.array(["2026-11-21T18:00:00Z"] * 2).dictionary_encode(), "text (string)"),
    ],
)
def test_times_of_a_type_that_gives_none_are_named_with_it(
    tmp_path: Path, title: str, values: pa.Array, held: str
) -> None:
    """They had been columns without a unit."""
    pq.write_table(pa.table({title: values, "rate[deg/s]": [1.0, 2.0]}), tmp_path / "r.parquet")
    with pytest.raises(BadInput) as caught:
        TableFile(tmp_path / "r.parquet", G1)
    assert f"column '{title}' holds {held}" in str(caught.value)
    assert "write times as time stamps with a date, as durations" in str(caught.value)
    left_out = TableOptions(unit="G1", sample_rate_hz=1.0, renames=((title, ""),))
    assert TableFile(tmp_path / "r.parquet", left_out).check().rows == 2


def test_true_and_false_without_a_unit_are_one_and_zero(write: Tool, deliver: Tool, samples: Tool) -> None:
    path = write({"time[s]": [0.0, 1.0, 2.0], "ok[1]": [True, None, False]}, "r.parquet")
    table = TableFile(path, G1)
    assert kinds(table) == {"ok": True}
    assert "column 'ok[1]': true is taken as 1, false as 0" in table.check().remarks
    assert samples(deliver(table))["G1", "r", "ok"] == [(0, 1.0), (2_000_000_000, 0.0)]


def test_counts_are_integers_by_type_or_by_unit_and_value(write: Tool, deliver: Tool) -> None:
    columns = {
        "time[s]": [0.0, 1.0],
        "by_type[deg/s]": [1, 2],
        "too_large[deg/s]": [1, 2**31],
        "by_unit[LSB]": [-1.0, 2.0],
        "fraction[count]": [1.0, 2.5],
        "whole[deg/s]": [1.0, 2.0],
    }
    table = TableFile(write(columns, "r.parquet"), G1)
    counts = {"by_type": True, "too_large": False, "by_unit": True, "fraction": False, "whole": False}
    assert kinds(table) == counts
    for batch in deliver(table):
        assert (batch.counts is not None) == counts[batch.signal]
        assert (batch.scale, batch.offset) == (1.0, 0.0)


def test_a_bad_row_decides_nothing_about_counts(write: Tool) -> None:
    path = write({"time[s]": [0.0, 0.0, 1.0], "k[count]": [1.0, 1.5, 2.0]}, "r.parquet")
    assert kinds(TableFile(path, TableOptions(unit="G1", skip_bad=True))) == {"k": True}


def test_bad_rows_are_named_by_row(write: Tool, said: Tool) -> None:
    columns = {
        "time[s]": [0.0, None, np.nan, 2.0, 3.0, 2.5, 1e300],
        "rate[deg/s]": [1.0, 1.0, 1.0, np.inf, 1.0, np.nan, 1.0],
        "repeat": [1.0, 1.0, 1.0, 1.0, 1.5, 1.0, None],
    }
    path = write(columns, "r.parquet")
    with pytest.raises(BadRows) as caught:
        TableFile(path, G1).check()
    assert said(caught.value.bad) == [
        "row 2, column time[s]: found 'null', expected a time",
        "row 3, column time[s]: found 'nan', expected a finite time within 146 years of 1970",
        "row 4, column rate[deg/s]: found 'inf', expected a finite number (null for no sample)",
        "row 5, column repeat: found '1.5', expected a whole number",
        "row 6, column rate[deg/s]: found 'nan', expected a finite number (null for no sample)",
        "row 7, column time[s]: found '1e+300', expected a finite time within 146 years of 1970",
    ]
    summary = TableFile(path, TableOptions(unit="G1", skip_bad=True)).check()
    assert (summary.rows, summary.bad_rows, summary.signals[0].sampling.samples) == (7, 6, 1)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"time[s]": [0.0], "rate[deg/s]": ["1"]}, "column 'rate[deg/s]' holds text (large_string), expected numbers"),
        ({"time[s]": [0.0], "rate[deg/s]": [True]}, "holds bool, expected numbers; convert it, or leave it out"),
        ({"time[s]": [0.0], "rate[deg/s]": [[1.0]]}, "expected numbers"),
        ({"time[s]": [0.0], "rate[deg/s]": [1.0], "step": [[1]]}, "expected text"),
        ({"time[s]": [], "rate[deg/s]": []}, "no rows"),
        ({"time[s]": [0.0], "rate[deg/s]": pl.Series([None], dtype=pl.Null)}, "not one sample"),
        ({"time[s]": [None], "rate[deg/s]": [1.0]}, "1 row does not keep"),
    ],
)
def test_columns_of_the_wrong_type(write: Tool, columns: dict[str, Any], message: str) -> None:
    path = write(columns, "r.parquet")
    with pytest.raises(BadInput) as caught:
        TableFile(path, G1).check()
    assert message in str(caught.value)


def test_names_and_words_of_any_type(write: Tool, deliver: Tool, samples: Tool) -> None:
    columns = {
        "time[s]": [0.0, 1.0],
        "rate[deg/s]": [1.0, 2.0],
        "unit": pl.Series([231, 232]),
        "run": pl.Series(["a", "b"], dtype=pl.Categorical),
        "room": [True, None],
    }
    assert set(samples(deliver(TableFile(write(columns, "r.parquet"), TableOptions())))) == {
        ("231", "a", "rate"),
        ("232", "b", "rate"),
    }


def test_text_that_is_not_utf8_is_refused(tmp_path: Path) -> None:
    step = pa.Array.from_buffers(
        pa.string(), 1, [None, pa.py_buffer(np.array([0, 1], np.int32)), pa.py_buffer(b"\xff")]
    )
    path = tmp_path / "r.parquet"
    pq.write_table(pa.table({"time[s]": [0.0], "rate[1]": [1.0], "step": step}), path)
    with pytest.raises(BadInput, match="damaged"):
        TableFile(path, G1).check()


@pytest.mark.parametrize("block_rows", [1, 7, 64, 10**6])
@pytest.mark.parametrize("group_rows", [5, 10**6])
@pytest.mark.in_gate("5-7", "1000000-64")
def test_block_size_changes_nothing(
    tmp_path: Path, deliver: Tool, by_signal: Tool, monkeypatch: pytest.MonkeyPatch, block_rows: int, group_rows: int
) -> None:
    n = 400
    generator = np.random.default_rng(3)
    columns = {
        "time[s]": np.cumsum(generator.choice([0.01, 0.01, 0.02, 1.0], n)),
        "rate[deg/s]": generator.normal(size=n),
        "k[count]": pl.Series([None if i % 4 else i for i in range(n)]),
        "step": ["ab"[i // 70 % 2] for i in range(n)],
    }
    path = tmp_path / "r.parquet"
    pl.DataFrame(columns).write_parquet(path, row_group_size=group_rows)
    options = TableOptions(unit="G1", batch_samples=32)
    expected = TableFile(path, options)
    monkeypatch.setattr(ParquetTable.__init__, "__defaults__", (block_rows,))
    found = TableFile(path, options)
    assert found.check() == expected.check()
    assert by_signal(deliver(found)) == by_signal(deliver(expected))


def test_csv_and_parquet_deliver_the_same(write: Tool, deliver: Tool, tmp_path: Path) -> None:
    generator = np.random.default_rng(4)
    frame = pl.DataFrame(
        {
            "time[s]": np.arange(3000) * 0.01,
            "rate[deg/s]": generator.normal(size=3000),
            "temperature[count]": generator.integers(-5, 5, 3000),
            "step": ["still" if i % 1000 < 800 else None for i in range(3000)],
        }
    )
    frame.write_csv(tmp_path / "r.csv")
    frame.write_parquet(tmp_path / "r.parquet")
    from_csv, from_parquet = (deliver(TableFile(tmp_path / name, G1)) for name in ("r.csv", "r.parquet"))
    assert from_csv == from_parquet
    assert sum(len(batch) for batch in from_csv if isinstance(batch, SampleBatch)) == 6000
