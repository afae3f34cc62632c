"""The table of group-sequential bounds: made by its function, in order, and the plans and points it is used with."""

import math
from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from stream.errors import EstimatorError
from stream.estimators.decision.decision import AllanDecision, DecisionPlan
from stream.estimators.decision.decision_bounds import AVERAGES, NO_BOUNDS, PROMISES, bounds, column_edf
from stream.estimators.decision.decision_plan import ROUNDING
from stream.events import EstimatePoint
from tests.bench.decision_calibration import RUNS, calibrated, simulated_ratios


def a_point(value: float, n: int, tau_s: float = 1.0) -> EstimatePoint:
    return EstimatePoint(tau_s=tau_s, value=value, lo=0.8 * value, hi=1.3 * value, edf=10.0, n=n)


@pytest.mark.long
@pytest.mark.parametrize("column", [0, 1])
def test_the_table_is_what_its_function_makes(column: int) -> None:
    ratios = simulated_ratios(AVERAGES[column], RUNS)
    for promise in PROMISES:
        made = calibrated(ratios, promise)
        shipped = bounds(column_edf(AVERAGES[column]), promise)
        for side, printed in zip(made, shipped, strict=True):
            np.testing.assert_allclose(side, printed, rtol=1e-9, atol=2e-4)


@given(st.floats(0.5, 1e7), st.floats(1.0, 4.0), st.sampled_from(PROMISES))
def test_bounds_enclose_the_limit_and_close_in(edf: float, more: float, promise: float) -> None:
    near = bounds(edf, promise)
    assert all(p < 1.0 < f for p, f in zip(near.passes, near.fails, strict=True))
    if edf >= column_edf(AVERAGES[0]):
        assert near.passes[-1] > 0.0
        assert math.isfinite(near.fails[-1])
    else:
        assert near == NO_BOUNDS
    if edf > column_edf(AVERAGES[-1]):
        wider, closer = near, bounds(edf * more, promise)
        assert all(a >= b for a, b in zip(wider.fails, closer.fails, strict=True))
        assert all(a <= b for a, b in zip(wider.passes, closer.passes, strict=True))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"limit": 0.0}, "limit is 0.0"),
        ({"tau_s": math.nan}, "tau_s is nan"),
        ({"duration_s": 1.5}, "holds no two averages"),
        ({"error_probability": 0.02}, "bounds exist for 0.01 and 0.05"),
        ({"looks": (0, 12)}, "24ths"),
        ({"windows_per_tau": 0}, "at least 1"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(EstimatorError, match=message):
        replace(DecisionPlan(tau_s=1.0, limit=1.0, duration_s=100.0), **change)  # type: ignore[arg-type]


def test_points_that_do_not_fit_are_refused() -> None:
    test = AllanDecision(DecisionPlan(tau_s=1.0, limit=1.0, duration_s=1000.0))
    test.look(100.0, a_point(1.0, 1000))
    with pytest.raises(EstimatorError, match="go forwards"):
        test.look(99.0, a_point(1.0, 1000))
    with pytest.raises(EstimatorError, match="is not between"):
        test.look(101.0, a_point(1.0, 999))
    with pytest.raises(EstimatorError, match="check elapsed_s and windows_per_tau"):
        test.look(101.0, a_point(1.0, 1700))
    with pytest.raises(EstimatorError, match=r"the point is of 1\.5 s"):
        test.look(101.0, a_point(1.0, 1500, tau_s=1.5))


def test_rounding_of_the_duration_costs_no_window() -> None:
    plan = DecisionPlan(tau_s=0.1, limit=1.0, duration_s=0.3, windows_per_tau=1)
    assert (plan.windows(0.3), plan.windows(0.3 * (1.0 - 100 * ROUNDING)), plan.averages(0.3)) == (2, 1, 3)
