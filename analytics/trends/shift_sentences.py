"""Changes of stations in words, and moments as people write them."""

from collections.abc import Iterator
from datetime import UTC, datetime

from analytics.trends.level_shifts import LevelShift, LevelShifts
from analytics.trends.series import Series
from analytics.trends.session_layout import LEAST_UNITS
from analytics.trends.trend import NS_PER_DAY, Trend
from analytics.trends.words import Refused, Words, interval

_BRIEF_DAYS = 10


def moment(series: Series, index: int) -> str:
    """When a point was measured, as people write it (UTC); its number where dates are not known.

    Examples
    --------
    >>> import numpy as np
    >>> from analytics.trends.series import Variant
    >>> one = Series("bias", "deg/h", np.zeros(1), np.zeros(1), np.array([1_763_683_200 * 10**9]), ["U"], ["r"], {},
    ...              Variant("", ()), (), 0, True)
    >>> moment(one, 0)
    '2025-11-21 00:00'
    """
    if not series.dated:
        return f"#{index + 1}"
    at = datetime.fromtimestamp(int(series.t_ns[index]) // 10**9, UTC)
    is_brief = int(series.t_ns[-1] - series.t_ns[0]) < _BRIEF_DAYS * NS_PER_DAY
    return at.strftime("%Y-%m-%d %H:%M" if is_brief else "%Y-%m-%d")


def of_shifts(trend: Trend) -> Iterator[Words]:
    """Sentences on the changes of stations, and on stations whose levels wander."""
    if isinstance(trend.shifts, Refused):
        return
    for each in trend.shifts.shifts:
        yield _shift(trend.series, each)
    if trend.shifts.unsteady is not None:
        yield _unsteady(trend.series, trend.shifts)


def _whose(shift: LevelShift) -> Words:
    if not shift.station:
        return Words("The level of all stations", "所有测试站的水平")
    return Words(f"The level of station {shift.station}", f"测试站 {shift.station} 的水平")


def _when(series: Series, shift: LevelShift) -> Words:
    before, after, at = (moment(series, point) for point in (shift.first, shift.last, shift.at))
    return Words(
        f"between {before} and {after} (most likely at {at})", f"在 {before} 与 {after} 之间（最可能始于 {at}）"
    )


def _shift(series: Series, shift: LevelShift) -> Words:
    whose, when = _whose(shift), _when(series, shift)
    size = interval(shift.size, shift.lo, shift.hi, series.unit_of_measure)
    if shift.units >= LEAST_UNITS:
        units = Words(
            f"; {shift.units} units were measured there before and after", f"；{shift.units} 个样品前后均在该处测量过"
        )
        if not shift.station:
            units = Words(
                f"; {shift.units} units were measured before and after", f"；{shift.units} 个样品前后均测量过"
            )
    else:
        units = Words(
            f"; {shift.units} units were measured there before and after, so it may be the units that changed",
            f"；前后均测量过的样品仅 {shift.units} 个，也可能是样品不同所致",
        )
    doubt = Words("", "")
    if not shift.is_plain:
        doubt = Words(
            f"; levels that wander from session to session would show as much with a probability of {shift.wander:.1g}",
            f"；若各次测试间水平缓慢游动，出现同样变化的概率为 {shift.wander:.1g}",
        )
    return Words(
        f"{whose.en} changes by {size.en} {when.en}{units.en}{doubt.en}.",
        f"{whose.zh}{when.zh}改变 {size.zh}{units.zh}{doubt.zh}。",
    )


def _unsteady(series: Series, found: LevelShifts) -> Words:
    assert found.unsteady is not None
    unit = series.unit_of_measure
    deviation = f"{found.unsteady.deviation:.2g} {unit}"
    largest = Words("", "")
    if (shift := found.unsteady.largest) is not None:
        whose, when = _whose(shift), _when(series, shift)
        size = interval(shift.size, shift.lo, shift.hi, unit)
        largest = Words(
            f"; the largest change, which cannot be told from that: {whose.en[0].lower()}{whose.en[1:]} by {size.en} "
            f"{when.en}",
            f"；其中最大的变化（无法与之区分）：{whose.zh}{when.zh}改变 {size.zh}",
        )
    return Words(
        f"Levels of stations wander from session to session by {deviation} (standard deviation), more than repeated "
        f"measurements scatter{largest.en}.",
        f"各次测试之间测试站水平不稳定，标准差 {deviation}，超出重复测量的分散{largest.zh}。",
    )
