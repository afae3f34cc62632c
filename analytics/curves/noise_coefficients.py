"""Noise coefficients of a stored Allan curve: the fit, its terms, their JSON, and their table in two languages."""

import dataclasses
import math
from typing import Any

import msgspec
import numpy as np

from analytics.curves.allan_curve import AllanCurve
from stream.batch import FloatArray
from stream.defects.outliers import IsolatedOutliers
from stream.estimators.base import NoEstimate, held_share
from stream.estimators.noise.noise_fit import NoiseCoefficient, NoiseFit, fit_noise
from stream.estimators.noise.noise_misfit import SIGNIFICANCE
from stream.estimators.noise.noise_model import (
    ANGLE_RANDOM_WALK,
    MARKOV_NOISE,
    TERMS,
    Term,
    markov_column,
    term_columns,
)
from stream.events import EstimatePoint
from stream.quantities import ANGULAR_RATE_UNIT
from stream.terminal.result_table import ResultTable

CONFIDENCE = 0.95
MOST_MISFIT = 0.25
_NOT_OBSERVABLE = "not observable (不可观测): at most"
_NONE = "\N{EN DASH}"


@dataclasses.dataclass(frozen=True)
class FittedTerm:
    """One term of a fitted model; `correlation_s` is the correlation time of Markov noise, None for the others."""

    term: Term
    coefficient: NoiseCoefficient
    correlation_s: float | None = None

    def variance(self, taus_s: FloatArray) -> FloatArray:
        """Its share of the fitted Allan variance, (deg/h)**2, at averaging times in seconds."""
        if self.correlation_s is None:
            column = term_columns(taus_s)[:, TERMS.index(self.term)]
        else:
            column = markov_column(taus_s, self.correlation_s)
        return np.asarray(column * (self.coefficient.value / self.term.per_si) ** 2, np.float64)


@dataclasses.dataclass(frozen=True)
class NoiseCoefficients:
    """Noise coefficients of one signal, fitted to its Allan curve."""

    fit: NoiseFit
    # angle random walk by normalised bias stability (GJB 2426A-2004 5.12.5.4.1), or why there is none
    normalised: NoiseCoefficient | NoEstimate

    @property
    def terms(self) -> tuple[FittedTerm, ...]:
        """The five terms, and the Markov term if there is one."""
        terms = tuple(FittedTerm(term, getattr(self.fit, term.key)) for term in TERMS)
        markov = self.fit.markov
        return terms if markov is None else (*terms, FittedTerm(MARKOV_NOISE, markov.amplitude, markov.correlation_s))

    def deviation(self, taus_s: FloatArray) -> FloatArray:
        """Allan deviation of the fitted model, all terms together, deg/h."""
        return np.asarray(np.sqrt(np.sum([term.variance(taus_s) for term in self.terms], axis=0)), np.float64)

    @property
    def describes(self) -> bool:
        """Whether the model describes the curve at all, so that it is worth drawing."""
        return self.fit.misfit <= MOST_MISFIT

    def farthest(self, curve: AllanCurve) -> tuple[float, float]:
        """Averaging time of the largest departure of the model beyond the bounds of a curve; model over curve there.

        The ratio is 1 where the model lies within the bounds everywhere.
        """
        model = self.deviation(np.array(curve.tau_s)).tolist()
        columns = zip(curve.tau_s, model, curve.adev, curve.lo, curve.hi, strict=True)
        outside = [(tau_s, y / adev) for tau_s, y, adev, lo, hi in columns if not lo <= y <= hi and adev > 0]
        return max(outside, key=lambda each: abs(math.log(each[1])), default=(curve.tau_s[0], 1.0))

    def agreeing(self, curve: AllanCurve) -> int:
        """At how many averaging times of a curve the model lies within the bounds of its deviation."""
        model = self.deviation(np.array(curve.tau_s))
        return int(np.count_nonzero((np.array(curve.lo) <= model) & (model <= np.array(curve.hi))))

    def document(self) -> dict[str, Any]:
        """The coefficients as JSON, with bounds; one that is not observable has no value, `hi` is its upper bound."""
        terms = {term.key: _term_document(getattr(self.fit, term.key)) for term in TERMS}
        markov = self.fit.markov
        if isinstance(self.normalised, NoEstimate):
            missing = dict.fromkeys(("value", "lo", "hi"))
            unit = {"unit_of_measure": ANGLE_RANDOM_WALK.unit_of_measure}
            normalised = missing | unit | {"observable": False, "reason": self.normalised.reason}
        else:
            normalised = _term_document(self.normalised)
        return {
            **terms,
            "markov": markov and msgspec.to_builtins(markov) | {"amplitude": _term_document(markov.amplitude)},
            "angle_random_walk_normalised": normalised,
        }


def _term_document(coefficient: NoiseCoefficient) -> dict[str, Any]:
    document: dict[str, Any] = msgspec.to_builtins(coefficient)
    return document if coefficient.observable else document | {"value": None}


