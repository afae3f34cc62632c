"""Limits: a table of them from TOML, and what an estimate says about each.

A check passes or fails only where the confidence limits of the estimate lie on one side of the limit.
"""

import math
from collections.abc import Iterable, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec

from stream.errors import BadInput, UnknownUnit
from stream.events import Check, EstimatePoint, EstimatePublished, Limit, LimitsApplied, Verdict, VerdictGiven
from stream.quantities import conversion, is_angular_rate
from stream.toml_text import decode_toml

ANGLE_RANDOM_WALK = "angle_random_walk"
ALLAN_DEVIATION = "allan_deviation"
BIAS_STABILITY = "bias_stability"
ANGLE_RANDOM_WALK_UNIT = "deg/sqrt(h)"
ANGLE_RANDOM_WALK_TAU_S = 1.0
SQRT_SECONDS_PER_SQRT_HOUR = 60.0
SAME_TAU = 0.01

# A failure stands whatever else is missing. MARGINAL comes before NO_DATA because values at the limit were seen:
# it asks for a longer test or a decision, NO_DATA only for the missing measurement. PASS is left when all passed.
_WORST_FIRST = (Verdict.FAIL, Verdict.MARGINAL, Verdict.NO_DATA, Verdict.PASS)


class _Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One `[[limit]]` of the file."""

    characteristic: Literal["bias_stability", "allan_deviation", "angle_random_walk"]
    signal: Annotated[str, msgspec.Meta(min_length=1)]
    upper: Annotated[float, msgspec.Meta(gt=0)]
    unit_of_measure: str
    tau_s: Annotated[float, msgspec.Meta(gt=0)] | None = None


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    revision: Annotated[str, msgspec.Meta(min_length=1)]
    limit: Annotated[tuple[_Entry, ...], msgspec.Meta(min_length=1)]


class LimitsTable(msgspec.Struct, frozen=True):
    """Limits under one revision.

    Parameters
    ----------
    revision: What a certificate calls this table.
    limits: The limits, in the file's order.
    """

    revision: str
    limits: tuple[Limit, ...]

    def applied(self, run: str, t_ns: int, planned_s: float | None = None) -> LimitsApplied:
        """Return the document that says that `run`, planned to last `planned_s` seconds, is judged by this table."""
        return LimitsApplied(run=run, t_ns=t_ns, revision=self.revision, limits=self.limits, planned_s=planned_s)


class Reading(NamedTuple):
    """A curve read at one averaging time, or why it cannot be."""

    value: float | None = None
    lo: float | None = None
    hi: float | None = None
    reason: str | None = None


def parse_limits(text: str | bytes, source: str) -> LimitsTable:
    """Read a table of limits from TOML.

    Parameters
    ----------
    text: The TOML.
    source: Where it comes from, for messages.

    Raises
    ------
    BadInput: If it is not such a table; the message names the place, such as ``$.limit[2].upper``.

    Examples
    --------
    >>> table = parse_limits('''
    ... revision = "A"
    ... [[limit]]
    ... characteristic = "bias_stability"
    ... signal = "rate"
    ... tau_s = 10.0
    ... upper = 0.5
    ... unit_of_measure = "deg/h"
    ... ''', "limits.toml")
    >>> table.revision, table.limits[0].upper
    ('A', 0.5)
    """
    try:
        parsed = decode_toml(text, _File)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(f"limits {source}: {error}") from error
    limits = tuple(
        _limit(entry, f"limits {source}: $.limit[{i}] ({entry.characteristic})") for i, entry in enumerate(parsed.limit)
    )
    return LimitsTable(parsed.revision, limits)


def read_limits(path: Path) -> LimitsTable:
    """Read a table of limits from a file; see `parse_limits`.

    Raises
    ------
    BadInput: If the file cannot be read or is not such a table.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise BadInput(f"limits {path}: cannot be read ({error.strerror or error})") from error
    return parse_limits(text, str(path))


