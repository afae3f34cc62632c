"""The driver of an effect for its figure: its channel if it is a function of that alone, else its regressor."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from analytics.loop.effects.base import EffectKind
from analytics.loop.effects.registry import effect
from analytics.loop.effects.turn_on import TURN_ON
from analytics.loop.report.residuals import Residuals
from analytics.loop.report.wording import Wording, shown_unit
from analytics.loop.tracing.result.finding import FoundEffect
from stream.batch import BoolArray, FloatArray

SMOOTH = 1e-3
"""Largest mean squared step between neighbours in the order of a channel, relative to the variance."""
FULL_TURN = 360.0
BINS = 24
FEWEST_IN_BIN = 3


@dataclass(frozen=True)
class Drawn:
    """An effect over its driver; arrays of shape (blocks,).

    Parameters
    ----------
    label: Name and unit of the driver.
    predicted: Contribution of the effect.
    partial: Residual with the effect left in, less the constant of each run.
    held_out: Marks the held-out blocks.
    """

    driver: FloatArray
    label: str
    predicted: FloatArray
    partial: FloatArray
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
    if known.kind is EffectKind.LINE or known.name == TURN_ON:
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
        unit = shown_unit(found.coefficients[0].unit_of_measure.removeprefix(run.unit_of_measure).removeprefix("/"))
        unit = unit.removeprefix("(").removesuffix(")") if unit.count("(") == 1 else unit
        return columns[:, 0], f"{words.effect(found)} ({unit})" if unit else words.effect(found)
    return predicted, f"{words.of('predicted', '预测值')} ({run.unit_of_measure})"


def is_function_of(driver: FloatArray, predicted: FloatArray) -> bool:
    """Whether predictions are a function of a driver.

    Examples
    --------
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
