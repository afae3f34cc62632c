"""What every effect is: a class that both predicts (columns of a regression) and simulates."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import FloatArray

Shape = Mapping[str, object]
"""Values of an effect's shape parameters: numbers, or lists of numbers such as the knots of a free function; JSON."""


class Role(StrEnum):
    """What part an effect's channel plays."""

    CAUSE = "cause"
    PROXY = "proxy"
    """Set-point, current, compressor: it follows a cause; it never wins over a significant cause."""
    ALIAS = "alias"
    """An error of an auxiliary sensor that looks like an effect on the gyro."""


class Kind(StrEnum):
    """How an effect comes into the search."""

    LIBRARY = "library"
    """A named physical effect; tried in the first round."""
    FUNCTION = "function"
    """A general function of one channel, for what has no name; found, it means "unknown function of"."""
    SECOND_TIER = "second_tier"
    """Products and thresholds; opened only when the library leaves structure."""
    LINE = "line"
    """A periodic line of unknown frequency: scanned for by its own spectrum, not over a grid."""
    EVENT = "event"
    """Something that happens at an unknown time in one run: scanned for by its own matched filter."""


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter that an effect is not linear in, searched over a grid.

    Parameters
    ----------
    name, unit_of_measure: Such as ``time_constant`` in ``s``.
    grid: The values that are tried; of a parameter with `relative_to` in parts of that channel's range.
    en, zh: Its name.
    relative_to: Channel whose range over all runs scales the grid, so that it fits a channel in any unit; empty:
        absolute.
    """

    name: str
    unit_of_measure: str
    grid: tuple[float, ...]
    en: str
    zh: str
    relative_to: str = ""

    def values(self, runs: Sequence[RunBlocks]) -> tuple[float, ...]:
        """What is tried on these runs; three digits of what a range scales, so that a shape can be written down."""
        if not self.relative_to:
            return self.grid
        found = range_over(self.relative_to, runs)
        scale = 0.0 if found is None else found[1] - found[0]
        return tuple(float(f"{part * scale:.3g}") for part in self.grid) if scale > 0 else ()


def range_over(channel: str, runs: Sequence[RunBlocks]) -> tuple[float, float] | None:
    """Least and greatest block mean of a channel over runs, but for 2 in 1000 at each end; None without readings."""
    means = [run.mean(channel) for run in runs if channel in run.channels]
    finite = np.concatenate([mean[np.isfinite(mean)] for mean in means]) if means else np.empty(0)
    if not finite.size:
        return None
    low, high = np.quantile(finite, (0.002, 0.998))
    return float(low), float(high)


class Effect(ABC):
    """One effect. A new one is a new file in this package; the registry and the laws find it.

    An instance has no state. Regressors are in natural units, so that a coefficient says something: deg/h per degC.
    """

    name: str
    en: str
    zh: str
    needs: tuple[str, ...]
    """Standard channels, all of which must be there and vary."""
    role: Role = Role.CAUSE
    kind: Kind = Kind.LIBRARY
    parameters: tuple[ShapeParameter, ...] = ()
    coefficients: tuple[str, ...] = ("",)
    """Names of the columns where there are several, such as ``cos`` and ``sin``."""
    per: str = "1"
    """What a coefficient is per: a unit of measure in which {temperature} stands for that channel's own unit."""
    cause: str
    """The physics in two sentences."""
    cause_zh: str
    reference: str
    aliases: tuple[str, ...] = ()
    """Names of effects that ordinary tests do not tell from this one."""
    follows: tuple[str, ...] = ()
    """Of a proxy: effects of the causes that it follows. Found alone, it stands for one of them."""
    separating_test: str
    """The measurement that would tell them apart."""
    separating_test_zh: str

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        """Shapes to try on these runs: by default every combination of the grids."""
        names = [parameter.name for parameter in self.parameters]
        return [dict(zip(names, values, strict=True)) for values in product(*(p.values(runs) for p in self.parameters))]

    def columns(self, shape: Shape) -> tuple[str, ...]:
        """Names of the columns at this shape."""
        return self.coefficients

    def unavailable(self, runs: Sequence[RunBlocks]) -> str | None:
        """Why this effect cannot be looked for in these runs; None where it can."""
        for channel in self.needs:
            missing = sum(channel not in run.channels for run in runs)
            if missing:
                return f"channel {channel} is missing in {missing} of {len(runs)} runs"
            finite = np.concatenate(
                [run.mean(channel)[np.isfinite(run.mean(channel))] for run in runs] or [np.empty(0)]
            )
            if not finite.size:
                return f"channel {channel} has no readings in these runs"
            if np.ptp(finite) == 0 and not self._varies_within(channel, runs):
                unit = runs[0].channels[channel].unit_of_measure
                return f"channel {channel} stays at {finite[0]:g} {unit} in these runs"
        return None

    @staticmethod
    def _varies_within(channel: str, runs: Sequence[RunBlocks]) -> bool:
        return any(bool(np.any(run.channels[channel].spread > 0)) for run in runs)

    @classmethod
    def instances(cls) -> "Sequence[Effect]":
        """What the registry lists of this class: one, if it has a name; a class may make several."""
        return (cls(),) if hasattr(cls, "name") else ()

    def recorded(self, time_s: FloatArray, channels: Mapping[str, FloatArray]) -> Mapping[str, FloatArray]:
        """What the record holds in place of `channels`: an auxiliary sensor's fault alters its channel."""
        return channels

    @abstractmethod
    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        """Columns of the effect, shape (blocks, columns); NaN only where a needed channel is NaN."""

    @abstractmethod
    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        """What the effect adds to the signal at each instant, by its physics and not by `regressors`.

        Parameters
        ----------
        time_s: shape (n,); instants, evenly spaced, seconds from the run's start.
        channels: shape (n,); what truly acts on the gyro at these instants.
        coefficients: One for each column.
        shape: Values of the shape parameters, within their grids or between.

        Returns
        -------
        array of shape (n,)
            In the signal's unit.
        """
