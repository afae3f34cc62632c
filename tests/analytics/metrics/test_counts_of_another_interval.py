"""Counts of a gyro: a scale factor that was measured with samples of another interval is remarked on."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

COUNTS_PER_DEG_PER_S = 1000.0
BIAS_DEG_PER_S = 0.01


def write_counts(folder: Path, interval_s: float) -> None:
    """A scale factor with samples of 1 s, and an hour at rest with samples of `interval_s`, counts of each sample."""
    rng = np.random.default_rng(5)
    with (folder / "scale.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time[s]", "rate[count]", "procedure", "step", "rate_command[deg/s]"])
        t_s = 0
        for rate in (sign * size for sign in (1, -1) for size in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 75, 100)):
            for _ in range(30):
                counts = round((rate + BIAS_DEG_PER_S) * COUNTS_PER_DEG_PER_S + rng.normal(0, 5))
                writer.writerow([t_s, counts, "scale_factor_gjb2426", "rate", rate])
                t_s += 1
    with (folder / "bias.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time[s]", "rate[count]"])
        for at in range(round(3700 / interval_s)):
            counts = round(BIAS_DEG_PER_S * COUNTS_PER_DEG_PER_S * interval_s + rng.normal(0, 5))
            writer.writerow([f"{at * interval_s:.1f}", counts])


@pytest.mark.in_gate("both")
@pytest.mark.parametrize("intervals_s", [(1.0,), (2.0,), (1.0, 2.0)], ids=["same", "other", "both"])
def test_a_scale_factor_of_another_interval_is_remarked_on(
    run_command: Callable[..., Any], tmp_path: Path, intervals_s: tuple[float, ...]
) -> None:
    """Of a unit whose record at rest has samples of another interval, and of no other."""
    for interval_s in intervals_s:
        unit = f"C-{interval_s:.0f}"
        write_counts(tmp_path, interval_s)
        at = ("--unit", unit, "--latitude", "39.9", "--store", "s")
        rest = ("--procedure", "static_bias", "--position", "IRA_up")
        for name, *words in (
            ("scale", "--start", "2026-03-02T09:00:00+08:00"),
            ("bias", "--start", "2026-03-02T13:00:00+08:00", *rest),
        ):
            done = run_command("import", f"{name}.csv", *at, "--run", f"{name}-{unit}", *words, cwd=tmp_path)
            assert done.code == 0, done.err
    rows = run_command("metrics", "--metric", "bias", "--store", "s", "--json", cwd=tmp_path).json
    rows = [row for row in rows if row["value"] is not None]
    assert {row["unit"] for row in rows} == {f"C-{interval_s:.0f}" for interval_s in intervals_s}
    for row in rows:
        remark = row["parameters"]["remark"] or ""
        assert ("measured with samples of 1 s, these are of 2 s" in remark) is (row["unit"] == "C-2"), row
        assert row["parameters"]["scale_factor"] == f"measured in run scale-{row['unit']}"
