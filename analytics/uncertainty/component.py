"""A component of an uncertainty budget (JCGM 100 4.2, 4.3; JJF 1059.1-2012 4.3)."""

import math
from typing import Any, Literal

import msgspec

from analytics.uncertainty.distribution import Distribution
from stream.errors import BadInput

Evaluation = Literal["A", "B"]


class Component(msgspec.Struct, frozen=True, kw_only=True):
    """One source of uncertainty: an input quantity and how it enters the measurand.

    Made by `type_a`, `from_certificate` or `from_half_width`.

    Parameters
    ----------
    en, zh
        Its name, unique in its budget.
    evaluation
        ``A``: from observations; ``B``: from anything else.
    distribution
        What is assumed of it.
    stated
        What is stated of it: s, U or a half-width, in `unit`.
    divisor
        `stated` over the standard uncertainty.
    unit
        Unit of measure of the input quantity.
    sensitivity, sensitivity_unit
        Partial derivative of the measurand by it, with its unit of measure.
    freedom
        Degrees of freedom; infinite where u is taken as exactly known.
    group
        Components of one group are fully correlated: one instrument that enters in several places.
    source
        Where it is stated: run, instrument with serial and certificate, clause.
    """

    en: str
    zh: str
    evaluation: Evaluation
    distribution: Distribution
    stated: float
    divisor: float
    unit: str
    sensitivity: float = 1.0
    sensitivity_unit: str = "1"
    freedom: float = math.inf
    group: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.stated) and self.stated >= 0):
            raise BadInput(f"component {self.en!r}: {self.stated:g} is stated; expected is a finite number from 0")
        if not (math.isfinite(self.divisor) and self.divisor > 0):
            raise BadInput(f"component {self.en!r}: the divisor {self.divisor:g} is not above 0")
        if not math.isfinite(self.sensitivity):
            raise BadInput(f"component {self.en!r}: the sensitivity {self.sensitivity:g} is not finite")
        if not self.freedom > 0:
            raise BadInput(f"component {self.en!r}: {self.freedom:g} degrees of freedom; more than 0 are expected")

    @classmethod
    def type_a(cls, en: str, zh: str, u: float, freedom: float, unit: str, **rest: Any) -> "Component":
        """From observations: standard uncertainty of their mean, or of a fit, with its degrees of freedom.

        >>> Component.type_a("repeatability", "重复性", 1.54e-4, 9, "1").u
        0.000154
        """
        return cls(
            en=en, zh=zh, unit=unit, evaluation="A", distribution=Distribution.T, stated=u, divisor=1.0,
            freedom=freedom, **rest,
        )  # fmt: skip

    @classmethod
    def from_certificate(cls, en: str, zh: str, expanded: float, k: float, unit: str, **rest: Any) -> "Component":
        """From a calibration certificate: U with its k (JCGM 100 4.3.3).

        >>> Component.from_certificate("rate table", "速率转台", 1e-4, 2, "1").u
        5e-05
        """
        return cls(
            en=en,
            zh=zh,
            evaluation="B",
            distribution=Distribution.NORMAL,
            stated=expanded,
            divisor=k,
            unit=unit,
            **rest,
        )

    @classmethod
    def from_half_width(
        cls, en: str, zh: str, half_width: float, distribution: Distribution, unit: str, **rest: Any
    ) -> "Component":
        """From bounds -+ `half_width` and a distribution between them (JCGM 100 4.3.7, 4.3.9).

        >>> round(Component.from_half_width("chamber", "温箱", 0.5, Distribution.UNIFORM, "degC").u, 4)
        0.2887
        """
        if (divisor := distribution.divisor) is None:
            raise BadInput(f"component {en!r}: {distribution.value} has no bounds; state U and k, or s")
        return cls(
            en=en,
            zh=zh,
            evaluation="B",
            distribution=distribution,
            stated=half_width,
            divisor=divisor,
            unit=unit,
            **rest,
        )

    @classmethod
    def from_step(cls, en: str, zh: str, step: float, unit: str, **rest: Any) -> "Component":
        """From a quantisation step: uniform over one step, u = step/sqrt(12) (JCGM 100 F.2.2.1).

        Erratum: JJF 1536-2015 A.1.2.2 2) prints step/sqrt(3).

        >>> round(Component.from_step("quantisation", "量化", 2**-12, "1").u, 9)
        7.0477e-05
        """
        return cls.from_half_width(en, zh, step / 2, Distribution.UNIFORM, unit, **rest)

    @property
    def u(self) -> float:
        """Standard uncertainty of the input quantity."""
        return self.stated / self.divisor

    @property
    def signed(self) -> float:
        """Sensitivity times standard uncertainty; the sign counts where components are correlated."""
        return self.sensitivity * self.u

    @property
    def contribution(self) -> float:
        """Contribution to the standard uncertainty of the measurand, in its unit."""
        return abs(self.signed)


def freedom_of(relative_uncertainty: float) -> float:
    """Degrees of freedom of a standard uncertainty that is known to a fraction of itself (JCGM 100 (G.3)).

    >>> freedom_of(0.25)
    8.0
    """
    return 0.5 / relative_uncertainty**2
