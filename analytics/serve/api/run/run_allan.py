"""Allan deviation of some units of a run side by side, with the limits that they are judged by."""

import time
from itertools import islice
from typing import Literal

import msgspec

from analytics.serve.api.operation import Call, Nothing, get
from analytics.serve.api.query.allan import Allan, AllanAsked, allan
from analytics.serve.api.rows import Name, dictionaries
from analytics.serve.api.run.run_course import RunCourse, run_course
from storage.specifications.live_limits import chosen_periods, unit_limits
from stream.errors import BadInput, GyrofleetError, NotFound, UnknownUnit
from stream.events import EstimatePoint, Limit
from stream.quantities import conversion, is_angular_rate
from stream.worker.limit_checks import (
    ALLAN_DEVIATION,
    ANGLE_RANDOM_WALK,
    ANGLE_RANDOM_WALK_TAU_S,
    SQRT_SECONDS_PER_SQRT_HOUR,
    estimator_key,
    read_curve,
)

MOST_UNITS = 8
_FIRST = 3
_ESTIMATED = (
    "select distinct unit from estimates where run = $run and signal = $signal and estimator = 'allan_deviation'"
)
_ABOUT = "select product from internal.served_units where unit = $unit and run = $run"
_SIGNALS = "select distinct signal, unit_of_measure from internal.lake_channels where run = $run and unit = $unit"


class RunAllanAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which units, at most 8, and which of their signals: a rate by default."""

    unit: tuple[Name, ...] = ()
    signal: Name = ""


class DrawnLimit(msgspec.Struct, frozen=True, kw_only=True):
    """An upper limit on the Allan deviation at `tau_s`, `upper` in the unit of measure of the curve.

    `comparison` says where the interval of the curve lies there so far: ``below`` the limit, ``above`` or ``across``
    it, or ``none`` without one. It is no verdict, for which a record must be whole, and more.
    """

    tau_s: float
    upper: float
    characteristic: str
    comparison: Literal["below", "above", "across", "none"]
    value: float | None
    lo: float | None
    hi: float | None


class UnitCurve(msgspec.Struct, frozen=True, kw_only=True):
    """The curve of a unit and its limits; without a curve, `reason` says why."""

    unit: str
    curve: Allan | None
    limits: list[DrawnLimit]
    reason: str | None = None


class RunAllan(msgspec.Struct, frozen=True, kw_only=True):
    """Curves of a run's units, and the rates that there are to choose from."""

    run: str
    signal: str
    signals: list[str]
    is_live: bool
    outcome: str
    units: list[UnitCurve]


@get("/api/runs/{run}/allan", is_kept=False, is_slow=True)
def run_allan(call: Call, asked: RunAllanAsked) -> RunAllan:
    """Allan deviation of up to 8 units of a run, the newest live estimate of each, with its limits.

    Without units, the first ones of which there is an estimate, live or stored.
    """
    course = run_course(call, Nothing())
    if len(asked.unit) > MOST_UNITS:
        raise BadInput(f"{len(asked.unit)} units are asked for; {MOST_UNITS} may be shown together")
    signals = _signals(call, course, asked.unit)
    signal = asked.signal or next((each for each in signals if each == "rate"), signals[0] if signals else "")
    units = asked.unit or _first(call, course, signal)
    curves = [_curve(call, course, unit, signal) for unit in dict.fromkeys(units)]
    return RunAllan(
        run=course.run, signal=signal, signals=signals, is_live=course.is_live, outcome=course.outcome, units=curves
    )


def _signals(call: Call, course: RunCourse, units: tuple[str, ...]) -> list[str]:
    """Angular rates of the units that are asked for, else of the first one."""
    known = call.service.live.tail.channels(course.run)
    found = set()
    for unit in units or course.units[:1]:
        rows = call.views.rows(_SIGNALS, {"run": course.run, "unit": unit})
        rows += [(signal, of) for (each, signal), of in known.items() if each == unit]
        found |= {signal for signal, of in rows if is_angular_rate(of)}
    return sorted(found)


