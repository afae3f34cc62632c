"""Files of steps of one unit each, for tests of what a characteristic takes together.

They are written by NumPy alone; each true value is the one that they were made with.
"""

import csv
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

RATES = (1.0, 1.6, 2.5, 4.0, 6.3, 10.0, 16.0, 25.0, 40.0, 63.0, 100.0)
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
        """A file of the unit that it is called after."""
        head = ["unit", "time[s]", *WORDS, *(["temperature[degC]"] if self.with_temperature else []), *self.signals]
        with path.open("w", newline="") as file:
            csv.writer(file).writerows([head, *([path.stem, *row] for row in self.rows)])


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
    "vibrated": vibrated, "flipped": flipped, "soaked": soaked, "ramped": ramped, "crossed": crossed,
    "half": partial(vibrated, without=("after", 60.0)), "falling": falling, "shared": shared, "about": about,
}  # fmt: skip
