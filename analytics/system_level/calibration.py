"""Scale-factor errors of a gyro from its rotations: the average of CN 102680005, and joint fits with the gyro bias."""

import math
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from analytics.methods.distributions import chi_square_quantile
from analytics.system_level.levelling import earth_rate_enu_rad_per_s
from analytics.system_level.rest_noise import NoiseDensity, noise_density
from analytics.system_level.rotation_record import Rotation
from analytics.uncertainty.budget import Budget
from analytics.uncertainty.component import Component
from analytics.uncertainty.distribution import Distribution
from stream.batch import FloatArray

QUANTITIES = ("S", "A", "B", "b")
# What the model leaves out (products of small errors) makes of A and S without noise.
MODEL_ERROR = 0.02e-6
SPEEDS_APART = 0.05  # two speeds closer than this share are one
_MISFIT = 0.99
_NAMES: Mapping[str, tuple[str, str]] = {
    "S": ("symmetric scale-factor error", "标度因数对称性误差"),
    "A": ("asymmetric scale-factor error", "标度因数非对称性误差"),
    "B": ("accelerometer bias", "加速度计零偏"),
    "b": ("gyro bias", "陀螺零偏"),
}  # fmt: skip
_UNITS: Mapping[str, str] = {"S": "1", "A": "1", "B": "m/s^2", "b": "rad/s"}


class Way(StrEnum):
    """How the results of the speeds are brought together."""

    SPEED = "speed"  # one speed alone
    AVERAGE = "average"  # the patent's: the mean over the speeds
    JOINT = "joint"  # A and the gyro bias b fitted to all speeds
    JOINT_REST = "joint_rest"  # and to dv'' of all rests


class Result(NamedTuple):
    """The errors of one gyro in one way, each with its budget; or why there are none."""

    way: Way
    speeds_deg_per_s: tuple[float, ...]
    budgets: Mapping[str, Budget]
    rotations: tuple[int, ...] = ()  # places of those that were used
    reason: str | None = None
    misfit: float | None = None  # root of chi-square over its degrees of freedom, of a fit


class GyroNoise(NamedTuple):
    """White noise at rest of a gyro (rad/s per root hertz) and of the accelerometers across it (m/s^2 likewise)."""

    gyro: NoiseDensity
    accelerometer: NoiseDensity


class _Fit(NamedTuple):
    """A linear estimate of S, A, B, b: theta = weights @ observations; `free` of them are estimated."""

    values: FloatArray
    covariance: FloatArray
    weights: FloatArray


def noise_of(rotations: Sequence[Rotation]) -> GyroNoise:
    """Noise of the gyro about which all rotations turn, and of the accelerometers that turn over."""
    dt_s = rotations[0].dt_s
    gyro = noise_density((rest for each in rotations for rest in each.rest_rates), dt_s)
    return GyroNoise(gyro, noise_density((rest for each in rotations for rest in each.rest_forces), dt_s))


def speed_groups(rotations: Sequence[Rotation]) -> list[list[int]]:
    """Places of the rotations of each speed, slowest first."""
    groups: list[list[int]] = []
    for at in sorted(range(len(rotations)), key=lambda place: rotations[place].speed_deg_per_s):
        speed = rotations[at].speed_deg_per_s
        if groups and speed < rotations[groups[-1][0]].speed_deg_per_s * (1.0 + SPEEDS_APART):
            groups[-1].append(at)
        else:
            groups.append([at])
    return [sorted(group) for group in groups]


