"""A trend in words: what is out of control, since when, which group differs and by how much."""

from collections.abc import Iterator

from analytics.metric_registry.registry import metrics
from analytics.trends.between_stations import Comparison, Difference, Pairs
from analytics.trends.capability import Capability
from analytics.trends.change_points import ChangePoint, Changes
from analytics.trends.chart_chance import wild_point_chance
from analytics.trends.control_chart import IndividualsChart
from analytics.trends.drift import Drift
from analytics.trends.nelson_rules import RULES
from analytics.trends.series import Series
from analytics.trends.shift_sentences import moment, of_shifts
from analytics.trends.trend import FALSE_ALARM, Chart, Trend
from analytics.trends.words import Refused, Words, figures, interval, listed

_GROUP_NAMES = {"station": "测试站", "fixture": "夹具", "lot": "批次", "unit": "样品", "product": "产品"}


def sentences(trend: Trend) -> list[Words]:
    """What is to be said of a trend: first what it is of, then what stands out, then capability.

    Where nothing stands out it says so: of trends of noise alone at most 6 % say more (1 % each for changes of
    stations, wild points, changes of charts, drifts, signals of rules, and groups; adjusted for all charts and groups).
    """
    found = [*of_shifts(trend), *_of_charts(trend), *_of_groups(trend)]
    if not found:
        found = [_nothing(trend)]
    return [_head(trend), *found, *_of_components(trend), *_of_capability(trend), *_left_out(trend)]


def stands_out(trend: Trend) -> bool:
    """Whether there is anything to say but that nothing stands out."""
    return any(True for told in (of_shifts, _of_charts, _of_groups) for _ in told(trend))


def _head(trend: Trend) -> Words:
    series = trend.series
    header = metrics()[series.metric].header if series.metric in metrics() else None
    en, zh = (header.en, header.zh) if header is not None else (series.metric, series.metric)
    units = len(set(series.unit))
    first, last = moment(series, 0), moment(series, series.value.size - 1)
    of_en, of_zh = _charted(trend)
    return Words(
        f"{en} ({series.variant}): {series.value.size} values of {units} unit{'s' * (units > 1)}, {first} to {last}; "
        f"{of_en}.",
        f"{zh}（{series.variant}）：{units} 个样品共 {series.value.size} 个值，{first} 至 {last}；{of_zh}。",
    )


def _charted(trend: Trend) -> Words:
    """What stands on the charts."""
    charts = len(trend.charts)
    if trend.by is None:
        return Words("one chart, of the first value of each unit", "控制图取每个样品的首个值")
    if any(chart.is_adjusted for chart in trend.charts):
        each = ", of every value, its unit's own level taken off"
        each_zh = "，取全部数值并扣除样品自身水平"
    else:
        each = "" if trend.by == "unit" else ", of the first value of each unit there"
        each_zh = ""
    return Words(
        f"{charts} chart{'s' * (charts > 1)}, by {trend.by}{each}",
        f"按{_GROUP_NAMES[trend.by]}共 {charts} 张控制图{each_zh}",
    )


def _of_charts(trend: Trend) -> Iterator[Words]:
    for chart in trend.charts:
        en = f"{trend.by} {chart.name}: " if trend.by is not None else ""
        zh = f"{_GROUP_NAMES[trend.by]} {chart.name}：" if trend.by is not None else ""
        for each in _of_chart(chart):
            yield Words(_begun(f"{en}{each.en}"), f"{zh}{each.zh}")


