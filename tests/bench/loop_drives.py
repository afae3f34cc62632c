"""What a gyro goes through in five types of test, at even instants: the true channels, and what sensors read.

Nothing here knows an effect or a noise model.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from stream.batch import FloatArray

TYPES = ("static", "temperature", "rate", "positions", "environment")
UNITS = {
    **dict.fromkeys(("input_rate", "rate_o", "rate_s", "table_rate"), "deg/s"),
    **dict.fromkeys(("gravity_i", "gravity_o", "gravity_s", "vibration"), "g_0"),
    **dict.fromkeys(("temperature", "case_temperature", "chamber_temperature", "chamber_setpoint"), "degC"),
    **dict.fromkeys(("magnetic_i", "magnetic_o", "magnetic_s"), "uT"),
    "table_angle": "deg",
    "table_acceleration": "deg/s^2",
    "supply_voltage": "V",
    "supply_current": "A",
    "humidity": "percent",
    "time_since_power_on": "s",
    "day": "day",
    "compressor": "1",
    "position": "1",
}
SENSOR_NOISE = {
    **dict.fromkeys(("temperature", "case_temperature", "chamber_temperature"), 0.02),
    **dict.fromkeys(("magnetic_i", "magnetic_o", "magnetic_s"), 0.2),
    "supply_voltage": 0.002,
    "supply_current": 0.0005,
    "vibration": 0.004,
    "humidity": 0.3,
    "table_acceleration": 0.002,
    "input_rate": 1e-7,
    "rate_o": 1e-7,
    "rate_s": 1e-7,
    "table_rate": 1e-7,
}
_RATES_DEG_PER_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0)
_DIAGONAL = np.sqrt(0.5)
_AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
_TILTS = np.array(
    [[_DIAGONAL, a * _DIAGONAL, 0] for a in (1, -1)]
    + [[_DIAGONAL, 0, a * _DIAGONAL] for a in (1, -1)]
    + [[0, _DIAGONAL, a * _DIAGONAL] for a in (1, -1)]
)


@dataclass(frozen=True)
class Drive:
    """One run's channels.

    Parameters
    ----------
    kind : str
        One of `TYPES`, or of the few things that leave effects confounded: ``ramp``, one temperature ramp at rest;
        ``two_rates``, ``one_way``, ``three_positions``, ``supply_ramp``, ``power_on``, ``two_headings``.
    time_s : array of shape (instants,)
        From the run's start, evenly spaced.
    day : float
        Of the run's start, counted from the first run.
    true, read : mapping of str to array of shape (instants,)
        What acts on the gyro, and what the sensors say.
    """

    kind: str
    time_s: FloatArray
    day: float
    true: Mapping[str, FloatArray]
    read: Mapping[str, FloatArray]


@dataclass
class _Bench:
    """The station while one run is made up."""

    time_s: FloatArray
    rng: np.random.Generator

    @property
    def step_s(self) -> float:
        return float(self.time_s[1] - self.time_s[0])

    def levels(self, values: FloatArray, dwell_s: float) -> FloatArray:
        """Held one after the other, from the start again at the end."""
        held: FloatArray = np.asarray(values, np.float64)[(self.time_s / dwell_s).astype(int) % len(values)]
        return held

    def follow(self, driven_by: FloatArray, time_constant_s: float) -> FloatArray:
        share = -np.expm1(-self.step_s / time_constant_s)
        start = [(1.0 - share) * driven_by[0]]
        return np.asarray(lfilter([share], [1.0, share - 1.0], driven_by, zi=start)[0])

    def limited(self, asked: FloatArray, most_per_s: float) -> FloatArray:
        reached = np.empty_like(asked)
        now, most = asked[0], most_per_s * self.step_s
        for i, wanted in enumerate(asked):
            now += min(max(wanted - now, -most), most)
            reached[i] = now
        return reached

    def wander(self, sd: float, correlation_s: float) -> FloatArray:
        keep = np.exp(-self.step_s / correlation_s)
        push = self.rng.standard_normal(self.time_s.size) * sd * np.sqrt(1.0 - keep**2)
        push[0] = self.rng.standard_normal() * sd
        return np.asarray(lfilter([1.0], [1.0, -keep], push))


def drive(kind: str, number: int, rng: np.random.Generator, duration_s: float, step_s: float) -> Drive:
    """Run `number` of a campaign, counted from 0, as a test of type `kind`."""
    time_s: FloatArray = (np.arange(round(duration_s / step_s), dtype=np.float64) + 0.5) * step_s
    bench = _Bench(time_s, rng)
    day = 0.9 * number + float(rng.uniform(0.0, 0.2))
    asked = _at_rest(bench, rng)
    asked |= _PLANS[kind](bench, number)
    before_s = float(rng.choice([0.0, 300.0, 1800.0, 9000.0]))
    since_s: FloatArray = time_s + (0.0 if kind == "power_on" else before_s)
    true = _physics(bench, asked, since_s) | {"day": day + time_s / 86400.0}
    read = {
        name: values + SENSOR_NOISE.get(name, 0.0) * rng.standard_normal(time_s.size) for name, values in true.items()
    }
    return Drive(kind, time_s, day, true, read)


def physics_of(
    time_s: FloatArray, asked: Mapping[str, FloatArray], since_s: FloatArray, rng: np.random.Generator
) -> dict[str, FloatArray]:
    """The true channels of a run at rest, but for what is asked for."""
    bench = _Bench(time_s, rng)
    return _physics(bench, {**_at_rest(bench, rng), **asked}, since_s)


def _at_rest(bench: _Bench, rng: np.random.Generator) -> dict[str, FloatArray]:
    zero = np.zeros(bench.time_s.size)
    orientation = np.tile(_AXES[rng.integers(3)] * rng.choice([-1.0, 1.0]), (zero.size, 1))
    return {
        "setpoint": zero + 25.0,
        "table_rate": zero,
        "angle0": zero + 22.5 * float(rng.integers(16)),
        "position": zero,
        "orientation": orientation,
        "supply_voltage": 12.0 + bench.wander(0.01, 3000.0),
        "vibration": np.abs(0.02 + bench.wander(0.005, 2000.0)),
        "humidity": 45.0 + bench.wander(2.0, 5000.0),
        **{f"magnetic_{axis}": bench.wander(2.0, 4000.0) for axis in "ios"},
    }


def _physics(bench: _Bench, asked: Mapping[str, FloatArray], since_s: FloatArray) -> dict[str, FloatArray]:
    setpoint = asked["setpoint"]
    air = bench.follow(setpoint, 200.0) + bench.wander(0.2, 900.0)
    case = bench.follow(air, 900.0)
    heat = 3.0 * -np.expm1(-since_s / 1500.0)
    temperature = bench.follow(case, 1100.0) + heat
    table_rate, orientation = asked["table_rate"], asked["orientation"]
    voltage = asked["supply_voltage"]
    return {
        "chamber_setpoint": setpoint,
        "chamber_temperature": air,
        "case_temperature": case,
        "temperature": temperature,
        "compressor": (setpoint < air - 0.1).astype(float),
        "position": asked["position"],
        "table_rate": table_rate,
        "table_angle": asked["angle0"] + np.cumsum(table_rate) * bench.step_s,
        "table_acceleration": np.gradient(table_rate, bench.step_s),
        **{name: table_rate * orientation[:, k] for k, name in enumerate(("input_rate", "rate_o", "rate_s"))},
        **{name: orientation[:, k] for k, name in enumerate(("gravity_i", "gravity_o", "gravity_s"))},
        **{name: asked[name] for name in ("vibration", "humidity", "magnetic_i", "magnetic_o", "magnetic_s")},
        "supply_voltage": voltage,
        "supply_current": 0.4 - 0.01 * (voltage - 12.0) + 5e-4 * (temperature - 25.0) + bench.wander(0.001, 600.0),
        "time_since_power_on": since_s,
    }


def _temperature(bench: _Bench, number: int) -> dict[str, FloatArray]:
    corners = np.array([25.0, 60.0, 60.0, 10.0, -35.0, -35.0, 40.0, 40.0]) + bench.rng.uniform(-5.0, 5.0, 8)
    per_min = (0.6, 1.2, 2.4)[number // len(TYPES) % 3]
    asked = bench.levels(corners, bench.time_s[-1] / 8.0 + 1.0)
    return {"setpoint": bench.limited(asked, per_min / 60.0), "humidity": 40.0 + bench.wander(6.0, 3000.0)}


def _rate(bench: _Bench, number: int) -> dict[str, FloatArray]:
    levels = np.array([*_RATES_DEG_PER_S, *(-rate for rate in _RATES_DEG_PER_S)])
    ladder = bench.levels(bench.rng.permutation(levels), 240.0)
    # the last tenth of every hour the table swings
    swings = bench.time_s % 3600.0 > 3240.0
    asked = np.where(swings, 12.0 * np.sin(2.0 * np.pi * bench.time_s / 180.0), ladder)
    # on the table's axis, then between two axes
    tilts = np.concatenate([_AXES[:1], _TILTS, _AXES])
    order = np.concatenate([[0], 1 + bench.rng.permutation(len(tilts) - 1)])
    first, last = ((25.0, 25.0), (5.0, 50.0), (50.0, -5.0))[number // len(TYPES) % 3]
    return {
        "table_rate": bench.limited(asked, 4.0),
        "orientation": bench.levels(tilts[order], 60.0 * (bench.time_s[-1] // (60.0 * len(tilts)) + 1.0)),
        "setpoint": np.linspace(first, last, bench.time_s.size),
    }


def _positions(bench: _Bench, number: int) -> dict[str, FloatArray]:
    signed = np.concatenate([_AXES, -_AXES, _TILTS, -_TILTS])
    stay_s = bench.time_s.size * bench.step_s / 48.0
    angles = bench.levels(22.5 * bench.rng.integers(0, 16, 48).astype(float), stay_s)
    angle = bench.limited(angles, 4.0)
    order = bench.rng.permutation(len(signed))
    return {
        "orientation": bench.levels(signed[order], 2.0 * stay_s),
        "position": bench.levels(np.asarray(1.0 + order, np.float64), 2.0 * stay_s),
        "angle0": np.full(angle.size, angle[0]),
        "table_rate": np.gradient(angle, bench.step_s),
    }


def _environment(bench: _Bench, number: int) -> dict[str, FloatArray]:
    rng = bench.rng

    def steps(values: tuple[float, ...], dwell_s: float) -> FloatArray:
        return bench.levels(rng.choice(values, 60), dwell_s)

    vibration = steps((0.02, 0.02, 0.5, 1.0, 1.5, 2.0), 500.0)
    return {
        "supply_voltage": bench.follow(steps((10.5, 11.0, 11.5, 12.0, 12.5, 13.0, 13.5), 700.0), 5.0),
        "vibration": np.abs(vibration * (1.0 + bench.wander(0.03, 20.0))),
        "humidity": bench.follow(steps((30.0, 45.0, 60.0, 75.0), 2400.0), 300.0),
        **{
            f"magnetic_{axis}": steps((-100.0, -50.0, 0.0, 50.0, 100.0), dwell_s)
            for axis, dwell_s in zip("ios", (430.0, 610.0, 790.0), strict=True)
        },
    }


def _turning(bench: _Bench, rates: tuple[float, ...], orientation: FloatArray) -> dict[str, FloatArray]:
    return {
        "table_rate": bench.limited(bench.levels(np.array(rates), 240.0), 4.0),
        "orientation": np.tile(orientation, (bench.time_s.size, 1)),
    }


def _two_headings(bench: _Bench, number: int) -> dict[str, FloatArray]:
    angle = bench.limited(bench.levels(np.array([0.0, 90.0]), 900.0), 4.0)
    return {
        "table_rate": np.gradient(angle, bench.step_s),
        "angle0": np.zeros(angle.size),
        "orientation": np.tile(_AXES[1], (angle.size, 1)),
    }


_PLANS: Mapping[str, Callable[[_Bench, int], dict[str, FloatArray]]] = {
    "static": lambda bench, number: {},
    "ramp": lambda bench, number: {"setpoint": np.linspace(-20.0, 55.0, bench.time_s.size)},
    "two_rates": lambda bench, number: _turning(bench, (0.0, 15.0, 0.0, -15.0), _TILTS[0]),
    "one_way": lambda bench, number: _turning(bench, (0.0, 5.0, 10.0, 20.0), _AXES[0]),
    "three_positions": lambda bench, number: {"orientation": bench.levels(_AXES, 1200.0)},
    "supply_ramp": lambda bench, number: {
        "setpoint": np.linspace(0.0, 40.0, bench.time_s.size),
        "supply_voltage": np.linspace(11.0, 13.0, bench.time_s.size),
    },
    "power_on": lambda bench, number: {},
    "two_headings": _two_headings,
    "temperature": _temperature,
    "rate": _rate,
    "positions": _positions,
    "environment": _environment,
}
