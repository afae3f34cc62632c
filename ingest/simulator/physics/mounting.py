"""Environments of a gyro on Earth: on a rate table, or at rest in a temperature chamber."""

import math
from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np

from ingest.simulator.physics.draws import SECONDS_PER_HOUR, NotNegative, Positive, Seeds, checked
from ingest.simulator.physics.environment import NOMINAL_SUPPLY_V, NOMINAL_TEMPERATURE_DEG_C, StaticEnvironment
from ingest.simulator.physics.noise import ornstein_uhlenbeck
from stream.batch import FloatArray, IntArray
from stream.compiled import compiled
from stream.errors import BadInput

EARTH_RATE_DEG_PER_H = 15.041067

Axes = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
FunctionOfTime = Callable[[IntArray], FloatArray]

_EAST, _NORTH, _UP = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_WEST, _SOUTH, _DOWN = (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)

# Directions of x (input axis), y and z in east, north, up; each right-handed.
POSITIONS: Mapping[str, Axes] = {
    "input_up": (_UP, _EAST, _NORTH),
    "input_down": (_DOWN, _EAST, _SOUTH),
    "input_east": (_EAST, _NORTH, _UP),
    "input_west": (_WEST, _SOUTH, _UP),
    "input_north": (_NORTH, _WEST, _UP),
    "input_south": (_SOUTH, _EAST, _UP),
}


def earth_rate_enu_deg_per_s(latitude_deg: float) -> FloatArray:
    """Earth's rate as a vector in east, north, up, deg/s: Omega_e (0, cos(lat), sin(lat)).

    >>> (earth_rate_enu_deg_per_s(30.0) * 3600).round(4).tolist()
    [0.0, 13.0259, 7.5205]
    """
    rate = EARTH_RATE_DEG_PER_H / SECONDS_PER_HOUR
    latitude = math.radians(latitude_deg)
    return rate * np.array([0.0, math.cos(latitude), math.sin(latitude)])


@compiled
def _turned(angle_deg: FloatArray, constant: FloatArray, cosine: FloatArray, sine: FloatArray, out: FloatArray) -> None:
    """Components of a vector fixed to Earth along three axes that turn: constant + cosine cos(a) + sine sin(a)."""
    for i in range(angle_deg.shape[0]):
        angle = math.radians(angle_deg[i] - 360.0 * math.floor(angle_deg[i] / 360.0))
        c, s = math.cos(angle), math.sin(angle)
        for k in range(3):
            out[k, i] = constant[k] + cosine[k] * c + sine[k] * s


