"""Exact and simulated Allan curves."""

import math
from uuid import UUID

import numpy as np
from hypothesis import strategies as st
from scipy.signal import lfilter

from stream.batch import FloatArray, SampleBatch
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.confidence import least_edf
from stream.estimators.noise.noise_fit import NoiseCoefficient, NoiseFit
from stream.estimators.noise.noise_model import TERMS, markov_column, term_columns
from stream.events import EstimatePoint

DAY = (0.35, 0.01, 0.05, 0.078, 0.0432)


INTERVAL_S = 0.1


SAMPLES = 864_000


def coefficients(fit: NoiseFit | NoEstimate) -> tuple[NoiseCoefficient, ...]:
    assert isinstance(fit, NoiseFit), fit
    return tuple(getattr(fit, term.key) for term in TERMS)


def exact_curve(
    truth: tuple[float, ...],
    *,
    samples: int = SAMPLES,
    interval_s: float = INTERVAL_S,
    markov: tuple[float, float] = (0.0, 300.0),
    per_octave: int = 1,
) -> list[EstimatePoint]:
    """The model's own curve with the degrees of freedom of a record; coefficients in reported units."""
    factors = np.unique(np.round(2 ** np.arange(0, math.log2(samples / 2), 1 / per_octave)).astype(int))
    taus_s = factors * interval_s
    si = np.array(truth) / [term.per_si for term in TERMS]
    variances = term_columns(taus_s) @ si**2 + (markov[0] / 60.0) ** 2 * markov_column(taus_s, markov[1])
    return [
        point(float(tau), math.sqrt(variance), degrees(int(factor), samples))
        for tau, variance, factor in zip(taus_s, variances, factors, strict=True)
    ]


def degrees(factor: int, samples: int) -> float:
    stride = max(1, factor // 16)
    return least_edf(
        averaging_factor=factor, windows=(samples - 2 * factor) // stride + 1, stride_per_tau=min(factor, 16)
    )


def point(tau_s: float, value: float, edf: float) -> EstimatePoint:
    return EstimatePoint(tau_s=tau_s, value=value, lo=0.0, hi=2.0 * value, edf=edf, n=1 + int(edf))


def simulated_curve(
    values: FloatArray, interval_s: float = INTERVAL_S, *, per_octave: int = 1
) -> tuple[EstimatePoint, ...]:
    estimator = AllanDeviation(per_octave)
    batch = SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, round(interval_s * 1e9), "deg/h", values=values)
    estimator.update(batch)
    curve = estimator.estimate()
    assert not isinstance(curve, NoEstimate)
    return curve


def a_day(rng: np.random.Generator, truth: tuple[float, ...] = DAY) -> FloatArray:
    """24 h at 10 Hz; flicker from a circular spectrum of more than twice the length."""
    q, n, b, k, r = truth
    values = rng.standard_normal(SAMPLES) * n * 60.0 / math.sqrt(INTERVAL_S)
    values += np.diff(rng.standard_normal(SAMPLES + 1)) * q / INTERVAL_S
    values += np.cumsum(rng.standard_normal(SAMPLES)) * k / 60.0 * math.sqrt(INTERVAL_S)
    values += np.arange(SAMPLES) * r / 3600.0 * INTERVAL_S
    length = 1 << 21
    spectrum = rng.standard_normal(length // 2 + 1) + 1j * rng.standard_normal(length // 2 + 1)
    spectrum *= length / np.sqrt(4.0 * np.pi * np.maximum(1.0, np.arange(length // 2 + 1)))
    spectrum[0] = 0.0
    return values + b * np.fft.irfft(spectrum, length)[:SAMPLES]


POSITIVE = st.floats(min_value=-1.0, max_value=1.0).map(lambda exponent: 10.0**exponent)


def through_a_filter(values: FloatArray) -> FloatArray:
    """The average of four samples, as a sensor's filter at the sample rate gives it: angle random walk is the same."""
    return np.convolve(values, np.full(4, 0.25), mode="valid")


def markov_noise(rng: np.random.Generator, amplitude: float, correlation_s: float) -> FloatArray:
    """Exponentially correlated noise over a day, its amplitude in deg/h/sqrt(h)."""
    kept = math.exp(-INTERVAL_S / correlation_s)
    deviation = amplitude / 60.0 * math.sqrt(correlation_s / 2.0)
    drive = rng.standard_normal(SAMPLES) * deviation * math.sqrt(1.0 - kept**2)
    drive[0] = rng.standard_normal() * deviation
    values: FloatArray = lfilter([1.0], [1.0, -kept], drive)
    return values
