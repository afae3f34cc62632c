"""Test plans: candidate tests with as many repeats as they need, and the cheapest of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.next_test.candidate import CandidateTest
from analytics.loop.next_test.predicted_run import ThermalChain, predicted_runs, repeated_run
from analytics.loop.next_test.separation import Separation
from analytics.loop.next_test.station_bounds import StationBounds
from analytics.loop.next_test.timeline import timeline

WANTED_POWER = 0.9
_LEAST_POWER, _HOPELESS_POWER = 0.05, 0.02  # of a plan worth naming; of a test not worth repeating
_MOST_PLANS = 5
_MOST_REPEATS = 3
_PREPARATION_H = 0.25  # to mount and warm up, for each run

Decides = Callable[[Sequence[RunBlocks]], Callable[[int], Separation] | None]
"""What a test, by its power-ons, decides if it is run a number of times; None if a channel has no value in it."""


class TestPlan(msgspec.Struct, frozen=True, kw_only=True):
    """A test that may decide.

    Parameters
    ----------
    hours: Of all its runs, with ramps and pauses.
    power: Probability that it decides.
    separation: Least expected difference of evidence between a true effect and another, chi-square.
    by_truth: Power if each of the rivals is the true one.
    assured: The least of these over the rivals that the data so far leave likely.
    """

    __test__ = False

    test: CandidateTest
    hours: float
    power: float
    separation: float
    by_truth: dict[str, float]
    assured: float = 0.0

    @property
    def is_enough(self) -> bool:
        """Whether it decides with the wanted power whichever of the likely rivals is true."""
        return self.assured >= WANTED_POWER

    def document(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "procedure": self.test.name,
            "what": str(self.test.what),
            "repeat_of": self.test.like or None,
            "runs": self.test.repeats,
            "hours": round(self.hours, 2),
            "power": round(self.power, 3),
            "separation": round(self.separation, 1),
            "least_power": round(self.assured, 3),
            "by_truth": {name: round(power, 3) for name, power in self.by_truth.items()},
            "steps": list(self.test.steps),
        }


@dataclass(frozen=True)
class TimedTest:
    """A candidate test with its hours and the runs that it would leave, one for each power-on."""

    hours: float
    runs: list[RunBlocks]
    test: CandidateTest


def timed_tests(
    tests: Sequence[CandidateTest],
    runs: Sequence[RunBlocks],
    bounds: StationBounds,
    positions: Mapping[str, float] | None = None,
) -> list[TimedTest]:
    """Candidate tests with what they would record, the shortest first; `positions` are the numbers of the words."""
    chain, last_ns = ThermalChain.of_runs(runs), max(run.t0_ns for run in runs)
    of_name = {run.run: run for run in runs}
    timed = []
    for test in tests:
        if test.like:
            own = [repeated_run(of_name[test.like], test.name, last_ns)]
            hours = float(own[0].slot[-1] + 1 - own[0].slot[0]) * own[0].block_s / 3600.0
        else:
            played = timeline(test, bounds)
            own, hours = predicted_runs(played, runs, chain, test.name, positions or {}), played.hours
        if own and all(len(each) for each in own):
            timed.append(TimedTest(hours + _PREPARATION_H, own, test))
    return sorted(timed, key=lambda each: each.hours)


def cheapest_plans(
    decides: Decides, timed: Sequence[TimedTest], on_progress: Callable[[str], None]
) -> tuple[tuple[TestPlan, ...], TestPlan | None]:
    """Plans that reach the power, the cheapest first, else the most powerful; and the cheapest repetition.

    Parameters
    ----------
    timed: The shortest first.
    """
    good: list[TestPlan] = []
    weak: list[TestPlan] = []
    repeat: TestPlan | None = None
    for number, each in enumerate(timed, start=1):
        on_progress(f"planning the next test ({number} of {len(timed)})")
        most = good[_MOST_PLANS - 1].hours if len(good) >= _MOST_PLANS else np.inf
        plan = _cheapest(decides, each, np.inf if each.test.like and repeat is None else most)
        if plan is None:
            continue
        if each.test.like and plan.is_enough and (repeat is None or plan.hours < repeat.hours):
            repeat = plan
        (good if plan.is_enough else weak).append(plan)
        good.sort(key=lambda each: each.hours)
    chosen = good or sorted(weak, key=lambda each: (-round(each.assured, 2), -round(each.power, 2), each.hours))
    return tuple(each for each in chosen[:_MOST_PLANS] if each.power > _LEAST_POWER), repeat


def _cheapest(decides: Decides, timed: TimedTest, most_h: float) -> TestPlan | None:
    """The test with as many repeats as its power needs; None if it does not fit or has no hope."""
    hours, test = timed.hours, timed.test
    if hours > most_h or (of_repeats := decides(timed.runs)) is None:
        return None
    best: TestPlan | None = None
    for repeats in range(1, min(_MOST_REPEATS, int(most_h / hours) if np.isfinite(most_h) else _MOST_REPEATS) + 1):
        found = of_repeats(repeats)
        best = TestPlan(
            test=msgspec.structs.replace(test, repeats=repeats),
            hours=repeats * hours,
            power=found.power,
            separation=found.least,
            by_truth=found.by_truth,
            assured=found.assured,
        )
        if best.is_enough or found.power < _HOPELESS_POWER:
            break
    return best
