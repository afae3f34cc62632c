"""How well noise coefficients are identified: simulated records, the project's Allan deviation, `fit_noise`.

    .venv/bin/python tests/bench/coefficients.py [--runs 200] [--hours 24] [--rate-hz 10] [--scenario five]
                                                 [--points-per-octave 1] [--jobs 2]

Scenarios: `five` has all five terms, `white` angle random walk alone, `walk` N, and K that prevails in the last octaves
of 6 h only, `usual` N, B and K, `markov` N, K and Markov noise of 300 s, `filtered` the `usual` ones in the average of
four samples. Printed are, for each coefficient, bias and RMS error relative to the truth, the share of runs whose 95 %
bounds hold the truth, and in how many the term counts as observable; beside it the fit that the standards print (GJB
2426A-2004 5.12.5.4.2 (31), JJF 2014-2022 (39): plain least squares of sigma^2 on tau^-2 .. tau^2), with the share of
runs in which the square comes out negative. A term that is absent shows the median of the estimate for an error. Below
stands how many curves depart from every model, and how far.
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from uuid import UUID

import msgspec
import numpy as np
from scipy.signal import lfilter

from stream.batch import FloatArray, SampleBatch
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.noise.noise_fit import NoiseCoefficient, fit_noise
from stream.estimators.noise.noise_model import TERMS, term_columns
from stream.events import EstimatePoint


class Truth(msgspec.Struct, frozen=True, kw_only=True):
    """What is simulated, in the reported units."""

    quantization_noise: float = 0.0
    angle_random_walk: float = 0.0
    bias_instability: float = 0.0
    rate_random_walk: float = 0.0
    rate_ramp: float = 0.0
    markov_noise: float = 0.0
    correlation_s: float = 300.0
    taps: int = 1


SCENARIOS = {
    "five": Truth(
        quantization_noise=0.35, angle_random_walk=0.01, bias_instability=0.05, rate_random_walk=0.078, rate_ramp=0.0432
    ),
    "white": Truth(angle_random_walk=0.01),
    "walk": Truth(angle_random_walk=0.01, rate_random_walk=0.036),
    "usual": Truth(angle_random_walk=0.01, bias_instability=0.05, rate_random_walk=0.078),
    "filtered": Truth(angle_random_walk=0.01, bias_instability=0.05, rate_random_walk=0.078, taps=4),
    "markov": Truth(angle_random_walk=0.01, rate_random_walk=0.06, markov_noise=0.6),
}


def flicker(samples: int, rng: np.random.Generator) -> FloatArray:
    """Noise of one-sided density 1/(pi f), B = 1 deg/h, circular over more than twice the record."""
    length = 1 << (2 * samples - 1).bit_length()
    frequencies = np.arange(1, length // 2 + 1)
    spectrum = np.zeros(length // 2 + 1, np.complex128)
    spectrum[1:] = rng.standard_normal(length // 2) + 1j * rng.standard_normal(length // 2)
    # density / (4 dt) times the length, per real part; f = k / (length dt), so that dt cancels
    spectrum[1:] *= length / np.sqrt(4.0 * np.pi * frequencies)
    values: FloatArray = np.fft.irfft(spectrum, length)[:samples]
    return values


def simulated(truth: Truth, samples: int, interval_s: float, rng: np.random.Generator) -> FloatArray:
    """A record in deg/h."""
    root_s = np.sqrt(interval_s)
    values: FloatArray = rng.standard_normal(samples) * (truth.angle_random_walk * 60.0 / root_s)
    if truth.quantization_noise:
        values += np.diff(rng.standard_normal(samples + 1)) * (truth.quantization_noise / interval_s)
    if truth.bias_instability:
        values += flicker(samples, rng) * truth.bias_instability
    if truth.rate_random_walk:
        values += np.cumsum(rng.standard_normal(samples)) * (truth.rate_random_walk / 60.0 * root_s)
    if truth.rate_ramp:
        values += np.arange(samples) * (truth.rate_ramp / 3600.0 * interval_s)
    if truth.markov_noise:
        kept = np.exp(-interval_s / truth.correlation_s)
        deviation = truth.markov_noise / 60.0 * np.sqrt(truth.correlation_s / 2.0)
        drive = rng.standard_normal(samples) * deviation * np.sqrt(1.0 - kept**2)
        drive[0] = rng.standard_normal() * deviation
        markov: FloatArray = lfilter([1.0], [1.0, -kept], drive)
        values += markov
    if truth.taps > 1:
        values = np.convolve(values, np.full(truth.taps, 1.0 / truth.taps), mode="valid")
    return values


def allan_curve(values: FloatArray, interval_s: float, points_per_octave: int = 1) -> tuple[EstimatePoint, ...]:
    """The project's Allan deviation of a record."""
    estimator = AllanDeviation(points_per_octave)
    estimator.update(
        SampleBatch("FOG-1", "rate", "r1", UUID(int=1), 0, 0, round(interval_s * 1e9), "deg/h", values=values)
    )
    curve = estimator.estimate()
    assert not isinstance(curve, NoEstimate), curve.reason
    return curve


