"""Noise coefficients as a table in English and Chinese."""

from analytics.curves.allan_curve import AllanCurve
from analytics.curves.noise_coefficients import CONFIDENCE, NoiseCoefficients
from stream.estimators.base import NoEstimate
from stream.estimators.noise.noise_fit import NoiseCoefficient
from stream.estimators.noise.noise_misfit import SIGNIFICANCE
from stream.result_table import ResultTable

_NOT_OBSERVABLE = "not observable (不可观测): at most"
_NONE = "\N{EN DASH}"


def noise_table(curve: AllanCurve, found: NoiseCoefficients) -> ResultTable:
    """Table of the coefficients with their bounds; of one that is not observable, the upper bound.

    Examples
    --------
    >>> from analytics.curves.noise_coefficients import noise_coefficients
    >>> taus = tuple(0.1 * 2.0**k for k in range(16))
    >>> adev = tuple(0.6 / tau**0.5 for tau in taus)
    >>> curve = AllanCurve("FOG-1", "rate", "r1", "deg/h", 0.1, 100_000, 0, taus, adev, adev, adev,
    ...                    tuple(1e4 / tau for tau in taus))
    >>> table = noise_table(curve, noise_coefficients(curve, NoEstimate("sample interval of 0.1 s")))
    >>> list(table.columns[0].cells)[1], list(table.columns[2].cells)[1]
    ('Angle random walk 角度随机游走', '0.01000')
    """
    table = ResultTable(
        title=f"Noise coefficients (噪声系数) of {curve.unit} {curve.signal}, run {curve.run}",
        caption=f"IEEE 952-2020 annex C; limits: {CONFIDENCE * 100:g} % confidence; {_agreement(found, curve)}; "
        "normalised (归一化法): GJB 2426A-2004 5.12.5.4.1, from the samples",
    )
    table.add_column("noise 噪声", overflow="fold")
    table.add_column("")
    for title in ("value", "from", "to"):
        table.add_column(title, justify="right")
    table.add_column("unit")
    table.add_column("remark 备注")
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
