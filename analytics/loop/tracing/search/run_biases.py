"""The biases of runs, and their regression on what differs between the runs."""

from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from analytics.loop.model.error_model import ModelNoise
from analytics.loop.tracing.search.screening import LEAST_LEFT
from analytics.loop.tracing.whitening.least_squares import Solution, fit, solve
from analytics.loop.tracing.whitening.stack import Stack, UnitRecord
from analytics.methods.distributions import student_quantile, student_sf
from stream.batch import FloatArray

_INSIDE = 1e-6  # part of a declared column within runs, over its length, below which it differs between them only


class Slope(NamedTuple):
    """A column's coefficient in a regression of biases, its standard error, and the degrees of freedom of its t."""

    value: float
    error: float
    degrees: int

    @property
    def p_value(self) -> float:
        """Two-sided."""
        return min(1.0, 2.0 * student_sf(abs(self.value) / max(self.error, 1e-300), self.degrees))

    @property
    def half(self) -> float:
        """Half of the 95 % interval."""
        return float(student_quantile(0.975, self.degrees)) * self.error


@dataclass(frozen=True)
class RunBiases:
    """The bias of each of n runs beside the declared terms that vary within runs."""

    value: FloatArray  # shape (n,)
    covariance: FloatArray  # shape (n, n); by the noise within the runs, and by the coefficients of these terms
    base: FloatArray  # shape (n, p); the other declared terms, with the bias

    @staticmethod
    def of(record: UnitRecord, noise: ModelNoise) -> "RunBiases":
        """The biases in a record of all runs, by this noise without its turn-on scatter."""
        number, runs = record.stack.run_number, len(record.stack.runs)
        own = np.asarray(number[:, None] == np.arange(runs), np.float64)
        means = run_means(record.stack, record.design)
        varies = _varying(record)
        columns = np.column_stack([own, record.design[:, varies]])
        whitened = record.whitener(msgspec.structs.replace(noise, turn_on=0.0))(
            np.column_stack([record.value, columns])
        )
        found = fit(whitened[:, 1:], whitened[:, 0])
        return RunBiases(found.coefficients[:runs], found.covariance[:runs, :runs], means[:, ~varies])

    def slope(self, column: FloatArray, *others: FloatArray) -> Slope | None:
        """The coefficient of a column of the runs' means beside others; None where it is one of them, or of too few.

        Biases scatter about the regression by a variance that is the same for all runs, beside the covariance: that of
        Paule and Mandel, at which the weighted squares are as many as the degrees of freedom. The coefficient over its
        error has Student's t (Knapp and Hartung, doi:10.1002/sim.1482): exactly where the runs are of one length.

        >>> runs = RunBiases(np.array([0.0, 1.1, 1.9, 3.0]), 1e-6 * np.eye(4), np.ones((4, 1)))
        >>> [round(each, 3) for each in runs.slope(np.arange(4.0))]
        [0.98, 0.042, 2]
        """
        beside = np.column_stack([self.base, *others])
        left = column - beside @ np.linalg.lstsq(beside, column, rcond=None)[0]
        degrees = self.value.size - int(np.linalg.matrix_rank(beside)) - 1
        scale = float(np.linalg.norm(column - column.mean()))
        if degrees < 1 or float(left @ left) <= LEAST_LEFT * scale**2:
            return None
        design = np.column_stack([beside, column])
        found, squares = self._weighted(design, self._between(design, degrees))
        excess = max(1.0, squares / degrees)  # never narrower than the noise within the runs
        return Slope(float(found.coefficients[-1]), float(np.sqrt(found.covariance[-1, -1] * excess)), degrees)

    def _weighted(self, design: FloatArray, variance: float) -> tuple[Solution, float]:
        """Generalised least squares with this variance between runs, and the weighted squares that it leaves."""
        covariance = self.covariance + variance * np.eye(self.value.size)
        weighted = np.linalg.solve(covariance, np.column_stack([self.value, design]))
        found = solve(design.T @ weighted[:, 1:], design.T @ weighted[:, 0])
        left = self.value - design @ found.coefficients
        return found, float(left @ np.linalg.solve(covariance, left))

    def _between(self, design: FloatArray, degrees: int) -> float:
        """The variance between runs at which the weighted squares are as many as the degrees; 0 if they are fewer."""

        def excess(variance: float) -> float:
            return self._weighted(design, variance)[1] - degrees

        if excess(0.0) <= 0:
            return 0.0
        most = float(np.ptp(self.value) ** 2)
        while excess(most) > 0:
            most *= 4.0
        from scipy.optimize import brentq  # slow to import

        return float(brentq(excess, 0.0, most, xtol=1e-6 * most))


def slope_within(record: UnitRecord, noise: ModelNoise, column: FloatArray) -> tuple[float, float] | None:
    """A column's coefficient within the runs, beside a bias of each, and its standard error; None if it is constant."""
    own = np.asarray(record.stack.run_number[:, None] == np.arange(len(record.stack.runs)), np.float64)
    inside = column - run_means(record.stack, column[:, None])[record.stack.run_number, 0]
    if np.linalg.norm(inside) <= _INSIDE * np.linalg.norm(column):
        return None
    varies = _varying(record)
    columns = np.column_stack([own, record.design[:, varies], inside])
    whitened = record.whitener(msgspec.structs.replace(noise, turn_on=0.0))(np.column_stack([record.value, columns]))
    found = fit(whitened[:, 1:], whitened[:, 0])
    return float(found.coefficients[-1]), float(np.sqrt(found.covariance[-1, -1]))


def _varying(record: UnitRecord) -> npt.NDArray[np.bool_]:
    """Which columns of the declared model vary within runs."""
    inside = record.design - run_means(record.stack, record.design)[record.stack.run_number]
    length = np.maximum(np.linalg.norm(record.design, axis=0), 1e-300)
    varies: npt.NDArray[np.bool_] = np.linalg.norm(inside, axis=0) > _INSIDE * length
    return varies


def run_means(stack: Stack, columns: FloatArray) -> FloatArray:
    """Mean of each column over the blocks of each run, shape (runs, columns)."""
    number = stack.run_number
    blocks = np.bincount(number)
    return np.column_stack([np.bincount(number, column) / blocks for column in columns.T])
