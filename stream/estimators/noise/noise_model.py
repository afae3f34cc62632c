"""The noise model of IEEE 952: its five terms and the Markov term as functions of the averaging time, and their units.

sigma^2(tau) = 3 Q^2/tau^2 + N^2/tau + (2 ln 2/pi) B^2 + K^2 tau/3 + R^2 tau^2/2, IEEE 952-2020 annex C;
JJF 2014-2022 7.2.20 (39), GJB 2426A-2004 5.12.5.4.2 (31) as the polynomial sum of A_m tau^m, m = -2 .. 2.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType

import msgspec
import numpy as np

from stream.batch import FloatArray

FLICKER = 2.0 * math.log(2.0) / math.pi
LATTICE = 16
_FARTHEST = 64
_SMALL = (0.0, 1.0 / 3.0, -1.0 / 4.0, 7.0 / 60.0, -1.0 / 24.0, 31.0 / 2520.0)
_SECOND_DIFFERENCE = (1.0, -2.0, 1.0)


class Term(msgspec.Struct, frozen=True, kw_only=True):
    """One term of the model.

    `key` is its name in files, `symbol` its letter in IEEE 952, `names` its names for people by language (``en``,
    ``zh``), and `per_si` the factor from deg/h and seconds to `unit_of_measure`.
    """

    key: str
    symbol: str
    names: Mapping[str, str]
    unit_of_measure: str
    per_si: float


def _term(key: str, symbol: str, en: str, zh: str, unit_of_measure: str, per_si: float) -> Term:
    names = MappingProxyType({"en": en, "zh": zh})
    return Term(key=key, symbol=symbol, names=names, unit_of_measure=unit_of_measure, per_si=per_si)


# 1 deg/h is 1 arcsec/s, so that (deg/h) s = arcsec; 1 h = 3600 s, so that a root of the hour is 60 roots of the second
QUANTIZATION_NOISE = _term("quantization_noise", "Q", "Quantization noise", "量化噪声", "arcsec", 1.0)
ANGLE_RANDOM_WALK = _term("angle_random_walk", "N", "Angle random walk", "角度随机游走", "deg/sqrt(h)", 1.0 / 60.0)
BIAS_INSTABILITY = _term("bias_instability", "B", "Bias instability", "零偏不稳定性", "deg/h", 1.0)
RATE_RANDOM_WALK = _term("rate_random_walk", "K", "Rate random walk", "角速率随机游走", "deg/h/sqrt(h)", 60.0)
RATE_RAMP = _term("rate_ramp", "R", "Rate ramp", "速率斜坡", "deg/h/h", 3600.0)
_MARKOV_EN, _MARKOV_ZH = "Exponentially correlated (Markov) noise", "马尔可夫噪声(指数相关)"
MARKOV_NOISE = _term("markov_noise", "q", _MARKOV_EN, _MARKOV_ZH, "deg/h/sqrt(h)", 60.0)
TERMS = (QUANTIZATION_NOISE, ANGLE_RANDOM_WALK, BIAS_INSTABILITY, RATE_RANDOM_WALK, RATE_RAMP)


def term_columns(taus_s: FloatArray) -> FloatArray:
    """Allan variance of each of the `TERMS` for a coefficient of 1, shape (n, 5); seconds and (deg/h)**2.

    >>> [round(x, 6) for x in term_columns(np.array([2.0]))[0].tolist()]
    [0.75, 0.5, 0.441271, 0.666667, 2.0]
    """
    return np.stack([3.0 / taus_s**2, 1.0 / taus_s, np.full_like(taus_s, FLICKER), taus_s / 3.0, taus_s**2 / 2.0], 1)


def markov_column(taus_s: FloatArray, correlation_s: float | FloatArray) -> FloatArray:
    """Allan variance of Markov noise of q = 1, IEEE 952-2020 annex C, exponentially correlated noise.

    With c the correlation time and u = tau/c,

        sigma^2 = (q c)^2/tau (1 - (3 - 4 exp(-u) + exp(-2 u))/(2 u)).

    It is q^2 tau/3 for tau << c, a random walk, and (q c)^2/tau for tau >> c. For small u, where digits
    cancel, its series in u is used.

    >>> bool(abs(markov_column(np.array([1.0]), 1e6)[0] - 1 / 3) < 1e-6)
    True
    """
    u = taus_s / correlation_s
    small = u < 0.02
    safe = np.where(small, 1.0, u)
    closed = (1.0 - (3.0 - 4.0 * np.exp(-safe) + np.exp(-2.0 * safe)) / (2.0 * safe)) / safe
    if not small.any():
        return correlation_s * closed
    series = np.zeros_like(u)
    for coefficient in reversed(_SMALL):
        series = series * np.where(small, u, 0.0) + coefficient
    shape: FloatArray = np.where(small, series, closed)
    return correlation_s * shape


@lru_cache(maxsize=4096)
def _products(short: int, long: int) -> tuple[tuple[float, ...], ...]:
    """Sums over lags of products of unit covariances of Q, N, B, K, 4 x 4, between two taus in lattice steps."""
    reach = 2 * (short + long)
    lags = np.arange(-reach, reach + 1, dtype=np.float64)
    covariances = np.zeros((4, len(lags)))
    for i, a in enumerate(_SECOND_DIFFERENCE):
        for j, b in enumerate(_SECOND_DIFFERENCE):
            covariances += a * b * _phase_covariances(lags + i * short - j * long)
    # the variance of a second difference is 2 tau**2 AVAR; the lesser units cancel in a correlation
    covariances /= 2.0 * short**2 * term_columns(np.array([float(short)]))[0, :4, np.newaxis]
    return tuple(tuple(row) for row in (covariances @ covariances.T).tolist())


def _phase_covariances(lags: FloatArray) -> FloatArray:
    """Generalised autocovariances of the angle for Q, N, B, K of 1; exact for second differences."""
    size = np.abs(lags)
    logarithm = np.log(np.where(size == 0.0, 1.0, size))
    return np.stack(
        [(size < 0.5).astype(np.float64), -size / 2.0, size**2 * logarithm / (2.0 * math.pi), size**3 / 12.0]
    )


def correlations(taus_s: FloatArray, parts: FloatArray) -> FloatArray:
    """Correlation of the Allan variances of one record at every two taus, shape (n, n).

    The averaging times ascend from the sample interval; `parts`, shape (n, 4), are the Allan variances contributed at
    each by noises of the slopes of Q, N, B, K.

    For Gaussian noise the covariance of two averages of squares is twice the mean square of the covariance C(s)
    between second differences at lag s (Isserlis). In a record long against both taus,

        cov(v_a, v_b) ~ sum_s C_ab(s)^2,    C_ab = sum over noises of their parts times the unit covariance,

    taken on a lattice of 16 steps a tau or of the samples where these are coarser, ratios of taus rounded to it.
    Taus more than 64 apart count as uncorrelated. Near the end of the record this is an approximation.

    >>> taus_s = np.array([1.0, 2.0, 4.0])
    >>> correlation = correlations(taus_s, np.stack([0 * taus_s, 1 / taus_s, 0 * taus_s, 0 * taus_s], 1))
    >>> bool(0 < correlation[0, 2] < correlation[0, 1] < 1)
    True
    """
    steps = np.clip(np.round(taus_s / taus_s[0]), 1, LATTICE).astype(np.int64).tolist()
    n = len(taus_s)
    products = [np.array(_products(m, m)) for m in steps]
    own = np.array([parts[i] @ products[i] @ parts[i] for i in range(n)])
    spacing = taus_s / np.array(steps)
    correlation = np.eye(n)
    for a in range(n):
        for b in range(a + 1, n):
            ratio = taus_s[b] / taus_s[a]
            if ratio > _FARTHEST:
                break
            product = np.array(_products(steps[a], round(steps[a] * ratio)))
            shared = parts[a] @ product @ parts[a] * spacing[a] * (2.0 * taus_s[a] ** 2) ** 2
            scale = math.sqrt(own[a] * spacing[a] * own[b] * spacing[b]) * 4.0 * taus_s[a] ** 2 * taus_s[b] ** 2
            correlation[a, b] = correlation[b, a] = min(1.0, shared / scale)
    return correlation