def _begun(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def _of_chart(chart: Chart) -> Iterator[Words]:
    unit = chart.series.unit_of_measure
    if isinstance(chart.changes, Changes) and not (chart.is_adjusted and chart.shifts):
        for change in chart.changes.points:
            yield _change(chart.series, change)
    if chart.drifts and isinstance(chart.drift, Drift):
        per = ("per day", "每天") if chart.series.dated else ("per point", "每点")
        told = interval(chart.drift.slope, chart.drift.lo, chart.drift.hi, unit)
        yield Words(f"it drifts by {told.en} {per[0]}.", f"存在漂移，{per[1]} {told.zh}。")
    if isinstance(chart.limits, Refused):
        return
    if chart.wild_point is not None:
        yield _wild(chart, chart.limits, chart.wild_point)
    # where the level moves, rules are met because of it
    if chart.too_many is not None and not (chart.has_changed or chart.drifts or chart.shifts or chart.is_unsteady):
        yield _signals(chart, chart.too_many)


def _change(series: Series, change: ChangePoint) -> Words:
    told = interval(change.size, change.lo, change.hi, series.unit_of_measure)
    before, after = moment(series, change.first - 1), moment(series, change.last)
    here = f"{series.unit[change.at]}, {moment(series, change.at)}"
    return Words(
        f"the level changes by {told.en} between {before} and {after} (most likely at {here}).",
        f"水平在 {before} 与 {after} 之间改变 {told.zh}（最可能始于 {here}）。",
    )


def _wild(chart: Chart, limits: IndividualsChart, point: int) -> Words:
    series = chart.series
    value = figures(float(chart.charted[point]), limits.sigma)
    z = chart.z[point]
    where = f"{series.unit[point]}, {moment(series, point)}"
    centre = figures(limits.centre, limits.sigma)
    chance = wild_point_chance(chart.charted)
    n = chart.charted.size
    return Words(
        f"a wild point ({where}): {value} {series.unit_of_measure}, {z:+.1f} sigma from the centre {centre}; of {n} "
        f"normal values the farthest is so far with a probability of {chance:.2g} at most (Grubbs).",
        f"异常点（{where}）：{value} {series.unit_of_measure}，距中心线 {centre} 为 {z:+.1f}σ；{n} 个正态值中最远者"
        f"达到此距离的概率至多为 {chance:.2g}（Grubbs 检验）。",
    )


def _signals(chart: Chart, rule: int) -> Words:
    first = moment(chart.series, chart.signals[rule][0])
    count = chart.counts[rule - 1]
    expected = 0.0 if chart.chance is None else chart.chance.expected[rule - 1]
    said = RULES[rule - 1]
    return Words(
        f"rule {rule} ({said.en}) is met {count} times, from {first} on; noise gives {expected:.2g}.",
        f"判异准则 {rule}（{said.zh}）自 {first} 起出现 {count} 次；随机预期 {expected:.2g} 次。",
    )


def _of_groups(trend: Trend) -> Iterator[Words]:
    if isinstance(trend.comparison, Refused):
        return
    told: set[str] = set()
    for each in trend.comparison.differences:
        if each.adjusted > FALSE_ALARM or told & set(each.confounded):
            continue
        if each.confounded:
            told.add(each.group)
        yield _difference(each, trend.comparison, trend.series.unit_of_measure)


def _difference(found: Difference, comparison: Comparison, unit: str) -> Words:
    effect = found.effect
    higher = effect.value > 0
    size = abs(effect.value)
    lo, hi = (effect.lo, effect.hi) if higher else (-effect.hi, -effect.lo)
    told = interval(size, lo, hi, unit)
    group_zh = _GROUP_NAMES[found.group]
    against_en = f"{found.group} {found.against}" if found.against else f"the other {found.group}s on average"
    against_zh = f"{group_zh} {found.against} " if found.against else f"其他{group_zh}平均值"
    why = _attribution(found, comparison, unit)
    way, way_zh = ("higher", "高") if higher else ("lower", "低")
    return Words(
        f"{_begun(found.group)} {found.level} gives values {told.en} {way} than {against_en} (95 % interval){why.en}.",
        f"{group_zh} {found.level} 的值比{against_zh}{way_zh} {told.zh}，95 % 区间{why.zh}。",
    )


def _attribution(found: Difference, comparison: Comparison, unit: str) -> Words:
    """To what a difference is due, as far as that can be known."""
    group_zh = _GROUP_NAMES[found.group]
    if found.confounded:
        names = " and ".join(found.confounded)
        names_zh = "、".join(_GROUP_NAMES[each] for each in found.confounded)
        return Words(
            f"; it cannot be told apart from {names}, which changed together with the {found.group}: measure some "
            f"of the same units on both",
            f"；无法与{names_zh}的影响区分（二者同时变化）：请在两处测量相同样品",
        )
    if found.group == "lot":
        return Words("", "")
    pair = next((each for each in comparison.pairs if _is_of(each, found)), None)
    elsewhere = [each.units for each in comparison.pairs if _takes_part(each, found)]
    if pair is None and elsewhere:
        return Words(
            f"; up to {max(elsewhere)} units were measured there and on another",
            f"；最多有 {max(elsewhere)} 个样品在该处和另一处都测量过",
        )
    if pair is None:
        return Words(
            "; no units were measured on both, so it rests on their units being alike",
            "；没有样品在两处都测量过，结论以各处样品相同为前提",
        )
    sign = 1 if pair.level == found.level else -1
    lo, hi = sorted((sign * pair.effect.lo, sign * pair.effect.hi))
    told = interval(sign * pair.effect.value, lo, hi, unit)
    if lo > 0 or hi < 0:
        return Words(
            f"; the {pair.units} units measured on both show {told.en}: it is the {found.group}, not its units",
            f"；两处都测量过的 {pair.units} 个样品相差 {told.zh}：差异来自{group_zh}，而非样品",
        )
    return Words(
        f"; the {pair.units} units measured on both show {told.en}, which alone would not prove it",
        f"；两处都测量过的 {pair.units} 个样品相差 {told.zh}，单凭这些样品不足以证明",
    )


def _is_of(pair: Pairs, found: Difference) -> bool:
    return (
        bool(found.against) and pair.group == found.group and {pair.level, pair.against} == {found.level, found.against}
    )


def _takes_part(pair: Pairs, found: Difference) -> bool:
    return not found.against and pair.group == found.group and found.level in {pair.level, pair.against}


def _nothing(trend: Trend) -> Words:
    judged = [chart for chart in trend.charts if chart.in_control is not None]
    compared = (
        [] if isinstance(trend.comparison, Refused) else sorted({each.group for each in trend.comparison.differences})
    )
    if not judged and not compared:
        return Words("There is too little to judge.", "数据不足，无法判断。")
    en = f", and {', '.join(compared)} make no difference that can be seen" if compared else ""
    zh = f"；{'、'.join(_GROUP_NAMES[each] for each in compared)}之间无可见差异" if compared else ""
    return Words(
        f"Nothing stands out: no wild point, no change, no drift, no more signals than noise gives{en}.",
        f"无异常：无异常点、无变点、无漂移，判异信号不超过随机预期{zh}。",
    )


def _of_components(trend: Trend) -> Iterator[Words]:
    """How far values scatter, where it was measured from what."""
    found = trend.components
    if "unit" not in found and len(found) < 2:
        return
    unit = trend.series.unit_of_measure
    names = {
        "unit": Words("from unit to unit", "样品间"),
        "residual": Words("from one measurement of a unit to the next", "同一样品各次测量间"),
    }
    if "unit" not in found:
        names["residual"] = Words("from unit to unit, measurement included", "样品间（含测量）")
    told = []
    for name in sorted(found, key=lambda name: (name not in names, name == "residual", name)):
        each = found[name]
        words = names.get(name) or Words(f"from {name} to {name}", f"{_GROUP_NAMES[name]}间")
        # the upper limit of few levels may be far away: two figures of each say it
        text = Words(
            f"{each.value:.2g} {unit} ({each.lo:.2g} to {each.hi:.2g})",
            f"{each.value:.2g} {unit}（{each.lo:.2g} 至 {each.hi:.2g}）",
        )
        told.append(Words(f"{words.en} {text.en}", f"{words.zh} {text.zh}"))
    yield Words(
        f"Standard deviations: {'; '.join(each.en for each in told)}.",
        f"标准差：{'；'.join(each.zh for each in told)}。",
    )


def _of_capability(trend: Trend) -> Iterator[Words]:
    refused: dict[Words, list[str]] = {}
    for chart, found in zip(trend.charts, trend.capabilities, strict=True):
        if isinstance(found, Refused):
            refused.setdefault(found.why, []).append(chart.name)
            continue
        en, zh = _whose(trend, [chart.name])
        against = _specification(trend)
        yield Words(
            _begun(f"{en}{_capable(found, chinese=False)}{against.en}."),
            f"{zh}{_capable(found, chinese=True)}{against.zh}。",
        )
    if trend.by == "unit" and len(trend.charts) > 1:
        return
    for why, names in refused.items():
        en, zh = _whose(trend, names)
        yield Words(_begun(f"{en}no capability: {why.en}."), f"{zh}无过程能力指数：{why.zh}。")


def _whose(trend: Trend, names: list[str]) -> Words:
    """Whose charts a sentence is of; nothing where all units stand on one."""
    if trend.by is None:
        return Words("", "")
    told = listed(names)
    return Words(f"{trend.by} {told.en}: ", f"{_GROUP_NAMES[trend.by]} {told.zh}：")


def _specification(trend: Trend) -> Words:
    limits, unit = trend.specification, trend.series.unit_of_measure
    sides = [f"{sign} {side:.6g}" for sign, side in (("≥", limits.lower), ("≤", limits.upper)) if side is not None]
    told = f"{' , '.join(sides)} {unit}".replace(" ,", ",")
    return Words(f"; limits {told} ({limits.source})", f"；限值 {told}（{limits.source}）")


def _capable(found: Capability, *, chinese: bool) -> str:
    indices = [("Cp", found.cp), ("Cpk", found.cpk)]
    shown = "{} {:.2f}（{:.2f} 至 {:.2f}）" if chinese else "{} {:.2f} ({:.2f} to {:.2f})"
    told = ", ".join(shown.format(name, each.value, each.lo, each.hi) for name, each in indices if each is not None)
    share = "" if found.measurement_share is None else f"{found.measurement_share * 100:.2g} %"
    if chinese:
        noise = f"；测量不确定度占方差的 {share}" if share else ""
        normal = "" if found.is_normal else "；数值不服从正态分布，指数不能换算为不合格率"
        return f"{told}，{found.n} 个值{noise}{normal}"
    noise = f"; the uncertainty of measurement is {share} of the variance" if share else ""
    normal = "" if found.is_normal else "; the values are not normal, so the indices do not say how many units fail"
    return f"{told}, of {found.n} values{noise}{normal}"


def _left_out(trend: Trend) -> Iterator[Words]:
    series = trend.series
    refused = [chart for chart in trend.charts if isinstance(chart.limits, Refused)]
    if refused and isinstance(refused[0].limits, Refused):
        names = listed([chart.name for chart in refused if chart.name])
        why = refused[0].limits.why
        en = f" of {names.en}" if names.en else ""
        zh = f"{names.zh} " if names.zh else ""
        yield Words(f"No control limits{en}: {why.en}.", f"{zh}无控制限：{why.zh}。")
    if not isinstance(trend.comparison, Refused):
        for each in trend.comparison.left_out:
            yield Words(f"Not compared: {each.en}.", f"未比较：{each.zh}。")
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
        told = "; ".join(kinds[:6]) + (f"; {len(kinds) - 6} more" if len(kinds) > 6 else "")
        yield Words(
            f"Other kinds of this characteristic, chosen by --standard and --parameter: {told}.",
            f"该特性的其他类别（用 --standard 与 --parameter 选择）：{told}。",
        )
