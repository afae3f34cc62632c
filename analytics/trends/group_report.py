"""Sentences on the groups of a trend: their differences, components of variance, and capability."""

from collections.abc import Iterator

from analytics.trends.between_stations import GROUP_NAMES_ZH, Difference, GroupComparison
from analytics.trends.capability import Capability
from analytics.trends.trend import FALSE_ALARM, Trend
from analytics.trends.words import NOTHING, NotComputed, Words, interval, joined, listed, words


def about(trend: Trend, names: list[str], text: Words) -> Words:
    """A sentence on these charts; without their names where all units share one."""
    whose = NOTHING
    if trend.by is not None:
        whose = words(f"{trend.by} {{names}}: ", f"{GROUP_NAMES_ZH[trend.by]} {{names}}：", names=listed(names))
    return Words(_capitalised(f"{whose.en}{text.en}"), f"{whose.zh}{text.zh}")


def _capitalised(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def of_groups(trend: Trend) -> Iterator[Words]:
    """Significant differences between the levels of groups."""
    if isinstance(trend.comparison, NotComputed):
        return
    reported: set[str] = set()
    for each in trend.comparison.differences:
        if each.adjusted > FALSE_ALARM or reported & set(each.confounded):
            continue
        if each.confounded:
            reported.add(each.group)
        yield _difference(each, trend.comparison, trend.series.unit_of_measure)


def _difference(found: Difference, comparison: GroupComparison, unit: str) -> Words:
    effect = found.effect
    higher = effect.value > 0
    lo, hi = (effect.lo, effect.hi) if higher else (-effect.hi, -effect.lo)
    group, group_zh = found.group, GROUP_NAMES_ZH[found.group]
    against = Words(f"{group} {found.against}", f"{group_zh} {found.against} ")
    return words(
        f"{_capitalised(group)} {{level}} gives values {{size}} {{way}} than {{against}} (95 % interval){{why}}.",
        f"{group_zh} {{level}} 的值比{{against}}{{way}} {{size}}，95 % 区间{{why}}。",
        level=found.level,
        size=interval(abs(effect.value), lo, hi, unit),
        way=Words("higher", "高") if higher else Words("lower", "低"),
        against=against if found.against else Words(f"the other {group}s on average", f"其他{group_zh}平均值"),
        why=_attribution(found, comparison, unit),
    )


def _attribution(found: Difference, comparison: GroupComparison, unit: str) -> Words:
    """The cause of a difference, as far as it can be known."""
    group = Words(found.group, GROUP_NAMES_ZH[found.group])
    if found.confounded:
        return words(
            "; it cannot be distinguished from {names}, which changed together with the {group}: measure some of the "
            "same units on both",
            "；无法与{names}的影响区分（二者同时变化）：请在两处测量相同样品",
            names=joined((Words(each, GROUP_NAMES_ZH[each]) for each in found.confounded), " and ", "、"),
            group=group,
        )
    if found.group == "lot":
        return NOTHING
    of_group = [each for each in comparison.pairs if each.group == found.group]
    levels = {found.level, found.against}
    pair = next((each for each in of_group if {each.level, each.against} == levels), None)
    elsewhere = [each.units for each in of_group if not found.against and found.level in {each.level, each.against}]
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
    proof = Words(", which alone would not prove it", "，单凭这些样品不足以证明")
    if lo > 0 or hi < 0:
        proof = Words(f": it is the {group.en}, not its units", f"：差异来自{group.zh}，而非样品")
    return words(
        "; the {units} units measured on both show {size}{proof}",
        "；两处都测量过的 {units} 个样品相差 {size}{proof}",
        units=pair.units, size=interval(sign * pair.effect.value, lo, hi, unit), proof=proof,
    )  # fmt: skip


def of_components(trend: Trend) -> Iterator[Words]:
    """Components of variance, where repeated measurements or groups separate them."""
    found = trend.components
    if "unit" not in found and len(found) < 2:
        return
    names = {
        "unit": Words("from unit to unit", "样品间"),
        "residual": Words("from one measurement of a unit to the next", "同一样品各次测量间"),
    }
    if "unit" not in found:
        names["residual"] = Words("from unit to unit, measurement included", "样品间（含测量）")
    parts = []
    for name in sorted(found, key=lambda name: (name not in names, name == "residual", name)):
        # the upper bound of few levels may be far away: two digits of each suffice
        value, lo, hi = (f"{each:.2g}" for each in found[name])
        whose = names.get(name) or Words(f"from {name} to {name}", f"{GROUP_NAMES_ZH[name]}间")
        size, unit = {"value": value, "lo": lo, "hi": hi}, trend.series.unit_of_measure
        text = ("{name} {value} {unit} ({lo} to {hi})", "{name} {value} {unit}（{lo} 至 {hi}）")
        parts.append(words(*text, name=whose, unit=unit, **size))
    yield words("Standard deviations: {parts}.", "标准差：{parts}。", parts=joined(parts))


def of_capability(trend: Trend) -> Iterator[Words]:
    """Capability of each chart, or why there is none."""
    refused: dict[Words, list[str]] = {}
    for chart, found in zip(trend.charts, trend.capabilities, strict=True):
        if isinstance(found, NotComputed):
            refused.setdefault(found.why, []).append(chart.name)
        else:
            yield about(trend, [chart.name], _capable(trend, found))
    if trend.by == "unit" and len(trend.charts) > 1:
        return
    for why, names in refused.items():
        yield about(trend, names, words("no capability: {why}.", "无过程能力指数：{why}。", why=why))


def _capable(trend: Trend, found: Capability) -> Words:
    indices = joined(
        (
            Words(
                f"{name} {index.value:.2f} ({index.lo:.2f} to {index.hi:.2f})",
                f"{name} {index.value:.2f}（{index.lo:.2f} 至 {index.hi:.2f}）",
            )
            for name, index in (("Cp", found.cp), ("Cpk", found.cpk))
            if index is not None
        ),
        ", ",
        ", ",
    )
    noise = normal = NOTHING
    if found.measurement_share is not None:
        share = f"{found.measurement_share * 100:.2g} %"
        noise = Words(f"; the uncertainty of measurement is {share} of the variance", f"；测量不确定度占方差的 {share}")
    if not found.is_normal:
        normal = Words(
            "; the values are not normal, so the indices do not say how many units fail",
            "；数值不服从正态分布，指数不能换算为不合格率",
        )
    limits = trend.specification
    sides = [f"{sign} {side:.6g}" for sign, side in (("≥", limits.lower), ("≤", limits.upper)) if side is not None]
    return words(
        "{indices}, of {n} values{noise}{normal}; limits {sides} ({source}).",
        "{indices}，{n} 个值{noise}{normal}；限值 {sides}（{source}）。",
        indices=indices, n=found.n, noise=noise, normal=normal,
        sides=f"{', '.join(sides)} {trend.series.unit_of_measure}", source=limits.source,
    )  # fmt: skip
