"""Limits: the table's border, how a curve is read, and what a check says."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analytics.curves.limits import (
    demo_limits,
    estimator_key,
    judge,
    judge_unit,
    parse_limits,
    read_curve,
    read_limits,
    unit_verdict,
)
from ingest.simulator.demo_fleet import demo_fleet
from ingest.simulator.physics.plan import Plan
from ingest.simulator.station import PowerCycle, SimulatedStation
from stream.errors import BadInput
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.bias_stability import BiasStability
from stream.events import Check, EstimatePoint, EstimatePublished, Limit, Verdict

HOURS = 6
STABILITY = Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=1.0, unit_of_measure="deg/h")
WALK = Limit(characteristic="angle_random_walk", signal="rate", tau_s=None, upper=0.03, unit_of_measure="deg/sqrt(h)")
GOOD = """
revision = "A"
[[limit]]
characteristic = "bias_stability"
signal = "rate"
tau_s = 10.0
upper = 0.5
unit_of_measure = "deg/h"
"""


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
def test_the_confidence_limits_decide(lo: float, hi: float, verdict: Verdict) -> None:
    check = judge(STABILITY, [published(point(10.0, 0.95, lo, hi))])
    assert check.verdict is verdict
    assert check.value == 0.95
    if verdict is Verdict.MARGINAL:
        assert check.reason == "the limit lies inside the 95% confidence limits: the data do not decide"


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


def test_a_unit_is_judged_by_its_own_estimates() -> None:
    table = parse_limits(GOOD, "x.toml")
    estimates = [published(point(10.0, 0.1), unit="FOG-1"), published(point(10.0, 9.0), unit="FOG-2", t_ns=9)]
    given_1 = judge_unit(table, estimates, run="r1", unit="FOG-1", t_ns=5)
    assert (given_1.verdict, given_1.t_ns, len(given_1.checks)) == (Verdict.PASS, 5, 1)
    assert judge_unit(table, estimates, run="r1", unit="FOG-2", t_ns=5).verdict is Verdict.FAIL
    assert judge_unit(table, estimates, run="r2", unit="FOG-2", t_ns=5).verdict is Verdict.NO_DATA


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"bias_stability"', '"bias_stabilty"', r"x\.toml: Invalid enum value 'bias_stabilty' - at `\$\.limit\[0\]"),
        ("upper = 0.5", "upper = -1", r"Expected `float` > 0.0 - at `\$\.limit\[0\]\.upper`"),
        ("upper = 0.5", "upper = inf", r"\$\.limit\[0\] \(bias_stability\): upper and tau_s are finite"),
        ("upper = 0.5", "uper = 0.5", r"unknown field `uper` - at `\$\.limit\[0\]`"),
        ("tau_s = 10.0", "", r"\$\.limit\[0\] \(bias_stability\): tau_s is missing"),
        ('"deg/h"', '"degg/h"', "unit of measure 'degg/h' is not known"),
        ('"deg/h"', '"degC"', "'degC' is no angular rate"),
        ('revision = "A"', "", "missing required field `revision`"),
        ('"bias_stability"', '"angle_random_walk"', r"unit_of_measure is 'deg/sqrt\(h\)', not 'deg/h'"),
        ("[[limit]]", "[[limit", "x.toml: "),
    ],
)
def test_a_wrong_table_is_refused_with_the_place(old: str, new: str, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        parse_limits(GOOD.replace(old, new), "x.toml")


def test_angle_random_walk_takes_no_tau_but_one_second() -> None:
    text = GOOD.replace("bias_stability", "angle_random_walk").replace("deg/h", "deg/sqrt(h)")
    with pytest.raises(BadInput, match="it is read at 1 s; leave tau_s out"):
        parse_limits(text, "x.toml")
    assert parse_limits(text.replace("tau_s = 10.0", ""), "x.toml").limits[0].tau_s is None


def test_limits_are_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    with pytest.raises(BadInput, match=r"limits\.toml: cannot be read \(No such file"):
        read_limits(path)
    path.write_text(GOOD, encoding="utf-8")
    assert read_limits(path).applied("r1", 7).limits == read_limits(path).limits
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(BadInput, match=r"limits\.toml: "):
        read_limits(path)


def simulated_estimates(unit: str) -> list[EstimatePublished]:
    estimators = [AllanDeviation(), BiasStability(10.0), BiasStability(100.0)]
    alone = Plan(1, {unit: demo_fleet(1).parameters[unit]})
    station = SimulatedStation(alone, "r1", batch=100_000, temperature_batch=60)
    for batch in station.batches("r1", PowerCycle(0, 0), round(HOURS * 3600e9)):
        for estimator in estimators:
            if batch.signal == "rate":
                estimator.update(batch)
    estimates = []
    for estimator in estimators:
        points = estimator.estimate()
        assert isinstance(points, tuple)
        estimates.append(published(*points, estimator=estimator.key, unit=unit))
    return estimates


def test_the_demo_fleet_is_judged_as_planted() -> None:
    table = demo_limits()
    assert [estimator_key(limit) for limit in table.limits] == [
        "allan_deviation",
        "allan_deviation",
        "bias_stability_10s",
        "bias_stability_100s",
    ]
    verdicts = {
        unit: judge_unit(table, simulated_estimates(unit), run="r1", unit=unit, t_ns=0) for unit in demo_fleet(1).units
    }
    marginal, worse, drifting = (verdicts.pop(unit) for unit in ("FOG-0238", "FOG-0234", "FOG-0236"))
    assert {unit: given.verdict for unit, given in verdicts.items()} == dict.fromkeys(verdicts, Verdict.PASS)
    assert [check.verdict for check in worse.checks[:3]] == [Verdict.FAIL] * 3
    assert [check.verdict for check in drifting.checks] == [*[Verdict.PASS] * 3, Verdict.FAIL]
    assert [check.verdict for check in marginal.checks] == [Verdict.PASS, Verdict.MARGINAL, Verdict.PASS, Verdict.PASS]
