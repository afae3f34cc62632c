"""Early decisions: their laws, their agreement with the finished test, and how often they are wrong at the limit.

The full form, with the hours saved, is ``tests/bench/early_decision.py``.
"""

import math
from dataclasses import replace
from uuid import UUID

import hypothesis.strategies as st
import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings

from stream.batch import SampleBatch
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.decision.decision import (
    AllanDecision,
    BiasStabilityDecision,
    DecisionPlan,
    DecisionRule,
    Outcome,
)
from stream.estimators.decision.decision_bounds import AVERAGES, PROMISES, bounds
from tests.stream.estimators.decision_records import KINDS, R, a_point, hourly, judged, noise, squares


@pytest.mark.in_gate("8-0.05", "8-0.01")
@pytest.mark.parametrize("promise", PROMISES)
@pytest.mark.parametrize("averages", AVERAGES[:4])
def test_bounds_keep_their_promise_on_other_draws(averages: int, promise: float) -> None:
    """Between two columns the one with fewer degrees is used, drawn in; the error must not exceed the promise."""
    for between in (averages, averages * 3 // 2):
        runs = 5000
        values = noise("random walk", runs, between * R, np.random.default_rng([between, 5]))
        ends = np.array([max(0, math.floor(t * R * between) - 2 * R + 1) for t in np.arange(1, 25) / 24])
        total = np.cumsum(squares(values), axis=1)
        ratio = np.where(ends > 0, total[:, np.maximum(ends, 1) - 1] / (2.0 * np.maximum(ends, 1)), 1.0)
        plan = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=float(between), error_probability=promise)
        used = AllanDecision(plan)._bounds
        most = scipy.stats.binom.ppf(1.0 - 0.001 / 40, runs, promise)
        assert np.count_nonzero((ratio >= used.fails).any(axis=1)) <= most
        assert np.count_nonzero(((ratio <= used.passes) & (np.array(used.passes) > 0.0)).any(axis=1)) <= most


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_wrong_at_the_limit_no_more_often_than_promised(kind: str) -> None:
    runs, averages = 1200, 120
    plan = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=float(averages), point_decides=False)
    rng = np.random.default_rng([20261121, KINDS.index(kind)])
    outcomes = [judged(plan, row, hourly(averages)).outcome for row in squares(noise(kind, runs, averages * R, rng))]
    # fails only if the one-sided 99.9 % binomial bound, for 8 checks together, excludes 1 %
    most = scipy.stats.binom.ppf(1.0 - 0.001 / (2 * len(KINDS)), runs, plan.error_probability)
    assert outcomes.count(Outcome.PASS) <= most
    assert outcomes.count(Outcome.FAIL) <= most