def printed_fit(points: tuple[EstimatePoint, ...]) -> FloatArray:
    """Coefficients of the standards' own fit, in reported units; a negative square gives a negative coefficient."""
    taus_s = np.array([point.tau_s for point in points])
    squares = np.linalg.lstsq(term_columns(taus_s), np.array([point.value**2 for point in points]), rcond=None)[0]
    per_si = np.array([term.per_si for term in TERMS])
    coefficients: FloatArray = np.sign(squares) * np.sqrt(np.abs(squares)) * per_si
    return coefficients


def one_run(seed: int, truth: Truth, samples: int, interval_s: float, per_octave: int) -> FloatArray:
    """Rows: value, lo, hi, observable, printed value; columns: the five terms, q, correlation time, misfit."""
    values = simulated(truth, samples, interval_s, np.random.default_rng(seed))
    points = allan_curve(values, interval_s, per_octave)
    fit = fit_noise(points)
    assert not isinstance(fit, NoEstimate), fit.reason
    result = np.full((5, 8), np.nan)
    found: list[NoiseCoefficient] = [getattr(fit, term.key) for term in TERMS]
    result[4, :5] = printed_fit(points)
    result[0, 7] = fit.misfit
    if fit.markov is not None:
        found.append(fit.markov.amplitude)
        result[:3, 6] = fit.markov.correlation_s, fit.markov.correlation_lo_s, fit.markov.correlation_hi_s
    for column, coefficient in enumerate(found):
        result[:4, column] = coefficient.value, coefficient.lo, coefficient.hi, coefficient.observable
    return result


def error(values: FloatArray, truth: float) -> str:
    """Bias and RMS error in percent of the truth; the median where the truth is 0."""
    if truth == 0.0:
        return f"median {np.median(values):9.3g}"
    relative = values / truth - 1.0
    return f"{100 * relative.mean():+8.1f} {100 * np.sqrt(np.mean(relative**2)):7.1f}"


def report(results: FloatArray, truth: Truth) -> None:
    """Print the table."""
    print(f"{'':20}{'truth':>9} | {'bias %':>8} {'RMS %':>7} {'covered %':>10} {'observable %':>13} ", end="")
    print(f"| printed: {'bias %':>8} {'RMS %':>7} {'negative %':>11}")
    for column, term in enumerate(TERMS):
        value, lo, hi, is_seen, printed = results[:, :, column].T
        true = getattr(truth, term.key)
        covered = 100 * np.mean((lo <= true) & (true <= hi))
        print(f"{term.key:20}{true:9.4g} | {error(value, true)} {covered:10.1f} {100 * is_seen.mean():13.1f} ", end="")
        print(f"|          {error(np.abs(printed), true)} {100 * np.mean(printed < 0.0):11.1f}")
    value, lo, hi = results[:, :3, 6].T
    accepted, misfit = np.isfinite(value), results[:, 0, 7]
    print(f"misfit in {100 * np.mean(misfit > 0.0):.1f} % of runs, median {100 * np.median(misfit):.2g} %; ", end="")
    print(f"Markov noise accepted in {100 * accepted.mean():.1f} % of runs", end="")
    if accepted.any() and truth.markov_noise:
        q = results[accepted, :3, 5].T
        covered_q = 100 * np.mean((q[1] <= truth.markov_noise) & (truth.markov_noise <= q[2]))
        covered_s = 100 * np.mean((lo <= truth.correlation_s)[accepted] & (truth.correlation_s <= hi)[accepted])
        print(f": q {np.median(q[0]):.3g} (truth {truth.markov_noise:.3g}, covered {covered_q:.0f} %), ", end="")
        time_s = np.median(value[accepted])
        print(f"time {time_s:.0f} s (truth {truth.correlation_s:.0f}, covered {covered_s:.0f} %)", end="")
    print()


def main() -> None:
    """Simulate, fit and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--rate-hz", type=float, default=10.0)
    parser.add_argument("--scenario", choices=tuple(SCENARIOS), default="five")
    parser.add_argument("--points-per-octave", type=int, choices=(1, 2, 4, 8), default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    truth, samples = SCENARIOS[given.scenario], round(given.hours * 3600.0 * given.rate_hz)
    run = partial(
        one_run, truth=truth, samples=samples, interval_s=1.0 / given.rate_hz, per_octave=given.points_per_octave
    )
    began = time.perf_counter()
    with ProcessPoolExecutor(given.jobs) as pool:
        results = np.array(list(pool.map(run, range(given.seed, given.seed + given.runs))))
    elapsed = time.perf_counter() - began
    print(f"{given.scenario}: {given.runs} runs of {given.hours:g} h at {given.rate_hz:g} Hz in {elapsed:.0f} s")
    report(results, truth)


if __name__ == "__main__":
    main()
