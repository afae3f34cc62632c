"""How long the noise fit of one Allan curve takes: ``python -m tests.bench.noise_fit_time [--curves 60] [--json]``.

The curves are of simulated records of 2 to 24 h at 10 Hz: white noise alone, the usual three terms, and all five. One
thread; the first fit, which compiles, is not counted.
"""

import argparse
import json
import time
from uuid import UUID

import numpy as np

from stream.batch import SampleBatch
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.noise.noise_fit import fit_noise
from stream.events import EstimatePoint

RATE_HZ = 10.0


def curve(rng: np.random.Generator, hours: float, scenario: int) -> tuple[EstimatePoint, ...]:
    """An Allan curve of white noise, with a random walk and flicker, and with a ramp and quantization as well."""
    n = int(hours * 3600 * RATE_HZ)
    values = rng.standard_normal(n)
    if scenario > 0:
        values += 2e-3 * np.cumsum(rng.standard_normal(n))
        spectrum = np.fft.rfft(rng.standard_normal(n))
        spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
        values += 4.0 * np.fft.irfft(spectrum, n) / np.std(np.fft.irfft(spectrum, n)) * 0.05
    if scenario > 1:
        values += np.linspace(0.0, 1.0, n) + np.diff(rng.uniform(-1.0, 1.0, n + 1))
    allan = AllanDeviation()
    for begin in range(0, n, 8192):
        part = values[begin : begin + 8192]
        t0_ns = round(begin * 1e9 / RATE_HZ)
        allan.update(SampleBatch("U", "rate", "r", UUID(int=1), begin, t0_ns, 100_000_000, "deg/h", values=part))
    points = allan.estimate()
    assert not isinstance(points, NoEstimate)
    return points


def measure(curves: int) -> dict[str, float]:
    """Milliseconds of a fit: median and worst."""
    rng = np.random.default_rng(1)
    made = [curve(rng, hours, number % 3) for number, hours in enumerate(rng.uniform(2.0, 24.0, curves))]
    fit_noise(made[0])
    spent_ms = []
    for points in made:
        began = time.perf_counter()
        fit_noise(points)
        spent_ms.append((time.perf_counter() - began) * 1e3)
    return {"median_ms": float(np.median(spent_ms)), "worst_ms": max(spent_ms)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--curves", type=int, default=60)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    found = measure(asked.curves)
    print(json.dumps(found) if asked.json else f"median {found['median_ms']:.1f} ms, worst {found['worst_ms']:.1f} ms")


if __name__ == "__main__":
    main()
