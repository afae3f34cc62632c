"""A limit compared with live estimates: how a curve is read, what a check says, and the verdict of a unit."""

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stream.events import Check, EstimatePoint, EstimatePublished, Limit, LimitsApplied, RunEnded, Verdict, VerdictGiven
from stream.worker.limit_checks import judge, read_curve, unit_verdict, unit_verdicts

STABILITY = Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=1.0, unit_of_measure="deg/h")
WALK = Limit(characteristic="angle_random_walk", signal="rate", tau_s=None, upper=0.03, unit_of_measure="deg/sqrt(h)")


def point(tau_s: float, value: float, lo: float | None = None, hi: float | None = None) -> EstimatePoint:
    return EstimatePoint(
        tau_s=tau_s, value=value, lo=value if lo is None else lo, hi=value if hi is None else hi, edf=9.0, n=10
    )


def published(
    *points: EstimatePoint,
    estimator: str = "bias_stability_10s",
    unit_of_measure: str = "deg/h",
    t_ns: int = 0,
    unit: str = "FOG-1",
    signal: str = "rate",
    reason: str | None = None,
) -> EstimatePublished:
    return EstimatePublished(
        run="r1",
        t_ns=t_ns,
        unit=unit,
        signal=signal,
        estimator=estimator,
        unit_of_measure=unit_of_measure,
        confidence=0.95,
        samples=100,
        missing=0,
        sample_interval_s=0.005,
        points=points,
        reason=reason,
    )


@pytest.mark.parametrize(
    ("lo", "hi", "verdict"),
    [
        (0.8, 1.0, Verdict.PASS),
        (0.9, 1.1, Verdict.MARGINAL),
        (1.0, 1.2, Verdict.MARGINAL),
        (1.0001, 1.2, Verdict.FAIL),
        (math.nan, math.nan, Verdict.MARGINAL),
    ],
)
def test_the_confidence_bounds_decide(lo: float, hi: float, verdict: Verdict) -> None:
    check = judge(STABILITY, [published(point(10.0, 0.95, lo, hi))])
    assert check.verdict is verdict
    assert check.value == 0.95
    if verdict is Verdict.MARGINAL:
        assert check.reason == "the limit lies inside the 95% confidence bounds: the data do not decide"


def test_values_are_told_in_the_unit_of_the_limit() -> None:
    check = judge(STABILITY, [published(point(10.0, 2e-4, 1e-4, 2.5e-4), unit_of_measure="deg/s")])
    assert (check.value, check.lo, check.hi) == pytest.approx((0.72, 0.36, 0.9))
    assert check.verdict is Verdict.PASS


def test_angle_random_walk_is_the_allan_deviation_at_one_second_over_60() -> None:
    curve = published(point(0.5, 4.0), point(2.0, 1.0), estimator="allan_deviation")
    check = judge(WALK, [curve])
    assert check.value == pytest.approx(2.0 / 60)
    assert check.verdict is Verdict.FAIL


def test_the_latest_fitting_estimate_counts() -> None:
    estimates = [
        published(point(10.0, 0.5), t_ns=5),
        published(point(10.0, 2.0), t_ns=9),
        published(point(10.0, 0.5), t_ns=7),
        published(point(10.0, 0.5), t_ns=99, signal="temperature"),
        published(point(10.0, 0.5), t_ns=99, estimator="bias_stability_100s"),
    ]
    assert judge(STABILITY, estimates).verdict is Verdict.FAIL


def test_no_estimate_is_no_data_with_the_reason() -> None:
    cases = {
        "no bias_stability_10s of signal rate was published": [],
        "2 averages of 10 s needed, 1 seen": [published(reason="2 averages of 10 s needed, 1 seen")],
        "the estimate has no points": [published()],
        "'degC' cannot be converted to 'deg/h': they measure different quantities": [
            published(point(10.0, 1.0), unit_of_measure="degC")
        ],
        "the curve reaches from 1 s to 5 s, not to 10 s: a longer record is needed": [
            published(point(1.0, 1.0), point(5.0, 1.0))
        ],
    }
    for reason, estimates in cases.items():
        check = judge(STABILITY, estimates)
        assert (check.verdict, check.reason, check.value) == (Verdict.NO_DATA, reason, None)


@given(exponent=st.floats(-1, 1), w=st.floats(0, 1), tau_s=st.floats(1e-3, 1e5), ratio=st.floats(1.1, 10))
def test_a_power_law_is_read_exactly_between_its_points(exponent: float, w: float, tau_s: float, ratio: float) -> None:
    taus = (tau_s, tau_s * ratio)
    at = tau_s * ratio**w
    curve = [point(t, t**exponent, 0.5 * t**exponent, 3 * t**exponent) for t in taus]
    reading = read_curve(curve, at)
    assert reading[:3] == pytest.approx(
        (at**exponent, 0.5 * at**exponent, 3 * at**exponent), rel=0.0101 * abs(exponent) + 1e-9
    )


