"""Base class of effects, each predicts (columns of a regression) and simulates; units of their coefficients."""

import functools
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import FloatArray
from stream.errors import BadInput, GyrofleetError

Shape = Mapping[str, object]  # values of an effect's shape parameters: numbers, or lists such as knots; JSON
Inputs = Mapping[str, FloatArray]  # true channels in standard units at the instants of a simulation, shape (n,)


class Role(StrEnum):
    """What part an effect's channel plays."""

    CAUSE = "cause"
    PROXY = "proxy"  # set-point, current, compressor: it follows a cause; it never wins over a significant cause
    ALIAS = "alias"  # an error of an auxiliary sensor that looks like an effect on the gyro


class EffectKind(StrEnum):
    """How an effect enters the search."""

    LIBRARY = "library"  # a named physical effect; tried in the first round
    FUNCTION = "function"  # a general function of one channel; if it is found, the verdict is "unknown function of"
    SECOND_TIER = "second_tier"  # products; tried only when the library leaves structure
    LINE = "line"  # a periodic line of unknown frequency; found by a scan of its own spectrum, not over a grid
    EVENT = "event"  # an event at an unknown time in one run; found by its own matched filter


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter in which an effect is not linear, searched over a grid; such as ``time_constant`` in ``s``."""

    name: str
    unit_of_measure: str
    grid: tuple[float, ...]  # if the unit is that of a channel, {temperature}, fractions of that channel's range
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
    """Range of a channel's block means, and of its seconds in blocks in which it moves, over runs.

    Without the outer 0.2 % of each at both ends; None without readings.
    """
    known = [run.channels[channel] for run in runs if channel in run.channels]
    means = [each.mean[np.isfinite(each.mean)] for each in known]
    seconds = [each.inside.mean[np.isfinite(each.inside.mean)] for each in known if each.inside is not None]
    ends = [np.quantile(np.concatenate(each), (0.002, 0.998)) for each in (means, seconds) if sum(map(len, each))]
    return (float(min(low for low, _ in ends)), float(max(high for _, high in ends))) if ends else None


def number(shape: Shape, name: str) -> float:
    """A shape parameter that is one number.

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
    needs: tuple[str, ...]  # standard channels, all of which must be present and vary
    role: Role = Role.CAUSE
    kind: EffectKind = EffectKind.LIBRARY
    is_late_in_one_run: bool = False  # of a single run, tried only when the others leave structure, as a second tier
    parameters: tuple[ShapeParameter, ...] = ()
    coefficients: tuple[str, ...] = ("",)  # names of the columns where there are several, such as ``cos`` and ``sin``
    per: str = "1"  # divisor of the coefficient's unit; {temperature} stands for the unit of measure of that channel
    cause: str  # the physics in two sentences
    cause_zh: str
    reference: str
    aliases: tuple[str, ...] = ()  # names of effects that ordinary tests do not distinguish from this one
    follows: tuple[str, ...] = ()  # of a proxy: effects of the causes that it follows; found alone, it stands for one
    clock_bound: tuple[str, float, str] | None = None
    """Of a clock error: the declared term that it acts through, its largest plausible size, and the unit of that."""
    separating_test: str  # the measurement that would distinguish this effect from its aliases
    separating_test_zh: str

    def __init_subclass__(cls) -> None:
        """Check the columns that a class computes, so that a mistake in an own effect names the effect."""
        super().__init_subclass__()
        own = cls.__dict__.get("regressors")
        if own is not None:
            cls.regressors = _checked(own)  # type: ignore[assignment]

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

        `time_s` are evenly spaced seconds from the run's start, `channels` the true inputs of the gyro at these
        instants; there is one coefficient for each column, in the signal's unit.
        """


_Regressors = Callable[[Effect, RunBlocks, Shape], FloatArray]


def _checked(regressors: _Regressors) -> _Regressors:
    """`regressors` that raises BadInput with the name of the effect where it fails or gives no such columns."""

    @functools.wraps(regressors)
    def checked(self: Effect, run: RunBlocks, shape: Shape) -> FloatArray:
        try:
            found = regressors(self, run, shape)
            wanted = (len(run), len(self.columns(shape)))
        except (GyrofleetError, MemoryError):
            raise
        except Exception as error:
            what = f"fails with {type(error).__name__}: {error}; mend it"
            raise BadInput(f"{_place_of(self, run)}: its `regressors` {what}") from error
        if not isinstance(found, np.ndarray) or found.shape != wanted or found.dtype.kind not in "fiub":
            what = f"{found.dtype} of shape {found.shape}" if isinstance(found, np.ndarray) else type(found).__name__
            raise BadInput(
                f"{_place_of(self, run)}: its `regressors` gives {what}; an array of numbers of shape {wanted} "
                "(blocks, columns) is needed"
            )
        return found

    return checked


def _place_of(effect: Effect, run: RunBlocks) -> str:
    return f"effect {effect.name!r} ({type(effect).__module__}) on unit {run.unit}, run {run.run}"


def coefficient_unit(effect: Effect, signal_unit: str, run: RunBlocks) -> str:
    """Unit of a coefficient of `effect`, for a signal in `signal_unit` and the channels of `run`.

    >>> import numpy as np
    >>> from analytics.loop.effects.registry import effect
    >>> from analytics.loop.blocks.run_blocks import Channel
    >>> one = np.ones(1)
    >>> run = RunBlocks("U", "r", "rate", np.array([0]), 30.0, 0, one, np.array([1]), one, "deg/h",
    ...                 {"temperature": Channel(one, one, "degC"), "input_rate": Channel(one, one, "deg/s")})
    >>> coefficient_unit(effect("temperature"), "deg/h", run)
    'deg/h/degC'
    >>> coefficient_unit(effect("scale_factor_temperature"), "deg/h", run)
    'deg/h/((deg/s)*degC)'
    """
    divisor = _filled(effect.per, run)
    if divisor == "1":
        return signal_unit
    return f"{signal_unit}/{_bracketed(divisor)}"


def parameter_unit(parameter: ShapeParameter, run: RunBlocks) -> str:
    """Unit of a shape parameter: its own, or that of the channel it names."""
    return _filled(parameter.unit_of_measure, run, is_alone=True)


def _filled(template: str, run: RunBlocks, is_alone: bool = False) -> str:
    def unit(match: re.Match[str]) -> str:
        channel = run.channels.get(match[1])
        text = "1" if channel is None else channel.unit_of_measure
        return text if is_alone or template == match[0] else _bracketed(text)

    return re.sub(r"\{([^}]+)\}", unit, template)


def _bracketed(unit: str) -> str:
    is_compound = re.search(r"[*/ ]", unit) is not None
    return f"({unit})" if is_compound else unit