class TableEnvironment:
    """Environment of a gyro on a rate table; vectors are in east, north, up.

    `axes_enu` are the directions of the gyro's x (input axis), y and z while the table stands at 0 deg: a name of
    `POSITIONS`, or the three rows of a rotation matrix. Positive rates are by the right-hand rule about the table's
    axis. Rate, angle and temperature are functions of an int64 array of nanoseconds; without them the table stands at
    0 deg, at 25 degC. Raises BadInput if the axes are no rotation matrix, the table's axis has no direction, or the
    latitude is out of range.

    An axis a turned by the angle theta about k is a cos(theta) + (k x a) sin(theta) + k (k . a)(1 - cos(theta))
    (Rodrigues). The rate about it is a . Omega_e + (a . k) omega_table; the specific force along it is its component
    upwards, in g. Centripetal acceleration is left out: the gyro stands on the table's axis.

    >>> still = TableEnvironment(30.0, "input_up")
    >>> (still.rates_deg_per_s(np.array([0])) * 3600).round(4).tolist()
    [[7.5205], [0.0], [13.0259]]
    >>> still.specific_force_g(np.array([0])).tolist()
    [[1.0], [0.0], [0.0]]
    """

    def __init__(
        self, latitude_deg: float, axes_enu: str | Sequence[Sequence[float]], table_axis_enu: Sequence[float] = _UP, *,
        rate_deg_per_s: FunctionOfTime | None = None, angle_deg: FunctionOfTime | None = None,
        temperature_deg_c: FunctionOfTime | None = None, magnetic_field_enu_gauss: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:  # fmt: skip
        if not -90.0 <= latitude_deg <= 90.0:
            raise BadInput(f"mounting: a latitude of {latitude_deg} deg, -90 to 90 is needed")
        axes, table_axis = _axes(axes_enu), _direction(table_axis_enu)
        self._along = axes @ table_axis
        self._rate, self._angle, self._temperature = rate_deg_per_s, angle_deg, temperature_deg_c
        self._earth_rate = _coefficients(axes, table_axis, earth_rate_enu_deg_per_s(latitude_deg))
        self._gravity = _coefficients(axes, table_axis, np.array(_UP))
        self._field = _coefficients(axes, table_axis, np.asarray(magnetic_field_enu_gauss, np.float64))

    def _components(self, of: tuple[FloatArray, FloatArray, FloatArray], t_ns: IntArray) -> FloatArray:
        if self._angle is None:
            return np.repeat((of[0] + of[1])[:, None], len(t_ns), axis=1)
        out = np.empty((3, len(t_ns)))
        _turned(np.ascontiguousarray(self._angle(t_ns), np.float64), *of, out)
        return out

    def rates_deg_per_s(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        rates = self._components(self._earth_rate, t_ns)
        if self._rate is not None:
            rates += self._along[:, None] * self._rate(t_ns)
        return rates

    def specific_force_g(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._components(self._gravity, t_ns)

    def temperature_deg_c(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        if self._temperature is None:
            return np.full(len(t_ns), NOMINAL_TEMPERATURE_DEG_C)
        return self._temperature(t_ns)

    def supply_v(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return np.full(len(t_ns), NOMINAL_SUPPLY_V)

    def magnetic_field_gauss(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._components(self._field, t_ns)


class ChamberParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Temperature in a chamber, and readings of the thermometer at each gyro in it."""

    mean_deg_c: float = 25.5
    start_offset_deg_c: float = -2.0  # start relative to the mean
    settling_time_constant_s: Positive = 2400.0
    daily_amplitude_deg_c: float = 1.0  # of a sine, 0 and rising at the start
    daily_period_s: Positive = 86400.0
    draught_deg_c: NotNegative = 0.03  # standard deviation of the fluctuation at each gyro
    draught_correlation_s: Positive = 600.0
    thermometer_noise_deg_c: NotNegative = 0.01  # standard deviation of one reading


class ChamberEnvironment(StaticEnvironment):
    """Environment of a gyro at rest in a chamber, with its input axis east-west: it senses no part of Earth's rate.

    Times must not lie before those of earlier calls. Two environments of the same seeds have the same temperatures.
    """

    def __init__(self, chamber: ChamberParameters, seeds: Seeds, start_ns: int = 0) -> None:
        super().__init__()
        self._chamber, self._start_ns = checked(chamber, "simulated chamber"), start_ns
        sd, correlation_s = np.array([chamber.draught_deg_c]), np.array([chamber.draught_correlation_s])
        self._draught = ornstein_uhlenbeck(sd, correlation_s, 1.0, seeds.of_power_on("draught"))
        self._second = 0  # of the first node
        self._nodes = np.empty(0)

    def temperature_deg_c(self, t_ns: IntArray) -> FloatArray:
        """Temperature, degC: linear between whole seconds."""
        if not len(t_ns):
            return np.empty(0)
        t_s = (t_ns - self._start_ns) * 1e-9
        known = self._second + len(self._nodes)
        if (missing := int(t_s[-1]) + 2 - known) > 0:
            self._nodes = np.concatenate([self._nodes, self._next_nodes(known, missing)])
        temperature: FloatArray = np.interp(t_s, self._second + np.arange(len(self._nodes)), self._nodes)
        passed = int(t_s[-1]) - self._second
        self._nodes, self._second = self._nodes[passed:], self._second + passed
        return temperature

    def _next_nodes(self, first: int, n: int) -> FloatArray:
        """Temperature at the seconds `first`, `first` + 1, ..."""
        c = self._chamber
        t_s = first + np.arange(n, dtype=np.float64)
        settling = c.start_offset_deg_c * np.exp(-t_s / c.settling_time_constant_s)
        daily = c.daily_amplitude_deg_c * np.sin(2 * np.pi * t_s / c.daily_period_s)
        return np.asarray(c.mean_deg_c + settling + daily + self._draught.means(n), np.float64)


def _axes(axes_enu: str | Sequence[Sequence[float]]) -> FloatArray:
    if isinstance(axes_enu, str):
        if axes_enu not in POSITIONS:
            raise BadInput(f"mounting: position {axes_enu!r} is not known; one of {', '.join(POSITIONS)}")
        return np.array(POSITIONS[axes_enu])
    axes = np.asarray(axes_enu, np.float64)
    if axes.shape != (3, 3) or not np.allclose(axes @ axes.T, np.eye(3), atol=1e-9) or np.linalg.det(axes) < 0:
        raise BadInput("mounting: the directions of x, y, z must be perpendicular, of length 1 and right-handed")
    return axes


def _direction(vector: Sequence[float]) -> FloatArray:
    direction = np.asarray(vector, np.float64)
    length = float(np.linalg.norm(direction)) if direction.shape == (3,) else 0.0
    if not (math.isfinite(length) and length > 0.0):
        raise BadInput(f"mounting: the table's axis {vector} has no direction; three numbers east, north, up")
    return direction / length


def _coefficients(
    axes: FloatArray, table_axis: FloatArray, vector: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Constant, cosine and sine part of the components of `vector` along the turning axes."""
    constant = (axes @ table_axis) * float(table_axis @ vector)
    return constant, axes @ vector - constant, np.cross(table_axis, axes) @ vector
