"""Plausible noise exponents at each averaging time of an Allan curve, and the least degrees of freedom.

Noise of a power law S_y(f) ~ f**alpha fixes the ratio of its Allan variances at two averaging times. Over an octave
that ratio is equivalent to the lag-1 autocorrelation method (W. J. Riley, C. A. Greenhall, Power law noise
identification using the lag 1 autocorrelation, Proc. 18th EFTF (2004) 576-580, DOI 10.1049/cp:20040932; NIST SP 1065,
section 5.5.6): with r1 and r2 the autocorrelations of the differences of adjacent averages over tau,

    AVAR(2 tau)/AVAR(tau) = (6 + 8 r1 + 2 r2)/4,

so that the curve alone is enough.
"""

import math
from functools import lru_cache
from itertools import pairwise

import msgspec
import numpy as np
import scipy

from stream.batch import BoolArray, FloatArray, IntArray
from stream.errors import EstimatorError
from stream.estimators.confidence import NOISE_EXPONENTS, basic_sum, edf, sx, sz

# two-sided levels of 5 and 1 %
_UNLIKELY, _EXCLUDED = 1.96, 2.58
_SPAN, _NEAR, _LONG = 4.0, 2.0, 64.0
_ENDLESS = 10**15
_SECOND_DIFFERENCE = ((-1, 1.0), (0, -2.0), (1, 1.0))
_LEAST_RATIO = 1.4
# beyond it the Allan variances of sampled flicker and its power law differ by less than 1e-4
_SMALL = 256


class Identified(msgspec.Struct, frozen=True, kw_only=True):
    """Noise at one averaging time.

    `exponent` is the alpha of S_y(f) ~ f**alpha, 2 .. -2, that agrees best with the curve; `plausible` are all that
    agree, from 2 down, without holes; `edf` are the least equivalent degrees of freedom of these.
    """

    exponent: int
    plausible: tuple[int, ...]
    edf: float


class _Comparison(msgspec.Struct, frozen=True, eq=False):
    """The two variances that are compared, for exponents (rows) and averaging times (columns).

    `early` and `late` are their indices in the curve; ln(AVAR(late)/AVAR(early)) is expected from `lo` to `hi`,
    infinite where the two are less than half an octave apart; `correlation` is that of the two variances.
    """

    early: IntArray
    late: IntArray
    lo: FloatArray
    hi: FloatArray
    correlation: FloatArray


class _Scatter(msgspec.Struct, frozen=True, eq=False):
    """Degrees of freedom for exponents (rows) and averaging times (columns).

    `means` and `spreads` are mean and variance of the logarithm of a chi-square over its degrees of freedom.
    """

    degrees: FloatArray
    means: FloatArray
    spreads: FloatArray

    def of(self, row: int) -> "_Scatter":
        """That of one exponent."""
        rows = slice(row, row + 1)
        return _Scatter(self.degrees[rows], self.means[rows], self.spreads[rows])


def identify(factors: IntArray, variances: FloatArray, windows: IntArray, strides: IntArray) -> tuple[Identified, ...]:
    """Plausible noise exponents at each averaging time of an Allan curve.

    Parameters
    ----------
    factors: shape (n,); averaging times over the sample interval, ascending.
    variances: shape (n,); overlapping Allan variances in any unit.
    windows: shape (n,); how many squares each averages, at least 1.
    strides: shape (n,); averaging time over the distance of neighbouring windows.

    Notes
    -----
    With m the averaging factor and s the one nearest m/4, alpha is plausible at m if

        abs(ln(AVAR(m)/AVAR(s)) - E) <= 1.96 S,

    a test at the level of 5 %. ln of a chi-square over its nu degrees of freedom has the mean psi(nu/2) - ln(nu/2) and
    the variance psi'(nu/2); E is the ratio expected for alpha plus the difference of the means, and
    S**2 = psi'_m + psi'_s - 2 rho (psi'_m psi'_s)**0.5, all with the degrees of alpha itself and rho the correlation of
    the two variances. Factors within the first two octaves share the test of these. Further rules:

    - Flicker of angle (1) differs from quantisation (2) by a logarithm of tau: too little over two octaves, and
      too little to dominate it within six. The curve must not be too steep for it over the six octaves before m.
    - Quantisation and white noise together resemble flicker of angle. Where quantisation alone is excluded (1 %), it
      suffices that white noise agrees over the one octave before m, where quantisation fades sooner.
    - Where no exponent agrees, the closest is plausible; where all are excluded (1 %), as in a well-known mixture, the
      two between which the curve runs. Exponents between plausible ones are plausible.

    Nothing else is inferred from shorter averaging times: noise may turn red anywhere, and Markov noise white again.
    In the last octaves the tests are weak, and more exponents remain. All five remain where a variance is 0 or there
    is no second averaging time.

    `edf` holds for noise averaged over the sample interval. Sampled white noise has 15 % less at m = 1, random walk
    30 % more; the degrees of the next higher exponent are used there, which fit both to a fifth.

    Examples
    --------
    >>> factors = 2 ** np.arange(12)
    >>> noise = identify(factors, 1.0 / factors, 4096 - 2 * factors + 1, factors)
    >>> noise[6].exponent, noise[6].plausible, round(noise[6].edf)
    (0, (0,), 92)
    """
    n = len(factors)
    if not n == len(variances) == len(windows) == len(strides) or (np.diff(factors) <= 0).any():
        raise EstimatorError("an Allan curve needs as many variances, windows and strides as ascending factors")
    if n == 0:
        return ()
    scatter = _scatter(tuple(factors.tolist()), tuple(windows.tolist()), tuple(strides.tolist()))
    logs = np.log(np.where(np.isfinite(variances) & (variances > 0.0), variances, np.nan))
    times = tuple(factors.tolist()), tuple(strides.tolist())
    deviates = _deviates(_comparison(*times, NOISE_EXPONENTS, _SPAN), logs, scatter)
    quantisation, flicker, white = deviates[:3]
    long = _deviates(_comparison(*times, NOISE_EXPONENTS[1:2], _LONG), logs, scatter.of(1))[0]
    flicker[:] = np.where(long < -np.abs(flicker), long, flicker)
    near = _deviates(_comparison(*times, NOISE_EXPONENTS[2:3], _NEAR), logs, scatter.of(2))[0]
    white[:] = np.where((quantisation > _EXCLUDED) & (np.abs(near) < np.abs(white)), near, white)
    return _identified(deviates, scatter.degrees)


