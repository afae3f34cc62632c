"""What a gyro is exposed to, as functions of time: rates, specific force, temperature, supply, magnetic field.

The three axes of a vector are those of the gyro's housing: x is the nominal input axis, y and z lie across it and
make a right-handed frame.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Protocol

import numpy as np

from stream.batch import FloatArray, IntArray
from stream.errors import BadInput

NOMINAL_TEMPERATURE_DEG_C = 25.0
NOMINAL_SUPPLY_V = 5.0

_VECTORS = ("rates_deg_per_s", "specific_force_g", "magnetic_field_gauss")
_DEFAULTS: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "rates_deg_per_s": (0.0, 0.0, 0.0),
        "specific_force_g": (0.0, 0.0, 0.0),
        "magnetic_field_gauss": (0.0, 0.0, 0.0),
        "temperature_deg_c": (NOMINAL_TEMPERATURE_DEG_C,),
        "supply_v": (NOMINAL_SUPPLY_V,),
    }
)


class Environment(Protocol):
    """Functions of time of everything that acts on one gyro.

    Each takes times (int64 nanoseconds, not decreasing, shape (n,)) and is asked for no time later than the
    samples that are wanted. It answers the same for a time whatever other times it is asked for with it; then the
    samples do not depend on the block sizes either. Only what a planted effect needs is asked for.
    """

    def rates_deg_per_s(self, t_ns: IntArray) -> FloatArray:
        """Rate against inertial space (Earth's included) about x, y, z, deg/s, shape (3, n)."""
        ...

    def specific_force_g(self, t_ns: IntArray) -> FloatArray:
        """Specific force along x, y, z, g, shape (3, n): +1 along an axis that points up at rest."""
        ...

    def temperature_deg_c(self, t_ns: IntArray) -> FloatArray:
        """Temperature at the housing, degC, shape (n,)."""
        ...

    def supply_v(self, t_ns: IntArray) -> FloatArray:
        """Supply voltage, V, shape (n,)."""
        ...

    def magnetic_field_gauss(self, t_ns: IntArray) -> FloatArray:
        """Magnetic flux density along x, y, z, gauss (1e-4 T), shape (3, n)."""
        ...


class PiecewiseEnvironment:
    """Straight lines between knots; constant before the first and after the last.

    Parameters
    ----------
    times_s: Times of the knots from `origin_ns`, seconds, not decreasing. Two equal times make a jump, and the later
        knot holds at that time.
    rates_deg_per_s, specific_force_g, magnetic_field_gauss: Three numbers a knot: x, y, z. Nought by default.
    temperature_deg_c, supply_v: A number a knot. 25 degC and 5 V by default.
    origin_ns: Time of second 0, nanoseconds.

    Raises
    ------
    BadInput: If a channel has another number of values, or a value or a time is not finite or out of order.

    Examples
    --------
    >>> ramp = PiecewiseEnvironment([0, 60], temperature_deg_c=[20, 30])
    >>> ramp.temperature_deg_c(np.array([0, 30, 90]) * 10**9).tolist()
    [20.0, 25.0, 30.0]
    """

    def __init__(
        self,
        times_s: Sequence[float],
        *,
        rates_deg_per_s: Sequence[Sequence[float]] | None = None,
        specific_force_g: Sequence[Sequence[float]] | None = None,
        temperature_deg_c: Sequence[float] | None = None,
        supply_v: Sequence[float] | None = None,
        magnetic_field_gauss: Sequence[Sequence[float]] | None = None,
        origin_ns: int = 0,
    ) -> None:
        self._times_s = np.asarray(times_s, np.float64)
        self._origin_ns = origin_ns
        if self._times_s.ndim != 1 or not len(self._times_s) or not np.isfinite(self._times_s).all():
            raise BadInput("a piecewise environment needs at least one knot, at finite times in seconds")
        if (np.diff(self._times_s) < 0).any():
            raise BadInput("the knots of a piecewise environment are out of order: sort them by time")
        given = {
            "rates_deg_per_s": rates_deg_per_s,
            "specific_force_g": specific_force_g,
            "temperature_deg_c": temperature_deg_c,
            "supply_v": supply_v,
            "magnetic_field_gauss": magnetic_field_gauss,
        }
        self._knots = {name: self._checked(name, values) for name, values in given.items()}

    def _checked(self, name: str, values: Sequence[float] | Sequence[Sequence[float]] | None) -> FloatArray:
        """Knots of a channel as rows, one a component."""
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

    def _at(self, name: str, t_ns: IntArray) -> FloatArray:
        rows = self._knots[name]
        if (rows == rows[:, :1]).all():
            return np.repeat(rows[:, :1], len(t_ns), axis=1)
        t_s = (t_ns - self._origin_ns) * 1e-9
        return np.stack([np.interp(t_s, self._times_s, row) for row in rows])

    def rates_deg_per_s(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._at("rates_deg_per_s", t_ns)

    def specific_force_g(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._at("specific_force_g", t_ns)

    def temperature_deg_c(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._at("temperature_deg_c", t_ns).reshape(-1)

    def supply_v(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._at("supply_v", t_ns).reshape(-1)

    def magnetic_field_gauss(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._at("magnetic_field_gauss", t_ns)


class StaticEnvironment(PiecewiseEnvironment):
    """Everything constant.

    Parameters
    ----------
    rates_deg_per_s, specific_force_g, magnetic_field_gauss: About or along x, y, z.
    temperature_deg_c, supply_v: Temperature and supply voltage.

    Raises
    ------
    BadInput: If a vector has not three numbers or a number is not finite.

    Examples
    --------
    >>> StaticEnvironment(rates_deg_per_s=(10, 0, 0)).rates_deg_per_s(np.array([5])).tolist()
    [[10.0], [0.0], [0.0]]
    """

    def __init__(
        self,
        *,
        rates_deg_per_s: Sequence[float] = (0.0, 0.0, 0.0),
        specific_force_g: Sequence[float] = (0.0, 0.0, 0.0),
        temperature_deg_c: float = NOMINAL_TEMPERATURE_DEG_C,
        supply_v: float = NOMINAL_SUPPLY_V,
        magnetic_field_gauss: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        super().__init__(
            [0.0],
            rates_deg_per_s=[rates_deg_per_s],
            specific_force_g=[specific_force_g],
            temperature_deg_c=[temperature_deg_c],
            supply_v=[supply_v],
            magnetic_field_gauss=[magnetic_field_gauss],
        )


class Conditions:
    """An environment over one block of samples: each channel is asked for once, checked, and only if needed.

    Parameters
    ----------
    environment: The environment.
    t_ns: shape (n,); times at which it acts.
    elapsed_s: shape (n,); times of the samples from power-on, seconds.
    who: Whose conditions, for messages.
    """

    def __init__(self, environment: Environment, t_ns: IntArray, elapsed_s: FloatArray, who: str) -> None:
        self._environment, self._t_ns, self._who = environment, t_ns, who
        self.elapsed_s = elapsed_s

    @cached_property
    def rates_deg_per_s(self) -> FloatArray:
        """Rates about x, y, z, shape (3, n)."""
        return self.rates_at(self._t_ns)

    def rates_at(self, t_ns: IntArray) -> FloatArray:
        """Rates about x, y, z at other times, shape (3, len(t_ns))."""
        return self._checked("rates_deg_per_s", t_ns, self._environment.rates_deg_per_s(t_ns))

    @cached_property
    def specific_force_g(self) -> FloatArray:
        """Specific force along x, y, z, shape (3, n)."""
        return self._checked("specific_force_g", self._t_ns, self._environment.specific_force_g(self._t_ns))

    @cached_property
    def temperature_deg_c(self) -> FloatArray:
        """Temperature at the housing, shape (n,)."""
        return self._checked("temperature_deg_c", self._t_ns, self._environment.temperature_deg_c(self._t_ns))

    @cached_property
    def supply_v(self) -> FloatArray:
        """Supply voltage, shape (n,)."""
        return self._checked("supply_v", self._t_ns, self._environment.supply_v(self._t_ns))

    @cached_property
    def magnetic_field_gauss(self) -> FloatArray:
        """Magnetic flux density along x, y, z, shape (3, n)."""
        return self._checked("magnetic_field_gauss", self._t_ns, self._environment.magnetic_field_gauss(self._t_ns))

    def _checked(self, name: str, t_ns: IntArray, values: FloatArray) -> FloatArray:
        values = np.ascontiguousarray(values, np.float64)
        shape = (3, len(t_ns)) if name in _VECTORS else (len(t_ns),)
        if values.shape != shape:
            raise BadInput(f"{self._who}: the environment's {name} has the shape {values.shape}, {shape} is needed")
        if not np.isfinite(values).all():
            bad = int(t_ns[np.flatnonzero(~np.isfinite(values).reshape(-1, len(t_ns)).all(axis=0))[0]])
            raise BadInput(f"{self._who}: the environment's {name} is not finite at {bad} ns")
        return values
