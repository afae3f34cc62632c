"""Misalignment separated from the errors of fixture and table (Li, Ren, Zhao 2012, HIT 2012).

One least squares over all positions, directions and speeds, with standard errors; the paper's closed forms are its
test.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from analytics.methods.confidence_bounds import CONFIDENCE
from analytics.methods.distributions import student_quantile
from storage.sql.catalog import Catalog
from stream.batch import FloatArray
from stream.errors import BadInput, UnknownUnit
from stream.quantities import conversion

ARCSEC_PER_RAD = 180 * 3600 / math.pi


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
    standard_uncertainty: float = math.nan  # of the output, with its degrees of freedom
    freedom: float = math.nan


class Angle(NamedTuple):
    """An angle in arcsec, its standard uncertainty and its 95 % bounds."""

    value: float
    standard_uncertainty: float
    lo: float
    hi: float


class Separation(NamedTuple):
    """The separated angles."""

    # by name: of a gyro ``y0``, ``x0`` (table), ``y1`` (fixture), ``y2``, ``z2`` (the gyro's own); of an accelerometer
    # ``y2``, ``z2`` and ``twice_beta``
    angles: dict[str, Angle]
    gamma: Angle  # hypot(y2, z2): the misalignment of the input axis. Its bounds are not below 0
    offset: float  # output at rest, V0; where each position has its own, their mean
    rms: float  # root of the mean square of the residuals, in the output's unit
    # of the standard errors: readings less unknowns, or those of the readings' own uncertainties; 0 leaves none (NaN)
    freedom: float


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

    V = V0 + k (y0 + z2 sin(beta) - y2 cos(beta) + c cos(2 beta)); V0 and the plumb line's error y0 stay together in
    `offset`. Closed forms: y2 = (V(180) - V(0))/2k, z2 = (V(90) - V(270))/2k, and
    c = (V(0) + V(180) - V(90) - V(270))/4k, ``twice_beta``, which the paper's model lacks: 13.1 to 13.5 arcsec in its
    table 2, of a surface that is not flat or an axis that is not round. It leaves y2 and z2 as they are, and would
    otherwise count as their error. Of one tumble the standard errors are those of the readings' own uncertainties; of
    several, of their scatter, if it is larger. Erratum: the paper's mean gamma of 21.5 arcsec should read 21.1.

    >>> outputs = {0: -0.001845, 180: -0.001911, 90: -0.001912, 270: -0.002175}
    >>> found = accelerometer_separation([AccelerometerReading(*each) for each in outputs.items()], 1.299)
    >>> [round(found.angles[name].value, 1) for name in ("y2", "z2", "twice_beta")], round(found.gamma.value, 1)
    ([-5.2, 20.9, 13.1], 21.5)
    """
    beta, output, u, freedom = np.array(readings, dtype=np.float64).T
    beta = np.radians(beta)
    along = [-np.cos(beta), np.sin(beta), np.cos(2 * beta)]
    design = scale_factor * np.stack(along, axis=1)
    names = ["y2", "z2", "twice_beta"]
    return _separated(np.ones((len(beta), 1)), design, output, names, "accelerometer separation", u, freedom)


def _separated(
    offsets: FloatArray, columns: FloatArray, output: FloatArray, names: list[str], what: str,
    u: FloatArray | None = None, freedoms: FloatArray | None = None,
) -> Separation:  # fmt: skip
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
    spare = len(output) - design.shape[1]
    variance = float(residual @ residual) / spare if spare else math.nan
    covariance, freedom = np.linalg.inv(scaled.T @ scaled) * variance / np.outer(size, size), float(spare)
    if u is not None and freedoms is not None and np.isfinite(u).all():
        weights = np.linalg.pinv(scaled) / size[:, np.newaxis]
        own = (weights * u**2) @ weights.T
        if not np.trace(own[constants:, constants:]) < np.trace(covariance[constants:, constants:]):
            fourth = float((u**4 / np.maximum(np.nan_to_num(freedoms, nan=1.0), 1.0)).sum())
            covariance, freedom = own, float((u**2).sum()) ** 2 / fourth if fourth > 0 else 1e9
    coefficients = solved / size
    t = float(student_quantile((1 + CONFIDENCE) / 2, freedom)) if freedom else math.nan
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


def gyro_rows(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric: y0 and x0 of the table, y1 of the fixture, y2, z2 and gamma of the gyro."""
    places = ("alpha0_beta0", "alpha0_beta180", "alpha180_beta180", "alpha90_beta180", "alpha0_beta90")
    return _rows(catalog, sql, places, _of_gyro)


def accelerometer_rows(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric: y2, z2, twice_beta and gamma."""
    return _rows(catalog, sql, ("beta0", "beta90", "beta180", "beta270"), _of_accelerometer)


_Steps = Sequence[Mapping[str, Any]]


def _of_gyro(steps: _Steps, positions: Sequence[str]) -> Separation:
    if steps[0]["deg_per_h"] is None:
        raise BadInput(steps[0]["no_scale"])
    for position in positions:
        if len({step["input_rate"] > 0 for step in steps if step["position"] == position}) < 2:
            one_way = f"position {position} was turned one way only"
            raise BadInput(f"{one_way}, the method turns it forwards and backwards")
    readings = [GyroReading(step["alpha"], step["beta"], step["input_rate"], step["output"]) for step in steps]
    return gyro_separation(readings, 3600.0 / steps[0]["deg_per_h"])


def _of_accelerometer(steps: _Steps, _: Sequence[str]) -> Separation:
    """By the output per local g; where the local g is unknown, per standard g."""
    step = steps[0]
    measure, gravity = step["unit_of_measure"], step["gravity_m_per_s2"]
    try:
        per_g = 1 / conversion(measure, "g_0")[0]
        per_g = per_g if gravity is None else per_g * gravity * conversion("m/s^2", "g_0")[0]
    except UnknownUnit as error:
        if not step["per_g"]:
            how = "give the nominal one of the product, per g, or import the output in g_0"
            raise BadInput(f"no scale factor for an output in {measure}: {how}") from error
        per_g = float(step["per_g"])
    readings = [
        AccelerometerReading(
            each["beta"], each["output"], *(math.nan if each[name] is None else each[name] for name in ("u", "freedom"))
        )
        for each in steps
    ]
    return accelerometer_separation(readings, per_g)


def _rows(
    catalog: Catalog, sql: str, positions: Sequence[str], separate: Callable[[_Steps, Sequence[str]], Separation]
) -> Iterator[dict[str, Any]]:
    """A row for each angle of a test, or one with the reason why there is none; `positions`: those of the method."""
    steps = catalog.reader(sql).read_all().to_pylist()
    for key, group in groupby(steps, itemgetter("run", "unit", "signal", "procedure")):
        rows = list(group)
        common = dict(zip(("run", "unit", "signal"), key, strict=False))
        common |= {"n": len(rows), "steps": [row["index"] for row in rows]}
        words = {"scale_factor": rows[0]["scale_source"], "steps_at_each": len(rows) // len(positions)}
        try:
            if missing := [name for name in positions if name not in {row["position"] for row in rows}]:
                raise BadInput(f"position {', '.join(missing)} was not measured")
            found = separate(rows, positions)
        except BadInput as error:
            yield common | {"parameters": {"angle": "gamma"} | words, "reason": str(error)}
            continue
        words["rms"] = float(f"{found.rms:.4g}")
        for name, angle in (found.angles | {"gamma": found.gamma}).items():
            yield common | angle._asdict() | {"freedom": found.freedom, "parameters": {"angle": name} | words}
