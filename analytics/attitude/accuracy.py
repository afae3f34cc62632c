"""Compensated angles A = inv(L)(N - B T) of the steps of a run, and the errors of its attitude at their ends.

Errors are turns about up (heading), east (pitch) and north (roll), JJF 1536-2015 3.3 to 3.5, so that they stay small
at every attitude; attitudes are in the frames of annex B.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from analytics.attitude.calibration import AttitudeCalibration
from analytics.attitude.record import AttitudeStep, Rates, attitude_steps, rates_of
from analytics.methods.attitude.compensation import compensated_angles
from analytics.methods.attitude.frames import AttitudeAngles, attitude_angles
from analytics.methods.attitude.positions import placed
from analytics.system_level.levelling import earth_rate_enu_rad_per_s
from analytics.system_level.strapdown import velocity_of
from storage.sql.catalog import Catalog
from stream.batch import FloatArray
from stream.errors import BadInput

K = 2.0
_STILL_DEG = 1e-3  # ripple of a table at rest, over a step


class AttitudeErrors(msgspec.Struct, frozen=True, kw_only=True):
    """What the attitude at the end of a step is off, deg; pitch and roll are None where no level axis is named.

    The level part of the Earth's rate is then of unknown direction.
    """

    heading_deg: float
    pitch_deg: float | None
    roll_deg: float | None


class StepAccuracy(msgspec.Struct, frozen=True, kw_only=True):
    """A step: what its axes turned (deg, in the order of the axes), and the errors of the attitude at its end.

    `reference_deg` is what the table and the Earth turned the unit; None where the position does not say it.
    `expanded_deg` is U (k = 2) of the errors after compensation: by K, B, L and the scatter of the outputs.
    """

    index: int
    step: str
    position: str | None
    duration_s: float
    raw_deg: list[float | None]
    compensated_deg: list[float]
    compensated_expanded_deg: list[float]
    reference_deg: list[float] | None
    attitude: AttitudeAngles | None
    reference_attitude: AttitudeAngles | None
    raw_error: AttitudeErrors | None
    compensated_error: AttitudeErrors | None
    expanded_deg: AttitudeErrors | None
    reason: str | None = None


class Reference(NamedTuple):
    """How a unit stood and was turned in a step."""

    start: FloatArray  # from the body to east, north, up
    end: FloatArray
    earth_rad_per_s: FloatArray  # east, north, up; without the level part where the heading is not known
    turned_deg: FloatArray  # what the axes turned
    is_heading_known: bool


class CompensatedStep(NamedTuple):
    """Rates of a step before and after compensation, deg/s."""

    step: AttitudeStep
    rates: Rates
    compensated_deg_per_s: FloatArray


def compensated_steps(
    catalog: Catalog, run: str, calibration: AttitudeCalibration
) -> list[tuple[AttitudeStep, CompensatedStep | str]]:
    """Steps of a run with their compensated rates, or why there are none."""
    found: list[tuple[AttitudeStep, CompensatedStep | str]] = []
    for step in attitude_steps(catalog, run, calibration.unit, calibration.axes):
        try:
            rates = rates_of(catalog, run, calibration.unit, step)
        except BadInput as error:
            found.append((step, str(error)))
            continue
        compensated = compensated_angles(rates.deg_per_s.T, calibration.matrix, calibration.bias_deg_per_s, 1.0).T
        found.append((step, CompensatedStep(step, rates, compensated)))
    return found


def accuracy_of(
    steps: Sequence[tuple[AttitudeStep, CompensatedStep | str]], calibration: AttitudeCalibration
) -> list[StepAccuracy]:
    """Angles and errors of attitude of each step."""
    return [_of_step(step, found, calibration) for step, found in steps]


def _of_step(step: AttitudeStep, found: CompensatedStep | str, calibration: AttitudeCalibration) -> StepAccuracy:
    axes = calibration.axes
    lasts_s = step.duration_s if isinstance(found, str) else found.rates.dt_s * found.rates.deg_per_s.shape[1]
    outputs = np.array([step.turned_deg(axis, lasts_s) for axis in axes])
    gains = np.array([step.axes[axis].per_deg_per_s / step.axes[axis].calibrated_deg_per_s for axis in axes])
    raw = (outputs * gains).tolist()
    compensated = compensated_angles(outputs, calibration.matrix, calibration.bias_deg_per_s, lasts_s)
    scatter = np.array([step.axes[axis].u * abs(step.axes[axis].calibrated_deg_per_s) for axis in axes]) * lasts_s
    u = np.hypot(calibration.uncertainty_deg(compensated, lasts_s), np.nan_to_num(scatter))
    reference = reference_of(step, axes, lasts_s)
    whole = StepAccuracy(
        index=step.number, step=step.step, position=step.position, duration_s=lasts_s,
        raw_deg=[None if math.isnan(each) else each for each in raw], compensated_deg=compensated.tolist(),
        compensated_expanded_deg=(K * u).tolist(),
        reference_deg=None if isinstance(reference, str) else reference.turned_deg.tolist(), attitude=None,
        reference_attitude=None, raw_error=None, compensated_error=None, expanded_deg=None,
        reason=reference if isinstance(reference, str) else found if isinstance(found, str) else None,
    )  # fmt: skip
    if isinstance(reference, str) or isinstance(found, str):
        return whole
    end = _turned(found.compensated_deg_per_s, found.rates.dt_s, reference)
    is_rate = bool(np.isfinite(gains).all())
    raw_end = _turned(found.rates.deg_per_s * gains[:, np.newaxis], found.rates.dt_s, reference) if is_rate else None
    of_attitude = K * np.sqrt((reference.end**2) @ u**2)
    return msgspec.structs.replace(
        whole, attitude=attitude_angles(end), reference_attitude=attitude_angles(reference.end),
        raw_error=None if raw_end is None else _errors(raw_end, reference),
        compensated_error=_errors(end, reference), expanded_deg=_about_axes(of_attitude, reference),
    )  # fmt: skip


def reference_of(step: AttitudeStep, axes: tuple[str, str, str], lasts_s: float) -> Reference | str:
    """How the unit stood and was turned; what is not known of it.

    Where only the axis of turning is named, the level part of the Earth's rate is left out, since the heading is not
    known; in the angles it averages out over whole turns.
    """
    if step.latitude_deg is None:
        return "the latitude of the station is not known"
    earth = earth_rate_enu_rad_per_s(step.latitude_deg)
    try:
        where = placed(step.position)
    except BadInput as error:
        return str(error)
    directions = {} if where is None else dict(where.axes)
    turn_deg = step.rate_deg_per_s * lasts_s
    moves = abs(turn_deg) > _STILL_DEG
    is_heading_known = len(directions) == len(axes)
    if is_heading_known:
        start = np.array([directions[axis] for axis in axes], np.float64).T
        if where is not None and where.angle_deg is not None:
            start = _about_up(where.angle_deg) @ start
    elif step.turned in axes:
        start = _with_axis_vertical(axes.index(step.turned), step.side)
        earth = earth * [0.0, 0.0, 1.0]
    else:
        return "the position names no directions of the axes, as X_east_Y_north or X_up"
    if moves and (step.turned not in axes or abs(start[2, axes.index(step.turned)]) != 1.0):
        return "the table turns the unit about an axis that is not named, or not upright"
    turn_deg = turn_deg if moves else 0.0
    turned = start.T @ (np.array([0.0, 0.0, turn_deg]) + _mean_about_up(turn_deg).T @ np.degrees(earth) * lasts_s)
    end = _about_up(turn_deg) @ start
    return Reference(start, end, earth, turned, is_heading_known)


def _about_up(angle_deg: float) -> FloatArray:
    return np.asarray(Rotation.from_euler("Z", angle_deg, degrees=True).as_matrix(), np.float64)


def _mean_about_up(angle_deg: float) -> FloatArray:
    """The mean of the turns about up from zero to an angle, at a steady rate."""
    angle = math.radians(angle_deg)
    along, across = np.sinc(angle / math.pi), np.sinc(angle / math.tau) * math.sin(angle / 2.0)
    return np.array([[along, -across, 0.0], [across, along, 0.0], [0.0, 0.0, 1.0]])


def _with_axis_vertical(at: int, side: int) -> FloatArray:
    """The attitude in which an axis points up (1) or down (-1), the next one east."""
    columns = np.zeros((3, 3))
    columns[2, at] = side
    columns[0, (at + 1) % 3] = 1.0
    columns[1, (at + 2) % 3] = side
    return columns


def _turned(rates_deg_per_s: FloatArray, dt_s: float, reference: Reference) -> FloatArray:
    """The attitude after the rates, the Earth's taken off."""
    rates = np.radians(rates_deg_per_s)
    _, end = velocity_of(rates, np.zeros_like(rates), dt_s, reference.start, reference.earth_rad_per_s, 0.0)
    return end


def _errors(found: FloatArray, reference: Reference) -> AttitudeErrors:
    return _about_axes(Rotation.from_matrix(found @ reference.end.T).as_rotvec(degrees=True), reference)


def _about_axes(turn_deg: FloatArray, reference: Reference) -> AttitudeErrors:
    """Turns about east, north, up as pitch, roll, heading."""
    east, north, up = turn_deg.tolist()
    known = reference.is_heading_known
    return AttitudeErrors(heading_deg=up, pitch_deg=east if known else None, roll_deg=north if known else None)
