"""Model error: how far an Allan curve departs from every sum of the terms beyond its own scatter."""

from functools import cache

import numpy as np

from stream.batch import FloatArray
from stream.estimators.noise.noise_likelihood import CurveLikelihood
from stream.estimators.noise.root_between import root_between

SIGNIFICANCE = 0.05
REACHES = (0.0, 4.0, 16.0, 64.0, 1024.0)
_LEAST, _MOST = 1e-10, 1e6
_TOLERANCE = 1e-6


def admitted(likelihood: CurveLikelihood, taus_s: FloatArray) -> list[CurveLikelihood]:
    """Likelihoods that allow for a model error, the most likely first; the given one alone if it fits.

    The model fits if its deviance is not above the 95 % quantile for scatter alone. If it is, the relative
    variance at tau is 2/edf + s^2 w(tau), as in the random-effects analysis of R. DerSimonian, N. Laird, Controlled
    Clinical Trials 7 (1986) 177-188, and s^2 the value that lowers the deviance to its mean.

    The effect of a sensor's filter, or of a line near the sampling rate, on white noise falls off as 1/tau beyond its
    time constant; other errors occur at any tau. Hence

        w = 1 + (r tau_1/tau)^2,

    tau_1 the shortest averaging time. The reach r of the first kind is one of 0, 4, 16, 64 and 1024, by likelihood; the
    result contains one of each. Errors are smooth in tau: their correlation falls to 0 over an octave, and points in
    between do not count as more evidence.
    """
    from scipy.special import chdtri

    theta, least = likelihood.minimum()
    mean, degrees = likelihood.freedom(theta)
    if degrees < 1.0 or least <= mean / degrees * chdtri(degrees, SIGNIFICANCE):
        return [likelihood]
    octaves = np.log2(taus_s)
    alike = np.clip(1.0 - np.abs(octaves[:, np.newaxis] - octaves), 0.0, 1.0)
    shapes = [1.0 + (reach * taus_s[0] / taus_s) ** 2 for reach in REACHES]
    return sorted((_admitting(likelihood, shape, alike) for shape in shapes), key=CurveLikelihood.height)


def misfit_chance(likelihood: CurveLikelihood) -> float:
    """Probability of a deviance at least this large if the noise is a sum of the terms; the test of `admitted`."""
    from scipy.special import chdtrc

    theta, least = likelihood.minimum()
    mean, degrees = likelihood.freedom(theta)
    return 1.0 if degrees < 1.0 else float(chdtrc(degrees, least * degrees / mean))


def _admitting(likelihood: CurveLikelihood, shape: FloatArray, alike: FloatArray) -> CurveLikelihood:
    @cache
    def widened(logarithm: float) -> CurveLikelihood:
        return likelihood.widened(np.exp(logarithm) * shape / np.mean(shape), alike)

    @cache
    def surplus(logarithm: float) -> float:
        each = widened(logarithm)
        theta, least = each.minimum()
        return least - each.freedom(theta)[0]

    least, most = float(np.log(_LEAST)), float(np.log(_MOST))
    if surplus(least) <= 0.0:
        return widened(least)
    if surplus(most) >= 0.0:
        return widened(most)
    return widened(root_between(surplus, least, most, absolute=_TOLERANCE))