def test_a_curve_is_read_at_a_point_within_one_percent_and_never_beyond_its_ends() -> None:
    curve = [point(4.0, 2.0), point(1.0, 8.0)]
    assert read_curve(curve, 1.009).value == 8.0
    assert read_curve(curve, 0.991).value == 8.0
    beyond = read_curve(curve, 0.9)
    assert beyond.value is None
    assert beyond.reason is not None
    assert beyond.reason.endswith("a shorter sample interval is needed")
    assert read_curve(curve, 4.1).value is None
    assert read_curve([], 1.0).reason == "the estimate has no points"


def test_a_curve_that_touches_zero_is_read_on_a_straight_line() -> None:
    assert read_curve([point(1.0, 0.0), point(4.0, 2.0)], 2.0).value == pytest.approx(1.0)


def test_the_worst_check_is_the_units_verdict() -> None:
    def checks(*verdicts: Verdict) -> list[Check]:
        return [Check(limit=STABILITY, verdict=verdict) for verdict in verdicts]

    order = [Verdict.PASS, Verdict.NO_DATA, Verdict.MARGINAL, Verdict.FAIL]
    for i, worst in enumerate(order):
        assert unit_verdict(checks(*order[: i + 1])) is worst
        assert unit_verdict(checks(*reversed(order[: i + 1]))) is worst
    assert unit_verdict([]) is Verdict.NO_DATA
    assert unit_verdict(checks(Verdict.FAIL), aborted=True) is Verdict.ABORTED


def verdicts(*applied: LimitsApplied, outcome: str = "completed") -> dict[str, VerdictGiven]:
    """Verdicts of two units of run r1: FOG-1 has a bias stability of 0.1, FOG-2 of 9."""
    final = [published(point(10.0, 0.1), unit="FOG-1"), published(point(10.0, 9.0), unit="FOG-2", t_ns=9)]
    ended = RunEnded(run="r1", t_ns=5, uid="e", outcome=outcome)
    return {each.unit: each for each in unit_verdicts(ended, applied, final)}


def limits(unit: str | None = None, upper: float = 0.5) -> LimitsApplied:
    limit = Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=upper, unit_of_measure="deg/h")
    return LimitsApplied(run="r1", t_ns=0, revision="A", limits=(limit,), unit=unit)


def test_a_unit_is_judged_by_its_own_estimates() -> None:
    found = verdicts(limits())
    assert (found["FOG-1"].verdict, found["FOG-1"].t_ns, len(found["FOG-1"].checks)) == (Verdict.PASS, 5, 1)
    assert found["FOG-2"].verdict is Verdict.FAIL
    assert verdicts(limits("FOG-3"))["FOG-3"].verdict is Verdict.NO_DATA
    assert verdicts(limits()) == found  # the same documents again, with the same identities


def test_limits_on_a_unit_take_the_place_of_those_on_the_run() -> None:
    found = verdicts(limits(), limits("FOG-2", upper=10.0))
    assert {unit: each.verdict for unit, each in found.items()} == {"FOG-1": Verdict.PASS, "FOG-2": Verdict.PASS}


@pytest.mark.parametrize(("planned_s", "verdict"), [(0.55, Verdict.PASS), (1.0, Verdict.MARGINAL)])
def test_a_unit_that_fell_silent_does_not_pass(planned_s: float, verdict: Verdict) -> None:
    """Its estimates are of 0.5 s."""
    found = verdicts(msgspec.structs.replace(limits(), planned_s=planned_s))
    assert (found["FOG-1"].verdict, found["FOG-2"].verdict) == (verdict, Verdict.FAIL)
    reason = found["FOG-1"].checks[0].reason or ""
    assert reason.endswith("the whole record") == (verdict is Verdict.MARGINAL)


def test_an_aborted_run_passes_and_fails_no_unit() -> None:
    assert {each.verdict for each in verdicts(limits(), outcome="aborted").values()} == {Verdict.ABORTED}


def test_without_limits_there_is_no_verdict() -> None:
    assert verdicts() == verdicts(LimitsApplied(run="r1", t_ns=0, revision="A", limits=(), unit="FOG-1")) == {}


def test_a_deviation_of_0_is_no_pass() -> None:
    check = judge(STABILITY, [published(point(10.0, 0.0, 0.0, 0.0))])
    assert (check.verdict, check.value) == (Verdict.NO_DATA, None)
    assert (check.reason or "").startswith("all samples are alike")
