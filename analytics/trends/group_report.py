"""Sentences on the groups of a trend: their differences, components of variance, and capability."""

from collections.abc import Iterator

from analytics.trends.between_stations import Difference, GroupComparison
from analytics.trends.capability import Capability
from analytics.trends.trend import FALSE_ALARM, Trend
from analytics.trends.words import NOTHING, NotComputed, Words, group_name, interval, joined, listed, words


def about(trend: Trend, names: list[str], text: Words) -> Words:
    """A sentence on these charts; without their names where all units share one."""
    whose = NOTHING
    if trend.by is not None:
        whose = words("about", group=group_name(trend.by), names=listed(names))
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
    group = group_name(found.group)
    against = words("against_level" if found.against else "against_others", group=group, level=found.against)
    return words(
        "difference", group=Words(_capitalised(group.en), group.zh), level=found.level,
        size=interval(abs(effect.value), lo, hi, unit), way=words("higher" if higher else "lower"), against=against,
        why=_attribution(found, comparison, unit),
    )  # fmt: skip


def _attribution(found: Difference, comparison: GroupComparison, unit: str) -> Words:
    """The cause of a difference, as far as it can be known."""
    group = group_name(found.group)
    if found.confounded:
        return words("confounded", names=joined(map(group_name, found.confounded), " and ", "、"), group=group)
    if found.group == "lot":
        return NOTHING
    of_group = [each for each in comparison.pairs if each.group == found.group]
    levels = {found.level, found.against}
    pair = next((each for each in of_group if {each.level, each.against} == levels), None)
    elsewhere = [each.units for each in of_group if not found.against and found.level in {each.level, each.against}]
    if pair is None:
        return words("units_elsewhere", n=max(elsewhere)) if elsewhere else words("units_on_one")
    sign = 1 if pair.level == found.level else -1
    lo, hi = sorted((sign * pair.effect.lo, sign * pair.effect.hi))
    proof = words("proof" if lo > 0 or hi < 0 else "proof_none", group=group)
    size = interval(sign * pair.effect.value, lo, hi, unit)
    return words("units_on_both", units=pair.units, size=size, proof=proof)


def of_components(trend: Trend) -> Iterator[Words]:
    """Components of variance, where repeated measurements or groups separate them."""
    found = trend.components
    if "unit" not in found and len(found) < 2:
        return
    names = {"unit": "between_units", "residual": "between_measurements"}
    if "unit" not in found:
        names["residual"] = "between_units_measured"
    parts = []
    for name in sorted(found, key=lambda name: (name not in names, name == "residual", name)):
        # the upper bound of few levels may be far away: two digits of each suffice
        value, lo, hi = (f"{each:.2g}" for each in found[name])
        whose, unit = words(names.get(name, "between_levels"), group=group_name(name)), trend.series.unit_of_measure
        parts.append(words("component", name=whose, unit=unit, value=value, lo=lo, hi=hi))
    yield words("components", parts=joined(parts))


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
        yield about(trend, names, words("no_capability", why=why))


def _capable(trend: Trend, found: Capability) -> Words:
    indices = {name: index for name, index in (("Cp", found.cp), ("Cpk", found.cpk)) if index is not None}
    noise = NOTHING
    if found.measurement_share is not None:
        noise = words("share", share=f"{found.measurement_share * 100:.2g} %")
    limits = trend.specification
    sides = [f"{sign} {side:.6g}" for sign, side in (("≥", limits.lower), ("≤", limits.upper)) if side is not None]
    return words(
        "capability", n=found.n, noise=noise, normal=NOTHING if found.is_normal else words("not_normal"),
        indices=joined((words("index", name=name, **each._asdict()) for name, each in indices.items()), ", ", ", "),
        sides=f"{', '.join(sides)} {trend.series.unit_of_measure}", source=limits.source,
    )  # fmt: skip
