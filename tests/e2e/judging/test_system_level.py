"""System-level calibration from a file of six signals to A, S, B: the worked case, and what people bring."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tests.analytics.system_level.rotation_kinematics import Planted, calibration

START = "2026-01-05T08:00:00Z"
CHANGES_MM_PER_S2 = (-3.41587, -4.59283, 3.97801, 1.66694, 3.62816, -3.26240, -2.64410, -0.682674, 0.436839)
UNITS = {"deg/s": np.degrees(1.0), "deg/h": np.degrees(3600.0), "rad/s": 1.0, "m/s^2": 1.0, "g": 1.0 / 9.80665}
PAUSE_S = 5.0
Rows = list[dict[str, Any]]


def table(
    planted: Planted, speeds: Sequence[float], *, rate_unit: str = "deg/s", force_unit: str = "m/s^2",
    rest_s: float = 15.0, unit: str = "IMU-1", names: str = "xyz", every: int = 1,
) -> pl.DataFrame:  # fmt: skip
    """The rotations one after the other, each labelled with its position and axis."""
    frames, begin_s = [], 0.0
    for number, series in calibration(planted, speeds, rest_s=rest_s):
        n = series.rates_rad_per_s.shape[1]
        t_s = begin_s + (np.arange(n) + 1) * series.dt_s
        begin_s = float(t_s[-1]) + PAUSE_S
        columns: dict[str, Any] = {"unit": [unit] * n, "time[s]": t_s.round(3)}
        for axis, name in enumerate(names):
            columns[f"rate_{name}[{rate_unit}]"] = series.rates_rad_per_s[axis] * UNITS[rate_unit]
            columns[f"accel_{name}[{force_unit}]"] = series.forces_m_per_s2[axis] * UNITS[force_unit]
        words = {"position": f"rotation_{number}", "axis": "XYZ"[(number - 1) // 3]}
        columns |= {name: [word] * n for name, word in (words | {"procedure": "system_level_asymmetry"}).items()}
        frames.append(pl.DataFrame(columns).gather_every(every))
    return pl.concat(frames)


class Laboratory:
    """A store of imported calibrations; asks for their metrics."""

    def __init__(self, folder: Path, run_command: Callable[..., Any]) -> None:
        self.folder, self._run = folder, run_command
        self._metrics: Rows = []

    def take(self, frame: pl.DataFrame, run: str, latitude: str | None = "39.9") -> None:
        frame.write_parquet(self.folder / f"{run}.parquet")
        place = () if latitude is None else ("--latitude", latitude)
        words = ("import", f"{run}.parquet", "--store", "S", "--start", START, "--run", run, *place)
        done = self._run(*words, cwd=self.folder)
        assert done.code == 0, done.err
        self._metrics = []

    def rows(self, run: str, letter: str = "asymmetry", **wanted: str) -> Rows:
        names = {"asymmetry": "system_level_scale_factor_asymmetry", "error": "system_level_scale_factor_error",
                 "accelerometer": "system_level_accelerometer_bias", "bias": "system_level_gyro_bias"}  # fmt: skip
        if not self._metrics:
            done = self._run("metrics", "--store", "S", "--standard", "CN 102680005", "--json", cwd=self.folder)
            assert done.code == 0, done.err
            self._metrics = json.loads(done.out)
        return [
            row
            for row in self._metrics
            if row["run"] == run and row["metric"] == names[letter] and wanted.items() <= row["parameters"].items()
        ]


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Laboratory:
    """The worked cases, and one unit for each thing that can be wrong."""
    made = Laboratory(tmp_path_factory.mktemp("system-level"), run_command)
    made.take(table(Planted(gyro_bias_deg_per_h=0.02), (10.0, 20.0, 30.0)), "whole")
    made.take(table(Planted(), (10.0,), rate_unit="deg/h", force_unit="g"), "no_latitude", latitude=None)
    clipped = [pl.col(f"rate_{axis}[deg/s]").clip(-25.0, 25.0) for axis in "xyz"]
    fast = table(Planted(), (30.0,), unit="WHOLE")
    is_cut = (pl.col("time[s]") > 17.0) & (pl.col("time[s]") < 17.1)
    late = table(Planted(), (30.0,), unit="LATE")
    nameless = table(Planted(), (20.0, 30.0), unit="NO-WORDS")
    units = [
        fast.filter(~is_cut & (pl.col("position") != "rotation_6")).with_columns(unit=pl.lit("BROKEN")),
        table(Planted(), (30.0,), rest_s=10.0, unit="SHORT"),
        late.filter(pl.col("time[s]") > pl.col("time[s]").min().over("position") + 16.0),
        table(Planted(), (30.0,), every=2, unit="SLOW"),
        table(Planted(), (30.0,), names="yxz", unit="SWAPPED").select(fast.columns),
        fast.with_columns(pl.lit("SATURATED").alias("unit"), *clipped),
        fast.with_columns(pl.lit("REVERSED").alias("unit"), (-pl.col("accel_y[m/s^2]")).alias("accel_y[m/s^2]")),
        nameless.with_columns(pl.lit("here").alias("position")),
        nameless.with_columns(pl.lit("TURNED").alias("unit"), pl.col("position") + "_of_ours"),
    ]
    made.take(pl.concat(units), "wrong")
    return made


@pytest.mark.long
def test_the_worked_case_comes_out_of_a_file(laboratory: Laboratory) -> None:
    found = {row["signal"]: row for row in laboratory.rows("whole", method="average")}
    assert found["rate_x"]["value"] == pytest.approx(10.786, abs=0.005)
    joint = {row["signal"]: row for row in laboratory.rows("whole", method="joint")}
    for signal, expected in (("rate_x", 10.002), ("rate_y", -5.997), ("rate_z", 3.999)):
        row = joint[signal]
        assert row["value"] == pytest.approx(expected, abs=0.005)
        assert row["lo"] < row["value"] < row["hi"]
        assert (row["unit_of_measure"], row["standard"]) == ("ppm", "CN102680005")
    speeds = laboratory.rows("whole", method="speed", axis="X")
    assert [row["value"] for row in speeds] == pytest.approx([10.998, 10.726, 10.636], abs=0.005)
    for way in ("average", "joint"):
        symmetric = [row["value"] for row in laboratory.rows("whole", "error", method=way)]
        assert symmetric == pytest.approx([120.0, -80.0, 50.0], abs=0.02)
        forces = {row["parameters"]["axis"]: row for row in laboratory.rows("whole", "accelerometer", method=way)}
        assert [forces[axis]["signal"] for axis in "XYZ"] == ["accel_y", "accel_x", "accel_x"]
        assert [forces[axis]["value"] for axis in "XYZ"] == pytest.approx([-30.0, 50.0, 50.0], abs=0.05)
    for way in ("joint", "joint_rest", "rest"):
        (bias,) = laboratory.rows("whole", "bias", method=way, axis="X")
        assert bias["value"] == pytest.approx(0.0196, abs=2e-4)


def test_one_speed_in_other_units_has_the_nine_changes_and_no_joint_fit(
    tmp_path: Path, run_command: Callable[..., Any]
) -> None:
    laboratory = Laboratory(tmp_path, run_command)  # of its own: the others take minutes to import
    laboratory.take(table(Planted(), (10.0,), rate_unit="deg/h", force_unit="g"), "one_speed")
    rows = laboratory.rows("one_speed", method="speed")
    changes = [float(each) for row in rows for each in row["parameters"]["changes_mm_per_s2"].split(", ")]
    assert changes == pytest.approx(CHANGES_MM_PER_S2, abs=1.1e-5)
    assert [row["value"] for row in rows] == pytest.approx([9.978, -5.936, 3.990], abs=0.005)
    for row in laboratory.rows("one_speed", method="joint"):
        assert row["value"] is None
        assert "A and the gyro bias need two speeds" in row["reason"]
    rests = laboratory.rows("one_speed", method="joint_rest")
    assert [row["value"] for row in rests] == pytest.approx([10.0, -6.0, 4.0], abs=0.02)


@pytest.mark.long
@pytest.mark.parametrize(
    ("unit", "axis", "reason"),
    [
        ("BROKEN", "X", "no speed has three rotations to solve: at 30 deg/s 2 rotations of 2 kinds are not the three"),
        ("BROKEN", "Y", "no speed has three rotations to solve"),
        ("SHORT", "Z", "10 s at rest before the turn, CN 102680005 step 2 asks for 15 s"),
        (
            "LATE",
            "X",
            "0 s at rest before the turn, CN 102680005 step 2 asks for 15 s; the record is cut within the turn",
        ),
        ("SLOW", "X", "sampled at 50 Hz, CN 102680005 step 1 asks for 100 Hz"),
        ("SWAPPED", "X", "the accelerometers do not follow the turn that the gyros see; are axes swapped"),
        ("SATURATED", "Y", "gyro Y turns by 150 deg, 180 deg are asked for; is a gyro saturated"),
        ("REVERSED", "X", "the accelerometers do not follow the turn that the gyros see"),
        ("NO-WORDS", "Z", "1000 of 12700 samples are missing at rest, at most 2% may be"),
    ],
)
def test_what_cannot_be_calibrated_says_why(laboratory: Laboratory, unit: str, axis: str, reason: str) -> None:
    rows = [row for row in laboratory.rows("wrong", axis=axis, method="average") if row["unit"] == unit]
    assert len(rows) == 1
    assert rows[0]["value"] is None
    assert reason in rows[0]["reason"]


@pytest.mark.long
def test_what_is_good_beside_it_is_calibrated(laboratory: Laboratory) -> None:
    rows = {(row["unit"], row["parameters"]["axis"]): row for row in laboratory.rows("wrong", method="average")}
    assert "9 samples are missing in the turn" in rows["BROKEN", "X"]["parameters"]["left_out"]
    assert rows["BROKEN", "Z"]["value"] == pytest.approx(4.0, abs=0.02)
    turned = [rows["TURNED", axis] for axis in "XYZ"]
    assert {row["parameters"]["heading"] for row in turned} == {"earth_rate"}
    for row, expected in zip(turned, (10.0, -6.0, 4.0), strict=True):
        assert row["lo"] < expected < row["hi"]
    for row in laboratory.rows("no_latitude"):
        assert "no latitude of the station" in row["reason"]


@pytest.mark.long
def test_no_step_of_a_calibration_is_left_unjudged(laboratory: Laboratory) -> None:
    assert laboratory.rows("whole")
    done = laboratory._run("metrics", "--store", "S", "--standard", "CN 102680005", cwd=laboratory.folder)
    assert done.code == 0
    assert "position rotation_" not in done.err
