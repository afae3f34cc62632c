"""Simulated calibrations whose instruments err as their certificates allow: the steps as records, and the truth.

One unit is calibrated at one station after the other. Each draws the errors of its instruments again from what it
states; the physics are written here, apart from the metrics.
"""

import json
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from tests.bench.metric_steps import PAUSE_S, SECOND_NS, START_NS, record_of

LATITUDE_DEG = 40.0
EARTH_DEG_PER_H = 15.041067
ARCSEC = math.pi / 648_000
RATES = tuple(float(rate) for rate in (1, 1.6, 2.5, 4, 6.3, 10, 16, 25, 40, 63, 100))
ROOM, HOT = 20.0, 60.0
# what the station states: half the U of k = 2, or the half-width of a distribution
STATED: dict[str, tuple[float, str]] = {
    "rate": (50.0, "normal"), "rate_nonuniformity": (20.0, "u_shaped"), "angle": (2.0, "normal"),
    "voltage": (30.0, "normal"), "voltage_offset": (20e-6, "uniform"), "temperature": (0.3, "normal"),
    "levelling": (300.0, "normal"), "heading": (400.0, "uniform"), "latitude": (100.0, "normal"),
    "mounting": (60.0, "normal"),
}  # fmt: skip
_UNITS = {"voltage_offset": "V", "temperature": "degC"} | dict.fromkeys(
    ("rate", "rate_nonuniformity", "voltage"), "ppm"
)
_DIVISORS = {"normal": 2.0, "uniform": math.sqrt(3.0), "u_shaped": math.sqrt(2.0)}


class Truth(NamedTuple):
    """What is true of the unit."""

    k_volt: float = 0.05  # V/(deg/s)
    asymmetry_ppm: float = 300.0
    bias: float = 7.0  # deg/h
    bias_per_degree: float = 0.5
    scale_ppm_per_degree: float = 40.0
    bias_per_g: float = 3.0
    misalignment_arcmin: tuple[float, float] = (30.0, -40.0)


UNIT = Truth()
# the metric, the parameters or standard of the row that is compared, and the true value
EXPECTED: tuple[tuple[str, dict[str, Any], float], ...] = (
    ("scale_factor", {"standard": "JJF2014"}, UNIT.k_volt),
    ("scale_factor_asymmetry", {"standard": "GJB2426A"}, UNIT.asymmetry_ppm),
    ("fitted_zero", {"standard": "JJF2014"}, UNIT.bias + EARTH_DEG_PER_H * math.sin(math.radians(LATITUDE_DEG))),
    ("bias", {"earth_rate": "removed", "position": "IRA_up"}, UNIT.bias),
    ("bias", {"earth_rate": "removed", "position": "IRA_east"}, UNIT.bias),
    ("bias_temperature_sensitivity", {}, UNIT.bias_per_degree),
    ("scale_factor_temperature_sensitivity", {"standard": "JJF2014"}, UNIT.scale_ppm_per_degree),
    ("bias_acceleration_sensitivity", {"axis": "X", "earth_rate": "none"}, UNIT.bias_per_g),
    ("misalignment", {"positions": 2}, math.hypot(*UNIT.misalignment_arcmin)),
)  # fmt: skip


def stated_standards() -> str:
    """The station's standards as the log has them."""
    quantities = [
        {
            "quantity": name, "stated": size * (2.0 if shape == "normal" else 1.0), "divisor": _DIVISORS[shape],
            "u": size / (1.0 if shape == "normal" else _DIVISORS[shape]), "unit": _UNITS.get(name, "arcsec"),
            "distribution": shape, "freedom": None,
        }
        for name, (size, shape) in STATED.items()
    ]  # fmt: skip
    return json.dumps([{"name": "station", "kind": "", "serial": "S-1", "quantities": quantities}])