def _first(call: Call, course: RunCourse, signal: str) -> tuple[str, ...]:
    live = call.service.live.tail
    stored = {unit for (unit,) in call.views.rows(_ESTIMATED, {"run": course.run, "signal": signal})}
    there = (unit for unit in course.units if unit in stored or live.curve((unit, course.run, signal)) is not None)
    return tuple(islice(there, _FIRST))


def _curve(call: Call, course: RunCourse, unit: str, signal: str) -> UnitCurve:
    if unit not in course.units:
        raise NotFound(f"unit {unit!r} is not in run {course.run}; it has {', '.join(course.units[:MOST_UNITS])}")
    path = {"unit": unit, "run": course.run, "signal": signal}
    try:
        with Call(call.service, call.person, call.state, path) as each:
            curve = allan(each, AllanAsked())
    except NotFound as error:
        return UnitCurve(unit=unit, curve=None, limits=[], reason=str(error))
    limits = course.limits.get(unit) or course.limits.get("") or _of_specification(call, course, unit, signal)
    drawn = [found for limit in limits if (found := _drawn(limit, curve)) is not None]
    return UnitCurve(unit=unit, curve=curve, limits=drawn, reason=curve.reason)


def _of_specification(call: Call, course: RunCourse, unit: str, signal: str) -> list[Limit]:
    """Limits of the specifications that are in force when the run begins, where the run itself has none.

    They are of a record at rest: none where a rate was commanded, or several temperatures.
    """
    if not _is_at_rest(course):
        return []

    def found() -> list[Limit]:
        t_ns = min((each.t_start_ns for each in course.steps), default=0) if course.date_known else 0
        product = next(
            (row["product"] for row in dictionaries(call.views, _ABOUT, {"unit": unit, "run": course.run})), None
        )
        try:
            periods = chosen_periods(call.store, t_ns or time.time_ns())
        except GyrofleetError:  # the pages of limits report a broken chain
            return []
        limits = unit_limits([each.specification for each in periods], product, [signal])
        return [] if limits is None else list(limits.live)

    key = ("limits", course.run, unit, signal, call.state.tag, call.service.live.entered())
    limits: list[Limit] = call.service.memo.result(key, found)
    return limits


def _is_at_rest(course: RunCourse) -> bool:
    words = [each.words for each in course.steps]
    temperatures = {each.temperature_command_deg_c for each in words}
    return bool(words) and len(temperatures) == 1 and not any(each.rate_command_deg_per_s for each in words)


def _drawn(limit: Limit, curve: Allan) -> DrawnLimit | None:
    """A limit as a point of the curve's plot; None if it is not one on the Allan deviation of this signal."""
    if limit.signal != curve.signal or estimator_key(limit) != ALLAN_DEVIATION or not curve.unit_of_measure:
        return None
    is_walk = limit.characteristic == ANGLE_RANDOM_WALK
    try:
        factor = conversion("deg/h" if is_walk else limit.unit_of_measure, curve.unit_of_measure)[0]
    except UnknownUnit:
        return None
    tau_s = ANGLE_RANDOM_WALK_TAU_S if is_walk else limit.tau_s
    if tau_s is None:
        return None
    upper = limit.upper * factor * (SQRT_SECONDS_PER_SQRT_HOUR if is_walk else 1.0)
    points = [
        EstimatePoint(tau_s=tau_s, value=value, lo=lo, hi=hi, edf=edf, n=0)
        for tau_s, value, lo, hi, edf in zip(curve.tau_s, curve.adev, curve.lo, curve.hi, curve.edf, strict=True)
    ]
    value, lo, hi, _ = read_curve(points, tau_s)
    comparison: Literal["below", "above", "across", "none"] = "none"
    if value is not None and lo is not None and hi is not None:
        comparison = "below" if hi <= upper else "above" if lo > upper else "across"
    return DrawnLimit(
        tau_s=tau_s, upper=upper, characteristic=limit.characteristic, comparison=comparison, value=value, lo=lo, hi=hi
    )
