"""Noise coefficients from an Allan curve (IEEE 952-2020 annex C; JJF 2014-2022 7.2.20, GJB 2426A-2004 5.12.5.4.2)."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from stream.batch import FloatArray
from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate
from stream.estimators.noise_likelihood import CurveLikelihood, deviance_quantile
from stream.estimators.noise_markov import best_correlation_time
from stream.estimators.noise_model import MARKOV_NOISE, TERMS, Term, markov_column, scatter, term_columns
from stream.events import EstimatePoint

LEAST_POINTS = 6
LEAST_SHARE = 0.5
LEAST_DEGREES = 4.0
KNOWN_DEGREES = 30.0
_TRIED_TIMES = 5


class Coefficient(msgspec.Struct, frozen=True, kw_only=True):
    """A noise coefficient with its limits.

    Parameters
    ----------
    value, lo, hi : float
        Estimate and limits in `unit_of_measure`, never negative; `lo` is 0 where the curve does without the term.
    unit_of_measure : str
        arcsec, deg/sqrt(h), deg/h, deg/h/sqrt(h) or deg/h/h.
    observable : bool
        Whether the record shows the term; if not, `hi` is what the record leaves room for.
    reason : str
        Why it is not observable, empty if it is.
    """

    value: float
    lo: float
    hi: float
    unit_of_measure: str
    observable: bool
    reason: str = ""


class Markov(msgspec.Struct, frozen=True, kw_only=True):
    """Exponentially correlated noise that the curve asks for beside the five terms.

    Parameters
    ----------
    amplitude : Coefficient
        q of IEEE 952, deg/h/sqrt(h); the standard deviation of the noise is q sqrt(correlation time/2).
    correlation_s, correlation_lo_s, correlation_hi_s : float
        Correlation time and its limits, seconds.
    """

    amplitude: Coefficient
    correlation_s: float
    correlation_lo_s: float
    correlation_hi_s: float


class NoiseFit(msgspec.Struct, frozen=True, kw_only=True):
    """The coefficients of one Allan curve; `points` of it were used, `confidence` is the level of all limits."""

    quantization_noise: Coefficient
    angle_random_walk: Coefficient
    bias_instability: Coefficient
    rate_random_walk: Coefficient
    rate_ramp: Coefficient
    markov: Markov | None
    confidence: float
    points: int


def fit_noise(points: Sequence[EstimatePoint], *, confidence: float = 0.95) -> NoiseFit | NoEstimate:
    """Identify the noise coefficients Q, N, B, K, R, and a Markov term where the curve asks for one.

    Parameters
    ----------
    points : sequence of EstimatePoint
        Overlapping Allan deviation in deg/h at any averaging times; points of 0, or of less than 1 degree of freedom,
        are left out.
    confidence : float
        Level of the limits.

    Returns
    -------
    NoiseFit or NoEstimate
        NoEstimate where there are fewer than 6 points above zero.

    Raises
    ------
    EstimatorError
        If `confidence` is not between 0 and 1.

    Notes
    -----
    Weighted non-negative least squares on the variances, the weights edf/(2 m^2) of the fitted model m repeated until
    they stand (`CurveLikelihood`). **Erratum**: the standards fit the same polynomial by plain least squares, which
    the longest taus govern and which returns negative squares.

    Points come with the least degrees of freedom of all noises; a first fit says which noises prevail at each tau,
    and a second uses the degrees of that mixture and the correlation between taus (`scatter`, where drift counts as
    random walk and Markov noise as flicker; below 30 degrees all is taken for random walk, which scatters most).
    Limits are by profile likelihood, widened for that correlation and for the bound at 0. Where there is Markov noise,
    they hold over its correlation times too.

    A term is not observable where the lower limit is 0 and the term makes up less than half of the fitted variance at
    every tau of at least 4 degrees of freedom; at longer ones the variance is known to a factor of two at best, and
    any term can seem to prevail.

    Examples
    --------
    >>> taus = [0.1 * 2**k for k in range(16)]
    >>> curve = [EstimatePoint(tau_s=t, value=(3600 * 0.01**2 / t + 0.44 * 0.02**2) ** 0.5, lo=0.0, hi=1.0,
    ...                        edf=1e5 / t, n=1) for t in taus]
    >>> fit = fit_noise(curve)
    >>> round(fit.angle_random_walk.value, 5), fit.angle_random_walk.unit_of_measure, fit.rate_ramp.observable
    (0.01, 'deg/sqrt(h)', False)
    >>> fit_noise(curve[:3])
    NoEstimate(reason='6 averaging times with a deviation above zero needed, 3 given')
    """
    if not 0.0 < confidence < 1.0:
        raise EstimatorError(f"a confidence of {confidence}: it lies between 0 and 1, such as 0.95")
    usable = sorted((point for point in points if _is_usable(point)), key=lambda point: point.tau_s)
    if points and not any(point.value > 0.0 for point in points):
        return NoEstimate("the Allan deviation is 0 at every averaging time: the output is constant; check the source")
    if len({point.tau_s for point in usable}) < LEAST_POINTS:
        return NoEstimate(
            f"{LEAST_POINTS} averaging times with a deviation above zero needed, "
            f"{len({point.tau_s for point in usable})} given"
        )
    return _fitted(
        np.array([point.tau_s for point in usable]),
        np.array([point.value for point in usable]),
        np.array([point.edf for point in usable]),
        confidence,
    )


def _is_usable(point: EstimatePoint) -> bool:
    numbers = (point.tau_s, point.value, point.edf)
    return all(math.isfinite(number) and number > 0.0 for number in numbers) and point.edf >= 1.0


def _fitted(taus_s: FloatArray, deviations: FloatArray, edf: FloatArray, confidence: float) -> NoiseFit:
    scale = float(np.exp(np.mean(np.log(deviations))))
    variances = (deviations / scale) ** 2
    columns = term_columns(taus_s)
    likelihood = _weighed(taus_s, columns, variances, edf)
    quantile = deviance_quantile(confidence)
    times = best_correlation_time(taus_s, variances, likelihood, quantile)
    if times is None:
        found = _coefficients(TERMS, [likelihood], quantile, scale)
        return NoiseFit(**found, markov=None, confidence=confidence, points=len(taus_s))
    best_s, lo_s, hi_s = times
    likelihood = _weighed(taus_s, np.column_stack([columns, markov_column(taus_s, best_s)]), variances, edf)
    tried = [
        likelihood.instead(markov_column(taus_s, float(time_s)) / variances)
        for time_s in np.geomspace(lo_s, hi_s, _TRIED_TIMES)
    ]
    found = _coefficients((*TERMS, MARKOV_NOISE), [likelihood, *tried], quantile, scale)
    markov = Markov(
        amplitude=found.pop(MARKOV_NOISE.key), correlation_s=best_s, correlation_lo_s=lo_s, correlation_hi_s=hi_s
    )
    return NoiseFit(**found, markov=markov, confidence=confidence, points=len(taus_s))


def _weighed(taus_s: FloatArray, columns: FloatArray, variances: FloatArray, edf: FloatArray) -> CurveLikelihood:
    """Likelihood with the degrees of freedom and correlations of the noises that a first fit finds."""
    first = CurveLikelihood(columns, variances, edf, np.eye(len(edf)))
    theta, _ = first.minimum()
    parts = first.columns * theta * variances[:, np.newaxis]
    mixture = parts[:, :4].copy()
    mixture[:, 3] += parts[:, 4]
    mixture[:, 2] += parts[:, 5:].sum(axis=1)
    # where few windows are left the fit cannot tell the noises apart: the one that scatters most is assumed
    is_unsure = edf < KNOWN_DEGREES
    mixture[is_unsure] = np.array([0.0, 0.0, 0.0, 1.0]) * variances[is_unsure, np.newaxis]
    gain, correlation = scatter(taus_s, mixture)
    return CurveLikelihood(columns, variances, edf * gain, correlation)


def _coefficients(
    terms: tuple[Term, ...], likelihoods: list[CurveLikelihood], quantile: float, scale: float
) -> dict[str, Coefficient]:
    """Coefficients of the first likelihood; their limits hold for any of them."""
    best = likelihoods[0]
    minima = [likelihood.minimum() for likelihood in likelihoods]
    theta, least = minima[0]
    parts = best.columns * theta
    shares = (parts / parts.sum(axis=1, keepdims=True))[best.degrees >= LEAST_DEGREES].max(axis=0, initial=0.0)
    found = {}
    for which, term in enumerate(terms):
        allowed = least + quantile * best.inflation(theta, which)
        squares = [(theta[which] / best.sizes[which],) * 2]
        squares += [
            tuple(np.array(likelihood.limits(minimum, allowed, which)) / likelihood.sizes[which])
            for likelihood, (minimum, lowest) in zip(likelihoods, minima, strict=True)
            if lowest < allowed
        ]
        ends = min(lo for lo, _ in squares), max(hi for _, hi in squares)
        value, lo, hi = (math.sqrt(square) * scale * term.per_si for square in (squares[0][0], *ends))
        is_seen = lo > 0.0 or bool(shares[which] >= LEAST_SHARE)
        found[term.key] = Coefficient(
            value=value,
            lo=lo,
            hi=hi,
            unit_of_measure=term.unit_of_measure,
            observable=is_seen,
            reason="" if is_seen else f"not observable in this record: at most {hi:.3g} {term.unit_of_measure}",
        )
    return found