def results(rotations: Sequence[Rotation], latitude_deg: float) -> list[Result]:
    """All ways for one gyro, whose rotations these are.

    a = c g (pi (s S + A) + b (T2 - T1)) - 2 o B with c = -1, s the sign of the turn and o that of the accelerometer
    at the start; dv'' = c g b at rest. CN 102680005's table of observation equations is missing from its text: derived,
    and checked by simulation. Its step 13 calls the sought quantity a quadratic coefficient of the accelerometer, which
    is a slip.
    """
    noise = noise_of(rotations)
    groups = speed_groups(rotations)
    speeds = tuple(float(np.mean([rotations[at].speed_deg_per_s for at in group])) for group in groups)
    every = tuple(range(len(rotations)))
    rests = _of_rests(rotations, noise, latitude_deg)
    found = []
    fits: list[tuple[_Fit, list[int], float]] = []
    for group, speed in zip(groups, speeds, strict=True):
        chosen = [rotations[at] for at in group]
        fit = _plain_fit(chosen, noise, latitude_deg)
        if isinstance(fit, str):
            found.append(Result(Way.SPEED, (speed,), {}, tuple(group), f"at {speed:.4g} deg/s {fit}"))
            continue
        fits.append((fit, group, speed))
        budgets = _budgets(fit, _bias_share([(fit, chosen)]), rests, noise, chosen, latitude_deg)
        found.append(Result(Way.SPEED, (speed,), budgets, tuple(group)))
    if fits:
        mean = _Fit(
            np.mean([fit.values for fit, _, _ in fits], axis=0),
            np.sum([fit.covariance for fit, _, _ in fits], axis=0) / len(fits) ** 2, np.empty((4, 0)),
        )  # fmt: skip
        share = _bias_share([(fit, [rotations[at] for at in group]) for fit, group, _ in fits])
        used = tuple(at for _, group, _ in fits for at in group)
        budgets = _budgets(mean, share, rests, noise, [rotations[at] for at in used], latitude_deg)
        found.append(Result(Way.AVERAGE, tuple(speed for _, _, speed in fits), budgets, used))
    else:
        lacking = "; ".join(each.reason for each in found if each.reason)
        found.append(Result(Way.AVERAGE, speeds, {}, every, f"no speed has three rotations to solve: {lacking}"))
    found += [_joint(way, rotations, speeds, noise, latitude_deg) for way in (Way.JOINT, Way.JOINT_REST)]
    return found


def _design(rotation: Rotation) -> FloatArray:
    """Rows of a, and dv'' of both rests; columns S, A, B, b."""
    g = rotation.gravity_m_per_s2
    turned = [-g * math.pi * rotation.sign, -g * math.pi, -2.0 * rotation.across_sign, -g * rotation.from_t1_to_t2_s]
    return np.array([turned, [0.0, 0.0, 0.0, -g], [0.0, 0.0, 0.0, -g]])


def _covariance(rotation: Rotation, noise: GyroNoise, latitude_deg: float) -> FloatArray:
    """Covariance of a and both dv'' from white noise; a heading that was measured adds its own error."""
    kernels, dt_s = rotation.kernels, rotation.dt_s
    floor = 1e-12  # rad/s per root hertz: of equal weights where there is no noise at all
    rate = (noise.gyro.value**2 + floor**2) / dt_s * (kernels.rate @ kernels.rate.T)
    force = noise.accelerometer.value**2 / dt_s * (kernels.force @ kernels.force.T)
    heading = np.zeros(3)
    if rotation.attitude.heading_source != "position":
        g, u = rotation.gravity_m_per_s2, _heading_rate(rotation, latitude_deg)
        heading = -u * g * np.array([rotation.from_t1_to_t2_s, 1.0, 1.0])
    return np.asarray(rate + force + np.outer(heading, heading), np.float64)


def _heading_rate(rotation: Rotation, latitude_deg: float) -> float:
    """Rate about the turning axis that an unknown heading leaves of the Earth's, rad/s."""
    level = float(np.linalg.norm(earth_rate_enu_rad_per_s(latitude_deg)[:2]))
    return level * abs(float(rotation.towards_enu[0])) * rotation.attitude.u_heading_rad


def _solved(design: FloatArray, values: FloatArray, covariance: FloatArray) -> _Fit:
    """Generalised least squares."""
    root = np.linalg.cholesky(covariance)
    weighted = np.linalg.solve(root, design)
    weights = np.linalg.pinv(weighted) @ np.linalg.inv(root)
    return _Fit(weights @ values, weights @ covariance @ weights.T, weights)


def _plain_fit(chosen: Sequence[Rotation], noise: GyroNoise, latitude_deg: float) -> _Fit | str:
    """S, A, B of one speed as in the patent, without a gyro bias; or what is missing."""
    design = np.stack([_design(each)[0, :3] for each in chosen])
    if np.linalg.matrix_rank(design, tol=1e-3) < 3:
        kinds = {(each.sign, each.across_sign) for each in chosen}
        asked = "the three, +, + and -, of CN 102680005 steps 2 to 10"
        return f"{len(chosen)} rotations of {len(kinds)} kinds are not {asked}"
    variances = [float(_covariance(each, noise, latitude_deg)[0, 0]) for each in chosen]
    fit = _solved(design, np.array([each.change for each in chosen]), np.diag(variances))
    whole = np.zeros((4, 4))
    whole[:3, :3] = fit.covariance
    return _Fit(np.append(fit.values, math.nan), whole, fit.weights)