@lru_cache(maxsize=1024)
def _scatter(factors: tuple[int, ...], windows: tuple[int, ...], strides: tuple[int, ...]) -> _Scatter:
    """That of each exponent at each averaging time, not to be changed; signals of one length share it."""
    counts = list(zip(factors, windows, strides, strict=True))
    degrees = np.array([[edf(alpha, 2, *count) for count in counts] for alpha in NOISE_EXPONENTS])
    if factors[0] == 1:
        degrees[1:, 0] = degrees[:-1, 0].copy()
    means = scipy.special.digamma(degrees / 2.0) - np.log(degrees / 2.0)
    return _Scatter(degrees, means, scipy.special.zeta(2.0, degrees / 2.0))  # psi', the first polygamma


def _deviates(expected: _Comparison, logs: FloatArray, scatter: _Scatter) -> FloatArray:
    """Standardised distance of each log ratio from that expected for each exponent, positive where it is redder."""
    rows = np.arange(len(scatter.degrees))[:, np.newaxis]
    means, spreads = scatter.means, scatter.spreads
    a, b = spreads[rows, expected.early], spreads[rows, expected.late]
    deviation = np.sqrt(a + b - 2.0 * expected.correlation * np.sqrt(a * b))
    ratio = logs[expected.late] - logs[expected.early] - (means[rows, expected.late] - means[rows, expected.early])
    distance = ratio - np.clip(ratio, expected.lo, expected.hi)
    deviates: FloatArray = np.where(np.isnan(distance), 0.0, distance / deviation)
    return deviates


def _identified(deviates: FloatArray, degrees: FloatArray) -> tuple[Identified, ...]:
    sizes = np.abs(deviates)
    chosen: BoolArray = sizes <= _UNLIKELY
    for i in np.flatnonzero(~chosen.any(axis=0)).tolist():
        _choose_nearest(chosen[:, i], deviates[:, i], sizes[:, i])
    chosen = np.logical_or.accumulate(chosen) & np.logical_or.accumulate(chosen[::-1])[::-1]  # without holes
    nearest = np.argmin(np.where(chosen, sizes, np.inf), axis=0).tolist()
    least = np.where(chosen, degrees, np.inf).min(axis=0).tolist()
    plausible = [
        tuple(alpha for alpha, is_chosen in zip(NOISE_EXPONENTS, column, strict=True) if is_chosen)
        for column in chosen.T.tolist()
    ]
    return tuple(
        Identified(exponent=NOISE_EXPONENTS[at], plausible=alphas, edf=own)
        for at, alphas, own in zip(nearest, plausible, least, strict=True)
    )


def _choose_nearest(chosen: BoolArray, deviates: FloatArray, sizes: FloatArray) -> None:
    """Choose where no exponent agrees: the closest, or those between which the curve runs where all are excluded."""
    chosen[int(np.argmin(sizes))] = True
    is_excluded = sizes.min() > _EXCLUDED
    is_redder = (deviates > 0.0).tolist()
    for i, (before, after) in enumerate(pairwise(is_redder)):
        if before and not after and is_excluded:
            chosen[i : i + 2] = True


