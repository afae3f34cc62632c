"""Attitude of a unit at rest: level from its accelerometers, heading as given or from the Earth's rate."""

import math

import numpy as np

from stream.batch import FloatArray

EARTH_RATE_RAD_PER_S = math.radians(15.041067 / 3600.0)

EAST, NORTH, UP = np.eye(3)


def earth_rate_enu_rad_per_s(latitude_deg: float) -> FloatArray:
    """Earth's rate in east, north, up: Omega_e (0, cos(lat), sin(lat)), rad/s.

    >>> (np.degrees(earth_rate_enu_rad_per_s(30.0)) * 3600).round(4).tolist()
    [0.0, 13.0259, 7.5205]
    """
    latitude = math.radians(latitude_deg)
    return EARTH_RATE_RAD_PER_S * np.array([0.0, math.cos(latitude), math.sin(latitude)])


def levelled(force: FloatArray, axis: FloatArray, towards_enu: FloatArray) -> FloatArray:
    """Matrix from body to east, north, up of a unit at rest.

    The specific force points up; a body `axis` that is about level points `towards_enu`, a level direction. So what the
    accelerometers' biases tilt is level too, and the velocity of the first rest is about 0.

    >>> matrix = levelled(np.array([0.0, 0.0, 9.8]), np.array([1.0, 0.0, 0.0]), NORTH)
    >>> (matrix @ [1.0, 0.0, 0.0] + 0.0).round(6).tolist()
    [0.0, 1.0, 0.0]
    """
    up = force / np.linalg.norm(force)
    level = axis - (axis @ up) * up
    level /= np.linalg.norm(level)
    return np.asarray(
        np.outer(UP, up) + np.outer(towards_enu, level) + np.outer(np.cross(UP, towards_enu), np.cross(up, level)),
        np.float64,
    )


def gyrocompassed(force: FloatArray, rate: FloatArray) -> FloatArray:
    """Matrix from body to east, north, up by the specific force (up) and the Earth's rate (north) at rest.

    >>> gyrocompassed(np.array([0.0, 0.0, 1.0]), np.array([1e-5, 0.0, 2e-5])).round(6).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    up = force / np.linalg.norm(force)
    north = rate - (rate @ up) * up
    north /= np.linalg.norm(north)
    return np.stack([np.cross(north, up), north, up]) + 0.0
