"""Misalignment separated from the errors of fixture and table (Li, Ren, Zhao 2012, HIT 2012).

One least squares over all positions, directions and speeds, with standard errors; the paper's closed forms are its
test.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from analytics.methods.confidence_bounds import CONFIDENCE
from storage.sql.catalog import Catalog
from stream.batch import FloatArray
from stream.errors import BadInput

ARCSEC_PER_RAD = 180 * 3600 / math.pi
_GROUP = ("run", "unit", "signal", "procedure")


class GyroReading(NamedTuple):
    """Mean output of a gyro on a rate table over whole turns, input axis perpendicular to the table axis."""

    alpha_deg: float  # turn of the gyro in its fixture about the input axis
    beta_deg: float  # turn of the fixture on the table
    rate_deg_per_s: float  # of the table, with its sign
    output: float  # mean output, in the unit of the scale factor's numerator


class AccelerometerReading(NamedTuple):
    """Mean output of an accelerometer, input axis horizontal, turned by `beta_deg` about it on a plumb surface."""

    beta_deg: float
    output: float


class Angle(NamedTuple):
    """An angle in arcsec, its standard error and its 95 % bounds."""

    value: float
    standard_error: float
    lo: float
    hi: float


class Separation(NamedTuple):
    """The separated angles."""

    # by name: of a gyro ``y0``, ``x0`` (table), ``y1`` (fixture), ``y2``, ``z2`` (the gyro's own); of an accelerometer
    # ``y2``, ``z2``
    angles: dict[str, Angle]
    gamma: Angle  # hypot(y2, z2): the misalignment of the input axis. Its bounds are not below 0
    offset: float  # output at rest, V0; where each position has its own, their mean
    rms: float  # root of the mean square of the residuals, in the output's unit
    freedom: int  # readings less unknowns; 0 leaves no standard errors (NaN)


def gyro_separation(readings: Sequence[GyroReading], scale_factor: float) -> Separation:
    """Separate a gyro's misalignment, HIT 2012 (2)-(9).

    `readings`: at least the fixture positions (alpha, beta) = (0, 0), (0, 180), (180, 180), (90, 180), (0, 90) degrees,
    each turned both ways; any number of speeds and repeats. `scale_factor`: output per deg/s, with its sign.

    V = V0 - k y0 w cos(beta) + k x0 w sin(beta) - k y1 w + k z2 w sin(alpha) - k y2 w cos(alpha), k the scale factor, w
    the rate. Each position has a V0 of its own, as only the differences of both directions enter the closed forms: what
    differs between positions at rest is no error of these angles. Erratum: the table's signs hold; the prose after it
    drops some.

    >>> places = [(0, 0), (0, 180), (180, 180), (90, 180), (0, 90)]
    >>> y2_rad = 100 / ARCSEC_PER_RAD
    >>> readings = [GyroReading(a, b, w, -w * y2_rad * math.cos(math.radians(a))) for a, b in places for w in (-20, 20)]
    >>> round(gyro_separation(readings, 1.0).angles["y2"].value, 6)
    100.0
    """
    alpha, beta, rate, output = np.array(readings, dtype=np.float64).T
    alpha, beta = np.radians(alpha), np.radians(beta)
    driven = scale_factor * rate
    _, place = np.unique(np.stack([alpha, beta], axis=1), axis=0, return_inverse=True)
    offsets = (place[:, np.newaxis] == np.arange(place.max() + 1)).astype(np.float64)
    design = np.stack(
        [-driven * np.cos(beta), driven * np.sin(beta), -driven, -driven * np.cos(alpha), driven * np.sin(alpha)],
        axis=1,
    )
    return _separated(offsets, design, output, ["y0", "x0", "y1", "y2", "z2"], "gyro separation")


def accelerometer_separation(readings: Sequence[AccelerometerReading], scale_factor: float) -> Separation:
    """Separate an accelerometer's misalignment by a tumble, HIT 2012 (10)-(13).

    `readings`: at 0, 90, 180 and 270 degrees, any number of repeats. `scale_factor`: output per g.

    V = V0 + k (y0 + z2 sin(beta) - y2 cos(beta)); V0 and the plumb line's error y0 stay together in `offset`. Closed
    forms: y2 = (V(180) - V(0))/2k, z2 = (V(90) - V(270))/2k. Erratum: the paper's mean gamma of 21.5 arcsec should
    read 21.1.

    >>> outputs = {0: -0.001845, 180: -0.001911, 90: -0.001912, 270: -0.002175}
    >>> found = accelerometer_separation([AccelerometerReading(*each) for each in outputs.items()], 1.299)
    >>> round(found.angles["y2"].value, 1), round(found.angles["z2"].value, 1), round(found.gamma.value, 1)
    (-5.2, 20.9, 21.5)
    """
    beta, output = np.array(readings, dtype=np.float64).T
    beta = np.radians(beta)
    design = np.stack([-scale_factor * np.cos(beta), scale_factor * np.sin(beta)], axis=1)
    return _separated(np.ones((len(beta), 1)), design, output, ["y2", "z2"], "accelerometer separation")


def _separated(offsets: FloatArray, columns: FloatArray, output: FloatArray, names: list[str], what: str) -> Separation:
    design, constants = np.concatenate([offsets, columns], axis=1), offsets.shape[1]
    size = np.sqrt((design * design).sum(axis=0))
    rank = int(np.linalg.matrix_rank(design / np.where(size > 0, size, 1.0), tol=1e-6))
    if rank < design.shape[1]:
        raise BadInput(
            f"{what}: {len(output)} readings tell {rank} of {design.shape[1]} unknowns "
            f"({constants} offsets, {', '.join(names)}) apart; measure the positions that the method names, both ways"
        )
    scaled = design / size
    solved, *_ = np.linalg.lstsq(scaled, output, rcond=None)
    residual = output - scaled @ solved
    freedom = len(output) - design.shape[1]
    variance = float(residual @ residual) / freedom if freedom else math.nan
    covariance = np.linalg.inv(scaled.T @ scaled) * variance / np.outer(size, size)
    coefficients = solved / size
    t = float(stats.t.ppf((1 + CONFIDENCE) / 2, freedom)) if freedom else math.nan
    errors = np.sqrt(np.diag(covariance))
    angles = {name: _angle(coefficients[at], errors[at], t) for at, name in enumerate(names, start=constants)}
    y2, z2 = (constants + names.index(each) for each in ("y2", "z2"))
    own = coefficients[[y2, z2]]
    gamma = float(np.hypot(*own))
    slope = own / gamma if gamma > 0 else np.array([1.0, 0.0])
    error = math.sqrt(float(slope @ covariance[np.ix_([y2, z2], [y2, z2])] @ slope))
    misalignment = _angle(gamma, error, t)
    misalignment = misalignment._replace(lo=max(0.0, misalignment.lo) if freedom else math.nan)
    rms = math.sqrt(float((residual**2).mean()))
    return Separation(angles, misalignment, float(coefficients[:constants].mean()), rms, freedom)


def _angle(value_rad: float, error_rad: float, t: float) -> Angle:
    value, error = value_rad * ARCSEC_PER_RAD, error_rad * ARCSEC_PER_RAD
    return Angle(float(value), float(error), float(value - t * error), float(value + t * error))


def separation_rows(
    catalog: Catalog,
    statement: str,
    positions: Mapping[str, Any],
    lack: Callable[[Sequence[Mapping[str, Any]]], str | None],
    separate: Callable[[Sequence[Mapping[str, Any]]], Separation],
) -> Iterator[dict[str, Any]]:
    """Rows of a separation metric: one for each angle, or one with the reason why there is none.

    `statement` gives `run, unit, signal, procedure, index, position, scale_source` of each step, and what `lack` and
    `separate` take; in the order of the first four. `positions`: those that the method names, by their words. `lack`:
    what a group's steps lack besides positions, None if nothing. `separate` solves a group; the message of its
    `BadInput` is the reason.
    """
    steps: list[dict[str, Any]] = catalog.reader(statement).read_all().to_pylist()
    for key, group in groupby(steps, lambda row: tuple(row[name] for name in _GROUP)):
        rows = list(group)
        common = dict(zip(_GROUP, key, strict=True)) | {"n": len(rows), "steps": [row["index"] for row in rows]}
        words = {"scale_factor": rows[0]["scale_source"], "steps_at_each": len(rows) // len(positions)}
        missing = [name for name in positions if name not in {row["position"] for row in rows}]
        reason = f"position {', '.join(missing)} was not measured" if missing else lack(rows)
        if reason is None:
            try:
                yield from (common | row for row in _rows_of(separate(rows), words))
            except BadInput as error:
                reason = str(error)
        if reason is not None:
            yield common | {"parameters": {"angle": "gamma"} | words, "reason": reason}


def _rows_of(found: Separation, words: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for name, angle in (found.angles | {"gamma": found.gamma}).items():
        yield {
            "value": angle.value, "lo": angle.lo, "hi": angle.hi, "standard_uncertainty": angle.standard_error,
            "freedom": float(found.freedom), "parameters": {"angle": name, **words, "rms": float(f"{found.rms:.4g}")},
        }  # fmt: skip