def demo_limits() -> LimitsTable:
    """Return the limits of the demonstration, which ship with the package.

    Examples
    --------
    >>> [limit.characteristic for limit in demo_limits().limits]
    ['angle_random_walk', 'allan_deviation', 'bias_stability', 'bias_stability']
    """
    return parse_limits(files("analytics.demo").joinpath("demo_limits.toml").read_bytes(), "demo_limits.toml")


def estimator_key(limit: Limit) -> str:
    """Key of the estimator whose result `limit` is compared with.

    Examples
    --------
    >>> [estimator_key(limit) for limit in demo_limits().limits[1:3]]
    ['allan_deviation', 'bias_stability_10s']
    """
    return f"{BIAS_STABILITY}_{limit.tau_s:g}s" if limit.characteristic == BIAS_STABILITY else ALLAN_DEVIATION


def read_curve(points: Sequence[EstimatePoint], tau_s: float) -> Reading:
    """Read a curve at `tau_s`: a point within 1 % of it, else log-log between its neighbours, never beyond.

    Parameters
    ----------
    points: The curve, in any order.
    tau_s: Averaging time, seconds.

    Notes
    -----
    Between (tau_1, y_1) and (tau_2, y_2): ln y = ln y_1 + w (ln y_2 - ln y_1), w =
    ln(tau/tau_1)/ln(tau_2/tau_1); the confidence limits likewise. Where one y is 0 no logarithm exists and y
    itself is interpolated over ln tau.

    Examples
    --------
    >>> point = lambda tau_s, y: EstimatePoint(tau_s=tau_s, value=y, lo=0.5 * y, hi=2 * y, edf=9, n=9)
    >>> curve = [point(1.0, 8.0), point(4.0, 2.0)]
    >>> [round(y, 9) for y in read_curve(curve, 2.0)[:3]]
    [4.0, 2.0, 8.0]
    >>> read_curve(curve, 5.0).reason
    'the curve reaches from 1 s to 4 s, not to 5 s: a longer record is needed'
    """
    if not points:
        return Reading(reason="the estimate has no points")
    nearest = min(points, key=lambda point: abs(point.tau_s - tau_s))
    if abs(nearest.tau_s - tau_s) <= SAME_TAU * tau_s:
        return Reading(nearest.value, nearest.lo, nearest.hi)
    below = max((p for p in points if p.tau_s < tau_s), key=lambda p: p.tau_s, default=None)
    above = min((p for p in points if p.tau_s > tau_s), key=lambda p: p.tau_s, default=None)
    if below is None or above is None:
        first, last = min(p.tau_s for p in points), max(p.tau_s for p in points)
        remedy = "a longer record" if above is None else "a shorter sample interval"
        return Reading(
            reason=f"the curve reaches from {first:g} s to {last:g} s, not to {tau_s:g} s: {remedy} is needed"
        )
    w = math.log(tau_s / below.tau_s) / math.log(above.tau_s / below.tau_s)
    return Reading(
        _between(below.value, above.value, w), _between(below.lo, above.lo, w), _between(below.hi, above.hi, w)
    )


def judge(limit: Limit, estimates: Iterable[EstimatePublished]) -> Check:
    """Hold one limit against the latest fitting estimate of one unit.

    Parameters
    ----------
    limit: The limit; its characteristic names the estimator, see `estimator_key`. `angle_random_walk` is the Allan
        deviation at 1 s in deg/h, divided by 60 (N = sigma(1 s) sqrt(1 s)): true where white noise dominates at 1 s.
    estimates: What was estimated of the unit.

    Returns
    -------
    Check
        PASS if the upper confidence limit is at or below the limit, FAIL if the lower one is above it,
        MARGINAL in between (the data do not decide), NO_DATA with the reason if there is no estimate. Values
        are in the limit's unit of measure.

    Examples
    --------
    >>> limit = demo_limits().limits[2]
    >>> judge(limit, []).reason
    'no bias_stability_10s of signal rate was published'
    """
    key = estimator_key(limit)
    fitting = [e for e in estimates if e.estimator == key and e.signal == limit.signal]
    if not fitting:
        return _no_data(limit, f"no {key} of signal {limit.signal} was published")
    estimate = max(fitting, key=lambda e: e.t_ns)
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
    if hi <= limit.upper:
        return Check(limit=limit, verdict=Verdict.PASS, value=value, lo=lo, hi=hi)
    if lo > limit.upper:
        return Check(limit=limit, verdict=Verdict.FAIL, value=value, lo=lo, hi=hi)
    reason = f"the limit lies inside the {estimate.confidence:.0%} confidence limits: the data do not decide"
    return Check(limit=limit, verdict=Verdict.MARGINAL, value=value, lo=lo, hi=hi, reason=reason)