def _bias_share(fits: Sequence[tuple[_Fit, Sequence[Rotation]]]) -> FloatArray:
    """What a gyro bias of 1 rad/s adds to S, A, B of the mean over fits that do not know it."""
    shares = [fit.weights @ np.array([_design(each)[0, 3] for each in chosen]) for fit, chosen in fits]
    return np.append(np.mean(shares, axis=0), 1.0)


def _of_rests(rotations: Sequence[Rotation], noise: GyroNoise, latitude_deg: float) -> tuple[float, float]:
    """The gyro bias from dv'' of all rests, with its standard uncertainty, rad/s."""
    values, weights = [], []
    for each in rotations:
        covariance = _covariance(each, noise, latitude_deg)[1:, 1:] / each.gravity_m_per_s2**2
        for at in range(2):
            values.append(-each.curvatures[at] / each.gravity_m_per_s2)
            weights.append(1.0 / covariance[at, at])
    total = float(np.sum(weights))
    return float(np.dot(weights, values)) / total, 1.0 / math.sqrt(total)


def _joint(
    way: Way, rotations: Sequence[Rotation], speeds: tuple[float, ...], noise: GyroNoise, latitude_deg: float
) -> Result:
    every = tuple(range(len(rotations)))
    rows = slice(0, 1) if way is Way.JOINT else slice(0, 3)
    if way is Way.JOINT and len(speeds) < 2:
        asked = "A and the gyro bias need two speeds, CN 102680005 asks for three"
        why = f"all rotations turn at {speeds[0]:.4g} deg/s: {asked}"
        return Result(way, speeds, {}, every, why)
    design = np.concatenate([_design(each)[rows] for each in rotations])
    if np.linalg.matrix_rank(design / np.linalg.norm(design, axis=0).clip(1e-300), tol=1e-6) < 4:
        return Result(way, speeds, {}, every, f"{len(rotations)} rotations do not determine S, A, B and the gyro bias")
    values = np.concatenate([np.array([each.change, *each.curvatures])[rows] for each in rotations])
    blocks = [_covariance(each, noise, latitude_deg)[rows, rows] for each in rotations]
    n = blocks[0].shape[0]
    covariance = np.zeros((len(values), len(values)))
    for at, block in enumerate(blocks):
        covariance[at * n : (at + 1) * n, at * n : (at + 1) * n] = block
    fit = _solved(design, values, covariance)
    freedom = len(values) - 4
    left = np.linalg.solve(np.linalg.cholesky(covariance), values - design @ fit.values)
    chi_square = float(left @ left)
    misfit = math.sqrt(chi_square / freedom) if freedom else None
    # scatter beyond the noise at rest is not explained by the model: it widens the bounds
    if freedom and chi_square > float(chi_square_quantile(_MISFIT, np.array([float(freedom)]))[0]):
        fit = fit._replace(covariance=fit.covariance * chi_square / freedom)
    budgets = _budgets(fit, np.zeros(4), (0.0, 0.0), noise, rotations, latitude_deg)
    return Result(way, speeds, budgets, every, None, misfit)


def _budgets(
    fit: _Fit, bias_share: FloatArray, rests: tuple[float, float], noise: GyroNoise, chosen: Iterable[Rotation],
    latitude_deg: float,
) -> dict[str, Budget]:  # fmt: skip
    """A budget of each quantity that the fit knows."""
    bias, u_bias = rests
    heading = max(_heading_rate(each, latitude_deg) for each in chosen)
    found = {}
    for at, name in enumerate(QUANTITIES):
        if math.isnan(fit.values[at]):
            continue
        unit, share = _UNITS[name], float(bias_share[at])
        u = math.sqrt(max(float(fit.covariance[at, at]), 0.0))
        parts = [Component.type_a("noise at rest", "静置噪声", u, noise.gyro.freedom, unit)]
        if name in {"A", "S"}:
            parts.append(Component.from_half_width("model", "模型", MODEL_ERROR, Distribution.UNIFORM, "1"))
        if name != "b" and share != 0.0:
            size = math.hypot(bias, u_bias)
            per = f"{unit}/(rad/s)"
            known = {"sensitivity": share, "sensitivity_unit": per}
            parts.append(Component.from_certificate("gyro bias", "陀螺零偏", size, 1.0, "rad/s", **known))
            parts.append(Component.from_certificate("heading", "航向", heading, 1.0, "rad/s", **known))
        en, zh = _NAMES[name]
        source = ("CN 102680005 steps 11 to 14",)
        value = float(fit.values[at])
        found[name] = Budget(en=en, zh=zh, value=value, unit=unit, components=tuple(parts), sources=source)
    return found
