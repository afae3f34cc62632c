"""Errors over a driver, before and after: over temperature, over rate, and of an effect for its figure."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from analytics.loop.effects.base import EffectKind
from analytics.loop.effects.events import STATION, TURN_ON
from analytics.loop.effects.registry import effect
from analytics.loop.report.wording import Wording
from analytics.loop.residuals import Residuals
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from stream.batch import BoolArray, FloatArray
from stream.errors import UnknownUnit
from stream.quantities import conversion, format_unit

CLASSES = 8
FEWEST_BLOCKS = 5
AT_REST = 0.01  # rate relative to the largest rate below which a unit is at rest
TEMPERATURES = ("temperature", "case_temperature", "chamber_temperature")
RATES = ("input_rate", "table_rate")
PPM = 1e6
SMOOTH = 1e-3  # largest mean squared step between neighbours in the order of a channel, relative to the variance
FULL_TURN = 360.0
BINS = 24
FEWEST_IN_BIN = 3


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
    if (rate := _first(residuals, RATES)) is not None:
        speed = np.abs(residuals.channel(rate))
        at_rest = chosen & (speed <= AT_REST * speed.max())
        chosen = at_rest if np.count_nonzero(at_rest) >= 2 * FEWEST_BLOCKS else chosen
    driver = residuals.channel(channel)
    classes = [
        _in_class(residuals, driver, within, within / np.count_nonzero(within)) for within in _classes(driver, chosen)
    ]
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
    share = np.clip((driver - low) / (high - low), 0.0, 1.0) if high > low else np.zeros_like(driver)
    number = np.minimum((share * CLASSES).astype(np.int64), CLASSES - 1)
    masks = [chosen & (number == each) for each in range(CLASSES)]
    return [mask for mask in masks if np.count_nonzero(mask) >= FEWEST_BLOCKS]


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


@dataclass(frozen=True)
class Drawn:
    """An effect over its driver; arrays of shape (blocks,)."""

    driver: FloatArray
    label: str  # name and unit of the driver
    predicted: FloatArray  # contribution of the effect
    partial: FloatArray  # residual with the effect left in, less the constant of each run
    held_out: BoolArray

    def binned(self) -> tuple[FloatArray, FloatArray]:
        """Means of driver and partial residual in bins of equal width of the driver."""
        low, high = float(self.driver.min()), float(self.driver.max())
        edges = np.linspace(low, high, BINS + 1)
        number = np.clip(np.searchsorted(edges, self.driver, side="right") - 1, 0, BINS - 1)
        filled = [each for each in range(BINS) if np.count_nonzero(number == each) >= FEWEST_IN_BIN]
        means = [(self.driver[number == each].mean(), self.partial[number == each].mean()) for each in filled]
        return np.array([x for x, _ in means]), np.array([y for _, y in means])


def drawn(residuals: Residuals, found: FoundEffect, words: Wording) -> Drawn | None:
    """An effect over its driver, a jump over the time of its run; None if it follows no channel."""
    known = effect(found.name)
    if known.kind is EffectKind.LINE or known.name in {TURN_ON, STATION}:
        return None
    stack = residuals.record.stack
    columns = stack.column(lambda run: known.regressors(run, found.parameters))
    predicted = columns @ np.array([each.value for each in found.coefficients])
    is_event = known.kind is EffectKind.EVENT
    left = residuals.after - predicted if is_event else residuals.after  # the model excludes jumps
    number = stack.run_number
    constants = np.array([left[number == run].mean() for run in range(len(stack.runs))])
    partial = left - constants[number] + predicted
    if not is_event:
        driver, label = _driver(residuals, found, columns, predicted, words)
        return Drawn(driver, label, predicted, partial, residuals.held_out)
    its_run = number == [run.run for run in stack.runs].index(str(found.parameters["run"]))
    time_s = stack.column(lambda run: run.time_s)[its_run]
    label = words.of("time in its run (s)", "该次试验的时间 (s)")
    return Drawn(time_s, label, predicted[its_run], partial[its_run], residuals.held_out[its_run])


def _driver(
    residuals: Residuals, found: FoundEffect, columns: FloatArray, predicted: FloatArray, words: Wording
) -> tuple[FloatArray, str]:
    known = effect(found.name)
    run = residuals.record.stack.runs[0]
    if len(known.needs) == 1:
        (channel,) = known.needs
        values = residuals.channel(channel)
        if run.channels[channel].phasors is not None:
            values = values % FULL_TURN
        if is_function_of(values, predicted):
            return values, f"{channel} ({run.channels[channel].unit_of_measure})"
    if columns.shape[1] == 1:
        unit = format_unit(found.coefficients[0].unit_of_measure.removeprefix(run.unit_of_measure).removeprefix("/"))
        unit = unit.removeprefix("(").removesuffix(")") if unit.count("(") == 1 else unit
        return columns[:, 0], f"{words.effect(found)} ({unit})" if unit else words.effect(found)
    return predicted, f"{words.of('predicted', '预测值')} ({run.unit_of_measure})"


def is_function_of(driver: FloatArray, predicted: FloatArray) -> bool:
    """Whether predictions are a function of a driver.

    >>> x = np.sin(np.arange(500.0))
    >>> is_function_of(x, x**2), is_function_of(x, np.cos(np.arange(500.0)))
    (True, False)
    """
    order = np.argsort(driver, kind="stable")
    levels = np.flatnonzero(np.diff(driver[order], prepend=-np.inf, append=np.inf) > 0)
    if np.ptp(driver) == 0:
        return False
    if levels.size - 1 < predicted.size / 4:  # few levels: the same prediction on each
        within = sum(float(np.var(predicted[order[a:b]])) * (b - a) for a, b in pairwise(levels))
        return bool(within < SMOOTH * float(np.var(predicted)) * predicted.size)
    steps = np.diff(predicted[order])
    return float(np.mean(steps**2)) < SMOOTH * float(np.var(predicted))
