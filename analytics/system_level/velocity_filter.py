"""Rate of change of the velocity error at the end of a rest: the Kalman filter of CN 102680005, and least squares."""

from typing import NamedTuple

import numpy as np

from analytics.system_level.strapdown import product
from stream.batch import FloatArray
from stream.compiled import kernel, kernel_part

# Variance of the unknown initial state over that of one velocity, in units of the record: no prior knowledge.
_DIFFUSE = 1e9


@kernel_part()
def _turned(matrix: FloatArray, covariance: FloatArray, left: FloatArray, right: FloatArray) -> None:
    """Covariance of the states times a matrix, in place of theirs."""
    for i in range(3):
        for j in range(3):
            right[j, i] = matrix[i, j]
    product(matrix, covariance, left)
    product(left, right, covariance)


@kernel
def _filtered(velocity: FloatArray, dt: float, diffuse: float, state: FloatArray) -> None:
    """Final state with F = [[0,1,0],[0,0,1],[0,0,0]], H = [1,0,0], R = 1; covariances in Joseph's form."""
    step, rest, covariance = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    left, right, gain = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for i in range(3):
        step[i, i], rest[i, i], covariance[i, i] = 1.0, 1.0, diffuse
    step[0, 1], step[0, 2], step[1, 2] = dt, 0.5 * dt * dt, dt
    for k in range(velocity.shape[0]):
        if k:
            state[0] += dt * state[1] + 0.5 * dt * dt * state[2]
            state[1] += dt * state[2]
            _turned(step, covariance, left, right)
        for i in range(3):
            gain[i] = covariance[i, 0] / (covariance[0, 0] + 1.0)
        innovation = velocity[k] - state[0]
        for i in range(3):
            state[i] += gain[i] * innovation
            rest[i, 0] = (1.0 if i == 0 else 0.0) - gain[i]
        _turned(rest, covariance, left, right)
        for i in range(3):
            for j in range(3):
                covariance[i, j] += gain[i] * gain[j]


def kalman_derivatives(velocity: FloatArray, dt_s: float) -> FloatArray:
    """Velocity error and its first two derivatives at the end of a rest: [dv, dv', dv''].

    CN 102680005 step 12 with no process noise, since at rest dv'' is the constant gyro bias times g. Time counts in
    units of the record's length, so that the covariances of the three states are alike.

    >>> t_s = np.arange(1001) * 0.01
    >>> kalman_derivatives(2.0 + 3.0 * (t_s - 10.0) + 0.5 * (t_s - 10.0) ** 2, 0.01).round(6).tolist()
    [2.0, 3.0, 1.0]
    """
    length_s = dt_s * (len(velocity) - 1)
    scale = float(np.abs(velocity - velocity[0]).max()) or 1.0
    state = np.zeros(3)
    _filtered(np.ascontiguousarray((velocity - velocity[0]) / scale), dt_s / length_s, _DIFFUSE, state)
    found = np.asarray(scale * state / length_s ** np.arange(3), np.float64)
    found[0] += velocity[0]
    return found


class QuadraticFit(NamedTuple):
    """Weights with which least squares makes dv' and dv'' at the end of a rest from its velocities."""

    slope: FloatArray
    curvature: FloatArray


def quadratic_fit(n: int, dt_s: float) -> QuadraticFit:
    """Weights of `n` velocities in the fit of dv + dv' t + dv'' t^2/2, t from the end.

    The filter without process noise is this fit. Its weights say how the sensors' noise comes through.

    >>> fit = quadratic_fit(101, 0.1)
    >>> t_s = np.arange(101) * 0.1 - 10.0
    >>> float(fit.slope @ (3.0 * t_s + 0.5 * t_s**2)).__round__(9), float(fit.curvature @ (t_s**2 / 2)).__round__(9)
    (3.0, 1.0)
    """
    length_s = dt_s * (n - 1)
    t = np.linspace(-1.0, 0.0, n)
    design = np.stack([np.ones(n), t, 0.5 * t * t], axis=1)
    weights = np.linalg.pinv(design)
    return QuadraticFit(weights[1] / length_s, weights[2] / length_s**2)
