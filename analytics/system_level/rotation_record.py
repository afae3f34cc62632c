"""One rotation of the procedure: rest, half a turn about a level axis, rest; checked, and navigated on its own."""

import math
from typing import NamedTuple

import numpy as np

from analytics.system_level.levelling import (
    EARTH_RATE_RAD_PER_S,
    NORTH,
    UP,
    earth_rate_enu_rad_per_s,
    gyrocompassed,
    levelled,
)
from analytics.system_level.strapdown import velocity_of
from analytics.system_level.velocity_filter import kalman_derivatives, quadratic_fit
from stream.batch import FloatArray
from stream.errors import BadInput

AXES = "XYZ"
LEAST_REST_S = 15.0  # CN 102680005 step 2
LEAST_RATE_HZ = 100.0  # step 1
_SHARE = 0.99  # of a rest or a sampling rate, for what the borders of samples cost
_MOVING_RAD_PER_S = math.radians(0.5)
_PAUSE_S = 1.0  # rest of at least this length between two motions
_SETTLING_S = 0.5  # dropped after a motion that is cut off
_HALF_TURN_WITHIN_RAD = math.radians(5.0)
_LEVEL_WITHIN = math.sin(math.radians(5.0))
_FOLLOWS_WITHIN = math.sin(math.radians(2.0))
_GRAVITY_WITHIN = 0.05
_STANDARD_GRAVITY = 9.80665
# the Earth's rate on level axes must be seen with this many standard uncertainties to tell the heading
_SEEN = 10.0


class ImuSeries(NamedTuple):
    """Samples of three gyros and three accelerometers on one grid, each the mean of an interval."""

    dt_s: float
    rates_rad_per_s: FloatArray  # shape (3, n)
    forces_m_per_s2: FloatArray


class Rests(NamedTuple):
    """The samples before and after a turn: 0 to `first`, and `second` to the end."""

    first: int
    second: int


class Attitude(NamedTuple):
    """Body to east, north, up at the start of a record, and how well its heading is known."""

    matrix: FloatArray
    heading_source: str  # ``position``: given by its name; ``earth_rate``: found by the gyros
    u_heading_rad: float


class Kernels(NamedTuple):
    """How white noise of rates and forces comes through to dv'(T2) - dv'(T1) and to dv'' of both rests.

    Rows: the change of dv', dv'' of the first and of the second rest; columns: samples. The effect is the sum of
    kernel times error, of rates in rad/s, of forces in m/s^2.
    """

    rate: FloatArray
    force: FloatArray


class Rotation(NamedTuple):
    """What one rotation tells."""

    axis: int  # of the body, about which it turned
    sign: int  # of the turn
    towards_enu: FloatArray  # where the axis points, level
    path_rad: float  # half a turn, and what the table overshoots and comes back
    speed_deg_per_s: float
    across: int  # accelerometer that turns over, across the axis
    across_sign: int  # whether it points along (+1) or against the observed direction at the start
    change: float  # a_i = dv'(T2) - dv'(T1), m/s^2, in the observed direction: up x axis, so that c = -1
    curvatures: tuple[float, float]  # dv'' of the rests, m/s^3
    change_least_squares: float  # a_i by least squares
    from_t1_to_t2_s: float
    gravity_m_per_s2: float
    attitude: Attitude
    kernels: Kernels
    rest_rates: tuple[FloatArray, FloatArray]  # of the turning axis' gyro in both rests without their edges, rad/s
    rest_forces: tuple[FloatArray, FloatArray]  # of the accelerometer that turns over, m/s^2
    dt_s: float