@pytest.mark.parametrize(("ratio", "outcome"), [(0.5, Outcome.PASS), (2.0, Outcome.FAIL)])
def test_clear_cases_are_decided_right_and_early(ratio: float, outcome: Outcome) -> None:
    averages = 400
    plan = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=float(averages))
    rows = ratio**2 * squares(noise("flicker", 60, averages * R, np.random.default_rng(3)))
    decisions = [judged(plan, row, hourly(averages)) for row in rows]
    assert {decision.outcome for decision in decisions} == {outcome}
    assert np.mean([decision.looked_at_fraction for decision in decisions]) < 0.35


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.5, 2.0), st.sampled_from([0.0, 0.3]), st.integers(1, 20))
def test_curtailment_never_disagrees_with_the_finished_test(
    seed: int, limit: float, lost_share: float, windows_per_tau: int
) -> None:
    """No planned look but the end: whatever is decided before is curtailed. Windows are lost at random."""
    rng = np.random.default_rng(seed)
    plan = DecisionPlan(tau_s=1.0, limit=limit, duration_s=30.0, looks=(), windows_per_tau=windows_per_tau)
    test = AllanDecision(plan)
    most = plan.windows(plan.duration_s)
    there = rng.random(most) >= lost_share
    total = np.cumsum(2.0 * there * rng.standard_normal(most) ** 2 * rng.uniform(0.2, 3.0, most))
    counts = np.cumsum(there)
    early = None
    point = None
    for at_s in np.arange(2.0, 30.0, 0.5).tolist():
        done = plan.windows(at_s)
        n = int(counts[done - 1])
        point = a_point(float(total[done - 1]) / (2.0 * n), n) if n else None
        early = test.look(at_s, point)
    final_n = int(counts[-1])
    variance = float(total[-1]) / (2.0 * final_n)
    final = test.look(30.0, a_point(variance, final_n))
    assert early is not None
    assert early.outcome in {Outcome.UNDECIDED, Outcome.FAIL}
    if early.outcome is Outcome.FAIL:
        assert early.rule is DecisionRule.CURTAILED
        assert early.error_probability == 0.0
    if final.rule is not DecisionRule.BOUNDS:
        assert (final.outcome is Outcome.FAIL) == (math.sqrt(variance) > limit)


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.3, 2.0), st.floats(0.0, 0.3), st.floats(0.0, 0.02))
def test_bias_stability_fails_early_only_if_the_finished_test_fails(
    seed: int, limit: float, lost_share: float, drift: float
) -> None:
    rng = np.random.default_rng(seed)
    averages = 200
    values = rng.standard_normal(averages) + drift * np.arange(averages)
    kept = rng.random(averages) >= lost_share
    kept[:2] = True
    test = BiasStabilityDecision(DecisionPlan(tau_s=10.0, limit=limit, duration_s=10.0 * averages))
    decision = test.look(0.0, None)
    for i in range(2, averages):
        seen = values[:i][kept[:i]]
        decision = test.look(10.0 * i, a_point(float(np.var(seen, ddof=1)), len(seen), 10.0))
        assert decision.outcome is not Outcome.PASS
    finished = values[kept]
    final = test.look(10.0 * averages, a_point(float(np.var(finished, ddof=1)), len(finished), 10.0))
    assert (final.outcome is Outcome.FAIL) == (float(np.std(finished, ddof=1)) > limit)
    assert decision.outcome in {Outcome.UNDECIDED, final.outcome}


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.3, 3.0), st.floats(1.0, 3.0), st.booleans())
def test_a_larger_limit_never_turns_pass_to_fail(seed: int, limit: float, larger: float, point_decides: bool) -> None:
    rng = np.random.default_rng(seed)
    row = squares(noise("white", 1, 60 * R, rng))[0]
    plan = DecisionPlan(tau_s=1.0, limit=limit, duration_s=60.0, point_decides=point_decides)
    strict = judged(plan, row, hourly(60))
    lenient = judged(replace(plan, limit=limit * larger), row, hourly(60))
    order = [Outcome.FAIL, Outcome.UNDECIDED, Outcome.PASS]
    assert order.index(lenient.outcome) >= order.index(strict.outcome)


def test_a_decision_once_given_stands() -> None:
    test = AllanDecision(DecisionPlan(tau_s=1.0, limit=1.0, duration_s=1000.0))
    first = test.look(500.0, a_point(0.04, test.plan.windows(500.0)))
    assert (first.outcome, first.rule, first.looked_at_fraction) == (Outcome.PASS, DecisionRule.BOUNDS, 0.5)
    assert test.look(1000.0, a_point(100.0, test.plan.windows(1000.0))) is first
    assert test.decision is first


def test_a_planned_look_is_used_once() -> None:
    """A value beyond the bound that comes between two planned looks decides nothing until the next."""
    test = AllanDecision(DecisionPlan(tau_s=1.0, limit=1.0, duration_s=1000.0))
    assert test.look(500.0, a_point(1.0, test.plan.windows(500.0))).outcome is Outcome.UNDECIDED
    assert test.look(501.0, a_point(0.04, test.plan.windows(501.0))).outcome is Outcome.UNDECIDED
    assert test.look(542.0, a_point(0.04, test.plan.windows(542.0))).outcome is Outcome.PASS


def test_lost_windows_put_a_look_off() -> None:
    test = AllanDecision(DecisionPlan(tau_s=1.0, limit=1.0, duration_s=1000.0))
    just_passes = bounds(1e3, 0.01).passes[5]
    assert test.look(500.0, a_point(just_passes, test.plan.windows(100.0))).outcome is Outcome.UNDECIDED


