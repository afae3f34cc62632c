"""Which steps a characteristic takes together: axes, temperatures, visits and positions, from files by the commands.

The files are written by NumPy alone; each true value is the one that they were made with.
"""

import csv
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

RATES = (1.0, 1.6, 2.5, 4.0, 6.3, 10.0, 16.0, 25.0, 40.0, 63.0, 100.0)
PLACE = ("--start", "2026-10-01T08:00:00+08:00", "--latitude", "39.9", "--altitude", "50")
TURN = (0.0, *RATES, *(-each for each in RATES), 0.0)
WORDS = (
    "procedure",
    "step",
    "position",
    "axis",
    "phase",
    "rate_command[deg/s]",
    "temperature_command[degC]",
    "settle[s]",
    "room",
)
NOISE = 2e-4


Row = dict[str, Any]


def scaled(ppm: float, rate: float) -> list[float]:
    return [rate * (1 + ppm * 1e-6)]


class Steps:
    """Steps of one unit, written as a CSV file."""

    def __init__(self, *signals: str, with_temperature: bool = False) -> None:
        self.signals, self.with_temperature = signals, with_temperature
        self.rows: list[list[object]] = []
        self.at_s, self.rng = 0.0, np.random.default_rng(7)

    def step(self, values: Iterable[float], n: int = 20, temperature: Any = None, **words: object) -> None:
        given = {name.partition("[")[0]: words.get(name.partition("[")[0], "") for name in WORDS}
        given["step"] = given["step"] or f"s{len(self.rows)}"
        warm = np.broadcast_to(np.asarray(temperature if temperature is not None else 0.0, float), n)
        noisy = np.asarray(list(values), float)[:, None] + NOISE * self.rng.standard_normal((len(self.signals), n))
        for i in range(n):
            measured = [repr(float(warm[i]))] if self.with_temperature else []
            self.rows.append([f"{self.at_s + i:.3f}", *given.values(), *measured, *map(repr, noisy[:, i].tolist())])
        self.at_s += n

    def turn(self, line: Callable[[float], Iterable[float]], **words: Any) -> None:
        for rate in TURN:
            self.step(line(rate), rate_command=rate, **words)

    def write(self, path: Path) -> None:
        head = ["time[s]", *WORDS, *(["temperature[degC]"] if self.with_temperature else []), *self.signals]
        with path.open("w", newline="") as file:
            csv.writer(file).writerows([head, *self.rows])


def three_axes() -> Steps:
    matrix = np.array([[101.0, 0.2, -0.1], [0.15, 99.5, 0.1], [-0.1, 0.05, 100.2]])
    steps = Steps("rate_x[count]", "rate_y[count]", "rate_z[count]")
    for j, axis in enumerate("XYZ"):
        steps.turn(partial(np.multiply, matrix[:, j]), procedure="scale_factor", axis=axis)
    steps.step(np.zeros(3), n=3700, procedure="static_bias", position="Z_up")
    return steps


def visits(*, is_commanded: bool) -> Steps:
    """Room, hot, cold, hot again by -100 ppm, room."""
    steps = Steps("rate[deg/s]", with_temperature=not is_commanded)
    for number, (temperature, ppm) in enumerate(
        ((23.0, 0.0), (60.0, 100.0), (-40.0, 20.0), (60.0, -100.0), (23.0, 0.0))
    ):
        given = {"temperature_command": temperature} if is_commanded else {"temperature": temperature}
        steps.turn(
            partial(scaled, ppm), procedure="scale_factor_temperature_sensitivity",
            step=f"v{number}", room="true" if temperature == 23.0 else "false", **given,
        )  # fmt: skip
    return steps


def vibrated(*, without: tuple[str, float] = ("", 0.0)) -> Steps:
    """K has 5 ppm/degC and changes by 30, 80, 10 ppm; hot and cold before and after, in the order of a chamber."""
    steps = Steps("rate[deg/s]")
    for axis, change in zip("XYZ", (30.0, 80.0, 10.0), strict=True):
        for phase, temperature in (("before", 23.0), ("before", 60.0), ("after", 60.0), ("after", 23.0)):
            if (phase, temperature) == without:
                continue
            ppm = 5.0 * (temperature - 23.0) + (change if phase == "after" else 0.0)
            steps.turn(
                partial(scaled, ppm), procedure="scale_factor_vibration", axis=axis,
                phase=phase, temperature_command=temperature,
            )  # fmt: skip
    return steps


def flipped() -> Steps:
    """Bias of 0.5 deg/h/g along X and 0.04 deg/h/degC; with X up also at 60 degC."""
    steps = Steps("rate[deg/s]")
    for axis, side, temperature in (("X", 1, 23.0), ("X", 1, 60.0), ("X", -1, 23.0)):
        bias = 0.5 * side + 0.04 * (temperature - 23.0)
        steps.step(
            [bias / 3600], n=1200, procedure="bias_acceleration_sensitivity", axis=axis,
            position=f"{axis}_{'up' if side > 0 else 'down'}", temperature_command=temperature,
        )  # fmt: skip
    return steps


