"""Strapdown navigation of a unit that turns in place: velocity from rates and specific forces."""

import numpy as np

from stream.batch import FloatArray
from stream.compiled import kernel, kernel_part


@kernel_part()
def _rotation(x: float, y: float, z: float, out: FloatArray) -> None:
    """Rotation matrix of a rotation vector, rad (Rodrigues)."""
    square = x * x + y * y + z * z
    if square < 1e-16:
        first, second = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = np.sqrt(square)
        first, second = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    vector = (x, y, z)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, i] = 1.0 - second * (square - vector[i] * vector[i])
        out[i, j] = second * vector[i] * vector[j] - first * vector[k]
        out[j, i] = second * vector[i] * vector[j] + first * vector[k]


@kernel_part()
def product(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Product of two matrices of 3 rows and columns, in loops: those of arrays take seconds to compile."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@kernel
def _navigate(
    rates: FloatArray, forces: FloatArray, dt_s: float, attitude: FloatArray, earth: FloatArray, gravity: float,
    velocity: FloatArray,
) -> None:  # fmt: skip
    half, turned, middle, spin = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    _rotation(-earth[0] * dt_s, -earth[1] * dt_s, -earth[2] * dt_s, spin)
    for k in range(rates.shape[1]):
        x, y, z = rates[0, k] * dt_s, rates[1, k] * dt_s, rates[2, k] * dt_s
        _rotation(0.5 * x, 0.5 * y, 0.5 * z, half)
        product(attitude, half, middle)
        for i in range(3):
            force = middle[i, 0] * forces[0, k] + middle[i, 1] * forces[1, k] + middle[i, 2] * forces[2, k]
            velocity[i, k + 1] = velocity[i, k] + (force - (gravity if i == 2 else 0.0)) * dt_s
        product(middle, half, turned)
        product(spin, turned, attitude)


def velocity_of(
    rates_rad_per_s: FloatArray, forces: FloatArray, dt_s: float, attitude: FloatArray, earth_rad_per_s: FloatArray,
    gravity: float,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Velocity at the borders of the samples, east, north, up, shape (3, n + 1), and the attitude at the end.

    Each sample is the mean over an interval of `dt_s`: C <- R(-Omega_e dt) C R(omega dt) with exact rotations, the
    force turned by the attitude at the middle of the interval. A turn about a fixed axis has no coning, so the product
    is exact. The unit does not move: there is no transport rate, and the Coriolis acceleration of the small velocity
    error, which is no error of the sensors, is left out. `gravity` and the forces have one unit.

    >>> at_rest = np.zeros((3, 100)), np.repeat([[0.0], [0.0], [1.0]], 100, axis=1)
    >>> velocity, attitude = velocity_of(*at_rest, 0.01, np.eye(3), np.zeros(3), 1.0)
    >>> float(abs(velocity).max()), attitude.tolist() == np.eye(3).tolist()
    (0.0, True)
    """
    velocity = np.zeros((3, rates_rad_per_s.shape[1] + 1))
    end = np.array(attitude, np.float64)
    _navigate(
        np.ascontiguousarray(rates_rad_per_s, np.float64), np.ascontiguousarray(forces, np.float64), dt_s, end,
        np.ascontiguousarray(earth_rad_per_s, np.float64), gravity, velocity,
    )  # fmt: skip
    return velocity, end
