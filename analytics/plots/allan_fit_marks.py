"""The fitted noise model on a plot of Allan deviations: its sum and its terms with their coefficients."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from analytics.curves.noise_coefficients import FittedTerm, NoiseCoefficients
from analytics.plots.allan_marks import INK
from stream.batch import FloatArray

# dashes and colours both tell the terms apart; none is the blue of the curve
_STYLES = {
    "quantization_noise": ("#cc79a7", (0, (1.5, 1.5))),
    "angle_random_walk": ("#d55e00", (0, (5, 2))),
    "bias_instability": ("#009e73", (0, (5, 2, 1, 2))),
    "rate_random_walk": ("#7a4fa3", (0, (8, 3))),
    "rate_ramp": ("#6b4423", (0, (3, 1.5))),
    "markov_noise": ("#b88600", (0, (5, 1.5, 1, 1.5, 1, 1.5))),
}
_PLACES = 200
_FELT = 0.02
_MAY_BE_ABSENT = {"en": ", not observable", "zh": "，不可观测"}


def draw_fit(axes: Axes, found: NoiseCoefficients, taus_s: tuple[float, ...], language: str, word: str) -> None:
    """Draw a fitted model over the curve it was fitted to, and a legend of its terms.

    Parameters
    ----------
    axes: Logarithmic axes in seconds and deg/h, with their limits set and everything else drawn.
    taus_s: Averaging times of the curve, increasing: the sum of all terms is drawn between the first and the last.
    language: Of the terms' names, ``en`` or ``zh``.
    word: Name of the sum of all terms.
    """
    along = np.geomspace(taus_s[0], taus_s[-1], _PLACES)
    lines = axes.plot(along, found.deviation(along), color=INK, linewidth=0.9, zorder=4, label=word)
    whole = np.geomspace(*axes.get_xlim(), _PLACES)
    for fitted in found.terms:
        # a term that is not observable changes the sum where it is not zero
        if fitted.coefficient.observable or _is_felt(fitted, found, along):
            lines.append(_term(axes, whole, fitted, language))
    legend = axes.legend(
        handles=lines,
        loc="best",
        fontsize=7,
        handlelength=3.2,
        labelspacing=0.35,
        borderpad=0.5,
        borderaxespad=0.8,
        framealpha=0.92,
        edgecolor="#dfe3e8",
        fancybox=False,
        labelcolor=INK,
    )
    legend.set_zorder(7)


def _is_felt(fitted: FittedTerm, found: NoiseCoefficients, taus_s: FloatArray) -> bool:
    return bool((fitted.variance(taus_s) > _FELT * found.deviation(taus_s) ** 2).any())


def _term(axes: Axes, taus_s: FloatArray, fitted: FittedTerm, language: str) -> Line2D:
    colour, dashes = _STYLES[fitted.term.key]
    deviations = np.sqrt(fitted.variance(taus_s))
    is_seen = fitted.coefficient.observable
    label = f"{fitted.term.names[language]}  {fitted.term.symbol} = {_amount(fitted)}"
    if not is_seen:
        label += _MAY_BE_ABSENT[language]
    if fitted.correlation_s is not None:
        label += f", {fitted.correlation_s:.3g} s"
    (line,) = axes.plot(
        taus_s, deviations, color=colour, linewidth=0.95 if is_seen else 0.6, linestyle=dashes, zorder=3.5, label=label
    )
    return line


def _amount(fitted: FittedTerm) -> str:
    """Value and bounds with enough digits to distinguish them, three at least."""
    coefficient = fitted.coefficient
    value, lo, hi = coefficient.value, coefficient.lo, coefficient.hi
    width = max(hi - lo, 1e-5 * value)
    digits = max(3, math.ceil(math.log10(value / width)) + 1) if value > 0.0 else 3
    unit = coefficient.unit_of_measure.replace("sqrt(h)", "\N{SQUARE ROOT}h")
    return f"{value:.{digits}g} ({lo:.{digits}g} \N{EN DASH} {hi:.{digits}g}) {unit}"
