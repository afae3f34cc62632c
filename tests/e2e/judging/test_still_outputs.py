"""Outputs that stand still, answer to no rate, still settle, or hold what no noise model has: what may be claimed."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.e2e.judging.test_doubtful_records import bias_of, parameters, written

Ask = Callable[..., Any]
WHERE = ("--start", "2026-10-01T08:00:00+08:00", "--latitude", "39.9")
LIMITS = """
revision = "A"
[product.P]
startup_band_deg_per_h = 100.0
max_rate_deg_per_s = 100.0
[[limit]]
metric = "bias"
lower = -60.0
upper = 60.0
unit_of_measure = "deg/h"
[[limit]]
metric = "bias_stability"
upper = 1.0
unit_of_measure = "deg/h"
[[limit]]
metric = "scale_factor_nonlinearity"
upper = 1e6
unit_of_measure = "ppm"
"""
RATES = [sign * rate for rate in (5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100) for sign in (1, -1)]


def scale_file(path: Path, output: Callable[[float, int], Any]) -> Path:
    """Eleven rates in each direction of 10 s at 10 Hz, between two rests."""
    rows = ["time[s],rate[V],procedure,step,rate_command[deg/s]"]
    for at, rate in enumerate([0.0, *RATES, 0.0]):
        word = "rate" if rate else "rest_before" if at == 0 else "rest_after"
        for k, volt in enumerate(np.broadcast_to(output(rate, at), 100)):
            rows.append(f"{15 * at + k / 10:.1f},{volt:.9f},scale_factor,{word},{rate}")
    path.write_text("\n".join(rows))
    return path


def values(ask: Ask, unit: str, metric: str) -> list[dict[str, Any]]:
    answer = ask("metrics", "--unit", unit, "--metric", metric)
    return [dict(row) for row in (answer["metrics"] if isinstance(answer, dict) else answer)]


LONG = [pytest.param(each, marks=pytest.mark.long) for each in (0.0077, -0.0031, 0.0125, 1.0 / 3.0, 1e-9, 12345.678)]


@pytest.mark.parametrize("value", [0.0123, *LONG])
def test_a_frozen_output_is_frozen_whatever_its_digits(ask: Ask, tmp_path: Path, value: float) -> None:
    """Ten minutes at 100 Hz, which are reduced from means of seconds."""
    path = tmp_path / "k.csv"
    path.write_text("time[s],rate[deg/h]\n" + "".join(f"{at / 100:.2f},{value!r}\n" for at in range(60_000)))
    ask("import", path, "--unit", "K", *WHERE, "--procedure", "static_bias", "--position", "IRA_up")
    (tmp_path / "limits.toml").write_text(LIMITS)
    ask("limits", "add", tmp_path / "limits.toml")
    answer = ask("verdicts")["verdicts"]
    (stability,) = [row for row in answer if row["metric"] == "bias_stability"]
    assert (stability["verdict"], stability["value"]) == ("NO_DATA", None)
    assert "all 60000 samples are alike" in stability["reason"]
    if abs(value) < 60.0:
        bias = bias_of(answer, "K")
        assert (bias["verdict"], bias["lo"], bias["hi"]) == ("MARGINAL", None, None)


def test_a_scale_factor_of_a_coarse_output_has_no_interval_of_no_width(ask: Ask, tmp_path: Path) -> None:
    """Perfectly linear, in steps of 4 mV: 109 ppm of nonlinearity are all quantisation."""
    path = scale_file(tmp_path / "q.csv", lambda rate, _: 0.004 * np.round((0.05 * rate + 0.0007) / 0.004))
    ask("import", path, "--unit", "Q", *WHERE)
    for metric in ("scale_factor", "scale_factor_nonlinearity", "scale_factor_asymmetry"):
        rows = [row for row in values(ask, "Q", metric) if row["value"] is not None]
        assert rows
        for row in rows:
            assert row["lo"] is None or row["hi"] - row["lo"] > 1e-6 * abs(row["value"])
            assert "the output stands still at 22 of 22 rates" in parameters(row)["remark"]
    (tmp_path / "limits.toml").write_text(LIMITS)
    ask("limits", "add", tmp_path / "limits.toml")
    found = [row for row in ask("verdicts")["verdicts"] if row["metric"] == "scale_factor_nonlinearity"]
    assert {row["verdict"] for row in found} == {"MARGINAL"}


@pytest.mark.parametrize("kind", ["rectified", pytest.param("dead", marks=pytest.mark.long)])
def test_an_output_that_does_not_depend_on_the_rate_has_no_scale_factor(ask: Ask, tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(1)

    def output(rate: float, _: int) -> Any:
        return (0.05 * abs(rate) if kind == "rectified" else 0.1) + 1e-5 * rng.standard_normal(100)

    ask("import", scale_file(tmp_path / "d.csv", output), "--unit", "D", *WHERE)
    for metric in ("scale_factor_nonlinearity", "scale_factor_asymmetry", "fitted_zero"):
        for row in values(ask, "D", metric):
            assert row["value"] is None
            assert "the output does not depend on the rate: K is " in row["reason"]


@pytest.mark.parametrize("is_line", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_line_in_the_spectrum_gives_no_sure_random_walk(ask: Ask, tmp_path: Path, is_line: bool) -> None:
    """White noise of 0.06 deg/sqrt(h) at 100 Hz, and 18 deg/h at 0.1 Hz in one of the two."""
    time_s = np.arange(100_000) / 100.0
    noise = 0.06 * 60.0 * 10.0 * np.random.default_rng(2).standard_normal(time_s.size)
    path = written(tmp_path / "s.csv", time_s, rate__dph=noise + 18.0 * is_line * np.sin(0.2 * np.pi * time_s))
    ask("import", path, "--unit", "S", *WHERE, "--procedure", "static_bias", "--position", "IRA_up")
    (row,) = values(ask, "S", "angle_random_walk")
    remark = parameters(row)["remark"]
    if is_line:
        assert (row["lo"], row["hi"], row["standard_uncertainty"]) == (None, None, None)
        assert "the terms of the noise model do not describe the Allan curve" in remark
    else:
        assert row["lo"] < 0.06 < row["hi"]
        assert "noise model" not in remark
