"""A trend in sentences: changes, outliers, drift, signals, differences between groups, components, capability."""

from collections.abc import Iterator
from datetime import UTC, datetime

from analytics.trends.between_stations import GROUP_NAMES_ZH
from analytics.trends.change_points import Changes, Drift
from analytics.trends.control_chart import IndividualsChart
from analytics.trends.group_report import about, of_capability, of_components, of_groups
from analytics.trends.level_shifts import LevelShift, LevelShifts
from analytics.trends.nelson_rules import RULES, wild_point_chance
from analytics.trends.series import MetricSeries
from analytics.trends.sessions import LEAST_UNITS
from analytics.trends.trend import NS_PER_DAY, Chart, Trend
from analytics.trends.words import NOTHING, NotComputed, Words, figures, interval, joined, listed, words

_BRIEF_DAYS = 10


def sentences(trend: Trend) -> list[Words]:
    """The report of a trend: its values, the significant results, components of variance, capability.

    Where nothing is significant it says so: of trends of noise alone at most 6 % report more (1 % each for changes of
    stations, outliers, changes of charts, drifts, signals of rules, and groups; adjusted for all charts and groups).
    """
    found = _significant(trend) or [_nothing(trend)]
    return [_head(trend), *found, *of_components(trend), *of_capability(trend), *_left_out(trend)]


def stands_out(trend: Trend) -> bool:
    """Whether any result is significant."""
    return bool(_significant(trend))


def _significant(trend: Trend) -> list[Words]:
    of_charts = (about(trend, [chart.name], each) for chart in trend.charts for each in _of_chart(chart))
    return [*_of_shifts(trend), *of_charts, *of_groups(trend)]