class Errors:
    """The errors of a station's instruments, drawn once for each calibration."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.scale = 1e-6 * self.draw("rate")
        self.gain = 1e-6 * self.draw("voltage")
        self.offset = self.draw("voltage_offset")
        self.latitude = self.draw("latitude") * ARCSEC
        self.of_rate = {way * rate: 1e-6 * self.draw("rate_nonuniformity") for rate in RATES for way in (1, -1)}

    def draw(self, name: str) -> float:
        size, shape = STATED[name]
        if shape == "normal":
            return float(self.rng.normal(0, size))
        if shape == "uniform":
            return float(self.rng.uniform(-size, size))
        return size * math.sin(self.rng.uniform(0, 2 * math.pi))

    def true_rate(self, rate: float) -> float:
        """The rate of a table that shows `rate`, deg/s."""
        return rate * (1 + self.scale + self.of_rate.get(rate, 0.0))

    def volts(self, value: float) -> float:
        """What the voltmeter shows."""
        return value * (1 + self.gain) + self.offset

    def vertical(self) -> float:
        """Earth's rate on an axis that was set upright, deg/h."""
        return EARTH_DEG_PER_H * math.sin(math.radians(LATITUDE_DEG) + self.latitude + self.draw("levelling") * ARCSEC)

    def level(self) -> float:
        """Earth's rate on an axis that was set level and to the east, deg/h."""
        latitude = math.radians(LATITUDE_DEG) + self.latitude
        towards_north, up = self.draw("heading") * ARCSEC, self.draw("levelling") * ARCSEC
        return EARTH_DEG_PER_H * (math.cos(latitude) * math.sin(towards_north) + math.sin(latitude) * math.sin(up))


class Planned(NamedTuple):
    """A step: its words, the mean that the instruments show, the deviation of its samples and their number."""

    words: dict[str, Any]
    shown: float
    noise: float
    seconds: int = 60


def _scale_factor(errors: Errors, words: dict[str, Any], per_degree: float = 0.0) -> Iterator[Planned]:
    zero = UNIT.bias + errors.vertical()
    k = UNIT.k_volt * (1 + per_degree * 1e-6)
    rates = [0.0, *(way * rate for rate in RATES for way in (1, -1)), 0.0]
    for rate in rates:
        own = k * (1 + math.copysign(UNIT.asymmetry_ppm / 2e6, rate))
        output = own * errors.true_rate(rate) + UNIT.k_volt * zero / 3600
        yield Planned(words | {"rate_command": rate, "unit_of_measure": "V"}, errors.volts(output), 2e-6)


def _temperatures(errors: Errors) -> dict[float, float]:
    return {set_to: set_to + errors.draw("temperature") for set_to in (ROOM, HOT)}


def _runs(errors: Errors) -> Iterator[tuple[str, list[Planned]]]:
    yield "scale_factor", list(_scale_factor(errors, {}))
    yield (
        "static_bias",
        [
            Planned({"position": "IRA_up"}, UNIT.bias + errors.vertical(), 1.0, 3600),
            Planned({"position": "IRA_east"}, UNIT.bias + errors.level(), 1.0, 3600),
        ],
    )
    true = _temperatures(errors)
    yield (
        "bias_temperature_sensitivity",
        [
            Planned(
                {"temperature_command": t, "room": t == ROOM}, UNIT.bias + UNIT.bias_per_degree * (true[t] - ROOM), 0.01
            )
            for t in (ROOM, HOT)
        ],
    )
    true = _temperatures(errors)
    yield (
        "scale_factor_temperature_sensitivity",
        [
            step
            for t in (ROOM, HOT)
            for step in _scale_factor(
                errors, {"temperature_command": t, "room": t == ROOM}, UNIT.scale_ppm_per_degree * (true[t] - ROOM)
            )
        ],
    )
    yield (
        "bias_acceleration_sensitivity",
        [
            Planned(
                {"axis": axis, "position": f"{axis}_{side}"}, UNIT.bias + way * UNIT.bias_per_g + errors.level(), 0.02
            )
            for axis in ("X", "Y", "Z")
            for side, way in (("up", 1), ("down", -1))
        ],
    )
    yield "misalignment", [
        Planned(
            {"position": f"o{'xy'[at]}_up", "rate_command": way * 100.0},
            UNIT.bias + way * errors.true_rate(100.0) * 3600 * math.sin(angle), 1.0,
        )
        for at, own in enumerate(UNIT.misalignment_arcmin)
        for angle in [(own * 60 + errors.draw("mounting")) * ARCSEC]
        for way in (1, -1)
    ]  # fmt: skip


def calibration(name: str, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Records of the steps of one calibration; its runs are its own, with `name` in their names."""
    errors = Errors(rng)
    records = []
    for procedure, steps in _runs(errors):
        at_ns = START_NS
        for index, step in enumerate(steps, start=1):
            samples = step.shown + rng.normal(0, step.noise, step.seconds)
            words = {
                "run": f"{name}-{procedure}", "unit": name, "index": index, "procedure": procedure,
                "latitude_deg": LATITUDE_DEG,
            }  # fmt: skip
            records.append(record_of(samples, at_ns, words | step.words))
            at_ns += (step.seconds + PAUSE_S) * SECOND_NS
    return records
