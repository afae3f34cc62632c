"""`gyrofleet import A B C` of a campaign of means, then `gyrofleet diagnose`: runs keep their blocks.

The files are made here: true angle and rates of a table, a gyro on it, and means of both over 10, 30 or 60 s, beside
the table's angle as it is read once in that time, from 0 to 360 degrees.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.linalg import cho_factor, cho_solve

from stream.batch import FloatArray

MODEL = "rate = bias + scale_factor*input_rate + temperature"
RUNS = ("static", "rates", "heat") * 3
TRAINING = 6
HOURS, STEP_S = 2.5, 2.0
N, K, TURN_ON = 0.005, 0.006, 0.05  # deg/sqrt(h), deg/h/sqrt(h), deg/h
RATES = np.array([0.1, 1.0, 5.0, 20.0, -0.1, -1.0, -5.0, -20.0])  # deg/s: 20 is more than a turn and a half in 30 s
Z = 12.0


def drive(kind: str, rng: np.random.Generator) -> dict[str, FloatArray]:
    """What acts on the gyro every two seconds: rates about its axes, deg/s, and its temperature, degC."""
    time_s = np.arange(0.0, 3600.0 * HOURS, STEP_S)
    table, warm = np.zeros(time_s.size), np.full(time_s.size, 25.0)
    tilt = np.deg2rad(rng.choice([0.0, 45.0, 90.0, 135.0], 64))[(time_s // 600.0).astype(int)]
    if kind == "rates":
        table = rng.permutation(np.repeat(RATES, 8))[(time_s // 200.0).astype(int)]
        swings = time_s % 1800.0 > 1600.0
        table[swings] = 12.0 * np.sin(2 * np.pi * time_s[swings] / 180.0)
    if kind == "heat":
        warm = 25.0 + 20.0 * np.sin(2 * np.pi * time_s / 4000.0)
    return {
        "table_rate": table,
        "input_rate": table * np.cos(tilt),
        "rate_o": table * np.sin(tilt),
        "temperature": warm,
    }


def means(fine: FloatArray, interval_s: float) -> FloatArray:
    per = round(interval_s / STEP_S)
    return np.asarray(fine[: fine.size // per * per].reshape(-1, per).mean(axis=1))


def needed(drives: list[dict[str, FloatArray]]) -> float:
    """Misalignment at which least squares that know the noise tell rate_o from the declared model with z = 12."""
    information = 0.0
    parts = []
    for each in drives[:TRAINING]:
        blocks = {name: means(fine, 30.0) for name, fine in each.items()}
        hours = np.arange(len(blocks["rate_o"])) / 120.0
        noise = np.eye(hours.size) * N**2 * 120.0 + TURN_ON**2 + K**2 * np.minimum.outer(hours, hours)
        columns = np.column_stack(
            [np.ones(hours.size), blocks["input_rate"], blocks["temperature"] - 25.0, blocks["rate_o"]]
        )
        parts.append(columns.T @ cho_solve(cho_factor(noise), columns))
    normal = np.sum(parts, axis=0)
    information = normal[3, 3] - normal[3, :3] @ np.linalg.solve(normal[:3, :3], normal[:3, 3])
    return float(Z / np.sqrt(information))


def campaign(folder: Path, interval_s: float) -> tuple[list[Path], float]:
    """Files of nine runs of a gyro with a misalignment, and that, in deg/h for 1 deg/s."""
    rng = np.random.default_rng(1519)
    drives = [drive(kind, rng) for kind in RUNS]
    misaligned = needed(drives)
    paths = []
    for number, (kind, each) in enumerate(zip(RUNS, drives, strict=True)):
        size = each["table_rate"].size
        slow = rng.normal(0.0, TURN_ON) + np.cumsum(rng.standard_normal(size)) * K * np.sqrt(STEP_S / 3600.0)
        noise = slow + rng.standard_normal(size) * N / np.sqrt(STEP_S / 3600.0)
        error = 0.5 + 0.012 * (each["temperature"] - 25.0) + misaligned * each["rate_o"] + noise
        angle = np.concatenate([[0.0], np.cumsum(each["table_rate"])[:-1]]) * STEP_S
        columns = {f"{name}[deg/s]": means(each[name], interval_s) for name in ("table_rate", "input_rate", "rate_o")}
        paths.append(folder / f"{number}-{kind}.csv")
        pl.DataFrame(
            {
                "time[s]": 1.8e9 + 86_400.0 * number + interval_s * np.arange(len(columns["rate_o[deg/s]"])),
                "rate[deg/h]": means(3600.36 * each["input_rate"] + error, interval_s),
                **columns,
                "table_angle[deg]": angle[:: round(interval_s / STEP_S)][: len(columns["rate_o[deg/s]"])] % 360.0,
                "temperature[degC]": means(each["temperature"], interval_s)
                + rng.normal(0.0, 0.01, len(columns["rate_o[deg/s]"])),
            }
        ).write_csv(paths[-1], float_precision=7)
    return paths, misaligned


@pytest.mark.parametrize(
    "interval_s", [pytest.param(10.0, marks=pytest.mark.long), 30.0, pytest.param(60.0, marks=pytest.mark.long)]
)
def test_a_cross_axis_effect_is_found_in_means(
    gyrofleet: Callable[..., Any], tmp_path: Path, interval_s: float
) -> None:
    paths, misaligned = campaign(tmp_path, interval_s)
    assert gyrofleet("import", *paths, "--unit", "FOG-1", "--store", "S").code == 0
    found = gyrofleet("diagnose", "--unit", "FOG-1", "--model", MODEL, "--store", "S", "--json").json
    assert found["verdict"] == "effect_found"
    (effect,) = found["effects"]
    assert effect["name"] == "cross_axis_o"
    assert abs(effect["coefficient"] - misaligned) < 4 * (effect["hi"] - effect["lo"]) / 3.92
    assert effect["significance"] > Z - 4
    assert found["holdout"]["accepted"]
    # no block goes, neither across the edges of the rates nor where the angle turns more than half a turn
    assert found["left_out"] == []
    assert not {"unresolved", "far_outside", "channel_gap"} & {note["what"] for note in found["reduction"]}
    assert found["error"]["before"].keys() >= {f"rms_{max(30.0, interval_s):g}s"}