def around_the_turn(series: ImuSeries, name: str) -> tuple[ImuSeries, Rests]:
    """The record from rest to rest: the samples of the largest turn and the rests beside it.

    A gyro that sees more than 0.5 deg/s moves. Other motion, as of a table that still comes to its angle when the
    record begins, is cut off. Raises BadInput where there is no turn, or a rest is too short.
    """
    moving = np.flatnonzero((np.abs(series.rates_rad_per_s) > _MOVING_RAD_PER_S).any(axis=0))
    if not len(moving):
        raise BadInput(f"{name}: no gyro sees a turn; record from rest to rest")
    breaks = np.flatnonzero(np.diff(moving) > _PAUSE_S / series.dt_s)
    begins, ends = moving[np.append(0, breaks + 1)], moving[np.append(breaks, len(moving) - 1)] + 1
    turned = [np.abs(series.rates_rad_per_s[:, a:b].sum(axis=1)).max() for a, b in zip(begins, ends, strict=True)]
    # the end of a way back to the angle is no second turn
    if (turns := int(np.sum(np.array(turned) * series.dt_s > math.pi - _HALF_TURN_WITHIN_RAD))) > 1:
        raise BadInput(f"{name}: {turns} turns in one record; name each by its position, rotation_1 to rotation_9")
    at = int(np.argmax(turned))
    settling = round(_SETTLING_S / series.dt_s)
    first = int(ends[at - 1]) + settling if at else 0
    last = int(begins[at + 1]) if at + 1 < len(begins) else series.rates_rad_per_s.shape[1]
    for which, samples in (("before", int(begins[at]) - first), ("after", last - int(ends[at]))):
        if (length_s := samples * series.dt_s) < _SHARE * LEAST_REST_S:
            short = (
                f"{name}: {max(length_s, 0.0):.4g} s at rest {which} the turn, CN 102680005 step 2 asks for "
                f"{LEAST_REST_S:g} s"
            )
            # as where samples came late and got later times than the table's
            within = "; the record is cut within the turn: are the samples' times those of the table?"
            raise BadInput(short + within * (samples <= 0))
    cut = ImuSeries(series.dt_s, series.rates_rad_per_s[:, first:last], series.forces_m_per_s2[:, first:last])
    return cut, Rests(int(begins[at]) - first, int(ends[at]) - first)


def kernels_of(n: int, rests: Rests, dt_s: float, gravity: float) -> Kernels:
    """The kernels of a record of `n` samples; see `Kernels`."""
    force = np.zeros((3, n))
    for rest, at, sign in ((range(rests.first + 1), 1, -1.0), (range(rests.second, n + 1), 2, 1.0)):
        fit = quadratic_fit(len(rest), dt_s)
        for row, weights, factor in ((0, fit.slope, sign), (at, fit.curvature, 1.0)):
            of_velocities = np.zeros(n + 1)
            of_velocities[rest.start : rest.stop] = factor * weights
            # sample k moves all velocities after it
            force[row] += dt_s * np.cumsum(of_velocities[::-1])[::-1][1:]
    later = np.cumsum(force[:, ::-1], axis=1)[:, ::-1]
    return Kernels(gravity * dt_s * (later - 0.5 * force), force)


def nominal_attitude(axes_enu: FloatArray, force: FloatArray, axis: int) -> FloatArray | None:
    """The attitude of a named position, levelled; None where gravity contradicts it."""
    up = force / np.linalg.norm(force)
    if np.linalg.norm(np.cross(axes_enu @ UP, up)) > _LEVEL_WITHIN or float(axes_enu @ UP @ up) < 0.0:
        return None
    return levelled(force, np.eye(3)[axis], axes_enu[axis])


def attitude_of(
    series: ImuSeries, rests: Rests, axis: int, latitude_deg: float, nominal: tuple[FloatArray, float] | None, name: str
) -> Attitude:
    """Attitude at the start: of the position (axes in east, north, up, and u of the heading), else by the Earth's rate.

    Raises BadInput where neither tells the heading.
    """
    force = series.forces_m_per_s2[:, : rests.first].mean(axis=1)
    if nominal is not None and (matrix := nominal_attitude(nominal[0], force, axis)) is not None:
        return Attitude(matrix, "position", nominal[1])
    rates = series.rates_rad_per_s[:, : rests.first]
    level = EARTH_RATE_RAD_PER_S * math.cos(math.radians(latitude_deg))
    u = float(np.std(np.diff(rates, axis=1)) / math.sqrt(2.0) / math.sqrt(rests.first)) + 0.02 * EARTH_RATE_RAD_PER_S
    matrix = gyrocompassed(force, rates.mean(axis=1))
    seen = float(NORTH @ matrix @ rates.mean(axis=1))
    if level < _SEEN * u or abs(seen - level) > _SEEN * u:
        why = "names no position" if nominal is None else "contradicts gravity"
        raise BadInput(
            f"{name}: its heading is unknown: the position word {why}, and the gyros see "
            f"{math.degrees(seen) * 3600:.3g} deg/h level where the Earth's rate is {math.degrees(level) * 3600:.3g}; "
            f"name it rotation_1 to rotation_9"
        )
    towards = matrix[:, axis] * [1.0, 1.0, 0.0]
    return Attitude(levelled(force, np.eye(3)[axis], towards / np.linalg.norm(towards)), "earth_rate", u / level)


