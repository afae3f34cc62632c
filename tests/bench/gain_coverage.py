"""How often the bounds of the expected gain of accepted effects hold the truth.

    python -m tests.bench.gain_coverage [--z 10] [--count 1] [--first 0] [--only gravity_o,...] [--processes 2]

From the root of the checkout. Campaigns of fifteen runs with one effect each. The true gain is that of the frozen
models in new runs with the same channels: the squares of their errors without noise, and the variance of the noise in
closed form.
"""

import argparse
import multiprocessing
import sys
from typing import NamedTuple

import numpy as np

from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.held_out.error_report import less_run_means
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.result.holdout import ExpectedGain
from stream.batch import FloatArray
from tests.bench.loop_noise import block_covariance
from tests.bench.tracing_cases import DECLARED, MODEL, Built, Case, built, cases

BLOCK_S = 30.0


class Gained(NamedTuple):
    """The gain of one campaign: as reported, and the truth."""

    key: str
    names: tuple[str, ...]
    gain: ExpectedGain
    truth: float


def gained(case: Case) -> Gained | None:
    """Diagnose one campaign; None where no effect is accepted that predicts anything."""
    made = built(case)
    said = diagnose(made.runs, MODEL, declared_noise=DECLARED)
    if said.error is None or said.error.gain is None or not any(each.confirmed for each in said.effects):
        return None
    return Gained(case.key, said.names, said.error.gain, true_gain(made, said))


def true_gain(made: Built, said: Diagnosis) -> float:
    """1 - (mean squared error after) / (before), about the mean of each held-out run, expected over the noise."""
    assert said.error is not None
    assert said.error.gain is not None
    assert said.judged is not None
    assert said.model is not None
    held_out = [run for run in made.campaign.runs(made.planted, noiseless=True) if run.run in said.error.runs]
    blocks = round(said.error.gain.averaging_s / BLOCK_S)  # of an average
    before = after = 0.0
    for run in held_out:
        before += float(np.sum(_within(said.judged.residual(run), blocks) ** 2))
        after += float(np.sum(_within(said.model.residual(run), blocks) ** 2))
    noise = len(held_out) * _noise_squares(len(held_out[0]), blocks, made)
    return 1.0 - (after + noise) / (before + noise)


def _within(values: FloatArray, in_average: int) -> FloatArray:
    averages = values.reshape(-1, in_average).mean(axis=1)
    return less_run_means(averages, np.zeros(averages.size, dtype=np.int64))


def _noise_squares(blocks: int, in_average: int, made: Built) -> float:
    """Expected sum of squares of the averages of one run about their mean."""
    covariance = block_covariance(np.arange(float(blocks)), BLOCK_S, made.campaign.noise)
    averages = covariance.reshape(blocks // in_average, in_average, -1, in_average).mean(axis=(1, 3))
    return float(np.trace(averages) - averages.mean() * len(averages))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--z", type=float, default=10.0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", default="")
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    only = [name for name in asked.only.split(",") if name]
    wanted = cases("planted", asked.count, [asked.z], only, first=asked.first)
    found = []
    with multiprocessing.get_context("spawn").Pool(asked.processes) as pool:
        for each in pool.imap_unordered(gained, wanted):
            if each is not None:
                found.append(each)
                is_held = holds(each)
                bounds = f"{each.gain.fraction:8.4f} ({each.gain.lo:8.4f} to {each.gain.hi:8.4f})"
                bounds = f"{each.gain.averaging_s:5g} s {bounds}"
                print(f"{each.key:48} {bounds}, truth {each.truth:8.4f}{'' if is_held else '  outside'}", flush=True)
    positive = np.mean([each.gain.fraction > 0 for each in found])
    covered = np.mean([holds(each) for each in found])
    significant = np.mean([each.gain.is_significant for each in found])
    print(
        f"\n{len(found)} of {len(wanted)} campaigns with an accepted effect: gain positive in {positive:.1%} (>= 98), "
        f"significantly in {significant:.1%}; the bounds hold the truth in {covered:.1%} (93 to 97)"
    )
    slack = 2.0 * np.sqrt(0.95 * 0.05 / max(1, len(found)))
    sys.exit(0 if positive >= 0.98 and 0.93 - slack <= covered <= 0.97 + slack else "a target is missed")


def holds(each: Gained) -> bool:
    """Whether the bounds hold the truth."""
    return each.gain.lo is not None and each.gain.hi is not None and each.gain.lo <= each.truth <= each.gain.hi


if __name__ == "__main__":
    main()
