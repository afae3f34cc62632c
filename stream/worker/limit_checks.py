"""A limit compared with live estimates, and the verdict of a unit that follows at the end of its run.

A check passes or fails only where the whole confidence interval of the estimate lies on one side of the limit.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple
from uuid import UUID, uuid5

import msgspec

from stream.defects.stillness import remark_on_stillness
from stream.duration import duration
from stream.errors import UnknownUnit
from stream.events import (
    Check,
    EarlyDecision,
    EstimatePoint,
    EstimatePublished,
    Limit,
    LimitsApplied,
    RunEnded,
    UnitReleased,
    Verdict,
    VerdictGiven,
)
from stream.quantities import conversion

ANGLE_RANDOM_WALK = "angle_random_walk"
ALLAN_DEVIATION = "allan_deviation"
BIAS_STABILITY = "bias_stability"
ANGLE_RANDOM_WALK_TAU_S = 1.0
SQRT_SECONDS_PER_SQRT_HOUR = 60.0
VERDICT = "verdict"

_NAMESPACE = UUID("5b0f4f0e-58f1-4a55-9d4b-3d0a6d1c2e77")
_SAME_TAU = 0.01
_FROZEN = "all samples are alike: the output is frozen, or its resolution too coarse to show noise"
WHOLE_RECORD = 0.9  # share of its planned length from which a record counts as whole
# A failure stands whatever else is missing. MARGINAL comes before NO_DATA because values at the limit were seen:
# it asks for a longer test or a decision, NO_DATA only for the missing measurement. PASS is left when all passed.
_WORST_FIRST = (Verdict.FAIL, Verdict.MARGINAL, Verdict.NO_DATA, Verdict.PASS)


class CurveReading(NamedTuple):
    """A curve read at one averaging time, or the reason why it cannot be."""

    value: float | None = None
    lo: float | None = None
    hi: float | None = None
    reason: str | None = None


def estimator_key(limit: Limit) -> str:
    """Key of the estimator whose result `limit` is compared with.

    >>> limit = Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=1.0, unit_of_measure="deg/h")
    >>> estimator_key(limit)
    'bias_stability_10s'
    """
    return f"{BIAS_STABILITY}_{limit.tau_s:g}s" if limit.characteristic == BIAS_STABILITY else ALLAN_DEVIATION


def read_curve(points: Sequence[EstimatePoint], tau_s: float) -> CurveReading:
    """Read a curve at `tau_s` seconds: a point within 1 % of it, else log-log between its neighbours, never beyond.

    Between (tau_1, y_1) and (tau_2, y_2): ln y = ln y_1 + w (ln y_2 - ln y_1), w =
    ln(tau/tau_1)/ln(tau_2/tau_1); the confidence bounds likewise. Where one y is 0 no logarithm exists and y
    itself is interpolated over ln tau.

    >>> point = lambda tau_s, y: EstimatePoint(tau_s=tau_s, value=y, lo=0.5 * y, hi=2 * y, edf=9, n=9)
    >>> curve = [point(1.0, 8.0), point(4.0, 2.0)]
    >>> [round(y, 9) for y in read_curve(curve, 2.0)[:3]]
    [4.0, 2.0, 8.0]
    >>> read_curve(curve, 5.0).reason
    'the curve reaches from 1 s to 4 s, not to 5 s: a longer record is needed'
    """
    if not points:
        return CurveReading(reason="the estimate has no points")
    nearest = min(points, key=lambda point: abs(point.tau_s - tau_s))
    if abs(nearest.tau_s - tau_s) <= _SAME_TAU * tau_s:
        return CurveReading(nearest.value, nearest.lo, nearest.hi)
    below = max((p for p in points if p.tau_s < tau_s), key=lambda p: p.tau_s, default=None)
    above = min((p for p in points if p.tau_s > tau_s), key=lambda p: p.tau_s, default=None)
    if below is None or above is None:
        first, last = min(p.tau_s for p in points), max(p.tau_s for p in points)
        remedy = "a longer record" if above is None else "a shorter sample interval"
        return CurveReading(
            reason=f"the curve reaches from {first:g} s to {last:g} s, not to {tau_s:g} s: {remedy} is needed"
        )
    w = math.log(tau_s / below.tau_s) / math.log(above.tau_s / below.tau_s)
    return CurveReading(
        _between(below.value, above.value, w), _between(below.lo, above.lo, w), _between(below.hi, above.hi, w)
    )


def judge(limit: Limit, estimates: Iterable[EstimatePublished]) -> Check:
    """Compare one limit with the latest matching estimate of one unit.

    Its characteristic names the estimator, see `estimator_key`. `angle_random_walk` is the Allan deviation at 1 s in
    deg/h, divided by 60 (N = sigma(1 s) sqrt(1 s)): true where white noise dominates at 1 s.

    PASS if the upper confidence bound is at or below the limit, FAIL if the lower one is above it, MARGINAL in between
    (the data do not decide), NO_DATA with the reason if there is no estimate. Where the output stood still nothing
    passes. What an estimate leaves out, its reason says, and so does the check. Values are in the limit's unit of
    measure.

    >>> limit = Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=1.0, unit_of_measure="deg/h")
    >>> judge(limit, []).reason
    'no bias_stability_10s of signal rate was published'
    """
    key = estimator_key(limit)
    matching = [e for e in estimates if e.estimator == key and e.signal == limit.signal]
    if not matching:
        return _no_data(limit, f"no {key} of signal {limit.signal} was published")
    estimate = max(matching, key=lambda e: e.t_ns)
    if not estimate.points:
        return _no_data(limit, estimate.reason or "the estimate has no points")
    is_walk = limit.characteristic == ANGLE_RANDOM_WALK
    unit = "deg/h" if is_walk else limit.unit_of_measure
    try:
        factor = conversion(estimate.unit_of_measure, unit)[0]
    except UnknownUnit as error:
        return _no_data(limit, str(error))
    if is_walk:
        factor /= SQRT_SECONDS_PER_SQRT_HOUR
    assert is_walk or limit.tau_s is not None
    value, lo, hi, reason = read_curve(estimate.points, limit.tau_s or ANGLE_RANDOM_WALK_TAU_S)
    if value is None or lo is None or hi is None:
        return _no_data(limit, reason or "the estimate has no points")
    value, lo, hi = value * factor, lo * factor, hi * factor
    verdict = Verdict.PASS if hi <= limit.upper else Verdict.FAIL if lo > limit.upper else Verdict.MARGINAL
    reason = estimate.reason
    still = remark_on_stillness(estimate.longest_still, estimate.samples)
    if hi <= 0.0:  # also of an estimate that does not say how long it stood still
        return _no_data(limit, _FROZEN if still is None else still[0])
    if still is not None and verdict is Verdict.PASS:
        return Check(limit=limit, verdict=Verdict.MARGINAL, value=value, lo=lo, hi=hi, reason=still[0])
    if verdict is Verdict.MARGINAL:
        undecided = f"the limit lies inside the {estimate.confidence:.0%} confidence bounds: the data do not decide"
        reason = "; ".join(filter(None, (undecided, reason)))
    return Check(limit=limit, verdict=verdict, value=value, lo=lo, hi=hi, reason=reason)


def _of_whole_record(
    check: Check, own: Sequence[EstimatePublished], planned_s: float, unseen: Mapping[tuple[str, str], float]
) -> Check:
    """MARGINAL instead of a PASS by a record that lacks much of its planned length: its source fell silent."""
    lengths = [
        each.samples * each.sample_interval_s + unseen.get((each.unit, each.signal), 0.0)
        for each in own
        if each.signal == check.limit.signal
    ]
    recorded_s = max(lengths, default=0.0)
    lack = remark_on_lack(recorded_s, planned_s)
    if check.verdict is not Verdict.PASS or lack is None:
        return check
    return msgspec.structs.replace(check, verdict=Verdict.MARGINAL, reason=lack[0])


def remark_on_lack(recorded_s: float, planned_s: float) -> tuple[str, str] | None:
    """Why a record is too short for a PASS, in English and Chinese; None if it is whole.

    >>> remark_on_lack(105.0, 120.0)[0], remark_on_lack(110.0, 120.0)
    ('87.5 % of the samples of 2 min are there: a PASS needs 90 % of them, the whole record', None)
    """
    share = recorded_s / planned_s
    if share >= WHOLE_RECORD:
        return None
    shown, needed = f"{100.0 * share:.3g} %", f"{100.0 * WHOLE_RECORD:g} %"
    return (
        f"{shown} of the samples of {duration(planned_s)} are there: a PASS needs {needed} of them, the whole record",
        f"{duration(planned_s)} 的采样只有 {shown}：合格须有 {needed}",
    )


def unit_verdict(checks: Iterable[Check], *, aborted: bool = False) -> Verdict:
    """Worst of a unit's checks, NO_DATA without any; ABORTED for an aborted run, whose samples may be disturbed."""
    if aborted:
        return Verdict.ABORTED
    found = {check.verdict for check in checks}
    return next((verdict for verdict in _WORST_FIRST if verdict in found), Verdict.NO_DATA)


