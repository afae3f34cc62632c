"""What every effect is: a class that both predicts (columns of a regression) and simulates."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from typing import ClassVar

from analytics.run_blocks import RunBlocks
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


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter that an effect is not linear in, searched over a grid.

    Parameters
    ----------
    name, unit_of_measure : str
        Such as ``time_constant`` in ``s``.
    grid : tuple of float
        The values that are tried.
    en, zh : str
        Its name.
    """

    name: str
    unit_of_measure: str
    grid: tuple[float, ...]
    en: str
    zh: str


class Effect(ABC):
    """One effect. A new one is a new file in this package; the registry and the laws find it.

    An instance has no state. Regressors are in natural units, so that a coefficient says something: deg/h per degC.
    """

    name: ClassVar[str]
    en: ClassVar[str]
    zh: ClassVar[str]
    needs: ClassVar[tuple[str, ...]]
    """Standard channels, all of which must be there and vary."""
    role: ClassVar[Role] = Role.CAUSE
    kind: ClassVar[Kind] = Kind.LIBRARY
    parameters: ClassVar[tuple[ShapeParameter, ...]] = ()
    coefficients: ClassVar[tuple[str, ...]] = ("",)
    """Names of the columns where there are several, such as ``cos`` and ``sin``."""
    per: ClassVar[str] = "1"
    """What a coefficient is per: a unit of measure in which {temperature} stands for that channel's own unit."""
    cause: ClassVar[str]
    """The physics in two sentences."""
    cause_zh: ClassVar[str]
    reference: ClassVar[str]
    aliases: ClassVar[tuple[str, ...]] = ()
    """Names of effects that ordinary tests do not tell from this one."""
    separating_test: ClassVar[str]
    """The measurement that would tell them apart."""
    separating_test_zh: ClassVar[str]

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:  # noqa: ARG002  free functions look at the runs
        """Shapes to try on these runs: by default every combination of the grids."""
        names = [parameter.name for parameter in self.parameters]
        return [dict(zip(names, values, strict=True)) for values in product(*(p.grid for p in self.parameters))]

    def unavailable(self, runs: Sequence[RunBlocks]) -> str | None:
        """Why this effect cannot be looked for in these runs; None where it can."""
        for channel in self.needs:
            missing = sum(channel not in run.channels for run in runs)
            if missing:
                return f"channel {channel} is missing in {missing} of {len(runs)} runs"
        return None

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
        time_s : array of shape (n,)
            Instants, evenly spaced, seconds from the run's start.
        channels : mapping of str to array of shape (n,)
            What truly acts on the gyro at these instants.
        coefficients : sequence of float
            One for each column.
        shape : mapping
            Values of the shape parameters, within their grids or between.

        Returns
        -------
        array of shape (n,)
            In the signal's unit.
        """
