"""Noise coefficients from an Allan curve (IEEE 952-2020 annex C; JJF 2014-2022 7.2.20, GJB 2426A-2004 5.12.5.4.2)."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from stream.batch import FloatArray
from stream.errors import EstimatorError
from stream.estimators.base import NoEstimate
from stream.estimators.noise.noise_likelihood import CurveLikelihood, deviance_quantile
from stream.estimators.noise.noise_markov import Offer, best_markov
from stream.estimators.noise.noise_misfit import admitted, misfit_chance
from stream.estimators.noise.noise_model import MARKOV_NOISE, TERMS, Term, correlations, markov_column, term_columns
from stream.events import EstimatePoint

LEAST_POINTS = 6
KNOWN_DEGREES = 30.0
_TRIED_TIMES = 5
_MOST_ROUNDS = 4
_SETTLED = 0.01
_FILTER = 64.0


class NoiseCoefficient(msgspec.Struct, frozen=True, kw_only=True):
    """A noise coefficient with its confidence bounds.

    The value and its bounds are never negative; `lo` is 0 where the curve can be explained without the term. Units are
    arcsec, deg/sqrt(h), deg/h, deg/h/sqrt(h) or deg/h/h. If the record does not show the term (`observable`), `hi` is
    the largest value that it allows, and `reason` says why.
    """

    value: float
    lo: float
    hi: float
    unit_of_measure: str
    observable: bool
    reason: str = ""


class MarkovNoise(msgspec.Struct, frozen=True, kw_only=True):
    """Correlated noise required beside the five terms: q of IEEE 952; its deviation is q sqrt(correlation time/2)."""

    amplitude: NoiseCoefficient
    correlation_s: float
    correlation_lo_s: float
    correlation_hi_s: float


class NoiseFit(msgspec.Struct, frozen=True, kw_only=True):
    """The coefficients of one Allan curve at `points` averaging times, with bounds at the level `confidence`.

    `markov` is the sixth term, where the curve requires it. `misfit` is the relative standard deviation, root mean
    square over the averaging times, by which the Allan deviation departs from the model beyond its own scatter; 0 where
    the model is not rejected. The bounds allow for it. `misfit_chance` is the p-value of the test of the model against
    the scatter of the curve; below 0.05 it is rejected.
    """

    quantization_noise: NoiseCoefficient
    angle_random_walk: NoiseCoefficient
    bias_instability: NoiseCoefficient
    rate_random_walk: NoiseCoefficient
    rate_ramp: NoiseCoefficient
    markov: MarkovNoise | None
    confidence: float
    points: int
    misfit: float = 0.0
    misfit_chance: float = 1.0


def fit_noise(points: Sequence[EstimatePoint], *, confidence: float = 0.95, held: float = 1.0) -> NoiseFit | NoEstimate:
    """Identify the noise coefficients Q, N, B, K, R, and a Markov term where the curve requires one.

    `points` are the overlapping Allan deviation in deg/h at any averaging times; those of 0, or of less than 1 degree
    of freedom, are left out; fewer than 6 others are a `NoEstimate`. `confidence`, between 0 and 1, is that of the
    bounds, of which the lower ones allow for averages that hold a share `held` of their samples (`held_share`).

    Notes
    -----
    Non-negative least squares on the variances, iteratively reweighted by edf/(2 m^2) of the fitted model m
    (`CurveLikelihood`). **Erratum**: the standards fit the same polynomial by unweighted least squares, which is
    dominated by the longest taus and returns negative squares.

    The degrees of freedom are those of the points. A first fit identifies the noises that prevail at each tau; a second
    takes the correlation between taus from them (`correlations`, where drift counts as random walk and Markov
    noise as flicker; below 30 degrees everything counts as random walk, which correlates most). Bounds are by profile
    likelihood, widened for that correlation and for the boundary at 0. With Markov noise they cover its
    correlation times as well.

    No sensor is the sum of five terms to the 1e-3 to which its shortest taus are known: its filter alone correlates
    neighbouring samples. Where the curve departs from the model by more than its scatter, a model error is estimated
    with it (`admitted`), so that a million degrees of freedom at one tau do not outweigh all others; the bounds cover
    the forms of that error and its own uncertainty.

    A misfit of the five terms indicates Markov noise only if the likelihood gains enough with the misfit
    re-estimated beside it. Noise with a correlation time below 64 times the shortest tau that leaves a misfit and
    replaces angle random walk is the effect of a filter, and is not reported as Markov noise.

    A term is observable where its lower bound is above 0. It can prevail at some tau and still not be observable:
    random walk and ramp often explain the same rise at the end of a record, and either may then be absent.

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
    numbers = np.array([(point.tau_s, point.value, point.edf) for point in points]).reshape(-1, 3)
    is_usable = np.isfinite(numbers).all(axis=1) & (numbers > 0.0).all(axis=1) & (numbers[:, 2] >= 1.0)
    taus_s, deviations, edf = numbers[is_usable][np.argsort(numbers[is_usable, 0], kind="stable")].T
    if points and not any(point.value > 0.0 for point in points):
        return NoEstimate("the Allan deviation is 0 at every averaging time: the output is constant; check the source")
    given = len(np.unique(taus_s))
    if given < LEAST_POINTS:
        return NoEstimate(f"{LEAST_POINTS} averaging times with a deviation above zero needed, {given} given")
    found = _fitted(taus_s.copy(), deviations.copy(), edf.copy(), confidence)
    return found if held == 1.0 else _of_held(found, math.sqrt(held))


