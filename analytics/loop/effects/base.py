"""Base class of effects: each predicts (columns of a regression) and simulates."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import FloatArray
from stream.errors import BadInput

Shape = Mapping[str, object]
"""Values of an effect's shape parameters: numbers, or lists of numbers such as the knots of a function; JSON."""
Inputs = Mapping[str, FloatArray]
"""True inputs of the gyro: each channel in its standard unit at the instants of a simulation, shape (n,)."""


class Role(StrEnum):
    """What part an effect's channel plays."""

    CAUSE = "cause"
    PROXY = "proxy"
    """Set-point, current, compressor: it follows a cause; it never wins over a significant cause."""
    ALIAS = "alias"
    """An error of an auxiliary sensor that looks like an effect on the gyro."""


class EffectKind(StrEnum):
    """How an effect enters the search."""

    LIBRARY = "library"
    """A named physical effect; tried in the first round."""
    FUNCTION = "function"
    """A general function of one channel; if it is found, the verdict is "unknown function of"."""
    SECOND_TIER = "second_tier"
    """Products and thresholds; tried only when the library leaves structure."""
    LINE = "line"
    """A periodic line of unknown frequency; found by a scan of its own spectrum, not over a grid."""
    EVENT = "event"
    """An event at an unknown time in one run; found by its own matched filter."""


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter in which an effect is not linear, searched over a grid.

    Parameters
    ----------
    name, unit_of_measure: Such as ``time_constant`` in ``s``.
    grid: Values to try; of a parameter in the unit of a channel, ``{temperature}``, fractions of that channel's range.
    en, zh: Its name.
    """

    name: str
    unit_of_measure: str
    grid: tuple[float, ...]
    en: str
    zh: str

    def values(self, runs: Sequence[RunBlocks]) -> tuple[float, ...]:
        """Values to try on these runs; scaled ones have three digits, so that a shape can be written down."""
        if not self.unit_of_measure.startswith("{"):
            return self.grid
        found = range_over(self.unit_of_measure.strip("{}"), runs)
        scale = 0.0 if found is None else found[1] - found[0]
        return tuple(float(f"{part * scale:.3g}") for part in self.grid) if scale > 0 else ()


def range_over(channel: str, runs: Sequence[RunBlocks]) -> tuple[float, float] | None:
    """Range of a channel's block means over runs without the outer 0.2 % at each end; None without readings."""
    means = [run.mean(channel) for run in runs if channel in run.channels]
    finite = np.concatenate([mean[np.isfinite(mean)] for mean in means]) if means else np.empty(0)
    if not finite.size:
        return None
    low, high = np.quantile(finite, (0.002, 0.998))
    return float(low), float(high)


def number(shape: Shape, name: str) -> float:
    """A shape parameter that is one number.

    Examples
    --------
    >>> number({"time_constant": 600}, "time_constant")
    600.0
    >>> number({}, "time_constant")
    Traceback (most recent call last):
    stream.errors.BadInput: time_constant is missing; give it as time_constant=NUMBER
    """
    value = shape.get(name)
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf:
        return float(value)
    what = "is missing" if value is None else f"is {value!r}, not a number"
    raise BadInput(f"{name} {what}; give it as {name}=NUMBER")


def positive(shape: Shape, name: str) -> float:
    """A shape parameter that must be above 0, such as a time constant."""
    value = number(shape, name)
    if not value > 0:
        raise BadInput(f"{name} is {value:g}; it must be above 0")
    return value


def numbers(shape: Shape, name: str) -> FloatArray:
    """A shape parameter that is a list of increasing numbers, such as knots."""
    value = shape.get(name)
    if not isinstance(value, list | tuple) or not all(isinstance(each, int | float) for each in value):
        raise BadInput(f"{name} is {value!r}; a list of numbers is needed")
    found = np.asarray(value, dtype=np.float64)
    if found.size < 2 or not np.isfinite(found).all() or not np.all(np.diff(found) > 0):
        raise BadInput(f"{name} is {value!r}; at least two increasing numbers are needed")
    return found


class Effect(ABC):
    """One effect. The registry and the laws suite find each effect in the files of this package by themselves.

    A class with a `name` is one effect; several effects of one class are instances in its file's ``EFFECTS``.
    Instances have no state. Regressors are in natural units, so that coefficients are readable: deg/h per degC.
    """

    name: str
    en: str
    zh: str
    needs: tuple[str, ...]
    """Standard channels, all of which must be present and vary."""
    role: Role = Role.CAUSE
    kind: EffectKind = EffectKind.LIBRARY
    parameters: tuple[ShapeParameter, ...] = ()
    coefficients: tuple[str, ...] = ("",)
    """Names of the columns where there are several, such as ``cos`` and ``sin``."""
    per: str = "1"
    """Divisor of the coefficient's unit; {temperature} stands for the unit of measure of that channel."""
    cause: str
    """The physics in two sentences."""
    cause_zh: str
    reference: str
    aliases: tuple[str, ...] = ()
    """Names of effects that ordinary tests do not distinguish from this one."""
    follows: tuple[str, ...] = ()
    """Of a proxy: effects of the causes that it follows. Found alone, it stands for one of them."""
    separating_test: str
    """The measurement that would distinguish this effect from its aliases."""
    separating_test_zh: str

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        """Shapes to try on these runs: by default every combination of the grids."""
        names = [parameter.name for parameter in self.parameters]
        return [dict(zip(names, values, strict=True)) for values in product(*(p.values(runs) for p in self.parameters))]

    def columns(self, shape: Shape) -> tuple[str, ...]:
        """Names of the columns at this shape."""
        return self.coefficients

    def unavailable(self, runs: Sequence[RunBlocks]) -> Bilingual | None:
        """Why these runs do not allow a search for this effect; None where they do."""
        for channel in self.needs:
            missing = sum(channel not in run.channels for run in runs)
            if missing:
                return Bilingual(
                    f"channel {channel} is missing in {missing} of {len(runs)} runs",
                    f"{len(runs)}次试验中有{missing}次缺少通道{channel}",
                )
            means = np.concatenate([run.mean(channel) for run in runs] or [np.empty(0)])
            finite = means[np.isfinite(means)]
            if not finite.size:
                return Bilingual(
                    f"channel {channel} has no readings in these runs", f"通道{channel}在这些试验中没有读数"
                )
            if np.ptp(finite) == 0 and not any(np.any(run.channels[channel].spread > 0) for run in runs):
                value = f"{finite[0]:g} {runs[0].channels[channel].unit_of_measure}"
                return Bilingual(
                    f"channel {channel} stays at {value} in these runs", f"通道{channel}在这些试验中保持为{value}"
                )
        return None

    def recorded(self, time_s: FloatArray, channels: Inputs) -> Inputs:
        """Channels as the record has them: a fault of an auxiliary sensor alters its channel."""
        return channels

    @abstractmethod
    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        """Columns of the effect, shape (blocks, columns); NaN only where a needed channel is NaN."""

    @abstractmethod
    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        """Contribution of the effect to the signal at each instant, by its physics and not by `regressors`.

        Parameters
        ----------
        time_s: shape (n,); instants, evenly spaced, seconds from the run's start.
        channels: The true inputs of the gyro at these instants.
        coefficients: One for each column.
        shape: Values of the shape parameters, within their grids or between.

        Returns
        -------
        array of shape (n,)
            In the signal's unit.
        """