@lru_cache(maxsize=256)
def _comparison(
    factors: tuple[int, ...], strides: tuple[int, ...], exponents: tuple[int, ...], span: float
) -> _Comparison:
    """Compare each averaging time with the one nearest to it over the `span`; the first two octaves share their end.

    The expected ratio lies between that of noise averaged over the sample interval and that of sampled noise, which
    differ for averages of few samples.
    """
    logs = np.log(np.array(factors, np.float64))
    shape = (len(exponents), len(factors))
    first = int(np.argmin(np.abs(logs - logs[0] - math.log(_SPAN))))
    late = np.maximum(np.arange(len(factors)), first)
    early = np.argmin(np.abs(logs[:, np.newaxis] - logs[late] + math.log(span)), axis=0)
    lo, hi, shared = np.full(shape, -math.inf), np.full(shape, math.inf), np.zeros(shape)
    for row, alpha in enumerate(exponents):
        laws = np.array([(_averaged(factor, alpha), _sampled(factor, alpha)) for factor in factors])
        for i, (a, b) in enumerate(zip(early.tolist(), late.tolist(), strict=True)):
            if factors[b] >= _LEAST_RATIO * factors[a]:
                ratios = laws[b] - laws[a]
                lo[row, i], hi[row, i] = ratios.min(), ratios.max()
                shared[row, i] = _correlation(alpha, factors[a], strides[a], factors[b], strides[b])
    return _Comparison(np.broadcast_to(early, shape), np.broadcast_to(late, shape), lo, hi, shared)


def _averaged(factor: int, alpha: int) -> float:
    """Logarithm of AVAR, up to a constant, of averaged noise: tau**(-1 - alpha) sz(0), equation (9) of `confidence`."""
    size = abs(float(sz(np.zeros(1), factor, alpha, 2)[0]))
    return math.log(size) - (1.0 + alpha) * math.log(factor)


@lru_cache(maxsize=4096)
def _sampled(factor: int, alpha: int) -> float:
    """Logarithm of AVAR, up to a constant, of white samples, of their differences and sums, and of those of half order.

    Samples of alpha = -1, and the sums of those of alpha = 1, have the density 1/abs(2 sin(pi f)) and hence the
    generalised autocovariance -h(k), h(k) = 1 + 1/3 + .. + 1/(2 k - 1) = (psi(k + 1/2) - psi(1/2))/2: N. J. Kasdin,
    T. Walter, Discrete simulation of power law noise, Proc. 1992 IEEE FCS, DOI 10.1109/FREQ.1992.270003.
    """
    power = -(1.0 + alpha) * math.log(factor)
    if alpha == 1:
        h = scipy.special.digamma(np.array([factor, 2 * factor]) + 0.5) - scipy.special.digamma(0.5)
        return power + math.log(4.0 * h[0] - h[1])
    if alpha == -1:
        size = min(factor, _SMALL)
        lags = np.arange(2 * size)
        weights = 2.0 * np.maximum(0, size - lags) - np.maximum(0, size - np.abs(lags - size))
        h = scipy.special.digamma(lags + 0.5) - scipy.special.digamma(0.5)
        return math.log(-float(weights @ h) / size**2)
    return power + (math.log1p(0.5 / factor**2) if alpha == -2 else 0.0)


@lru_cache(maxsize=8192)
def _correlation(alpha: int, short: int, short_stride: int, long: int, long_stride: int) -> float:
    """Correlation of the overlapping Allan variances at two averaging times of one record long against both.

    For Gaussian noise the covariance of two averages of squares is twice the mean square of the covariance C_ab
    between what is squared (Isserlis). With r_ab = C_ab/(C_aa(0) C_bb(0))**0.5 and h the distances of windows,

        rho = sum r_ab**2 h_a / (sum r_aa**2 h_a sum r_bb**2 h_b)**0.5.
    """
    ratio = long / short
    reach = math.ceil((2.0 + 2.0 * ratio) * short_stride)
    t = np.arange(-reach, reach + 1) / short_stride
    cross, own = np.zeros_like(t), np.zeros(1)
    for i, a in _SECOND_DIFFERENCE:
        for j, b in _SECOND_DIFFERENCE:
            cross += a * b * sx(t + i - j * ratio, short, alpha)
            own += a * b * sx(np.array([(i - j) * ratio]), short, alpha)
    squares = float(np.sum(cross**2)) / float(own[0] * sz(np.zeros(1), short, alpha, 2)[0])
    of_short = basic_sum(_ENDLESS, short, short_stride, alpha, 2) * short / short_stride
    of_long = basic_sum(_ENDLESS, long, long_stride, alpha, 2) * long / long_stride
    return min(1.0, squares * (short / short_stride) / math.sqrt(of_short * of_long))
