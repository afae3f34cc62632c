"""Outputs that stand still, answer to no rate, still settle, or hold what no noise model has: what may be claimed."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from gyrofleet import main
from tests.e2e.judging.test_doubtful_records import bias_of, of_unit, parameters, written

Stores = Callable[[str], "Answers"]
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


Rows = list[dict[str, Any]]
WHITE_HZ, WHITE = 100.0, 0.06  # deg/sqrt(h)
FROZEN = (0.0123, 0.0077, -0.0031, 0.0125, 1.0 / 3.0, 1e-9, 12345.678)
UNITS = {  # a store of these for the gate, one of all others for the long form
    "gate": ("K0", "Q", "RECTIFIED", "LINE"),
    "long": (*(f"K{number}" for number in range(1, len(FROZEN))), "DEAD", "WHITE"),
}


def frozen_file(path: Path, value: float) -> Path:
    """Ten minutes at 100 Hz, which are reduced from means of seconds."""
    path.write_text("time[s],rate[deg/h]\n" + "".join(f"{at / 100:.2f},{value!r}\n" for at in range(60_000)))
    return path


def noise_file(path: Path, *, is_line: bool) -> Path:
    """White noise of 0.06 deg/sqrt(h) at 100 Hz, and 18 deg/h at 0.1 Hz in one of the two."""
    time_s = np.arange(100_000) / WHITE_HZ
    noise = WHITE * 60.0 * np.sqrt(WHITE_HZ) * np.random.default_rng(2).standard_normal(time_s.size)
    return written(path, time_s, rate__dph=noise + 18.0 * is_line * np.sin(0.2 * np.pi * time_s))


def unresponsive_file(path: Path, *, is_rectified: bool) -> Path:
    rng = np.random.default_rng(1)

    def output(rate: float, _: int) -> Any:
        return (0.05 * abs(rate) if is_rectified else 0.1) + 1e-5 * rng.standard_normal(100)

    return scale_file(path, output)


def coarse_file(path: Path) -> Path:
    """Perfectly linear, in steps of 4 mV: 109 ppm of nonlinearity are all quantisation."""
    return scale_file(path, lambda rate, _: 0.004 * np.round((0.05 * rate + 0.0007) / 0.004))


def unit_file(folder: Path, unit: str) -> Path:
    path = folder / f"{unit}.csv"
    if unit.startswith("K"):
        return frozen_file(path, FROZEN[int(unit[1:])])
    if unit == "Q":
        return coarse_file(path)
    if unit in {"LINE", "WHITE"}:
        return noise_file(path, is_line=unit == "LINE")
    return unresponsive_file(path, is_rectified=unit == "RECTIFIED")


class Answers:
    """What the commands say of a store in which all units are: each would be evaluated for seconds alone."""

    def __init__(self, folder: Path, units: tuple[str, ...]) -> None:
        self._store = str(folder / "S")
        paths = {unit: of_unit(unit_file(folder, unit)) for unit in units}
        still = [path for unit, path in paths.items() if unit[0] == "K" or unit in {"LINE", "WHITE"}]
        turned = [path for path in paths.values() if path not in still]
        self._ask("import", *still, *WHERE, "--procedure", "static_bias", "--position", "IRA_up")
        self._ask("import", *turned, *WHERE)
        (folder / "limits.toml").write_text(LIMITS)
        self._ask("limits", "add", folder / "limits.toml")
        self._verdicts: Rows = json.loads(self._ask("verdicts"))["verdicts"]
        self._metrics: Rows = json.loads(self._ask("metrics"))

    def _ask(self, *words: object) -> str:
        done = CliRunner().invoke(main, [*(str(word) for word in words), "--store", self._store, "--json"])
        assert done.exit_code == 0, (done.output, done.exception)
        return done.stdout

    def verdicts(self, unit: str) -> Rows:
        return [row for row in self._verdicts if row["unit"] == unit]

    def metrics(self, unit: str, metric: str) -> Rows:
        return [row for row in self._metrics if (row["unit"], row["metric"]) == (unit, metric)]


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Answers]:
    """The answers of the store in which a unit is."""

    @cache
    def of(store: str) -> Answers:
        return Answers(tmp_path_factory.mktemp(store), UNITS[store])

    return lambda unit: of(next(store for store, units in UNITS.items() if unit in units))


@pytest.mark.in_gate("K0")
@pytest.mark.parametrize("unit", [f"K{number}" for number in range(len(FROZEN))])
def test_a_frozen_output_is_frozen_whatever_its_digits(stores: Stores, unit: str) -> None:
    answer = stores(unit).verdicts(unit)
    (stability,) = [row for row in answer if row["metric"] == "bias_stability"]
    assert (stability["verdict"], stability["value"]) == ("NO_DATA", None)
    assert "all 60000 samples are alike" in stability["reason"]
    if abs(FROZEN[int(unit[1:])]) < 60.0:
        bias = bias_of(answer, unit)
        assert (bias["verdict"], bias["lo"], bias["hi"]) == ("MARGINAL", None, None)


def test_a_scale_factor_of_a_coarse_output_has_no_interval_of_no_width(stores: Stores) -> None:
    for metric in ("scale_factor", "scale_factor_nonlinearity", "scale_factor_asymmetry"):
        rows = [row for row in stores("Q").metrics("Q", metric) if row["value"] is not None]
        assert rows
        for row in rows:
            assert row["lo"] is None or row["hi"] - row["lo"] > 1e-6 * abs(row["value"])
            assert "the output stands still at 22 of 22 rates" in parameters(row)["remark"]
    found = [row for row in stores("Q").verdicts("Q") if row["metric"] == "scale_factor_nonlinearity"]
    assert {row["verdict"] for row in found} == {"MARGINAL"}


@pytest.mark.in_gate("RECTIFIED")
@pytest.mark.parametrize("unit", ["RECTIFIED", "DEAD"])
def test_an_output_that_does_not_depend_on_the_rate_has_no_scale_factor(stores: Stores, unit: str) -> None:
    for metric in ("scale_factor_nonlinearity", "scale_factor_asymmetry", "fitted_zero"):
        rows = stores(unit).metrics(unit, metric)
        assert rows
        for row in rows:
            assert row["value"] is None
            assert "the output does not depend on the rate: K is " in row["reason"]


@pytest.mark.in_gate("LINE")
@pytest.mark.parametrize("unit", ["LINE", "WHITE"])
def test_a_line_in_the_spectrum_gives_no_sure_random_walk(stores: Stores, unit: str) -> None:
    (row,) = stores(unit).metrics(unit, "angle_random_walk")
    remark = parameters(row)["remark"]
    if unit == "LINE":
        assert (row["lo"], row["hi"], row["standard_uncertainty"]) == (None, None, None)
        assert "the terms of the noise model do not describe the Allan curve" in remark
    else:
        assert row["lo"] < WHITE < row["hi"]
        assert "noise model" not in (remark or "")