def soaked() -> Steps:
    """0.03 deg/h/degC on plateaus; 3 deg/h more while it soaks."""
    steps = Steps("rate[deg/s]", with_temperature=True)
    for temperature in (23.0, 60.0, -40.0):
        for step, more in (("soak", 3.0), ("static", 0.0)):
            bias = 0.03 * (temperature - 23.0) + more * (temperature != 23.0)
            steps.step(
                [bias / 3600], n=1900, temperature=temperature, procedure="bias_temperature_sensitivity", step=step,
                temperature_command=temperature,
            )  # fmt: skip
    return steps


def ramped() -> Steps:
    steps = Steps("rate[deg/s]", with_temperature=True)
    for first, last, word in ((23.0, 23.0, 23.0), (23.0, 60.0, 60.0)):
        warm = np.linspace(first, last, 1900)
        steps.step([0.0], n=1900, temperature=warm, procedure="bias_temperature_sensitivity", temperature_command=word)
    return steps


def crossed() -> Steps:
    """ox up twice: off by 4 arcmin more the first time."""
    steps = Steps("rate[deg/s]")
    for position, arcmin in (("ox_up", 13.0), ("oy_up", 6.0), ("ox_up", 9.0)):
        for rate in (100.0, -100.0):
            steps.step(
                [rate * np.radians(arcmin / 60)], n=200, procedure="misalignment", position=position, rate_command=rate
            )
    return steps


def falling() -> Steps:
    """Increments downwards from a base of 400 deg/h; up to 4 deg/h they are not followed."""
    steps = Steps("rate[deg/s]")
    for sign in (1, -1):
        for base, change in ((True, 0.0), *((False, each) for each in (36.0, 18.0, 9.0, 4.5, 2.2)), (True, 0.0)):
            seen = 400.0 - (change - 4.0 if change > 8.5 else 0.0)
            steps.step(
                [sign * seen / 3600], n=2000, procedure="resolution", step="base" if base else "increment",
                rate_command=sign * (400.0 - change) / 3600,
            )  # fmt: skip
    return steps


def shared() -> Steps:
    """Forwards at 23, 60, -40 degC, then backwards: one scale factor each; 5 ppm/degC."""
    steps = Steps("rate[deg/s]")
    for sign in (1, -1):
        for temperature in (23.0, 60.0, -40.0):
            for rate in (0.0, *RATES) if sign > 0 else (*(-each for each in RATES), 0.0):
                steps.step(
                    scaled(5.0 * (temperature - 23.0), rate), procedure="scale_factor_temperature_sensitivity",
                    rate_command=rate, temperature_command=temperature,
                )  # fmt: skip
    return steps


def about() -> Steps:
    """Before at 22.98, after at 23.03 degC, as a column of measured set-points has it; a step named warm."""
    steps = Steps("rate[deg/s]")
    for axis, change in zip("XYZ", (0.4, 2.0, 0.3), strict=True):
        for phase, temperature in (("before", 22.98), ("after", 23.03)):
            steps.step(
                [change * (phase == "after") / 3600], n=600, procedure="bias_vibration", axis=axis, phase=phase,
                temperature_command=temperature,
            )  # fmt: skip
    for step, temperature in (("room", 23.0), ("warm", 60.0), ("cold", -40.0)):
        bias = 0.12 * (temperature - 23.0) if step == "warm" else 0.05 * (temperature - 23.0)
        steps.step(
            [bias / 3600], n=600, procedure="bias_temperature_sensitivity", step=step, temperature_command=temperature
        )
    return steps


UNITS: dict[str, Callable[[], Steps]] = {
    "axes": three_axes, "commanded": partial(visits, is_commanded=True),
    "recorded": partial(visits, is_commanded=False),
    "vibrated": vibrated, "flipped": flipped, "soaked": soaked, "ramped": ramped, "crossed": crossed,
    "half": partial(vibrated, without=("after", 60.0)), "falling": falling, "shared": shared, "about": about,
}  # fmt: skip


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> dict[str, list[Row]]:
    """The metrics of each unit."""
    folder = tmp_path_factory.mktemp("steps")
    for name, made in UNITS.items():
        made().write(folder / f"{name}.csv")
        done = run_command(
            "import", f"{name}.csv", "--unit", name, "--run", name, "--store", "S", *PLACE, cwd=folder
        )  # fmt: skip
        assert done.code == 0, done.err
    found = run_command("metrics", "--store", "S", "--json", cwd=folder).json
    return {name: [row for row in found if row["unit"] == name] for name in UNITS}


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


@pytest.mark.parametrize("unit", ["commanded", "recorded"])
def test_each_visit_to_a_temperature_is_a_point(rows: dict[str, list[Row]], unit: str) -> None:
    (row,) = of(rows[unit], "scale_factor_temperature_sensitivity")
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
