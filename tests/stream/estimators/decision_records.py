"""Records of known noise for the tests of early decisions, and the decision on them."""

import math

import numpy as np

from stream.batch import FloatArray
from stream.estimators.decision.decision import AllanDecision, Decision, DecisionPlan
from stream.estimators.decision.decision_bounds import LOOKS
from stream.events import EstimatePoint

R = 16
KINDS = ("white", "flicker", "random walk", "mixture")


def noise(kind: str, runs: int, samples: int, rng: np.random.Generator) -> FloatArray:
    """Rates at 16 samples a tau whose Allan variance at tau is exactly 1."""
    if kind == "white":
        return rng.standard_normal((runs, samples)) * math.sqrt(R)
    if kind == "random walk":
        walk: FloatArray = np.cumsum(rng.standard_normal((runs, samples)), axis=1)
        return walk / math.sqrt((2 * R**2 + 1) / (6 * R))
    if kind == "mixture":
        mixed = np.zeros((runs, samples))
        for part in KINDS[:3]:
            mixed += noise(part, runs, samples, rng) / math.sqrt(3.0)
        return mixed
    m = 2 ** math.ceil(math.log2(3 * samples))
    f = np.fft.rfftfreq(m)[1:]
    # the differences of two means of R have the gain 4 sin(pi f R)**4 / (R sin(pi f))**2
    gain = 4.0 * np.sin(math.pi * f * R) ** 4 / (R * np.sin(math.pi * f)) ** 2
    amplitude = f**-0.5 / math.sqrt(2.0 / m**2 * float(np.sum(gain / f)))
    out = np.empty((runs, samples))
    for i in range(runs):
        spectrum = np.zeros(m // 2 + 1, np.complex128)
        spectrum[1:] = amplitude * (rng.standard_normal(m // 2) + 1j * rng.standard_normal(m // 2))
        out[i] = np.fft.irfft(spectrum, m)[:samples]
    return out


def squares(values: FloatArray) -> FloatArray:
    """D**2 of every window, at 16 windows a tau."""
    integral = np.concatenate([np.zeros((len(values), 1)), np.cumsum(values, axis=1)], axis=1)
    second: FloatArray = integral[:, 2 * R :] - 2.0 * integral[:, R:-R] + integral[:, : -2 * R]
    return np.square(second / R)


def a_point(variance: float, n: int, tau_s: float = 1.0) -> EstimatePoint:
    value = math.sqrt(variance)
    return EstimatePoint(tau_s=tau_s, value=value, lo=0.8 * value, hi=1.3 * value, edf=10.0, n=n)


def judged(plan: DecisionPlan, squares_of_run: FloatArray, elapsed_s: FloatArray) -> Decision:
    """The first decision of a test, or its last word; windows are all there, tau is 1 s."""
    test = AllanDecision(plan)
    total = np.cumsum(squares_of_run)
    decision = test.look(0.0, None)
    for at_s in elapsed_s.tolist():
        n = plan.windows(min(at_s, plan.duration_s))
        decision = test.look(at_s, a_point(float(total[n - 1]) / (2.0 * n), n) if n else None)
        if test.decision is not None:
            break
    return decision


def hourly(averages: int) -> FloatArray:
    return np.arange(1, LOOKS + 1) / LOOKS * averages
