"""What the estimators cost: time beside a peer in one run, memory, and a month at 1 kHz.

    .venv/bin/python tests/bench/estimators.py [speed] [memory] [month] [--batch 1000] [--json]

speed   the Allan estimator at 24 octave averaging times in batches of 1000 samples (or `--batch`), all through its own
        `update`, beside allantools' batch `oadev` and its `oadev_realtime` with as many averaging times, and its
        agreement with the former
memory  10,000 signals in one process, each with everything that a signal is given by default
month   30 days at 1 kHz through one Allan estimator, and through another with a mean of a million standard deviations
        added; CPU time is that of `update` alone, the making of the noise left out

Without a name it runs all three. Times are of one thread.
"""

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from uuid import UUID

import allantools
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from stream.batch import FloatArray, SampleBatch
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import Estimator, NoEstimate, all_estimators
from stream.events import EstimatePoint
from stream.worker.compile_kernels import warm_up

EPOCH = UUID(int=1)
DT_NS = 1_000_000
BATCH = 1000
OCTAVES = 24
SIGNALS = 10_000
MONTH = 30 * 86_400 * 1000
MEAN_SIGMA = 1e6


def batches(values: FloatArray, first: int, unit: str = "FOG-1", size: int = BATCH) -> list[SampleBatch]:
    """Values as batches, the first sample of them with number `first`."""
    return [
        SampleBatch(
            unit, "rate", "r1", EPOCH, first + i, (first + i) * DT_NS, DT_NS, "deg/h", values=values[i : i + size]
        )
        for i in range(0, len(values), size)
    ]


def points_of(estimator: AllanDeviation) -> tuple[EstimatePoint, ...]:
    points = estimator.estimate()
    assert not isinstance(points, NoEstimate)
    return points


def fed(estimator: Estimator[Any], blocks: Iterator[FloatArray], size: int = BATCH) -> float:
    """CPU seconds of the updates. Batches are made in small lots just before, as they come from a bus."""
    seconds = 0.0
    first = 0
    for block in blocks:
        lot = batches(block, first, size=size)
        began = time.thread_time()
        for batch in lot:
            estimator.update(batch)
        seconds += time.thread_time() - began
        first += len(block)
    return seconds


def speed(size: int = BATCH, repeats: int = 5) -> dict[str, float]:
    n = (2**OCTAVES + 2 ** (OCTAVES - 4)) // BATCH * BATCH
    values = np.random.default_rng(1).standard_normal(n) + 15.0
    lot = 40 * BATCH
    ours_s: list[float] = []
    batch_s: list[float] = []
    for _ in range(repeats):
        estimator = AllanDeviation()
        ours_s.append(fed(estimator, (values[i : i + lot] for i in range(0, n, lot)), size))
        taus_s = np.array([float(2**k) for k in range(OCTAVES)])
        began = time.thread_time()
        peer = allantools.oadev(values, rate=1.0, data_type="freq", taus=taus_s)
        batch_s.append(time.thread_time() - began)
    found = {round(point.tau_s * 1000): point for point in points_of(estimator)}
    assert len(peer[0]) == OCTAVES
    # centred, for the peer sums from the beginning; the estimator was given the mean of 15
    phase = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    full, strided, beyond = 0.0, 0.0, 0.0
    for tau, value in zip(peer[0].tolist(), peer[1].tolist(), strict=True):
        m = round(tau)
        off = abs(found[m].value / value - 1.0)
        if m <= 16:
            exact = allantools.oadev(phase, rate=1.0, data_type="phase", taus=[m])[1][0]
            full = max(full, abs(found[m].value / exact - 1.0))
            continue
        stride = m // 16
        same = allantools.oadev(phase[::stride], rate=1.0 / stride, data_type="phase", taus=[m])[1][0]
        strided = max(strided, abs(found[m].value / same - 1.0))
        # in units of the standard deviation of the value itself
        beyond = max(beyond, off * np.sqrt(2.0 * found[m].edf))
    realtime = allantools.realtime.oadev_realtime(afs=[2**k for k in range(OCTAVES)], tau0=1.0)
    realtime.x = phase.tolist()
    more = np.random.default_rng(2).standard_normal(3000).cumsum().tolist()
    began = time.thread_time()
    for x in more:
        realtime.add_phase(x)
    realtime_ns = (time.thread_time() - began) / len(more) * 1e9
    ours_ns, batch_ns = min(ours_s) / n * 1e9, min(batch_s) / n * 1e9
    return {
        "samples": n,
        "averaging_times": len(found),
        "ns_per_sample": ours_ns,
        "allantools_oadev_ns_per_sample": batch_ns,
        "times_faster_than_oadev": batch_ns / ours_ns,
        "allantools_realtime_ns_per_sample": realtime_ns,
        "times_faster_than_realtime": realtime_ns / ours_ns,
        "off_full_overlap_to_16_intervals": full,
        "off_strided_form_beyond": strided,
        "off_full_overlap_beyond_in_standard_deviations": beyond,
        "state_bytes": estimator.state_bytes,
    }