def evaluated(series: ImuSeries, latitude_deg: float, nominal: tuple[FloatArray, float] | None, name: str) -> Rotation:
    """Evaluate one record.

    `nominal` are the directions of X, Y, Z in east, north, up at its start by the position's name, with the standard
    uncertainty of their heading, rad. Raises BadInput, which says what is wrong with record `name`.
    """
    if 1.0 / series.dt_s < _SHARE * LEAST_RATE_HZ:
        raise BadInput(
            f"{name}: sampled at {1.0 / series.dt_s:.4g} Hz, CN 102680005 step 1 asks for {LEAST_RATE_HZ:g} Hz"
        )
    series, rests = around_the_turn(series, name)
    turned = series.rates_rad_per_s[:, rests.first : rests.second].sum(axis=1) * series.dt_s
    axis = int(np.abs(turned).argmax())
    if abs(abs(turned[axis]) - math.pi) > _HALF_TURN_WITHIN_RAD:
        raise BadInput(
            f"{name}: gyro {AXES[axis]} turns by {math.degrees(turned[axis]):.4g} deg, 180 deg are asked for; is a "
            f"gyro saturated, or the record cut?"
        )
    force = series.forces_m_per_s2[:, : rests.first].mean(axis=1)
    gravity = float(np.linalg.norm(force))
    if abs(gravity / _STANDARD_GRAVITY - 1.0) > _GRAVITY_WITHIN:
        raise BadInput(
            f"{name}: the accelerometers see {gravity:.4g} m/s^2 at rest, not gravity; is one saturated, or its unit "
            f"wrong?"
        )
    if abs(force[axis]) > _LEVEL_WITHIN * gravity:
        raise BadInput(f"{name}: axis {AXES[axis]}, about which it turns, is not level at rest")
    attitude = attitude_of(series, rests, axis, latitude_deg, nominal, name)
    return _navigated(series, rests, axis, int(np.sign(turned[axis])), gravity, attitude, latitude_deg, name)


def _navigated(
    series: ImuSeries, rests: Rests, axis: int, sign: int, gravity: float, attitude: Attitude, latitude_deg: float,
    name: str,
) -> Rotation:  # fmt: skip
    rates, forces, dt_s = series.rates_rad_per_s, series.forces_m_per_s2, series.dt_s
    earth = earth_rate_enu_rad_per_s(latitude_deg)
    velocity, end = velocity_of(rates, forces, dt_s, attitude.matrix, earth, gravity)
    after = forces[:, rests.second :].mean(axis=1)
    gained = float(np.linalg.norm(velocity[:, rests.second] - velocity[:, rests.first]))
    most = _FOLLOWS_WITHIN * gravity * (rests.second - rests.first) * dt_s
    tilted = float(np.linalg.norm(np.cross(end @ after, UP)))
    if tilted > _FOLLOWS_WITHIN * gravity or float(UP @ end @ after) < 0.0 or gained > most:
        raise BadInput(
            f"{name}: the accelerometers do not follow the turn that the gyros see; are axes swapped, or signs "
            f"reversed?"
        )
    towards = attitude.matrix[:, axis] * [1.0, 1.0, 0.0]
    towards /= np.linalg.norm(towards)
    observed = np.cross(UP, towards)
    along = observed @ attitude.matrix
    across = int(np.abs(along).argmax())
    n = rates.shape[1]
    course = observed @ velocity
    parts = course[: rests.first + 1], course[rests.second :]
    first, second = (kalman_derivatives(part, dt_s) for part in parts)
    kernels = kernels_of(n, rests, dt_s, gravity)
    fits = [quadratic_fit(len(part), dt_s).slope @ part for part in parts]
    turn = slice(rests.first, rests.second)
    size = np.abs(rates[axis, turn])
    overshoot = float(size.sum() - abs(rates[axis, turn].sum())) * dt_s
    edge = round(_SETTLING_S / dt_s)  # a table that still moves a little is no noise
    return Rotation(
        axis=axis, sign=sign, towards_enu=towards, path_rad=math.pi + overshoot,
        speed_deg_per_s=float(np.degrees(np.median(size))),
        across=across, across_sign=int(np.sign(along[across])), change=float(second[1] - first[1]),
        curvatures=(float(first[2]), float(second[2])), change_least_squares=float(fits[1] - fits[0]),
        from_t1_to_t2_s=(n - rests.first) * dt_s, gravity_m_per_s2=gravity, attitude=attitude, kernels=kernels,
        rest_rates=(rates[axis, : rests.first - edge], rates[axis, rests.second + edge :]),
        rest_forces=(forces[across, : rests.first - edge], forces[across, rests.second + edge :]), dt_s=dt_s,
    )  # fmt: skip