def noise_coefficients(curve: AllanCurve, normalised: NoiseCoefficient | NoEstimate) -> NoiseCoefficients | NoEstimate:
    """Fit the noise model of IEEE 952 to an overlapping Allan deviation.

    NoEstimate where the signal is no angular rate, or the curve too short or zero throughout; `normalised` is that of
    the same signal, see `normalised_walk`.

    >>> taus = tuple(0.1 * 2.0**k for k in range(16))
    >>> adev = tuple(60.0 * 0.01 / tau**0.5 for tau in taus)
    >>> curve = AllanCurve("FOG-1", "rate", "r1", "deg/h", 0.1, 100_000, 0, taus, adev, adev, adev,
    ...                    tuple(1e4 / tau for tau in taus))
    >>> found = noise_coefficients(curve, NoEstimate("sample interval of 0.1 s"))
    >>> round(found.fit.angle_random_walk.value, 6), found.document()["angle_random_walk"]["unit_of_measure"]
    (0.01, 'deg/sqrt(h)')
    >>> noise_coefficients(dataclasses.replace(curve, unit_of_measure="degC"), NoEstimate("")).reason[:52]
    'unit FOG-1, signal rate, run r1: the signal is in de'
    """
    who = f"unit {curve.unit}, signal {curve.signal}, run {curve.run}"
    if curve.unit_of_measure != ANGULAR_RATE_UNIT:
        return NoEstimate(
            f"{who}: the signal is in {curve.unit_of_measure}, the noise coefficients of IEEE 952 are those of an "
            "angular rate; choose a signal in deg/s, deg/h or rad/s"
        )
    noises = curve.plausible or ((),) * len(curve.tau_s)
    columns = zip(curve.tau_s, curve.adev, curve.lo, curve.hi, curve.edf, noises, strict=True)
    points = [
        EstimatePoint(tau_s=tau_s, value=y, lo=lo, hi=hi, edf=edf, n=0, plausible=noise)
        for tau_s, y, lo, hi, edf, noise in columns
    ]
    fit = fit_noise(points, confidence=CONFIDENCE, held=held_share(curve.samples, curve.missing))
    if isinstance(fit, NoEstimate):
        return NoEstimate(f"{who}: {fit.reason}")
    return NoiseCoefficients(fit, normalised)


def curve_document(
    curve: AllanCurve, found: NoiseCoefficients | NoEstimate, outliers: IsolatedOutliers | None = None
) -> dict[str, Any]:
    """A curve and its coefficients, or the reason why there are none, as one JSON document."""
    return {
        **curve.document(),
        "coefficients": None if isinstance(found, NoEstimate) else found.document(),
        "coefficients_reason": found.reason if isinstance(found, NoEstimate) else None,
        "misfit": None if isinstance(found, NoEstimate) else found.fit.misfit,
        "misfit_probability": None if isinstance(found, NoEstimate) else found.fit.misfit_chance,
        "misfit_level": SIGNIFICANCE,
        "confidence": CONFIDENCE,
        "outliers": None if outliers is None else dataclasses.asdict(outliers),
    }


def noise_table(curve: AllanCurve, found: NoiseCoefficients) -> ResultTable:
    """Table of the coefficients with their bounds; of one that is not observable, the upper bound."""
    table = ResultTable(
        title=f"Noise coefficients (噪声系数) of {curve.unit} {curve.signal}, run {curve.run}",
        caption=f"IEEE 952-2020 annex C; limits: {CONFIDENCE * 100:g} % confidence; {_agreement(found, curve)}; "
        "normalised (归一化法): GJB 2426A-2004 5.12.5.4.1, from the samples",
    )
    table.add_column("noise 噪声", overflow="fold")
    for title in ("", "value", "from", "to", "unit", "remark 备注"):
        table.add_column(title, justify="right" if title in {"value", "from", "to"} else "left")
    for fitted in found.terms:
        names, coefficient = fitted.term.names, fitted.coefficient
        table.add_row(f"{names['en']} {names['zh']}", fitted.term.symbol, *_cells(coefficient))
    markov = found.fit.markov
    if markov is not None:
        times = (markov.correlation_s, markov.correlation_lo_s, markov.correlation_hi_s)
        table.add_row("Its correlation time 相关时间", "", *(f"{time_s:.4g}" for time_s in times), "s", "")
    name = "Angle random walk, normalised 角度随机游走(归一化法)"
    normalised = found.normalised
    if isinstance(normalised, NoEstimate):
        unit = found.fit.angle_random_walk.unit_of_measure
        table.add_row(name, "RWC", _NONE, _NONE, _NONE, unit, normalised.reason)
    else:
        table.add_row(name, "RWC", *_cells(normalised))
    return table


def _agreement(found: NoiseCoefficients, curve: AllanCurve) -> str:
    test = f"at the {SIGNIFICANCE:.0%} level (p = {found.fit.misfit_chance:.2g}"
    if found.fit.misfit == 0.0:
        return f"a test does not reject the sum of the terms {test}; 检验未拒绝模型)"
    at_s, ratio = found.farthest(curve)
    if not found.describes:
        return (
            f"these terms do not describe the curve (模型不适用), which departs from them by {found.fit.misfit:.0%}: "
            "was the unit at rest? `gyrofleet spectrum` and --rolling show more"
        )
    return (
        f"a test rejects the sum of the terms {test}, as for about {SIGNIFICANCE:.0%} of records of such noise; "
        f"检验拒绝模型): estimated misfit (失配) {found.fit.misfit:.1%}; the model is {abs(ratio - 1):.0%} too "
        f"{'high' if ratio > 1 else 'low'} at {at_s:g} s, {found.agreeing(curve)} of {len(curve.tau_s)} points agree "
        "within their limits; the limits of the coefficients are widened for it"
    )


def _cells(coefficient: NoiseCoefficient) -> tuple[str, str, str, str, str]:
    unit = coefficient.unit_of_measure
    if not coefficient.observable:
        return _NONE, _NONE, _NONE, unit, f"{_NOT_OBSERVABLE} {coefficient.hi:.3g}"
    return f"{coefficient.value:#.4g}", f"{coefficient.lo:#.4g}", f"{coefficient.hi:#.4g}", unit, ""
