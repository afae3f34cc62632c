"""Times written too coarsely for the samples: 32-bit floats, hundredths of a second at 60 Hz, whole seconds."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from ingest.tables.timing.grid import Sampling, SamplingGrid
from storage.sql.catalog import Catalog
from storage.store import Store

ADVISED = ("--rename", "time[s]=", "--sample-rate", "100")


def sampling(times_ns: np.ndarray[tuple[int], np.dtype[np.int64]], piece: int = 4096) -> Sampling:
    grid = SamplingGrid()
    for begin in range(0, len(times_ns), piece):
        grid.add(times_ns[begin : begin + piece])
    return grid.finish()


def float32_file(path: Path, start_s: float, n: int) -> Path:
    times = (start_s + np.arange(n) * 0.01).astype(np.float32)
    values = np.random.default_rng(1).standard_normal(n)
    pq.write_table(pa.table({"time[s]": times, "rate[deg/s]": values}), path)
    return path


def test_floats_of_32_bits_keep_their_interval_and_are_said(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    path = float32_file(tmp_path / "a.parquet", 80_000.0, 20_000)
    imported = gyrofleet("import", path, "--unit", "U1", "--json").json
    (file,) = imported["files"]
    (remark,) = [each for each in file["remarks"] if "is written in steps of" in each]
    assert remark.startswith("warning: column 'time[s]' is written in steps of 0.0078125 s")
    assert file["signals"][0]["irregular"]
    assert file["signals"][0]["sample_interval_s"] == pytest.approx(0.01, rel=1e-5)
    with Catalog(Store.open(tmp_path / "gyrofleet-data")) as catalog:
        assert catalog.rows("select sample_interval_s, samples from signals") == [
            (pytest.approx(0.01, rel=1e-5), 20_000)
        ]
    refused = gyrofleet("allan", "--unit", "U1", "--signal", "rate")
    assert refused.code != 0, "the times show no grid, and no losses may be made of them"
    assert "--resample" in refused.err

    assert f"--rename 'time[s]=' {' '.join(ADVISED[2:])}" in remark


@pytest.mark.long
def test_floats_of_32_bits_are_even_as_is_advised(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    path = float32_file(tmp_path / "a.parquet", 80_000.0, 20_000)
    evenly = gyrofleet("import", path, "--unit", "U2", "--run", "even", *ADVISED, "--json").json
    assert not evenly["files"][0]["signals"][0]["irregular"]
    curve = gyrofleet("allan", "--unit", "U2", "--signal", "rate", "--json").json
    assert curve["samples"] == 20_000
    assert curve["missing"] == 0


def test_times_that_become_coarse_as_the_record_goes_on_are_said(tmp_path: Path) -> None:
    path = float32_file(tmp_path / "day.parquet", 32_500.0, 100_000)
    summary = TableFile(path, TableOptions(unit="U1")).check()
    (remark,) = summary.remarks
    assert remark.startswith("warning: column 'time[s]' is written in steps of 0.00390625 s")
    assert summary.signals[0].sampling.dt_ns == 10_000_000


@pytest.mark.parametrize(("every", "share"), [(10, "10%"), (5, "20%"), (3, "33%")])
def test_even_losses_of_many_samples_are_named_beside_rounded_times(tmp_path: Path, every: int, share: str) -> None:
    times = [f"{i / 100:.2f},{i % 7}" for i in range(5000) if i % every]
    path = tmp_path / "lost.csv"
    path.write_text("\n".join(["time[s],rate[deg/h]", *times]))
    remarks = TableFile(path, TableOptions(unit="U1")).check().remarks
    (remark,) = [each for each in remarks if "is written in steps of" in each]
    assert f"samples every 0.01 s of which {share} are missing, evenly, have the same times" in remark
    assert f"--sample-rate {100 * (1 - 1 / every):.4g}" in remark


@pytest.mark.parametrize("rate_hz", [59.94, 60.0, 70.0, 30.3])
def test_hundredths_of_a_second_give_the_interval(rate_hz: float) -> None:
    times_ns = np.round(np.arange(20_000) / rate_hz, 2) * 1e9
    found = sampling(np.rint(times_ns).astype(np.int64))
    assert found.step_ns == 10_000_000
    assert found.irregular
    assert found.dt_ns == pytest.approx(1e9 / rate_hz, rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("lost", [0.003, 0.02, 0.28, 0.4])
def test_losses_are_not_taken_for_rounding(lost: float, seed: int) -> None:
    kept = np.random.default_rng(seed).random(20_000) >= lost
    found = sampling(np.flatnonzero(kept).astype(np.int64) * 7_812_500)
    assert found.step_ns == 0
    assert found.dt_ns == 7_812_500
    assert not found.irregular


def test_half_of_the_samples_lost_in_a_short_record_is_no_rounding() -> None:
    """The hardest case: of 400,000 simulated records 2 were taken for rounded ones, of 500 none is to be expected."""
    rng = np.random.default_rng(5)
    for _ in range(500):
        intervals = 1 + (rng.random(70) < 0.5)
        assert sampling(np.cumsum(intervals).astype(np.int64) * 10_000_000).step_ns == 0


def test_rounding_is_found_beside_losses() -> None:
    index = np.flatnonzero(np.random.default_rng(3).random(20_000) >= 0.002)
    times_ns = np.rint(np.round(index / 60, 2) * 1e9).astype(np.int64)
    found = sampling(times_ns)
    assert found.step_ns == 10_000_000
    assert found.dt_ns == pytest.approx(1e9 / 60, rel=1e-4)


@pytest.mark.parametrize("digits", [0, pytest.param(1, marks=pytest.mark.long)])
def test_repeated_times_say_their_cause_and_what_to_do(
    digits: int, gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / "coarse.csv"
    rows = "".join(f"{i * 0.01:.{digits}f},{i % 7}\n" for i in range(3000))
    path.write_text(f"time[s],rate[deg/s]\n{rows}")
    refused = gyrofleet("import", path, "--unit", "U1")
    assert refused.code != 0
    assert "of its 3000 rows have the time of the row before: column 'time[s]' is written with too few" in refused.err
    assert "--rename 'time[s]=' --sample-rate RATE_HZ" in refused.err
    assert gyrofleet("import", path, "--unit", "U1", *ADVISED, "--json").json["files"][0]["signals"][0]["added"] == 3000


def test_a_few_repeated_rows_are_to_be_corrected(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "few.csv"
    rows = "".join(f"{i - (i % 50 == 49)},1\n" for i in range(500))
    path.write_text(f"time[s],rate[deg/s]\n{rows}")
    refused = gyrofleet("import", path, "--unit", "U1")
    assert "10 rows do not keep the import contract; correct the file, or leave them out with --skip-bad" in refused.err


@pytest.mark.parametrize("jitter", [0.15, 0.3, 0.4])  # of an interval
@pytest.mark.in_gate("0.4")
def test_times_about_a_grid_give_its_interval_and_no_second_is_missing(
    gyrofleet: Callable[..., Any], tmp_path: Path, jitter: float
) -> None:
    rng = np.random.default_rng(20261129)
    n, rate_hz = 6000, 10
    times = (np.arange(n) + rng.uniform(-jitter, jitter, n)) / rate_hz + 1.0
    values = 12.0 + rng.standard_normal(n)
    head = "time[s],rate[deg/h],procedure,position\n"
    rows = "".join(f"{t:.4f},{x:.6f},static_bias,IRA_up\n" for t, x in zip(times, values, strict=True))
    (tmp_path / "polled.csv").write_text(head + rows)
    imported = gyrofleet("import", tmp_path / "polled.csv", "--unit", "U1", "--json").json
    assert imported["files"][0]["signals"][0]["sample_interval_s"] == pytest.approx(0.1, rel=2e-5)
    curve = gyrofleet("allan", "--unit", "U1", "--signal", "rate", "--resample", "1", "--json").json
    # only the second in which the record begins or ends may be a part
    assert curve["missing"] == 0
    assert curve["samples"] >= n // rate_hz - 2
    averages = gyrofleet("metrics", "--metric", "bias_stability_averaged", "--json").json
    of_1_s = next(row for row in averages if row["parameters"]["average_s"] == 1)
    seconds, second = np.unique(np.floor(times), return_inverse=True)
    means = (np.bincount(second, values) / np.bincount(second))[1:-1]
    assert of_1_s["n"] >= len(seconds) - 2
    assert of_1_s["value"] == pytest.approx(means.std(ddof=1), rel=2e-3)


@pytest.mark.parametrize("lost", [(9,), (9, 10), (9, 11)])
def test_losses_that_return_regularly_are_no_rounding(lost: tuple[int, ...]) -> None:
    kept = np.flatnonzero(~np.isin(np.arange(60_000) % 50, lost)).astype(np.int64)
    found = sampling(kept * 10_000_000)
    assert (found.dt_ns, found.step_ns, found.irregular) == (10_000_000, 0, False)
    assert found.missing_share == pytest.approx(len(lost) / 50, abs=1e-3)
    # of a loss in every 50, even samples of 98 Hz would have the same times; of two, none have them
    assert found.even_dt_ns == pytest.approx(1e9 / 98 if len(lost) == 1 else 0, rel=1e-6)


def test_even_losses_may_be_rounding_and_both_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "even.csv"
    rows = (f"{i * 0.01:.2f},{i % 7}\n" for i in range(3000) if i % 50 != 9)
    path.write_text(f"time[s],rate[deg/s]\n{''.join(rows)}")
    (remark,) = TableFile(path, TableOptions(unit="U1")).check().remarks
    assert remark.startswith("warning: of 1 signal about one sample in 50 is missing, evenly, by times in whole steps")
    assert "samples every 0.0102041 s" in remark
    assert "--rename 'time[s]=' --sample-rate 98" in remark


def test_samples_that_another_signal_has_are_missing(tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    rows = (f"{i * 0.01:.2f},{i % 7},{'' if i % 50 == 9 else 25.0}\n" for i in range(6000))
    path.write_text(f"time[s],rate[deg/s],temperature[degC]\n{''.join(rows)}")
    assert TableFile(path, TableOptions(unit="U1")).check().remarks == ()


def test_times_with_a_long_gap_are_not_to_be_made_even(tmp_path: Path) -> None:
    path = tmp_path / "gap.csv"
    rows = (f"{i * 0.01 + (7 if i > 1500 else 0):.2f},{i % 7}\n" for i in range(3000) if i % 50 != 9)
    path.write_text(f"time[s],rate[deg/s]\n{''.join(rows)}")
    (remark,) = TableFile(path, TableOptions(unit="U1")).check().remarks
    assert remark.endswith("if so, write them with more digits")
