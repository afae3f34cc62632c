"""Early decisions at full size: how often they are wrong at the limit, and how many hours they save.

    python -m tests.bench.early_decision [--runs 4000] [--table]

From the root of the checkout. With --table it only prints the bounds of `decision_bounds` again (2 minutes). A test is
24 h; tau is T/tau of it. Errors are against the truth, a true deviation at the limit, and are marked TOO MANY
where the one-sided 99.9 % binomial bound for all checks together excludes the promised 1 %. `hours` is the mean time
to the decision; a test not decided early takes 24.
"""

import argparse
import math
import sys
from dataclasses import dataclass

import numpy as np
import scipy.stats

from stream.batch import FloatArray
from stream.estimators.decision.decision import BiasStabilityDecision, Decision, DecisionPlan, Outcome
from tests.bench.decision_calibration import table
from tests.stream.estimators.decision_records import KINDS, R, a_point, hourly, judged, noise, squares

HOURS = 24.0
RATIOS = (0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0)
SPANS = (864, 120, 24)
CHUNK = 250


@dataclass
class Tally:
    """Outcomes of tests; `otherwise` are those that the finished test would have decided otherwise."""

    runs: int = 0
    passed: int = 0
    failed: int = 0
    otherwise: int = 0
    hours: float = 0.0

    def add(self, decision: Decision, finished: Outcome) -> None:
        self.runs += 1
        self.passed += decision.outcome is Outcome.PASS
        self.failed += decision.outcome is Outcome.FAIL
        self.otherwise += decision.outcome not in {Outcome.UNDECIDED, finished}
        self.hours += HOURS * decision.looked_at_fraction

    def __str__(self) -> str:
        n = self.runs
        return f"{self.passed / n:7.4f} {self.failed / n:7.4f} {self.otherwise / n:7.4f} {self.hours / n:6.1f}"


def tallied(
    plan: DecisionPlan, kind: str, ratios: tuple[float, ...], runs: int, planned_s: FloatArray, latest_s: float = 0.0
) -> list[Tally]:
    """Outcomes at each ratio of the true deviation to the limit, with the same draws."""
    rng = np.random.default_rng([20261122, KINDS.index(kind), int(plan.duration_s)])
    tallies = [Tally() for _ in ratios]
    for _ in range(max(1, runs // CHUNK)):
        for row in squares(noise(kind, CHUNK, int(plan.duration_s) * R, rng)):
            root = math.sqrt(float(np.mean(row)) / 2.0)
            at_s = planned_s + rng.uniform(0.0, latest_s, len(planned_s))
            for ratio, tally in zip(ratios, tallies, strict=True):
                finished = Outcome.FAIL if root * ratio > plan.limit else Outcome.PASS
                tally.add(judged(plan, row * ratio**2, at_s), finished)
    return tallies


def errors_at_the_limit(runs: int) -> bool:
    """Print the error rates; whether all keep the promise."""
    checks = 2 * 2 * len(KINDS) * len(SPANS)
    most = scipy.stats.binom.ppf(1.0 - 0.001 / checks, runs // CHUNK * CHUNK, 0.01)
    kept = True
    print(f"\nTrue deviation at the limit, promise 0.01 a side, {runs // CHUNK * CHUNK} runs")
    print("T/tau  looks    noise           PASS    FAIL  differs  hours")
    for span in SPANS:
        plan = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=float(span), point_decides=False)
        # a look late by up to an hour is as a person or a slow bus gives it
        for looks, latest in (("hourly", 0.0), ("late", span / 24.0)):
            for kind in KINDS:
                (tally,) = tallied(plan, kind, (1.0,), runs, hourly(span), latest)
                is_kept = max(tally.passed, tally.failed) <= most
                kept &= is_kept
                print(f"{span:5d}  {looks:8s} {kind:12s} {tally}  {'' if is_kept else 'TOO MANY'}", flush=True)
    return kept


def hours_saved(runs: int) -> None:
    """Print outcomes and hours for good and bad units: bounds alone, and all rules with the point at the end."""
    span = SPANS[0]
    bounded = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=float(span), point_decides=False)
    full = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=float(span))
    curtailed = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=float(span), looks=())
    dense = np.arange(4.0, span + 1.0, 4.0)
    print(
        f"\nGood and bad units, T/tau = {span}, {max(1, runs // CHUNK) * CHUNK} runs (curtailment: looks every T/216)"
    )
    print("                        bounds                          all rules                       curtailment alone")
    print("noise        ratio " + "   PASS    FAIL differs  hours " * 3)
    for kind in KINDS:
        columns = [
            tallied(plan, kind, RATIOS, runs, at_s)
            for plan, at_s in ((bounded, hourly(span)), (full, hourly(span)), (curtailed, dense))
        ]
        for ratio, row in zip(RATIOS, zip(*columns, strict=True), strict=True):
            print(f"{kind:12s} {ratio:5.2f} " + " ".join(str(tally) for tally in row), flush=True)


def bias_stability(runs: int) -> None:
    """Print how early bias stability fails, white and drifting."""
    averages, rng = 2160, np.random.default_rng(5)
    plan = DecisionPlan(tau_s=40.0, limit=1.0, duration_s=86400.0)
    print(f"\nBias stability of {averages} averages, limit on the finished standard deviation, {runs} runs")
    print("noise                 ratio    PASS    FAIL differs  hours")
    for drifts in (False, True):
        for ratio in (0.8, 1.0, 1.2, 1.5, 2.0):
            tally = Tally()
            for _ in range(runs):
                y = rng.standard_normal(averages)
                if drifts:
                    walk = np.cumsum(rng.standard_normal(averages)) / math.sqrt(averages / 6.0)
                    y = math.sqrt(0.7) * y + math.sqrt(0.3) * walk
                y *= ratio
                test, n = BiasStabilityDecision(plan), np.arange(1, averages + 1)
                variance = (np.cumsum(y**2) - np.cumsum(y) ** 2 / n) / np.maximum(1, n - 1)
                decision = test.look(0.0, None)
                for i in range(9, averages + 1, 9):
                    decision = test.look(40.0 * i, a_point(float(variance[i - 1]), i, 40.0))
                    if test.decision is not None:
                        break
                tally.add(decision, Outcome.FAIL if variance[-1] > 1.0 else Outcome.PASS)
            print(f"{'white + random walk' if drifts else 'white':20s}  {ratio:5.2f} {tally}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=4000)
    parser.add_argument("--table", action="store_true")
    arguments = parser.parse_args()
    if arguments.table:
        print(table())
        return
    kept = errors_at_the_limit(max(CHUNK, arguments.runs))
    hours_saved(max(CHUNK, arguments.runs // 16))
    bias_stability(max(20, arguments.runs // 40))
    if not kept:
        sys.exit("an error rate is above its promise")


if __name__ == "__main__":
    main()