def decided_early(check: Check, decision: EarlyDecision, released: UnitReleased) -> Check:
    """The check of a unit that was released early: the early decision stands in place of the short record.

    Where the estimate, all of it, lies on the other side of the limit, the two contradict each other: MARGINAL.
    """
    outcome = Verdict(decision.outcome)
    when = f"after {duration(released.recorded_s)} of {duration(released.planned_s)}"
    reason = f"decided early, {when}: {decision.reason}"
    if {outcome, check.verdict} == {Verdict.PASS, Verdict.FAIL}:
        outcome, reason = Verdict.MARGINAL, f"{outcome} was {reason}; the estimate says {check.verdict}: test it again"
    return msgspec.structs.replace(check, verdict=outcome, reason=reason)


def unit_verdicts(
    ended: RunEnded, applied: Iterable[LimitsApplied], final: Sequence[EstimatePublished],
    early: Iterable[EarlyDecision] = (), released: Mapping[str, UnitReleased] = MappingProxyType({}),
    unseen: Mapping[tuple[str, str], float] = MappingProxyType({}),
) -> Iterator[VerdictGiven]:  # fmt: skip
    """Verdict of each unit with limits by its `final` estimates; a unit's own limits replace those of the run.

    Limits of a `released` unit that were decided `early` stay decided. `unseen`: seconds of the record of a unit and
    signal that came too long before the limits to be judged.
    """
    decisions = {(each.unit, each.limit): each for each in early if each.outcome != "UNDECIDED"}
    by_unit = {each.unit: each for each in applied}
    common = by_unit.pop(None, None)
    of_unit = {unit: each for unit, each in by_unit.items() if unit is not None}
    if common is not None:
        signals = {limit.signal for limit in common.limits}
        of_unit |= {e.unit: common for e in final if e.signal in signals and e.unit not in of_unit}
    for unit, limits in of_unit.items():
        if limits.limits:
            own = [each for each in final if each.unit == unit]
            checks = tuple(judge(limit, own) for limit in limits.limits)
            if unit not in released and limits.planned_s is not None:
                checks = tuple(_of_whole_record(check, own, limits.planned_s, unseen) for check in checks)
            if (gone := released.get(unit)) is not None:
                checks = tuple(
                    decided_early(check, decision, gone) if (decision := decisions.get((unit, check.limit))) else check
                    for check in checks
                )
            verdict = unit_verdict(checks, aborted=ended.outcome == "aborted")
            uid = uuid5(_NAMESPACE, f"{ended.run}/{unit}/{ended.t_ns}").hex
            yield VerdictGiven(run=ended.run, t_ns=ended.t_ns, uid=uid, unit=unit, verdict=verdict, checks=checks)


def _between(below: float, above: float, w: float) -> float:
    if below > 0 and above > 0:
        return math.exp(math.log(below) * (1 - w) + math.log(above) * w)
    return below * (1 - w) + above * w


def _no_data(limit: Limit, reason: str) -> Check:
    return Check(limit=limit, verdict=Verdict.NO_DATA, reason=reason)