def moment(series: MetricSeries, index: int) -> str:
    """When a point was measured (UTC); its number where dates are unknown.

    >>> import numpy as np
    >>> from analytics.trends.series import Variant
    >>> one = MetricSeries("bias", "deg/h", np.zeros(1), np.zeros(1), np.array([1_763_683_200 * 10**9]), ["U"], ["r"],
    ...                    {}, Variant("", ()), (), 0, True)
    >>> moment(one, 0)
    '2025-11-21 00:00'
    """
    if not series.dated:
        return f"#{index + 1}"
    is_brief = int(series.t_ns[-1] - series.t_ns[0]) < _BRIEF_DAYS * NS_PER_DAY
    at = datetime.fromtimestamp(int(series.t_ns[index]) // 10**9, UTC)
    return at.strftime("%Y-%m-%d %H:%M" if is_brief else "%Y-%m-%d")


def _head(trend: Trend) -> Words:
    series, header = trend.series, trend.series.header
    units, charts = len(set(series.unit)), len(trend.charts)
    if trend.by is None:
        charted = Words("one chart, of the first value of each unit", "控制图取每个样品的首个值")
    else:
        each = Words("" if trend.by == "unit" else ", of the first value of each unit there", "")
        if any(chart.is_adjusted for chart in trend.charts):
            each = Words(", of every value, its unit's own level taken off", "，取全部数值并扣除样品自身水平")
        zh = f"按{GROUP_NAMES_ZH[trend.by]}共 {charts} 张控制图{{each}}"
        charted = words(f"{charts} chart{'s' * (charts > 1)}, by {trend.by}{{each}}", zh, each=each)
    return words(
        "{name} ({variant}): {n} values of {units} unit{s}, {first} to {last}; {charted}.",
        "{name}（{variant}）：{units} 个样品共 {n} 个值，{first} 至 {last}；{charted}。",
        name=series.metric if header is None else Words(header.en, header.zh), variant=series.variant,
        n=series.value.size, units=units, s="s" * (units > 1), first=moment(series, 0),
        last=moment(series, series.value.size - 1), charted=charted,
    )  # fmt: skip


def _of_shifts(trend: Trend) -> Iterator[Words]:
    """Level shifts of stations, and stations whose levels wander."""
    if isinstance(trend.shifts, NotComputed):
        return
    for each in trend.shifts.shifts:
        yield _shift(trend.series, each)
    if trend.shifts.unsteady is not None:
        yield _unsteady(trend.series, trend.shifts)


def _shift_parts(series: MetricSeries, shift: LevelShift) -> dict[str, Words]:
    before, after, at = (moment(series, point) for point in (shift.first, shift.last, shift.at))
    whose = Words("The level of all stations", "所有测试站的水平")
    if shift.station:
        whose = Words(f"The level of station {shift.station}", f"测试站 {shift.station} 的水平")
    en = f"between {before} and {after} (most likely at {at})"
    when = Words(en, f"在 {before} 与 {after} 之间（最可能始于 {at}）")
    return {"whose": whose, "when": when, "size": interval(shift.size, shift.lo, shift.hi, series.unit_of_measure)}


def _shift(series: MetricSeries, shift: LevelShift) -> Words:
    there, there_zh = ("there ", "在该处") if shift.station else ("", "")
    units = Words(
        f"; {shift.units} units were measured {there}before and after", f"；{shift.units} 个样品前后均{there_zh}测量过"
    )
    if shift.units < LEAST_UNITS:
        units = Words(
            f"; {shift.units} units were measured there before and after, so it may be the units that changed",
            f"；前后均测量过的样品仅 {shift.units} 个，也可能是样品不同所致",
        )
    doubt = NOTHING
    if not shift.is_plain:
        doubt = Words(
            f"; levels that wander from session to session would show as much with a probability of {shift.wander:.1g}",
            f"；若各次测试间水平缓慢游动，出现同样变化的概率为 {shift.wander:.1g}",
        )
    return words(
        "{whose} changes by {size} {when}{units}{doubt}.",
        "{whose}{when}改变 {size}{units}{doubt}。",
        **_shift_parts(series, shift), units=units, doubt=doubt,
    )  # fmt: skip


def _unsteady(series: MetricSeries, found: LevelShifts) -> Words:
    assert found.unsteady is not None
    largest = NOTHING
    if (shift := found.unsteady.largest) is not None:
        parts = _shift_parts(series, shift)
        parts["whose"] = Words(parts["whose"].en[0].lower() + parts["whose"].en[1:], parts["whose"].zh)
        largest = words(
            "; the largest change, which cannot be separated from that: {whose} by {size} {when}",
            "；其中最大的变化（无法与之区分）：{whose}{when}改变 {size}",
            **parts,
        )
    return words(
        "Levels of stations wander from session to session by {deviation} (standard deviation), more than repeated "
        "measurements scatter{largest}.",
        "各次测试之间测试站水平不稳定，标准差 {deviation}，超出重复测量的分散{largest}。",
        deviation=f"{found.unsteady.deviation:.2g} {series.unit_of_measure}",
        largest=largest,
    )


def _of_chart(chart: Chart) -> Iterator[Words]:
    series, unit = chart.series, chart.series.unit_of_measure
    if isinstance(chart.changes, Changes) and not (chart.is_adjusted and chart.shifts):
        for change in chart.changes.points:
            yield words(
                "the level changes by {size} between {before} and {after} (most likely at {here}).",
                "水平在 {before} 与 {after} 之间改变 {size}（最可能始于 {here}）。",
                size=interval(change.size, change.lo, change.hi, unit), before=moment(series, change.first - 1),
                after=moment(series, change.last), here=f"{series.unit[change.at]}, {moment(series, change.at)}",
            )  # fmt: skip
    if chart.drifts and isinstance(chart.drift, Drift):
        per = Words("per day", "每天") if series.dated else Words("per point", "每点")
        size = interval(chart.drift.slope, chart.drift.lo, chart.drift.hi, unit)
        yield words("it drifts by {size} {per}.", "存在漂移，{per} {size}。", size=size, per=per)
    if isinstance(chart.limits, NotComputed):
        return
    if chart.wild_point is not None:
        yield _outlier(chart, chart.limits, chart.wild_point)
    # a moving level meets the rules by itself
    if chart.too_many is not None and not (chart.has_changed or chart.drifts or chart.shifts or chart.is_unsteady):
        yield words(
            "rule {rule} ({text}) is met {count} times, from {first} on; noise gives {expected:.2g}.",
            "判异准则 {rule}（{text}）自 {first} 起出现 {count} 次；随机预期 {expected:.2g} 次。",
            rule=chart.too_many, text=RULES[chart.too_many - 1], count=chart.counts[chart.too_many - 1],
            first=moment(series, chart.signals[chart.too_many][0]),
            expected=0.0 if chart.chance is None else chart.chance.expected[chart.too_many - 1],
        )  # fmt: skip


def _outlier(chart: Chart, limits: IndividualsChart, point: int) -> Words:
    series = chart.series
    return words(
        "a wild point ({where}): {value} {unit}, {z:+.1f} sigma from the centre {centre}; of {n} normal values the "
        "farthest is so far with a probability of {chance:.2g} at most (Grubbs).",
        "异常点（{where}）：{value} {unit}，距中心线 {centre} 为 {z:+.1f}σ；{n} 个正态值中最远者达到此距离的概率至多为 "
        "{chance:.2g}（Grubbs 检验）。",
        where=f"{series.unit[point]}, {moment(series, point)}",
        value=figures(float(chart.charted[point]), limits.sigma), unit=series.unit_of_measure, z=float(chart.z[point]),
        centre=figures(limits.centre, limits.sigma), n=chart.charted.size, chance=wild_point_chance(chart.charted),
    )  # fmt: skip


def _nothing(trend: Trend) -> Words:
    is_judged = any(chart.in_control is not None for chart in trend.charts)
    comparison = trend.comparison
    differences = () if isinstance(comparison, NotComputed) else comparison.differences
    compared = sorted({each.group for each in differences})
    if not is_judged and not compared:
        return Words("There is too little to judge.", "数据不足，无法判断。")
    groups = words(
        ", and {names} make no difference that can be seen",
        "；{names}之间无可见差异",
        names=joined((Words(each, GROUP_NAMES_ZH[each]) for each in compared), ", ", "、"),
    )
    return words(
        "Nothing stands out: no wild point, no change, no drift, no more signals than noise gives{groups}.",
        "无异常：无异常点、无变点、无漂移，判异信号不超过随机预期{groups}。",
        groups=groups if compared else NOTHING,
    )


def _left_out(trend: Trend) -> Iterator[Words]:
    series = trend.series
    refused = [(chart.name, chart.limits) for chart in trend.charts if isinstance(chart.limits, NotComputed)]
    if refused:
        names = listed([name for name, _ in refused if name])
        whose = Words(f" of {names.en}", f"{names.zh} ") if names.en else NOTHING
        why = refused[0][1].why
        yield words("No control limits{whose}: {why}.", "{whose}无控制限：{why}。", whose=whose, why=why)
    if not isinstance(trend.comparison, NotComputed):
        for each in trend.comparison.left_out:
            yield words("Not compared: {each}.", "未比较：{each}。", each=each)
    if series.without_value:
        yield Words(
            f"{series.without_value} tests have no value; `gyrofleet metrics --metric {series.metric}` says why.",
            f"{series.without_value} 次试验无结果；原因见 `gyrofleet metrics --metric {series.metric}`。",
        )
    if not series.dated:
        yield Words(
            "The dates of some runs are not known: values stand in the order in which they were recorded.",
            "部分试验日期未知：按记录先后排序。",
        )
    if series.others:
        kinds = [str(each) for each in series.others]
        text = "; ".join(kinds[:6]) + (f"; {len(kinds) - 6} more" if len(kinds) > 6 else "")
        yield Words(
            f"Other kinds of this characteristic, chosen by --standard and --parameter: {text}.",
            f"该特性的其他类别（用 --standard 与 --parameter 选择）：{text}。",
        )