@pytest.mark.parametrize(("variance", "outcome"), [(1.0, Outcome.PASS), (1.02, Outcome.FAIL)])
def test_the_end_decides_by_the_point(variance: float, outcome: Outcome) -> None:
    plan = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=1000.0)
    point = a_point(variance, plan.windows(1000.0))
    final = AllanDecision(plan).look(1000.0, point)
    assert (final.outcome, final.rule) == (outcome, DecisionRule.FINISHED)
    open_end = AllanDecision(replace(plan, point_decides=False))
    assert open_end.look(1000.0, point).outcome is Outcome.UNDECIDED
    assert open_end.decision is not None
    assert BiasStabilityDecision(plan).look(1000.0, a_point(variance, 1000)).outcome is outcome


def test_without_the_point_curtailment_waits_for_the_last_bound() -> None:
    plan = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=1000.0, looks=(), point_decides=False)
    most, n = plan.windows(1000.0), plan.windows(900.0)
    last = AllanDecision(plan)._bounds.fails[-1]
    below = AllanDecision(plan).look(900.0, a_point(last * 0.99 * most / n, n))
    above = AllanDecision(plan).look(900.0, a_point(last * 1.01 * most / n, n))
    assert (below.outcome, above.outcome, above.error_probability) == (Outcome.UNDECIDED, Outcome.FAIL, 0.01)


def test_forecasts_come_true_if_the_deviation_stays() -> None:
    for variance in (0.2, 0.55, 0.8, 1.0, 1.1, 1.5, 4.0):
        test = AllanDecision(DecisionPlan(tau_s=1.0, limit=1.0, duration_s=1000.0))
        decision = test.look(20.0, a_point(variance, test.plan.windows(20.0)))
        assert decision.outcome is Outcome.UNDECIDED
        foreseen_s = decision.forecast_s
        for at_s in np.arange(21.0, 1001.0, 0.5).tolist():
            decision = test.look(at_s, a_point(variance, test.plan.windows(at_s)))
            if decision.outcome is not Outcome.UNDECIDED:
                break
        decided_s = decision.looked_at_fraction * 1000.0
        if foreseen_s is None:
            assert decided_s > 999.0
        else:
            assert decided_s == pytest.approx(foreseen_s, abs=1.0)


def test_a_forecast_says_how_late_it_may_be() -> None:
    plan = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=1000.0)
    early = AllanDecision(plan).look(100.0, a_point(0.8, plan.windows(100.0)))
    assert early.forecast_s is not None
    assert early.forecast_latest_s is None
    assert "as late as the end" in early.reason_en
    at_limit = AllanDecision(plan).look(100.0, a_point(1.0, plan.windows(100.0)))
    assert at_limit.forecast_s is None
    assert "not before the end" in at_limit.reason_en
    assert "结束前不会有结论" in at_limit.reason_zh
    bias = BiasStabilityDecision(plan).look(100.0, a_point(2.0, 100))
    assert bias.forecast_s == pytest.approx(500.0, abs=2.0)
    assert BiasStabilityDecision(plan).look(100.0, a_point(0.5, 100)).forecast_s is None


def test_short_tests_have_no_bounds_and_end_by_the_point() -> None:
    plan = DecisionPlan(tau_s=1.0, limit=1.0, duration_s=6.0)
    test = AllanDecision(plan)
    assert test.look(5.0, a_point(0.0, plan.windows(5.0))).outcome is Outcome.UNDECIDED
    assert test.look(6.0, a_point(0.0, plan.windows(6.0))).outcome is Outcome.PASS


@pytest.mark.long
def test_points_of_the_estimator_fit_the_plan() -> None:
    rng = np.random.default_rng(9)
    estimator = AllanDeviation()
    plan = DecisionPlan(tau_s=32.0, limit=3.0, duration_s=9600.0)
    test = AllanDecision(plan)
    for i in range(96):
        values = rng.standard_normal(100)
        estimator.update(
            SampleBatch("FOG-1", "rate", "r1", UUID(int=1), i, i * 100 * 10**9, 10**9, "deg/h", values=values)
        )
        points = estimator.estimate()
        assert not isinstance(points, NoEstimate)
        point = next((p for p in points if p.tau_s == 32.0), None)
        elapsed_s = 100.0 * (i + 1)
        assert point is None or point.n == plan.windows(elapsed_s)
        test.look(elapsed_s, point)
    assert test.decision is not None
    assert test.decision.outcome is Outcome.PASS
    assert test.decision.looked_at_fraction < 0.3
