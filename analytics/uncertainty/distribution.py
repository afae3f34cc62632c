"""Distributions of the components of a budget: divisor (JCGM 100 4.3) and quantiles (JCGM 101 6.4)."""

import math
from enum import StrEnum

import numpy as np
import scipy

from analytics.methods.distributions import student_quantile
from stream.batch import FloatArray


class Distribution(StrEnum):
    """What is assumed of an input quantity; the texts are those of documents and files."""

    NORMAL = "normal"  # U with its k, or a standard uncertainty
    T = "t"  # mean of repeated observations, scaled and shifted t (JCGM 101 6.4.9)
    UNIFORM = "uniform"  # half-width a, divisor sqrt(3)
    TRIANGULAR = "triangular"  # half-width a, divisor sqrt(6)
    U_SHAPED = "u_shaped"  # arc sine: a sine of unknown phase, half-width a, divisor sqrt(2)
    TRAPEZOIDAL = "trapezoidal"  # half-width a, top half as wide as the base, divisor sqrt(24/5)

    @property
    def zh(self) -> str:
        """The name in Chinese (JJF 1059.1-2012 4.3.3)."""
        return _CHINESE[self]

    @property
    def en(self) -> str:
        """The name in English."""
        return _ENGLISH.get(self, self.value)

    @property
    def divisor(self) -> float | None:
        """Half-width over standard uncertainty; None where U and k, or u, are given instead.

        >>> round(Distribution.UNIFORM.divisor, 4), Distribution.NORMAL.divisor
        (1.7321, None)
        """
        return _DIVISORS.get(self)

    def quantiles(self, probability: FloatArray, freedom: float = math.inf) -> FloatArray:
        """Quantiles of the distribution with standard uncertainty 1; of `t`, in units of its scale.

        The scale of t is the standard uncertainty of JCGM 100, its standard deviation sqrt(v/(v - 2)) times as large.

        >>> Distribution.UNIFORM.quantiles(np.array([0.0, 0.5, 1.0])).round(4).tolist()
        [-1.7321, 0.0, 1.7321]
        """
        p = np.asarray(probability, dtype=np.float64)
        match self:
            case Distribution.T if math.isfinite(freedom):
                return student_quantile(p, freedom)
            case Distribution.NORMAL | Distribution.T:
                return np.asarray(scipy.special.ndtri(p))
            case Distribution.UNIFORM:
                unit = 2 * p - 1
            case Distribution.TRIANGULAR:
                unit = np.where(p < 0.5, np.sqrt(2 * p) - 1, 1 - np.sqrt(2 * (1 - p)))
            case Distribution.U_SHAPED:
                unit = -np.cos(np.pi * p)
            case Distribution.TRAPEZOIDAL:
                tail = np.minimum(p, 1 - p)
                # density rises over half of each half-width: 1/6 of the probability lies on each slope
                side = np.where(tail < 1 / 6, np.sqrt(1.5 * tail) - 1, 1.5 * tail - 0.75)
                unit = np.where(p < 0.5, side, -side)
        return np.asarray(unit * _DIVISORS[self])


_DIVISORS = {
    Distribution.UNIFORM: math.sqrt(3.0),
    Distribution.TRIANGULAR: math.sqrt(6.0),
    Distribution.U_SHAPED: math.sqrt(2.0),
    Distribution.TRAPEZOIDAL: math.sqrt(24.0 / 5.0),
}
_ENGLISH = {Distribution.U_SHAPED: "U-shaped"}
_CHINESE = {
    Distribution.NORMAL: "正态", Distribution.T: "t", Distribution.UNIFORM: "均匀", Distribution.TRIANGULAR: "三角",
    Distribution.U_SHAPED: "反正弦", Distribution.TRAPEZOIDAL: "梯形",
}  # fmt: skip
