"""Which steps a characteristic takes together: axes, temperatures, visits and positions, from files by the commands."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.e2e.judging.step_files import NOISE, UNITS, Steps, visits

PLACE = ("--start", "2026-10-01T08:00:00+08:00", "--latitude", "39.9", "--altitude", "50")
Row = dict[str, Any]


def measured(
    folder: Path, run_command: Callable[..., Any], units: dict[str, Callable[[], Steps]]
) -> dict[str, list[Row]]:
    """The metrics of each unit."""
    for name, made in units.items():
        made().write(folder / f"{name}.csv")
    # one command: each would open the store and start a recorder of its own
    done = run_command("import", *(f"{name}.csv" for name in units), "--store", "S", *PLACE, cwd=folder)
    assert done.code == 0, done.err
    found = run_command("metrics", "--store", "S", "--json", cwd=folder).json
    return {name: [row for row in found if row["unit"] == name] for name in units}


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> dict[str, list[Row]]:
    return measured(tmp_path_factory.mktemp("steps"), run_command, UNITS)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> dict[str, list[Row]]:
    """Apart, since no test of the gate asks for it."""
    units: dict[str, Callable[[], Steps]] = {"recorded": partial(visits, is_commanded=False)}
    return measured(tmp_path_factory.mktemp("recorded"), run_command, units)


def of(
    rows: list[dict[str, Any]], metric: str, standard: str = "JJF2014", **parameters: object
) -> list[dict[str, Any]]:
    return [
        row for row in rows
        if row["metric"] == metric and standard in (row["standard"] or "")
        and all(row["parameters"].get(name) == value for name, value in parameters.items())
    ]  # fmt: skip


def test_a_scale_factor_is_of_the_axis_that_turned(rows: dict[str, list[Row]]) -> None:
    found = {row["signal"]: row["value"] for row in of(rows["axes"], "scale_factor")}
    assert found == pytest.approx({"rate_x": 101.0, "rate_y": 99.5, "rate_z": 100.2}, rel=1e-5)
    assert len(of(rows["axes"], "scale_factor")) == 3
    for row in of(rows["axes"], "bias", earth_rate="none"):
        assert abs(row["value"]) < 1.0, "deg/h; with K of a cross axis it is a thousand times larger"


@pytest.mark.in_gate("rows-commanded")
@pytest.mark.parametrize(("store", "unit"), [("rows", "commanded"), ("recorded", "recorded")])
def test_each_visit_to_a_temperature_is_a_point(request: pytest.FixtureRequest, store: str, unit: str) -> None:
    (row,) = of(request.getfixturevalue(store)[unit], "scale_factor_temperature_sensitivity")
    assert row["reason"] is None
    assert row["parameters"]["points"] == 3
    assert row["lo"] <= 100.0 / 37.0 <= row["hi"]
    assert row["value"] == pytest.approx(100.0 / 37.0, abs=0.5)


def test_scale_factors_at_one_temperature_are_compared(rows: dict[str, list[Row]]) -> None:
    for temperature in (23.0, 60.0):
        for axis, change in zip("XYZ", (30e-6, 80e-6, 10e-6), strict=True):
            (row,) = of(rows["vibrated"], "scale_factor_vibration_change", axis=axis, temperature_command=temperature)
            assert abs(row["value"] - change) < max(5 * row["standard_uncertainty"], 1e-7)


def test_a_temperature_that_was_measured_on_one_side_only_is_named(rows: dict[str, list[Row]]) -> None:
    for row in of(rows["half"], "scale_factor_vibration_change", temperature_command=60.0):
        assert (row["value"], "not measured after it" in row["reason"]) == (None, True)
    for row in of(rows["half"], "scale_factor_vibration_change", temperature_command=23.0):
        assert row["reason"] is None


def test_biases_at_one_temperature_are_compared(rows: dict[str, list[Row]]) -> None:
    (row,) = of(
        rows["flipped"], "bias_acceleration_sensitivity", axis="X", earth_rate="none", temperature_command=23.0
    )  # fmt: skip
    assert row["lo"] <= 0.5 <= row["hi"]
    (hot,) = of(
        rows["flipped"], "bias_acceleration_sensitivity", axis="X", earth_rate="none", temperature_command=60.0
    )  # fmt: skip
    assert (hot["value"], "only with it up" in hot["reason"]) == (None, True)


def test_a_soak_is_no_plateau_and_a_ramp_is_named(rows: dict[str, list[Row]]) -> None:
    (row,) = of(rows["soaked"], "bias_temperature_sensitivity")
    assert (row["parameters"]["points"], row["parameters"]["remark"]) == (2, None)
    assert row["lo"] <= 0.03 <= row["hi"]
    (row,) = of(rows["ramped"], "bias_temperature_sensitivity")
    assert "the temperature moved within 1 of the steps, by up to 37" in row["parameters"]["remark"]


def test_a_scale_factor_of_which_the_rates_are_shared_among_visits_is_one(rows: dict[str, list[Row]]) -> None:
    assert [row["parameters"]["visit"] for row in of(rows["shared"], "scale_factor")] == [None] * 3
    (row,) = of(rows["shared"], "scale_factor_temperature_sensitivity")
    assert row["lo"] <= 5.0 <= row["hi"]


def test_set_points_that_differ_by_hundredths_are_one(rows: dict[str, list[Row]]) -> None:
    found = {row["parameters"]["axis"]: row["value"] for row in of(rows["about"], "bias_vibration_change")}
    assert found == pytest.approx({"X": 0.4, "Y": 2.0, "Z": 0.3, "largest": 2.0}, abs=0.15)
    (row,) = of(rows["about"], "bias_temperature_sensitivity")
    assert row["parameters"]["points"] == 2, "a step named warm is a point where none else measures at its temperature"
    assert row["lo"] <= 0.12 <= row["hi"]


def test_a_position_that_was_measured_twice_is_the_mean(rows: dict[str, list[Row]]) -> None:
    (row,) = of(rows["crossed"], "misalignment", "GJB2426A")
    assert row["parameters"]["towards_x_arcmin"] == pytest.approx(11.0, abs=0.05)
    assert row["hi"] - row["lo"] > 2.0, "the two differ by 4 arcmin"


def test_the_base_of_a_resolution_is_where_it_says(rows: dict[str, list[Row]]) -> None:
    for row in of(rows["falling"], "resolution"):
        assert row["parameters"]["base_rate_deg_per_h"] == pytest.approx(400.0)
        assert row["value"] == pytest.approx(9.0, abs=0.3)


def test_white_noise_at_every_rate_bounds_the_nonlinearity(rows: dict[str, list[Row]]) -> None:
    """By chance a third of the records has few degrees of freedom: the bound had been that of the worst of 22."""
    for unit in ("axes", "commanded"):
        wide = [row["hi"] - row["value"] for row in of(rows[unit], "scale_factor_nonlinearity", "GJB2426A")]
        full_scale, u = (100.0, NOISE / np.sqrt(20)) if unit == "commanded" else (1e4, NOISE / np.sqrt(20))
        assert np.median(wide) < 8 * u / full_scale * 1e6
