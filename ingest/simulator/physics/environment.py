"""Environment of a gyro as functions of time: rates, specific force, temperature, supply, magnetic field.

The three axes of a vector are those of the gyro's housing: x is the nominal input axis, y and z lie across it and
make a right-handed frame.
"""

from collections.abc import Mapping, Sequence
from functools import partialmethod
from typing import Any, Literal, Protocol

import numpy as np

from stream.batch import FloatArray, IntArray
from stream.errors import BadInput

NOMINAL_TEMPERATURE_DEG_C = 25.0
NOMINAL_SUPPLY_V = 5.0

Channel = Literal["rates_deg_per_s", "specific_force_g", "magnetic_field_gauss", "temperature_deg_c", "supply_v"]

_DEFAULTS: Mapping[Channel, tuple[float, ...]] = {
    "rates_deg_per_s": (0.0, 0.0, 0.0),
    "specific_force_g": (0.0, 0.0, 0.0),
    "magnetic_field_gauss": (0.0, 0.0, 0.0),
    "temperature_deg_c": (NOMINAL_TEMPERATURE_DEG_C,),
    "supply_v": (NOMINAL_SUPPLY_V,),
}


class Environment(Protocol):
    """Functions of time of everything that acts on one gyro.

    Each takes times (int64 nanoseconds, not decreasing, shape (n,)). The value at a time must not depend on the other
    times of the call; then the samples do not depend on block sizes either. Only what a planted effect needs is called.
    """

    def rates_deg_per_s(self, t_ns: IntArray) -> FloatArray:
        """Rate against inertial space (Earth's included) about x, y, z, deg/s, shape (3, n)."""

    def specific_force_g(self, t_ns: IntArray) -> FloatArray:
        """Specific force along x, y, z, g, shape (3, n): +1 along an axis that points up at rest."""

    def temperature_deg_c(self, t_ns: IntArray) -> FloatArray:
        """Temperature at the housing, degC, shape (n,)."""

    def supply_v(self, t_ns: IntArray) -> FloatArray:
        """Supply voltage, V, shape (n,)."""

    def magnetic_field_gauss(self, t_ns: IntArray) -> FloatArray:
        """Magnetic flux density along x, y, z, gauss (1e-4 T), shape (3, n)."""


class PiecewiseEnvironment:
    """Straight lines between knots; constant before the first and after the last.

    The times of the knots do not decrease. Two equal times make a jump, and the later knot holds at that time. Channels
    have a value per knot, vectors x, y, z; by default 0, 25 degC, 5 V.

    >>> ramp = PiecewiseEnvironment([0, 60], temperature_deg_c=[20, 30])
    >>> ramp.temperature_deg_c(np.array([0, 30, 90]) * 10**9).tolist()
    [20.0, 25.0, 30.0]
    """

    def __init__(self, times_s: Sequence[float], *, origin_ns: int = 0, **channels: Sequence[Any]) -> None:
        self._times_s = np.asarray(times_s, np.float64)
        self._origin_ns = origin_ns
        if self._times_s.ndim != 1 or not len(self._times_s) or not np.isfinite(self._times_s).all():
            raise BadInput("a piecewise environment needs at least one knot, at finite times in seconds")
        if (np.diff(self._times_s) < 0).any():
            raise BadInput("the knots of a piecewise environment are out of order: sort them by time")
        if unknown := channels.keys() - set(_DEFAULTS):
            raise BadInput(f"environment: no channel {min(unknown)}, only {', '.join(_DEFAULTS)}")
        self._knots = {name: self._rows(name, channels.get(name)) for name in _DEFAULTS}

    def _rows(self, name: Channel, values: Sequence[Any] | None) -> FloatArray:
        """Knots of a channel as rows, one per component."""
        default = _DEFAULTS[name]
        n = len(self._times_s)
        if values is None:
            return np.repeat(np.array(default)[:, None], n, axis=1)
        rows = np.asarray(values, np.float64).reshape(len(values), -1).T
        if rows.shape != (len(default), n):
            raise BadInput(
                f"environment: {name} has {len(values)} values of {len(rows)} numbers for {n} knots of {len(default)}"
            )
        if not np.isfinite(rows).all():
            raise BadInput(f"environment: {name} holds a value that is not finite")
        return np.ascontiguousarray(rows)

    def _at(self, name: Channel, t_ns: IntArray) -> FloatArray:
        rows = self._knots[name]
        if (rows == rows[:, :1]).all():
            values = np.repeat(rows[:, :1], len(t_ns), axis=1)
        else:
            t_s = (t_ns - self._origin_ns) * 1e-9
            values = np.stack([np.interp(t_s, self._times_s, row) for row in rows])
        return values if len(rows) > 1 else values.reshape(-1)

    rates_deg_per_s = partialmethod(_at, "rates_deg_per_s")
    specific_force_g = partialmethod(_at, "specific_force_g")
    magnetic_field_gauss = partialmethod(_at, "magnetic_field_gauss")
    temperature_deg_c = partialmethod(_at, "temperature_deg_c")
    supply_v = partialmethod(_at, "supply_v")


class StaticEnvironment(PiecewiseEnvironment):
    """A constant environment; channels by the names of `Environment`."""

    def __init__(self, **channels: float | Sequence[float]) -> None:
        knots: dict[str, Any] = {name: [value] for name, value in channels.items()}
        super().__init__([0.0], **knots)


class Conditions:
    """An environment over one block of samples: each channel is evaluated once, checked, and only if needed."""

    def __init__(self, environment: Environment, t_ns: IntArray, elapsed_s: FloatArray, who: str) -> None:
        self._environment, self._t_ns, self._who = environment, t_ns, who
        self.elapsed_s = elapsed_s
        self._known: dict[Channel, FloatArray] = {}

    def __getitem__(self, name: Channel) -> FloatArray:
        """A channel, shape (n,), or (3, n) for vectors."""
        if name not in self._known:
            self._known[name] = self.at(name, self._t_ns)
        return self._known[name]

    def at(self, name: Channel, t_ns: IntArray) -> FloatArray:
        """A channel at other times."""
        values = np.ascontiguousarray(getattr(self._environment, name)(t_ns), np.float64)
        components = len(_DEFAULTS[name])
        shape = (components, len(t_ns)) if components > 1 else (len(t_ns),)
        if values.shape != shape:
            raise BadInput(f"{self._who}: the environment's {name} has the shape {values.shape}, {shape} is needed")
        if not np.isfinite(values).all():
            bad = int(t_ns[np.flatnonzero(~np.isfinite(values).reshape(-1, len(t_ns)).all(axis=0))[0]])
            raise BadInput(f"{self._who}: the environment's {name} is not finite at {bad} ns")
        return values