def _of_held(found: NoiseFit, factor: float) -> NoiseFit:
    """A fit with lower bounds of that much less."""
    terms = {name: getattr(found, name) for name in found.__struct_fields__}
    lower: dict[str, NoiseCoefficient | MarkovNoise] = {
        name: msgspec.structs.replace(each, lo=each.lo * factor)
        for name, each in terms.items()
        if isinstance(each, NoiseCoefficient)
    }
    if (markov := found.markov) is not None:
        amplitude = msgspec.structs.replace(markov.amplitude, lo=markov.amplitude.lo * factor)
        lower["markov"] = msgspec.structs.replace(markov, amplitude=amplitude)
    return msgspec.structs.replace(found, **lower)


def _fitted(taus_s: FloatArray, deviations: FloatArray, edf: FloatArray, confidence: float) -> NoiseFit:
    scale = float(np.exp(np.mean(np.log(deviations))))
    variances = (deviations / scale) ** 2
    likelihoods = _weighed(taus_s, term_columns(taus_s), variances, edf)
    quantile = deviance_quantile(confidence)
    offer = _markov_noise(taus_s, variances, edf, likelihoods[0], quantile)
    if offer is None:
        found, markov = _coefficients(TERMS, likelihoods, quantile, scale), None
    else:
        likelihoods = _weighed(taus_s, _and_markov(taus_s, offer.correlation_s), variances, edf)
        tried = [
            likelihood.instead(markov_column(taus_s, float(time_s)) / variances)
            for likelihood in likelihoods
            for time_s in np.geomspace(offer.lo_s, offer.hi_s, _TRIED_TIMES)
        ]
        found = _coefficients((*TERMS, MARKOV_NOISE), [*likelihoods, *tried], quantile, scale)
        markov = MarkovNoise(
            amplitude=found.pop(MARKOV_NOISE.key),
            correlation_s=offer.correlation_s,
            correlation_lo_s=min(offer.lo_s, offer.correlation_s),
            correlation_hi_s=max(offer.hi_s, offer.correlation_s),
        )
    misfit = math.sqrt(float(np.mean(likelihoods[0].excess))) / 2.0
    tested = _of_mixture(likelihoods[0], taus_s, variances, edf) if misfit else likelihoods[0]
    chance = misfit_chance(tested)
    points = len(taus_s)
    return NoiseFit(**found, markov=markov, confidence=confidence, points=points, misfit=misfit, misfit_chance=chance)


def _and_markov(taus_s: FloatArray, correlation_s: float) -> FloatArray:
    return np.column_stack([term_columns(taus_s), markov_column(taus_s, correlation_s)])


