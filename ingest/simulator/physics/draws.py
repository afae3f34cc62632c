"""Random draws of the effects: bounds of their parameters, seeds by name, and events at random times."""

import math
from collections.abc import Iterator
from typing import Annotated, NamedTuple, TypeVar

import msgspec
import numpy as np

from stream.batch import BoolArray, FloatArray
from stream.decoding import decode_json
from stream.errors import BadInput

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Parameters = TypeVar("Parameters", bound=msgspec.Struct)

SECONDS_PER_HOUR = 3600.0
_NEVER = 2**62
_UNIT, _POWER_ON, _DAY = range(3)


def checked(parameters: Parameters, who: str) -> Parameters:
    """Return parameters that are finite and within their bounds."""
    try:
        # JSON has null in place of numbers that are not finite
        return decode_json(msgspec.json.encode(parameters), type(parameters))
    except msgspec.ValidationError as error:
        raise BadInput(f"{who}: {str(error).replace('got `null`', 'got no finite number')}") from error


class Seeds:
    """Generators of one power-on of one unit, one for each named random process.

    >>> seeds = Seeds(1, "FOG-1", power_on=2, day=1)
    >>> bool(seeds.of_power_on("white").random() == Seeds(1, "FOG-1", 2, 9).of_power_on("white").random())
    True
    >>> bool(seeds.of_power_on("white").random() == seeds.of_power_on("flicker").random())
    False
    """

    def __init__(self, seed: int, unit: str, power_on: int, day: int) -> None:
        self._seed, self._unit, self._power_on, self._day = seed, unit, power_on, day

    def of_power_on(self, process: str) -> np.random.Generator:
        """Generator of a process that is drawn again at every power-on."""
        return _generator(self._seed, _POWER_ON, self._power_on, self._unit, process)

    def of_day(self, process: str) -> np.random.Generator:
        """Generator of a process that all power-ons of a day share."""
        return _generator(self._seed, _DAY, self._day, self._unit, process)


def unit_generator(seed: int, unit: str, process: str) -> np.random.Generator:
    """Generator of what is constant over a unit's life."""
    return _generator(seed, _UNIT, 0, unit, process)


def _generator(seed: int, kind: int, number: int, unit: str, process: str) -> np.random.Generator:
    # a name holds no zero byte, so that no two pairs of unit and process share a key
    key = (kind, number, *unit.encode(), 0, *process.encode())
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


class Jump(NamedTuple):
    """A permanent change of the bias, at a time from power-on."""

    at_s: float
    size_deg_per_h: float


class SampleRange(NamedTuple):
    """Samples from `first` up to but not including `stop`; the first after power-on is number 0."""

    first: int
    stop: int


def random_jumps(rate_per_h: float, sd_deg_per_h: float, generator: np.random.Generator) -> Iterator[Jump]:
    """Endless jumps of a Poisson process with normally distributed sizes of mean 0."""
    at_s = 0.0
    while rate_per_h > 0.0:
        at_s += generator.exponential(SECONDS_PER_HOUR / rate_per_h)
        yield Jump(at_s, sd_deg_per_h * generator.standard_normal())


class Staircase:
    """The sum of all jumps so far, block by block; a jump acts from the first sample at or after it."""

    def __init__(self, jumps: Iterator[Jump], interval_s: float) -> None:
        self._jumps, self._interval_s = jumps, interval_s
        self._level = 0.0
        self._take()

    def _take(self) -> None:
        at_s, self._size = next(self._jumps, (math.inf, 0.0))
        self._next = _NEVER if math.isinf(at_s) else math.ceil(at_s / self._interval_s)

    def add(self, first: int, out: FloatArray) -> None:
        """Add the level, deg/h, to samples `first`, `first` + 1, ..."""
        done = 0
        while done < len(out):
            while self._next <= first + done:
                self._level += self._size
                self._take()
            stop = min(len(out), self._next - first)
            out[done:stop] += self._level
            done = stop


def random_ranges(probability: float, mean_samples: float, generator: np.random.Generator) -> Iterator[SampleRange]:
    """Ranges that begin with a probability at every good sample, of geometrically distributed lengths."""
    stop = 0
    while probability > 0.0:
        first = stop + int(generator.geometric(probability)) - 1
        if first >= _NEVER:
            return
        stop = first + int(generator.geometric(1.0 / mean_samples))
        yield SampleRange(first, stop)


class RangeMask:
    """Which samples lie in a range, block by block; the ranges are in order and do not overlap."""

    def __init__(self, ranges: Iterator[SampleRange]) -> None:
        self._ranges = ranges
        self._next = next(ranges, SampleRange(_NEVER, _NEVER))

    def take(self, first: int, n: int) -> BoolArray:
        """Whether samples `first` to `first + n - 1` lie in a range, shape (n,)."""
        mask = np.zeros(n, np.bool_)
        while self._next.first < first + n:
            mask[max(self._next.first - first, 0) : min(self._next.stop - first, n)] = True
            if self._next.stop > first + n:
                break
            self._next = next(self._ranges, SampleRange(_NEVER, _NEVER))
        return mask
