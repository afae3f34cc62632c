"""Remarks on units, times and names of a table that can be read in two ways."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from ingest.tables.rows import BadRows
from ingest.tables.sample_file import TableSummary
from ingest.tables.units import column_unit, database_unit
from stream.errors import BadInput


def checked(path: Path, text: str, time_zone: str | None = None) -> TableSummary:
    path.write_text(text)
    return TableFile(path, TableOptions(unit="U1", time_zone=time_zone)).check()


@pytest.mark.parametrize(("unit", "expected"), [("Grad/s", "deg/s"), ("grad/h", "deg/h"), ("Grad/min", "deg/min")])
def test_german_degrees_are_no_gradians(unit: str, expected: str) -> None:
    found, remark = column_unit(unit, "rate")
    assert found == expected
    assert remark == f"{unit} is taken as {expected} (German Grad, a degree); write gon for gradians"
    assert database_unit(unit, "rate") == (expected, True)
    assert column_unit("gon/s", "rate") == ("gon/s", "")


@pytest.mark.parametrize("unit", ["Mdps", "Mrad/s", "Gdeg/s"])
def test_a_prefix_in_the_wrong_case_is_asked_back(unit: str) -> None:
    with pytest.raises(BadInput, match=f"unit '{unit}' is .* deg/s: M is mega and G is giga"):
        column_unit(unit, "rate")
    assert column_unit("mdps", "rate") == ("mdps", "")


def test_times_in_the_future_are_said(tmp_path: Path) -> None:
    labview = "time[s],rate[deg/s]\n3880000000.0,1\n3880000001.0,2\n"
    (remark,) = checked(tmp_path / "a.csv", labview).remarks
    assert remark.startswith("warning: its times reach 2092-12-13, in the future")
    assert not checked(tmp_path / "b.csv", labview.replace("38800", "17900")).remarks


def test_a_repeated_hour_is_said_where_it_is_read(tmp_path: Path) -> None:
    text = "time,rate[deg/s]\n2026-10-25 02:30:00,1\n2026-10-25 02:30:01,2\n"
    berlin = checked(tmp_path / "a.csv", text, time_zone="Europe/Berlin").remarks
    assert any(each.startswith("warning: the clocks of Europe/Berlin were set back") for each in berlin)
    for zone, written in (("Asia/Shanghai", text), ("Europe/Berlin", text.replace("-25 02", "-24 02"))):
        remarks = checked(tmp_path / "b.csv", written, time_zone=zone).remarks
        assert not any("set back" in each for each in remarks)


def test_rows_of_a_repeated_hour_are_refused_by_that_name(tmp_path: Path) -> None:
    begin, berlin = datetime(2026, 10, 25, 0, 30, tzinfo=UTC), ZoneInfo("Europe/Berlin")
    times = [(begin + timedelta(seconds=4 * i)).astimezone(berlin) for i in range(1350)]
    text = "time,rate[deg/s]\n" + "".join(f"{at:%Y-%m-%d %H:%M:%S},1\n" for at in times)
    why = (
        "900 rows go back in time where the clocks of Europe/Berlin were set back at 2026-10-25 03:00: the hour before"
    )
    with pytest.raises(BadRows, match=f"900 rows do not .*; {why} came twice, .* write them in UTC"):
        checked(tmp_path / "a.csv", text, time_zone="Europe/Berlin")
    with pytest.raises(BadRows, match="correct the file"):
        checked(tmp_path / "b.csv", text, time_zone="Asia/Shanghai")
    zoned = "time,rate[deg/s]\n" + "".join(f"{at.isoformat()},1\n" for at in times)
    assert checked(tmp_path / "c.csv", zoned).signals[0].sampling.dt_ns == 4 * 10**9


def test_a_temperature_under_another_name_is_said(tmp_path: Path) -> None:
    rows = "\n0,1,20\n1,2,20\n"
    (remark,) = checked(tmp_path / "a.csv", f"time[s],rate[deg/s],Temp (°C){rows}").remarks
    assert "under the name temperature: give --rename 'Temp (°C)=temperature'" in remark
    assert not checked(tmp_path / "b.csv", f"time[s],rate[deg/s],temperature[K]{rows}").remarks


@pytest.mark.parametrize("rate_hz", [60.0, 75.0, 120.0, 128.0, 150.0, 200.0])
def test_rounded_times_lie_on_their_grid(rate_hz: float, tmp_path: Path) -> None:
    rows = (f"{round(1000 * i / rate_hz)},{i % 7}" for i in range(2000))
    (signal,) = checked(tmp_path / "a.csv", "time[ms],rate[deg/s]\n" + "\n".join(rows) + "\n").signals
    assert not signal.sampling.irregular
    assert signal.sampling.dt_ns == pytest.approx(1e9 / rate_hz, rel=1e-4)


def test_jitter_is_not_taken_for_rounding(tmp_path: Path) -> None:
    late = np.random.default_rng(1).integers(0, 2, 500)
    rows = (f"{5 * i + int(late[i])},{i % 7}" for i in range(500))
    (signal,) = checked(tmp_path / "a.csv", "time[ms],rate[deg/s]\n" + "\n".join(rows) + "\n").signals
    assert signal.sampling.irregular


@pytest.mark.parametrize(("mark", "value"), [(".", "1"), (",", "1")])
def test_a_mark_that_may_separate_thousands_is_said(mark: str, value: str, tmp_path: Path) -> None:
    text = f"time[s];raw[count]\n0;998\n1;999\n2;1{mark}000\n3;1{mark}001\n"
    (remark,) = [each for each in checked(tmp_path / "a.csv", text).remarks if "thousands" in each]
    assert remark.startswith(f"warning: column 'raw[count]': 1{mark}000 is read as {value}, and whole numbers")
    for rows in (f"0;0{mark}998\n1;1{mark}000\n", f"0;99\n1;1{mark}25\n", "0;998\n1;999\n"):
        remarks = checked(tmp_path / "b.csv", f"time[s];raw[count]\n{rows}").remarks
        assert not any("thousands" in each for each in remarks)


def test_whole_numbers_beyond_the_floats_are_said(tmp_path: Path) -> None:
    large = f"time[s],angle[count]\n0,{2**53 - 1}\n1,{2**53 + 1}\n2,{-(2**60)}\n"
    assert any(
        "2 whole numbers of signal angle are beyond 2**53" in each
        for each in checked(tmp_path / "a.csv", large).remarks
    )
    exact = f"time[s],angle[count]\n0,{2**53 - 1}\n1,-4\n"
    assert not any("2**53" in each for each in checked(tmp_path / "b.csv", exact).remarks)
    pq.write_table(pa.table({"time[s]": [0, 1], "turns[1]": [1, 2**61 + 1]}), tmp_path / "c.parquet")
    (remark,) = TableFile(tmp_path / "c.parquet", TableOptions(unit="U1")).check().remarks
    assert remark.startswith("warning: 1 whole number of signal turns is beyond 2**53")


@pytest.mark.parametrize(
    ("later_s", "effect"), [(0.1, "takes one sample every 0.01 s"), (0.015, "is taken as irregular")]
)
def test_a_sample_rate_that_changes_is_said(later_s: float, effect: str, tmp_path: Path) -> None:
    times_s = [*(i / 100 for i in range(600)), *(6.0 + later_s * i for i in range(100))]
    text = "time[s],rate[deg/h],bias[deg/h]\n" + "".join(f"{at:.3f},{i % 7},1\n" for i, at in enumerate(times_s))
    summary = checked(tmp_path / "a.csv", text)
    (change,) = summary.signals[0].sampling.rate_changes
    assert (change.from_hz, change.to_hz) == pytest.approx((100.0, 1 / later_s))
    (remark,) = summary.remarks
    assert remark.startswith("warning: unit U1, run a, rate, bias: the sample rate changes at 6 s from 100 Hz to ")
    assert effect in remark
    assert not checked(tmp_path / "b.csv", "".join(text.splitlines(keepends=True)[:601])).remarks


def test_a_sample_rate_that_changes_is_said_beside_the_deviation(
    run_command: Callable[..., Any], tmp_path: Path
) -> None:
    times_s = [*(i / 100 for i in range(600)), *(6.0 + 0.1 * i for i in range(100))]
    rows = "".join(f"{at:.2f},{i * i % 97}\n" for i, at in enumerate(times_s))
    (tmp_path / "a.csv").write_text(f"time[s],rate[deg/h]\n{rows}")
    imported = run_command("import", "a.csv", "--unit", "U1", "--json", cwd=tmp_path).json
    (change,) = imported["files"][0]["signals"][0]["rate_changes"]
    assert change == {"t_ns": 6 * 10**9, "from_hz": pytest.approx(100.0), "to_hz": pytest.approx(10.0)}
    shown = run_command("allan", "--unit", "U1", "--signal", "rate", cwd=tmp_path).out
    assert "the sample rate changes at 6 s from 100 Hz to 10 Hz: where no sample is every 0.01 s" in shown
    resampled = run_command("allan", "--unit", "U1", "--signal", "rate", "--resample", "1", cwd=tmp_path).out
    assert "10 Hz: blocks of 1 s are means of other numbers of samples then" in resampled