def _markov_noise(
    taus_s: FloatArray, variances: FloatArray, edf: FloatArray, likelihood: CurveLikelihood, quantile: float
) -> Offer | None:
    """Markov noise that the curve requires beside the five terms of a likelihood; None if it requires none."""
    if not likelihood.excess.any():
        offer = best_markov(taus_s, variances, likelihood, quantile)
        return offer if offer is not None and offer.is_significant(offer.gain) else None
    # a misfit of the five terms may be the Markov noise itself: the misfit that remains beside it decides
    starts = _of_mixture(likelihood, taus_s, variances, edf), likelihood
    # the misfit estimated by moments is not the most likely one: where it is small, none may be likelier
    without = min(start.height() for start in starts)
    best, least = likelihood, without
    for start in starts:
        at = start
        for _ in range(_MOST_ROUNDS):
            offer = best_markov(taus_s, variances, at, quantile)
            if offer is None:
                return None
            whole = _weighed(taus_s, _and_markov(taus_s, offer.correlation_s), variances, edf)[0]
            if math.isinf(offer.bound) or _is_bandwidth(whole, offer.correlation_s, taus_s):
                break
            if whole.height() < least:
                best, least = whole, whole.height()
            is_settled = np.allclose(whole.excess, at.excess, rtol=_SETTLED)
            at = whole.without()
            if is_settled:
                break
    if best is likelihood:
        return None
    offer = best_markov(taus_s, variances, best.without(), quantile)
    gain = (without - least) * best.known_share()
    return offer if offer is not None and offer.is_significant(gain) else None


def _is_bandwidth(whole: CurveLikelihood, correlation_s: float, taus_s: FloatArray) -> bool:
    """Whether Markov noise of a short correlation time, and a misfit, replace white noise that a filter has passed."""
    theta = whole.minimum()[0] / whole.sizes
    is_short = correlation_s < _FILTER * taus_s[0]
    return bool(whole.excess.any() and is_short and theta[-1] * correlation_s**2 > theta[1])


def _weighed(taus_s: FloatArray, columns: FloatArray, variances: FloatArray, edf: FloatArray) -> list[CurveLikelihood]:
    """Likelihoods with the correlations of the noises found by a first fit; best first."""
    first = CurveLikelihood(columns, variances, edf, np.eye(len(edf)))
    likelihoods = admitted(_of_mixture(first, taus_s, variances, edf), taus_s)
    if likelihoods[0].excess.any():
        likelihoods = admitted(_of_mixture(likelihoods[0], taus_s, variances, edf), taus_s)
    return likelihoods


def _of_mixture(fitted: CurveLikelihood, taus_s: FloatArray, variances: FloatArray, edf: FloatArray) -> CurveLikelihood:
    theta, _ = fitted.minimum()
    parts = fitted.columns * theta * variances[:, np.newaxis]
    mixture = parts[:, :4].copy()
    mixture[:, 3] += parts[:, 4]
    mixture[:, 2] += parts[:, 5:].sum(axis=1)
    # with few windows the fit cannot separate the noises: the one that correlates most is assumed
    is_unsure = edf < KNOWN_DEGREES
    mixture[is_unsure] = np.array([0.0, 0.0, 0.0, 1.0]) * variances[is_unsure, np.newaxis]
    correlation = correlations(taus_s, mixture)
    return CurveLikelihood(fitted.columns * fitted.sizes, np.ones(len(edf)), edf, correlation)


def _coefficients(
    terms: tuple[Term, ...], likelihoods: list[CurveLikelihood], quantile: float, scale: float
) -> dict[str, NoiseCoefficient]:
    """Coefficients of the first likelihood; their bounds cover all of them."""
    best = likelihoods[0]
    minima = [likelihood.minimum() for likelihood in likelihoods]
    theta, least = minima[0]
    heights = [likelihood.constant() - best.constant() for likelihood in likelihoods]
    spread = best.spread(theta, quantile)
    found = {}
    for which, term in enumerate(terms):
        inflation = best.inflation(theta, which)
        allowed = least + spread * inflation
        squares = [(theta[which] / best.sizes[which],) * 2]
        squares += [
            tuple(
                np.array(likelihood.bounds(minimum, least - height, spread, which, inflation)) / likelihood.sizes[which]
            )
            for likelihood, (minimum, lowest), height in zip(likelihoods, minima, heights, strict=True)
            if lowest + height < allowed
        ]
        ends = min(lo for lo, _ in squares), max(hi for _, hi in squares)
        value, lo, hi = (math.sqrt(square) * scale * term.per_si for square in (squares[0][0], *ends))
        is_seen = lo > 0.0
        found[term.key] = NoiseCoefficient(
            value=value, lo=lo, hi=hi, unit_of_measure=term.unit_of_measure, observable=is_seen,
            reason="" if is_seen else f"not observable in this record: at most {hi:.3g} {term.unit_of_measure}",
        )  # fmt: skip
    return found
