"""How well a sum of non-negative terms explains an Allan curve: the likelihood of its chi-square scatter."""

import math

import numpy as np

from stream.batch import FloatArray
from stream.estimators.noise.noise_kernel import (
    descend,
    descend_with,
    deviance,
    least_deviances,
    residual_of,
    weighted_least_squares,
)
from stream.estimators.noise.root_between import root_between

_ROOT_TOLERANCE = 1e-6
_NEGLIGIBLE = 1e-9
_MOST_EXPONENT = 100.0
_MOST_ROUNDS = 5
_SETTLED = 0.01


class CurveLikelihood:
    """Gamma likelihood of Allan variances v_i with edf_i degrees of freedom about a model m_i = sum_k x_ik theta_k.

    `columns`, shape (n, p), are the terms x, positive; `variances` and `degrees`, shape (n,), the Allan variances,
    positive, and their equivalent degrees of freedom; `correlation`, shape (n, n), is that of the variances, `excess`,
    shape (n,), the relative variance of the model error beyond the scatter of the curve; see `widened`.

    edf v/m approximately follows chi-square (NIST SP 1065 5.3), so that twice the negative log likelihood is, up to a
    constant,

        D(theta) = sum_i edf_i (v_i/m_i - 1 + ln(m_i/v_i)),    theta >= 0.

    Its minimum is where least squares weighted by edf_i/(2 m_i^2), the model's own variance, no longer moves
    (iteratively reweighted non-negative least squares; Lawson, Hanson 1974). Weights by 2 v_i^2/edf_i would favour the
    points that came out low.

    D treats the points as independent. They are not, so D deviates from chi-square by the ratio of the true variance of
    an estimate to the one that D implies, the sandwich over the inverse information (composite likelihood: Varin,
    Reid, Firth, Statistica Sinica 21 (2011) 5-42); `inflation` gives it, and the bounds are where D has risen by it
    times the quantile. Coefficients are relative to the curve: theta_k = 1 touches it at its closest point.
    """

    def __init__(
        self, columns: FloatArray, variances: FloatArray, degrees: FloatArray, correlation: FloatArray,
        excess: FloatArray | None = None,
    ) -> None:  # fmt: skip
        relative = columns / variances[:, np.newaxis]
        self.sizes: FloatArray = relative.max(axis=0)
        self.columns: FloatArray = np.ascontiguousarray(relative / self.sizes)
        self.degrees: FloatArray = np.ascontiguousarray(degrees)
        self.excess: FloatArray = np.zeros(len(variances)) if excess is None else excess
        self._correlation = correlation
        self._minimum: tuple[FloatArray, float] | None = None

    def _with(self, relative: FloatArray) -> "CurveLikelihood":
        return CurveLikelihood(relative, np.ones(len(relative)), self.degrees, self._correlation, self.excess)

    def beside(self, relative: FloatArray) -> "CurveLikelihood":
        """The same with one more term, given relative to the curve."""
        return self._with(np.column_stack([self.columns * self.sizes, relative]))

    def deviances_beside(self, relative: FloatArray) -> FloatArray:
        """Least deviance with one more term, for each column of terms given relative to the curve."""
        found: FloatArray = least_deviances(self.columns, self.degrees, relative)
        return found

    def instead(self, relative: FloatArray) -> "CurveLikelihood":
        """The same with another last term, given relative to the curve."""
        return self._with(np.column_stack([(self.columns * self.sizes)[:, :-1], relative]))

    def without(self) -> "CurveLikelihood":
        """The same without its last term."""
        return self._with((self.columns * self.sizes)[:, :-1])

    def widened(self, excess: FloatArray, alike: FloatArray) -> "CurveLikelihood":
        """The same with a model error of relative variance `excess`, correlated as `alike`; D keeps its form."""
        scatter = 2.0 / self.degrees
        total = scatter + excess
        covariance = self._correlation * np.sqrt(np.outer(scatter, scatter)) + alike * np.sqrt(np.outer(excess, excess))
        correlation = covariance / np.sqrt(np.outer(total, total))
        return CurveLikelihood(
            self.columns * self.sizes, np.ones(len(total)), 2.0 / total, correlation, self.excess + excess
        )

    def deviance(self, model: FloatArray) -> float:
        """D of a model, given relative to the curve; infinite for one too far from it."""
        return float(deviance(self.degrees, model))

    def constant(self) -> float:
        """Twice the negative log likelihood less D: it depends on the degrees of freedom."""
        from scipy.special import gammaln

        half = self.degrees / 2.0
        return float(2.0 * np.sum(half + gammaln(half) - half * np.log(half)))

    def height(self) -> float:
        """Twice the negative log likelihood at the minimum, to compare between degrees of freedom."""
        return self.minimum()[1] + self.constant()

    def minimum(self) -> tuple[FloatArray, float]:
        """Coefficients of least deviance, not to be changed, and that deviance."""
        if self._minimum is None:
            self._minimum = self._descended()
        return self._minimum

    def _descended(self) -> tuple[FloatArray, float]:
        terms = self.columns.shape[1]
        every, nothing = np.ones(terms, np.bool_), np.zeros(len(self.columns))
        start = weighted_least_squares(self.columns, self.degrees, np.ones(len(self.columns)), nothing, every)
        return descend(self.columns, self.degrees, start, every)

    def minimum_at(self, theta: FloatArray, which: int, at: float) -> tuple[FloatArray, float]:
        """As `minimum`, with one coefficient fixed `at`; searched from theta, the deviance never more than there."""
        return descend_with(self.columns, self.degrees, theta, which, at, _NEGLIGIBLE)

    def scores(self, theta: FloatArray, columns: FloatArray) -> FloatArray:
        """Columns in units of the scatter of each variance expected by theta, m sqrt(2/edf)."""
        return columns * (np.sqrt(self.degrees / 2.0) / (self.columns @ theta))[:, np.newaxis]

    def covariance(self, scores: FloatArray) -> FloatArray:
        """Covariance of sums of the correlated variances weighted by the scores."""
        product: FloatArray = scores.T @ self._correlation @ scores
        return product

    def residual(self, theta: FloatArray, columns: FloatArray, without: int | None = None) -> FloatArray:
        """Residual of columns, as scores, after regression on the positive terms of theta."""
        at_work = theta > _NEGLIGIBLE
        if without is not None:
            at_work[without] = False
        others = self.scores(theta, self.columns[:, at_work])
        target = self.scores(theta, columns)
        return _residual_of(others, target)

    def inflation(self, theta: FloatArray, which: int) -> float:
        """Variance of an estimate over that of independent points, at least 1."""
        left = self.residual(theta, self.columns[:, [which]], without=which)
        return max(1.0, float(self.covariance(left)[0, 0] / np.sum(left**2)))

    def freedom(self, theta: FloatArray) -> tuple[float, float]:
        """Mean of D at the minimum theta if the model holds, and the degrees of freedom of an equivalent chi-square.

        With P the residual projection of the positive terms and C the correlation of the variances, D is a quadratic
        form of mean tr(P C) and variance 2 tr(P C P C) (F. E. Satterthwaite, Biometrics Bull. 2 (1946) 110-114).
        """
        product = _residual_of(self.scores(theta, self.columns[:, theta > _NEGLIGIBLE]), self._correlation)
        mean, square = float(np.trace(product)), float(np.sum(product * product.T))
        return mean, mean**2 / square if square > 0.0 else 0.0

    def known_share(self) -> float:
        """Share of a gain in `height` that counts: 1 if variances are known, nu/n where all is model error."""
        unknown = float(np.mean(self.excess * self.degrees / 2.0))
        return 1.0 - unknown * (1.0 - self.freedom(self.minimum()[0])[0] / len(self.degrees))

    def spread(self, theta: FloatArray, quantile: float) -> float:
        """Quantile that replaces that of chi-square where the model error was estimated from the curve itself.

        With nu degrees of freedom of the variances that it dominates, nu (exp(quantile/nu) - 1): the profile
        likelihood of a variance shared by nu points, close to the square of Student's t.
        """
        if not self.excess.any():
            return quantile
        share = self.excess * self.degrees / 2.0
        nu = max(1.0, self.freedom(theta)[1] * float(np.mean((share / share.max()) ** 2)))
        return nu * math.expm1(min(quantile / nu, _MOST_EXPONENT))

    def bounds(
        self, theta: FloatArray, base: float, spread: float, which: int, inflation: float
    ) -> tuple[float, float]:
        """Where the deviance, the other coefficients free, rises to base + spread*inflation on either side of theta.

        A coefficient at its upper bound prevails at taus at which theta has it as nothing, and noises that correlate
        more prevail with it: where the inflation is larger there, that one counts (a test of the bound judges by the
        scatter that holds at the bound, as a score test does).
        """

        def excess(at: float) -> float:
            return self.minimum_at(theta, which, at)[1] - base - spread * inflation

        lo, best = 0.0, float(theta[which])
        if best > 0.0 and excess(0.0) > 0.0:
            lo = root_between(excess, 0.0, best, absolute=1e-15, relative=_ROOT_TOLERANCE)
        below, above = best, max(1.5 * best, 1e-3)
        for _ in range(_MOST_ROUNDS):
            while excess(above) < 0.0:
                below, above = above, 2.0 * above
            hi = root_between(excess, below, above, absolute=1e-15, relative=_ROOT_TOLERANCE)
            there = self.inflation(self.minimum_at(theta, which, hi)[0], which)
            if there <= inflation * (1.0 + _SETTLED):
                break
            inflation, below, above = there, hi, 1.5 * hi
        return lo, hi


def _residual_of(others: FloatArray, target: FloatArray) -> FloatArray:
    left: FloatArray = residual_of(np.ascontiguousarray(others), np.ascontiguousarray(target))
    return left


def deviance_quantile(confidence: float) -> float:
    """How far the deviance may rise above its minimum within the bounds of one coefficient.

    Chi-square with one degree of freedom if no other coefficient were at its boundary. Where another one is truly 0, as
    most are, the rise is a mixture (Self, Liang, J. Am. Stat. Assoc. 82 (1987) 605-610, by the angle between the two),
    in the worst case, two that cannot be separated, of chi-square with 0, 1, 1 and 2 degrees in equal parts.
    The larger of both quantiles is taken: bounds 5 % wider at 95 %.

    >>> round(deviance_quantile(0.95), 3)
    4.231
    """
    lo, hi = 0.0, 1000.0
    for _ in range(80):
        middle = (lo + hi) / 2.0
        free = math.erfc(math.sqrt(middle / 2.0))
        tail = max(free, free / 2.0 + math.exp(-middle / 2.0) / 4.0)
        lo, hi = (middle, hi) if tail > 1.0 - confidence else (lo, middle)
    return hi