def unit_verdict(checks: Iterable[Check], *, aborted: bool = False) -> Verdict:
    """Worst of a unit's checks: FAIL, then MARGINAL, then NO_DATA, then PASS; NO_DATA without any check.

    A run that was aborted gives ABORTED whatever its checks say: what stopped it may have disturbed the
    samples.

    Examples
    --------
    >>> unit_verdict([]).value, unit_verdict([], aborted=True).value
    ('NO_DATA', 'ABORTED')
    """
    if aborted:
        return Verdict.ABORTED
    given = {check.verdict for check in checks}
    return next((verdict for verdict in _WORST_FIRST if verdict in given), Verdict.NO_DATA)


def judge_unit(
    table: LimitsTable, estimates: Sequence[EstimatePublished], *, run: str, unit: str, t_ns: int, aborted: bool = False
) -> VerdictGiven:
    """Hold all limits of a table against one unit's estimates of one run; estimates of others are left out.

    Examples
    --------
    >>> judge_unit(demo_limits(), [], run="r1", unit="FOG-1", t_ns=0).verdict.value
    'NO_DATA'
    """
    own = [e for e in estimates if e.run == run and e.unit == unit]
    checks = tuple(judge(limit, own) for limit in table.limits)
    return VerdictGiven(run=run, t_ns=t_ns, unit=unit, verdict=unit_verdict(checks, aborted=aborted), checks=checks)


def _limit(entry: _Entry, where: str) -> Limit:
    if not math.isfinite(entry.upper) or not math.isfinite(entry.tau_s or 0.0):
        raise BadInput(f"{where}: upper and tau_s are finite numbers")
    if entry.characteristic == ANGLE_RANDOM_WALK:
        if entry.unit_of_measure != ANGLE_RANDOM_WALK_UNIT:
            raise BadInput(f"{where}: unit_of_measure is {ANGLE_RANDOM_WALK_UNIT!r}, not {entry.unit_of_measure!r}")
        if entry.tau_s not in (None, ANGLE_RANDOM_WALK_TAU_S):
            raise BadInput(f"{where}: it is read at 1 s; leave tau_s out")
    else:
        if entry.tau_s is None:
            raise BadInput(f"{where}: tau_s is missing")
        try:
            is_rate = is_angular_rate(entry.unit_of_measure)
        except UnknownUnit as error:
            raise BadInput(f"{where}: {error}") from error
        if entry.signal == "rate" and not is_rate:
            raise BadInput(f"{where}: {entry.unit_of_measure!r} is no angular rate; for example deg/h")
    return Limit(
        characteristic=entry.characteristic,
        signal=entry.signal,
        tau_s=entry.tau_s,
        upper=entry.upper,
        unit_of_measure=entry.unit_of_measure,
    )


def _between(below: float, above: float, w: float) -> float:
    if below > 0 and above > 0:
        return math.exp(math.log(below) * (1 - w) + math.log(above) * w)
    return below * (1 - w) + above * w


def _no_data(limit: Limit, reason: str) -> Check:
    return Check(limit=limit, verdict=Verdict.NO_DATA, reason=reason)
