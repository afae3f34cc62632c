"""Positions of a unit by the names that procedures use, and the environment of a unit that is carried between them."""

import re
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ingest.simulator.physics.mounting import POSITIONS, Axes, FunctionOfTime, TableEnvironment
from stream.batch import FloatArray, IntArray
from stream.errors import BadInput

_Direction = tuple[float, float, float]
_UP: _Direction = (0.0, 0.0, 1.0)
_DIRECTIONS: Mapping[str, _Direction] = MappingProxyType({
    "east": (1.0, 0.0, 0.0), "west": (-1.0, 0.0, 0.0), "north": (0.0, 1.0, 0.0), "south": (0.0, -1.0, 0.0),
    "up": _UP, "down": (0.0, 0.0, -1.0),
})  # fmt: skip
_AXES = "XYZ"
_TWO_AXES = re.compile(r"([XYZ])_([a-z]+)_([XYZ])_([a-z]+)")


class Mounting(NamedTuple):
    """Directions of a unit's X, Y, Z in east, north, up while the table stands at 0 deg, and of the table's axis."""

    axes_enu: Axes
    table_axis_enu: _Direction = _UP


def _towards(x: str, y: str, z: str) -> Axes:
    return _DIRECTIONS[x], _DIRECTIONS[y], _DIRECTIONS[z]


# CN 102680005 steps 1 to 10: the table turns the unit about X, Y, then Z, from 0 deg of each
_TURNED_ABOUT = {
    "X": Mounting(_towards("east", "north", "up"), _DIRECTIONS["east"]),
    "Y": Mounting(_towards("east", "south", "down"), _DIRECTIONS["south"]),
    "Z": Mounting(_towards("north", "up", "east"), _DIRECTIONS["east"]),
}
_NAMED: Mapping[str, Mounting] = MappingProxyType({
    **{name: Mounting(axes) for name, axes in POSITIONS.items()},
    "X_up": Mounting(_towards("up", "east", "north")),
    "Y_up": Mounting(_towards("north", "up", "east")),
    "Z_up": Mounting(_towards("east", "north", "up")),
    **{f"rotation_{n}": _TURNED_ABOUT[_AXES[(n - 1) // 3]] for n in range(1, 10)},
})  # fmt: skip
_LEVEL = tuple(
    f"{axis}_{towards}_{_AXES[(_AXES.index(axis) + 1) % 3]}_{across}"
    for axis in _AXES
    for towards in ("east", "west")
    for across in ("north", "south")
)
# What a simulated table can carry a unit to by itself.
POSITION_NAMES = (*_NAMED, *_LEVEL)


def mounting_of(name: str) -> Mounting:
    """The mounting of a position's name; raises BadInput for one that is not known.

    Two axes with their directions give the third: ``X_east_Y_north``. Of the positions of CN 102680005,
    ``rotation_1`` to ``rotation_9``, it is the mounting with the table at 0 deg.

    >>> mounting_of("X_east_Y_south").axes_enu[2], mounting_of("rotation_4").table_axis_enu
    ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0))
    """
    if name in _NAMED:
        return _NAMED[name]
    match = _TWO_AXES.fullmatch(name)
    if match is None or not {match[2], match[4]} <= set(_DIRECTIONS):
        raise BadInput(f"mounting: position {name!r} is not known; one of {', '.join(POSITION_NAMES)}")
    rows = np.zeros((3, 3))
    first, second = _AXES.index(match[1]), _AXES.index(match[3])
    rows[first], rows[second] = _DIRECTIONS[match[2]], _DIRECTIONS[match[4]]
    third = 3 - first - second
    if first == second or float(rows[first] @ rows[second]) != 0.0:
        raise BadInput(f"mounting: position {name!r} is none: its two axes are not perpendicular")
    rows[third] = np.cross(rows[(third + 1) % 3], rows[(third + 2) % 3]) + 0.0
    x, y, z = (tuple(map(float, row)) for row in rows)
    return Mounting(((x[0], x[1], x[2]), (y[0], y[1], y[2]), (z[0], z[1], z[2])))


class CarriedEnvironment:
    """Environment of a unit that a table carries from position to position, and turns there.

    `positions` gives the names that hold at times, and the index of each time's name in them. With `interval_ns` a
    value at a time is that of the interval of this length before it: rates as their exact means, all else at its
    middle. So integrating sensors sample. See `TableEnvironment`.

    >>> turning = CarriedEnvironment(
    ...     0.0, lambda t_ns: (("Z_up",), np.zeros(len(t_ns), np.int64)), rate_deg_per_s=lambda t_ns: (t_ns > 0) * 2.0,
    ...     angle_deg=lambda t_ns: (t_ns > 0) * t_ns * 2e-9, interval_ns=10**9)
    >>> turning.rates_deg_per_s(np.array([0, 5 * 10**8, 10**9]))[2].tolist()
    [0.0, 1.0, 2.0]
    """

    def __init__(
        self, latitude_deg: float, positions: Callable[[IntArray], tuple[tuple[str, ...], IntArray]], *,
        rate_deg_per_s: FunctionOfTime, angle_deg: FunctionOfTime, temperature_deg_c: FunctionOfTime | None = None,
        interval_ns: int = 0,
    ) -> None:  # fmt: skip
        self._latitude_deg, self._positions = latitude_deg, positions
        self._rate, self._angle, self._temperature = rate_deg_per_s, angle_deg, temperature_deg_c
        self._interval_ns = interval_ns
        self._known: dict[str, TableEnvironment] = {}

    def rates_deg_per_s(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._vectors(t_ns, TableEnvironment.rates_deg_per_s)

    def specific_force_g(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._vectors(t_ns, TableEnvironment.specific_force_g)

    def magnetic_field_gauss(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._vectors(t_ns, TableEnvironment.magnetic_field_gauss)

    def temperature_deg_c(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._at("input_up").temperature_deg_c(t_ns)

    def supply_v(self, t_ns: IntArray) -> FloatArray:
        """See `Environment`."""
        return self._at("input_up").supply_v(t_ns)

    def _vectors(self, t_ns: IntArray, of: Callable[[TableEnvironment, IntArray], FloatArray]) -> FloatArray:
        names, which = self._positions(t_ns)
        middle_ns = t_ns - self._interval_ns // 2
        out = np.empty((3, len(t_ns)))
        for k in np.unique(which):
            mine = which == k
            out[:, mine] = of(self._at(names[k]), middle_ns[mine])
        return out

    def _mean_rate(self, middle_ns: IntArray) -> FloatArray:
        if not self._interval_ns:
            return self._rate(middle_ns)
        end_ns = middle_ns + self._interval_ns // 2
        turned = self._angle(end_ns) - self._angle(end_ns - self._interval_ns)
        return np.asarray(turned / (self._interval_ns * 1e-9), np.float64)

    def _at(self, name: str) -> TableEnvironment:
        if name not in self._known:
            mounting = mounting_of(name)
            self._known[name] = TableEnvironment(
                self._latitude_deg,
                mounting.axes_enu,
                mounting.table_axis_enu,
                rate_deg_per_s=self._mean_rate,
                angle_deg=self._angle,
                temperature_deg_c=self._temperature,
            )
        return self._known[name]
