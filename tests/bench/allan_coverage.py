"""How often the 95 % bounds of the Allan deviation hold the truth, by noise and by T/tau.

    .venv/bin/python tests/bench/allan_coverage.py [--runs 2000] [--seed 1] [--json]

Simulated records go through `AllanDeviation`, with the overlap it truly has; the limits are chi-square with three
choices of the degrees of freedom: `rule` the least of the exponents that `identify` finds plausible from the curve,
`all five` the least of all exponents, `known` those of the true exponent (single noises only). `found` is the share
of runs in which the true exponent is among the plausible ones. Records of 16384 samples show tau of 16 samples and
more, records of 1024 those from 1 sample on; both are read at 16000 and 1000 samples for T/tau of 125 and more.

All noises are exact: white samples, their sums and differences, and flicker as sums of the stationary increments of
N. J. Kasdin, T. Walter, Discrete simulation of power law noise, Proc. 1992 IEEE FCS, DOI 10.1109/FREQ.1992.270003,
drawn by circulant embedding. The truth is their theoretical Allan variance, not a mean of the runs. In mixtures the
parts are equal at the named share of the record.

A single noise of the four (quantisation, white, flicker, walk) is marked OUTSIDE where the one-sided 99.9 % binomial
bounds for all checks together exclude 93 % to 98 %, and the command fails.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import NamedTuple, TypedDict
from uuid import UUID

import numpy as np
import scipy.stats

from stream.batch import FloatArray, IntArray, SampleBatch
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.confidence import deviation_bounds, edf, least_edf
from stream.estimators.noise.noise_exponent import identify

CONFIDENCE = 0.95
LEAST, MOST = 0.93, 0.98
SPANS = (8, 16, 32, 64, 125, 250, 500, 1000)
LENGTHS = ((1000, 1024), (16000, 16384))
EXPONENTS = {"quantisation": 2, "flicker of angle": 1, "white": 0, "flicker": -1, "walk": -2}
REQUIRED = ("quantisation", "white", "flicker", "walk")
# the parts, and the share of the record at which their Allan variances are equal
MIXTURES = {
    "quantisation + white, T/64": ("quantisation", "white", 64),
    "white + flicker, T/64": ("white", "flicker", 64),
    "white + walk, T/64": ("white", "walk", 64),
    "white + walk, T/8": ("white", "walk", 8),
}


class Row(TypedDict):
    """A row of the table: shares of 1, `span` is T/tau and `factor` tau in samples."""

    noise: str
    span: int
    factor: int
    rule: float
    error: float
    all_five: float
    known: float | None
    found: float | None
    outside: bool


@lru_cache(maxsize=8)
def increments_covariance(lags: int) -> FloatArray:
    """Autocovariance of white noise differenced to the half order, 1 for lag 0."""
    k = np.arange(1, lags, dtype=np.float64)
    return np.concatenate([[1.0], np.cumprod((k - 1.5) / (k + 0.5))])


@lru_cache(maxsize=4)
def embedding(samples: int) -> FloatArray:
    """Roots of the eigenvalues of the circulant that holds that covariance; all are positive."""
    covariance = increments_covariance(samples + 1)
    eigenvalues = np.fft.rfft(np.concatenate([covariance, covariance[-2:0:-1]])).real
    assert eigenvalues.min() > 0.0
    roots: FloatArray = np.sqrt(eigenvalues)
    return roots


def half_order(samples: int, rng: np.random.Generator) -> FloatArray:
    """Samples of the flicker of angle; their sums are flicker."""
    white = np.fft.rfft(rng.standard_normal(2 * samples))
    values: FloatArray = np.fft.irfft(white * embedding(samples), 2 * samples)[:samples]
    return values


DRAWN: dict[str, Callable[[int, np.random.Generator], FloatArray]] = {
    "quantisation": lambda samples, rng: np.diff(rng.standard_normal(samples + 1)),
    "flicker of angle": half_order,
    "white": lambda samples, rng: rng.standard_normal(samples),
    "flicker": lambda samples, rng: np.cumsum(half_order(samples, rng)),
    "walk": lambda samples, rng: np.cumsum(rng.standard_normal(samples)),
}


def true_variance(noise: str, factor: int) -> float:
    """Allan variance of the process that `DRAWN` draws."""
    plain = {"quantisation": 3.0 / factor**2, "white": 1.0 / factor, "walk": (2 * factor**2 + 1) / (6 * factor)}
    if noise in plain:
        return plain[noise]
    box = np.ones(factor)
    # weights of the difference of two averages, over the samples or over the increments
    weights = np.concatenate([-box, box]) if noise == "flicker of angle" else np.convolve(box, box)
    length = 1 << (2 * len(weights)).bit_length()
    products = np.fft.irfft(np.abs(np.fft.rfft(weights / factor, length)) ** 2, length)[: len(weights)]
    products[1:] *= 2.0
    return float(products @ increments_covariance(len(weights))) / 2.0


def parts_of(noise: str, samples: int) -> dict[str, float]:
    """Variances of the parts."""
    if noise in EXPONENTS:
        return {noise: 1.0}
    first, second, share = MIXTURES[noise]
    return {first: 1.0, second: true_variance(first, samples // share) / true_variance(second, samples // share)}


class Curves(NamedTuple):
    """Allan variances of all runs, shape (runs, n), at the same averaging times."""

    samples: int
    factors: IntArray
    windows: IntArray
    variances: FloatArray


def read(estimator: AllanDeviation) -> tuple[IntArray, IntArray, FloatArray]:
    """Factors, windows and variances of an estimate."""
    points = estimator.estimate()
    assert not isinstance(points, NoEstimate), points.reason
    factors = np.array([round(point.tau_s) for point in points])
    return factors, np.array([point.n for point in points]), np.array([point.value for point in points]) ** 2


def simulated(noise: str, lengths: tuple[int, int], runs: int, seed: int) -> list[Curves]:
    """Curves after the first and after all samples of records."""
    rng = np.random.default_rng([seed, lengths[1], *noise.encode()])
    parts = parts_of(noise, lengths[1])
    found: list[list[tuple[IntArray, IntArray, FloatArray]]] = [[], []]
    for _ in range(runs):
        values = np.zeros(lengths[1])
        for part, size in parts.items():
            values += math.sqrt(size) * DRAWN[part](lengths[1], rng)
        estimator = AllanDeviation()
        for first, stop, kept in ((0, lengths[0], found[0]), (*lengths, found[1])):
            batch = SampleBatch(
                "FOG-1", "rate", "r1", UUID(int=1), first, first * 10**9, 10**9, "deg/h", values=values[first:stop]
            )
            estimator.update(batch)
            kept.append(read(estimator))
    return [
        Curves(samples, kept[0][0], kept[0][1], np.array([variances for _, _, variances in kept]))
        for samples, kept in zip(lengths, found, strict=True)
    ]


@lru_cache(maxsize=100_000)
def limits(degrees: float) -> tuple[float, float]:
    """Limits of a deviation of 1."""
    return deviation_bounds(1.0, degrees, CONFIDENCE)


def coverage(ratios: FloatArray, degrees: Iterable[float]) -> float:
    """Share of runs whose limits hold the truth; `ratios` are those of the true deviations to the estimated."""
    lo, hi = np.array([limits(each) for each in degrees]).T
    return float(np.mean((lo <= ratios) & (ratios <= hi)))


def rows(noise: str, curves: Curves) -> list[Row]:
    """Rows of the table for T/tau of 8 to 64 of a full record, or of 125 to 1000."""
    samples, factors, windows, variances = curves
    exponent, runs = EXPONENTS.get(noise), len(variances)
    strides = np.minimum(factors, 16)
    identified = [identify(factors, each, windows, strides) for each in variances]
    parts = parts_of(noise, 1 << (samples - 1).bit_length())
    found: list[Row] = []
    for i, (m, n, stride) in enumerate(zip(factors.tolist(), windows.tolist(), strides.tolist(), strict=True)):
        if samples / m not in SPANS or (samples / m < 125.0) != (samples & (samples - 1) == 0):
            continue
        truth = sum(size * true_variance(part, m) for part, size in parts.items())
        ratios = np.sqrt(truth / variances[:, i])
        share = coverage(ratios, (each[i].edf for each in identified))
        row: Row = {
            "noise": noise,
            "span": samples // m,
            "factor": m,
            "rule": share,
            "error": math.sqrt(share * (1.0 - share) / runs),
            "all_five": coverage(ratios, [least_edf(m, n, stride)] * runs),
            "known": None,
            "found": None,
            "outside": noise in REQUIRED and is_outside(share, runs),
        }
        if exponent is not None:
            row["known"] = coverage(ratios, [edf(exponent, 2, m, n, stride)] * runs)
            row["found"] = sum(exponent in each[i].plausible for each in identified) / runs
        found.append(row)
    return found


def is_outside(share: float, runs: int) -> bool:
    """Whether a share is not that of a coverage between the promised ones, at 99.9 % for all checks together."""
    level = 0.001 / (2 * len(REQUIRED) * len(LENGTHS) * len(SPANS))
    least, most = scipy.stats.binom.ppf(level, runs, LEAST), scipy.stats.binom.isf(level, runs, MOST)
    return not bool(least <= round(share * runs) <= most)


def percent(share: object) -> str:
    return f"{100.0 * share:7.1f}" if isinstance(share, float) else f"{'':7}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    table: list[Row] = []
    kept = True
    if not given.json:
        print(f"Coverage of {CONFIDENCE:.0%} limits in %, {given.runs} runs")
        print(f"{'noise':28}{'T/tau':>6}{'tau':>6}   {'rule':>6}  s.e.{'all five':>9}{'known':>7}{'found':>7}")
    for noise in (*EXPONENTS, *MIXTURES):
        for lengths in LENGTHS:
            found = [row for curves in simulated(noise, lengths, given.runs, given.seed) for row in rows(noise, curves)]
            for row in sorted(found, key=lambda row: row["span"]):
                kept &= not row["outside"]
                if not given.json:
                    shares = "".join(percent(row[column]) for column in ("all_five", "known", "found"))
                    print(
                        f"{noise:28}{row['span']:6}{row['factor']:6}  {percent(row['rule'])}{100 * row['error']:6.1f}"
                        f"  {shares}{'  OUTSIDE' if row['outside'] else ''}",
                        flush=True,
                    )
            table += found
    if given.json:
        print(json.dumps({"runs": given.runs, "confidence": CONFIDENCE, "rows": table}, indent=1))
    if not kept:
        sys.exit(f"a coverage is outside of {LEAST:.0%} to {MOST:.0%}")


if __name__ == "__main__":
    main()
