"""The error over temperature and over rate, before and after, beside the error due to noise."""

from dataclasses import dataclass

import numpy as np

from analytics.loop.report.residuals import Residuals
from stream.batch import BoolArray, FloatArray
from stream.errors import UnknownUnit
from stream.quantities import conversion

CLASSES = 8
FEWEST_BLOCKS = 5
AT_REST = 0.01
"""Rate relative to the largest rate below which a unit is at rest."""
TEMPERATURES = ("temperature", "case_temperature", "chamber_temperature")
RATES = ("input_rate", "table_rate")
PPM = 1e6


@dataclass(frozen=True)
class ErrorInClass:
    """Error in one class of a driver between `lo` and `hi`; `floor` is its standard deviation due to noise."""

    lo: float
    hi: float
    blocks: int
    before: float
    after: float
    floor: float


@dataclass(frozen=True)
class ErrorOverDriver:
    """Error in classes of a driver, in their order."""

    channel: str
    channel_unit: str
    unit_of_measure: str
    classes: tuple[ErrorInClass, ...]


def bias_over_temperature(residuals: Residuals) -> ErrorOverDriver | None:
    """Mean residual in classes of temperature, of blocks at rest if there are enough; None without a temperature."""
    channel = _first(residuals, TEMPERATURES)
    if channel is None:
        return None
    chosen = residuals.judged
    rate = _first(residuals, RATES)
    if rate is not None:
        speed = np.abs(residuals.channel(rate))
        at_rest = chosen & (speed <= AT_REST * speed.max())
        chosen = at_rest if np.count_nonzero(at_rest) >= 2 * FEWEST_BLOCKS else chosen
    driver = residuals.channel(channel)
    classes = [_mean_error(residuals, driver, within) for within in _classes(driver, chosen)]
    return _over(residuals, channel, residuals.unit_of_measure, classes)


def scale_factor_over_rate(residuals: Residuals) -> ErrorOverDriver | None:
    """Error of the scale factor in classes of rate, in ppm if the signal is a rate; None without a rate.

    It is the least-squares slope of the residuals on the rate, through zero.
    """
    channel = _first(residuals, RATES)
    if channel is None:
        return None
    driver = residuals.channel(channel)
    turning = residuals.judged & (np.abs(driver) > AT_REST * np.abs(driver).max())
    own_unit = residuals.record.stack.runs[0].channels[channel].unit_of_measure
    try:
        factor, unit = PPM / conversion(own_unit, residuals.unit_of_measure)[0], "ppm"
    except UnknownUnit:
        factor, unit = 1.0, f"{residuals.unit_of_measure}/({own_unit})"
    classes = []
    for within in _classes(driver, turning):
        weights = np.where(within, driver, 0.0) / float(np.sum(driver[within] ** 2)) * factor
        classes.append(_in_class(residuals, driver, within, weights))
    return _over(residuals, channel, unit, classes)


def _first(residuals: Residuals, names: tuple[str, ...]) -> str | None:
    """The first of these channels that all runs have and that varies over the judged blocks."""
    for name in names:
        if name in residuals.channels and np.ptp(residuals.channel(name)[residuals.judged]) > 0:
            return name
    return None


def _classes(driver: FloatArray, chosen: BoolArray) -> list[BoolArray]:
    """Classes of equal width that have enough blocks."""
    if not chosen.any():
        return []
    low, high = float(driver[chosen].min()), float(driver[chosen].max())
    number = np.clip(((driver - low) / max(high - low, 1e-300) * CLASSES).astype(np.int64), 0, CLASSES - 1)
    masks = [chosen & (number == each) for each in range(CLASSES)]
    return [mask for mask in masks if np.count_nonzero(mask) >= FEWEST_BLOCKS]


def _mean_error(residuals: Residuals, driver: FloatArray, within: BoolArray) -> ErrorInClass:
    return _in_class(residuals, driver, within, within / np.count_nonzero(within))


def _in_class(residuals: Residuals, driver: FloatArray, within: BoolArray, weights: FloatArray) -> ErrorInClass:
    return ErrorInClass(
        lo=float(driver[within].min()),
        hi=float(driver[within].max()),
        blocks=int(np.count_nonzero(within)),
        before=float(residuals.before @ weights),
        after=float(residuals.after @ weights),
        floor=residuals.noise_variance(weights) ** 0.5,
    )


def _over(
    residuals: Residuals, channel: str, unit_of_measure: str, classes: list[ErrorInClass]
) -> ErrorOverDriver | None:
    if not classes:
        return None
    channel_unit = residuals.record.stack.runs[0].channels[channel].unit_of_measure
    return ErrorOverDriver(channel, channel_unit, unit_of_measure, tuple(classes))
