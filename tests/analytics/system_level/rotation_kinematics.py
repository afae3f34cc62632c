"""Rates and specific forces of a unit in the rotations of CN 102680005, from the geometry of a turn about a fixed axis.

Written apart from the code under test: no attitude is integrated here, every component is a function of the angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from analytics.system_level.rotation_record import ImuSeries
from stream.batch import FloatArray

LATITUDE_DEG = 39.9
GRAVITY = 9.80665
DEG_PER_H = np.pi / 180 / 3600
EARTH = 15.041067 * DEG_PER_H * np.array([0.0, np.cos(np.radians(LATITUDE_DEG)), np.sin(np.radians(LATITUDE_DEG))])
DIRECTIONS = {
    "E": (1, 0, 0), "N": (0, 1, 0), "U": (0, 0, 1), "W": (-1, 0, 0), "S": (0, -1, 0), "D": (0, 0, -1)
}  # fmt: skip
STARTS = ("ENU", "ESD", "ENU", "ESD", "WSU", "ESD", "NUE", "SDE", "NUE")
SIGNS = (1, 1, -1, 1, 1, -1, 1, 1, -1)
# planted in the worked case: S, A, accelerometer bias of X, Y, Z
SYMMETRIC = np.array([120.0, -80.0, 50.0]) * 1e-6
ASYMMETRIC = np.array([10.0, -6.0, 4.0]) * 1e-6
ACCELEROMETER = np.array([50.0, -30.0, 20.0]) * 1e-6 * GRAVITY


@dataclass(frozen=True)
class Planted:
    """Errors of a unit; the scale factor is 1 + S +- A by the direction in which the table turns."""

    symmetric: FloatArray = field(default_factory=lambda: SYMMETRIC)
    asymmetric: FloatArray = field(default_factory=lambda: ASYMMETRIC)
    accelerometer_m_per_s2: FloatArray = field(default_factory=lambda: ACCELEROMETER)
    gyro_bias_deg_per_h: float = 0.0
    walk_deg_per_sqrt_h: float = 0.0
    heading_error_deg: float = 0.0  # of the table, clockwise


def axes_of(start: str) -> FloatArray:
    return np.array([DIRECTIONS[each] for each in start], np.float64)


def turned(
    start: str, axis: int, sign: int, speed_deg_per_s: float, planted: Planted, *, rest_s: float = 15.0,
    dt_s: float = 0.01, rng: np.random.Generator | None = None,
) -> ImuSeries:  # fmt: skip
    """Samples at the middles of their intervals; the table turns at once at full speed."""
    heading = np.radians(-planted.heading_error_deg)
    about_up = np.array([[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
    axes = axes_of(start) @ about_up.T
    rest, turn = round(rest_s / dt_s), round(180.0 / speed_deg_per_s / dt_s)
    t_s = (np.arange(2 * rest + turn) + 0.5) * dt_s
    moving = (t_s > rest_s) & (t_s < rest_s + turn * dt_s)
    angle = sign * np.clip((t_s - rest_s) * np.pi / (turn * dt_s), 0.0, np.pi)
    rate = sign * np.where(moving, np.pi / (turn * dt_s), 0.0)

    def along_axes(vector: FloatArray) -> FloatArray:
        about = axes[axis]
        fixed = (axes @ about)[:, None] * float(about @ vector)
        cosine, sine = axes @ vector - fixed[:, 0], np.cross(about, axes) @ vector
        return np.asarray(fixed + cosine[:, None] * np.cos(angle) + sine[:, None] * np.sin(angle), np.float64)

    rates = along_axes(EARTH)
    rates[axis] += rate
    scale = 1.0 + planted.symmetric[:, None] + planted.asymmetric[:, None] * np.sign(rate)
    rates = scale * rates + planted.gyro_bias_deg_per_h * DEG_PER_H
    if rng is not None:
        walk = planted.walk_deg_per_sqrt_h * np.radians(1.0) / 60.0
        rates = rates + walk / np.sqrt(dt_s) * rng.standard_normal(rates.shape)
    forces = along_axes(np.array([0.0, 0.0, GRAVITY])) + planted.accelerometer_m_per_s2[:, None]
    return ImuSeries(dt_s, rates, np.asarray(forces, np.float64))


def calibration(
    planted: Planted, speeds_deg_per_s: Sequence[float] = (10.0, 20.0, 30.0), *, rest_s: float = 15.0,
    rng: np.random.Generator | None = None,
) -> list[tuple[int, ImuSeries]]:  # fmt: skip
    """Number of the rotation, 1 to 9, and its samples, for each speed in turn."""
    return [
        (n + 1, turned(STARTS[n], n // 3, SIGNS[n], speed, planted, rest_s=rest_s, rng=rng))
        for speed in speeds_deg_per_s
        for n in range(9)
    ]