def memory() -> dict[str, float]:
    values = np.random.default_rng(1).standard_normal(10 * BATCH)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    fleet: list[list[Estimator[Any]]] = []
    began = time.thread_time()
    for i in range(SIGNALS):
        estimators = [make() for make in all_estimators().values()] if i == 0 else [f.copy() for f in fleet[0]]
        if i == 0:
            fleet.append(estimators)
            continue
        fleet.append(estimators)
        for batch in batches(values, 0, f"FOG-{i:05d}"):
            for estimator in estimators:
                estimator.update(batch)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    one = fleet[1]
    return {
        "signals": SIGNALS,
        "estimators_per_signal": len(one),
        "state_bytes_per_signal": sum(estimator.state_bytes for estimator in one),
        "allan_state_bytes": next(f.state_bytes for f in one if isinstance(f, AllanDeviation)),
        "process_mb": after / 1024,
        "process_mb_before": before / 1024,
        "us_per_batch_of_all": (time.thread_time() - began) / (SIGNALS - 1) / 10 * 1e6,
    }


def month() -> dict[str, float]:
    rng = np.random.default_rng(1)
    plain, shifted = AllanDeviation(), AllanDeviation()
    cpu_s = 0.0
    lot = 40 * BATCH
    first = 0
    reported = time.monotonic()
    while first < MONTH:
        values = rng.standard_normal(lot)
        for estimator, block in ((plain, values), (shifted, values + MEAN_SIGMA)):
            ready = batches(block, first)
            began = time.thread_time()
            for batch in ready:
                estimator.update(batch)
            if estimator is plain:
                cpu_s += time.thread_time() - began
        first += lot
        if time.monotonic() - reported > 10.0:
            reported = time.monotonic()
            print(f"{first / MONTH:.0%} of the month", file=sys.stderr)
    pairs = zip(points_of(plain), points_of(shifted), strict=True)
    off = max(abs(b.value / a.value - 1.0) for a, b in pairs)
    return {
        "samples": float(plain.samples),
        "averaging_times": len(points_of(plain)),
        "longest_tau_s": points_of(plain)[-1].tau_s,
        "cpu_s": cpu_s,
        "most_off_with_mean_of_1e6_sigma": off,
        "one_sigma_at_1_interval": points_of(plain)[0].value,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", choices=["speed", "memory", "month", []], default=[])
    parser.add_argument("--batch", type=int, default=BATCH, help="samples a batch of `speed`")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    warm_up()
    runs: dict[str, Callable[[], dict[str, float]]] = {
        "memory": memory,
        "speed": lambda: speed(arguments.batch),
        "month": month,
    }
    found = {name: run() for name, run in runs.items() if not arguments.what or name in arguments.what}
    if arguments.json:
        print(json.dumps(found))
        return
    for name, numbers in found.items():
        print(name)
        for what, number in numbers.items():
            print(f"  {what:52s} {number:,.6g}")


if __name__ == "__main__":
    main()
