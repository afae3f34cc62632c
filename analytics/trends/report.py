"""A trend in sentences: changes, outliers, drift, signals, differences between groups, components, capability."""

from collections import Counter
from collections.abc import Iterable, Iterator

from analytics.evaluation.reasons import in_chinese
from analytics.trends.chart_sentences import drift_parts, moment, of_chart, unremarkable
from analytics.trends.charts.capability import Capability, SpecifiedLimits
from analytics.trends.groups.between_stations import LEAST_PAIRS, Difference, GroupComparison
from analytics.trends.groups.nested_units import coinciding
from analytics.trends.levels.level_shifts import LevelShift, LevelShifts
from analytics.trends.levels.sessions import LEAST_UNITS
from analytics.trends.series import GROUPS, MetricSeries
from analytics.trends.trend import FALSE_ALARM, Chart, Trend
from analytics.trends.words import (
    NOTHING,
    NotComputed,
    Words,
    behind,
    group_name,
    interval,
    joined,
    kind_of,
    listed,
    words,
)

_MOST_NAMED = 8
_POSSIBLE = 0.05  # chance up to which a drift that is not significant is reported as a possible one


def sentences(trend: Trend) -> list[Words]:
    """The report of a trend: its values, the significant results, components of variance, capability.

    Where nothing is significant it says so: of trends of noise alone at most 8 % report more (1 % each for changes of
    stations, outliers, changes of charts, drifts of charts, drifts of stations and fixtures against each other, signals
    of rules, groups, and their scatter; adjusted for all charts and groups).
    """
    found = significant(trend) or [_nothing(trend)]
    return [
        _head(trend),
        *_of_products(trend),
        *_of_order(trend),
        *found,
        *unremarkable(trend.charts),
        *_possible_drifts(trend),
        *_of_repeated(trend),
        *_of_components(trend),
        *_of_capability(trend),
        *_left_out(trend),
    ]


def stands_out(trend: Trend) -> bool:
    """Whether any result is significant."""
    return bool(significant(trend))


def significant(trend: Trend) -> list[Words]:
    """Sentences on what is significant; none where nothing is."""
    of_charts = (_about(trend, [chart.name], each) for chart in trend.charts for each in of_chart(chart))
    return [*_of_shifts(trend), *_of_drifts(trend), *of_charts, *_of_groups(trend), *_of_scatters(trend)]


def _head(trend: Trend) -> Words:
    series, header = trend.series, trend.series.header
    units, charts = len(set(series.serial)), len(trend.charts)
    if trend.by is None:
        charted = words("one_chart")
    else:
        each = NOTHING if trend.by == "unit" else words("charts_of_first")
        if any(chart.is_adjusted for chart in trend.charts):
            each = words("charts_of_units_adjusted" if trend.by == "unit" else "charts_adjusted")
        charted = words("charts", charts=charts, s="s" * (charts > 1), by=group_name(trend.by), each=each)
    return words(
        "head", name=series.metric if header is None else Words(header.en, header.zh), variant=kind_of(*series.variant),
        n=series.value.size, units=units, s="s" * (units > 1), first=moment(series, 0),
        last=moment(series, series.value.size - 1), zone=words("in_utc") if series.dated else NOTHING, charted=charted,
    )  # fmt: skip


def _of_products(trend: Trend) -> Iterator[Words]:
    """That charts have values of several products, which differ by their make."""
    units: dict[str, set[str]] = {}
    for product, serial in zip(trend.series.groups.get("product", []), trend.series.serial, strict=False):
        units.setdefault(product, set()).add(serial)
    if len(units) > 1 and trend.by not in {"unit", "product"}:
        counts = [f"{name}: {len(of)}" for name, of in sorted(units.items(), key=lambda each: (-len(each[1]), each[0]))]
        yield words("several_products", n=len(units), parts=listed(counts))


def _of_order(trend: Trend) -> Iterator[Words]:
    """That most values of the charts were measured at the same time as others."""
    counts = Counter((chart.name, at) for chart in trend.charts for at in chart.series.t_ns.tolist())
    alike = sum(each for each in counts.values() if each > 1)
    if 2 * alike > (of := sum(counts.values())):
        yield words("no_order", n=alike, of=of)


def _of_shifts(trend: Trend) -> Iterator[Words]:
    """Level shifts of stations, and stations whose levels wander."""
    if isinstance(trend.shifts, NotComputed):
        return
    for each in trend.shifts.shifts:
        yield _shift(trend.series, each)
    if trend.shifts.unsteady is not None:
        yield _unsteady(trend.series, trend.shifts)


def _of_repeated(trend: Trend) -> Iterator[Words]:
    """That charts of other groups than units do not show what changes in a single unit."""
    counts = Counter(trend.series.unit)
    repeated = sum(each > 1 for each in counts.values())
    if repeated and trend.by != "unit":
        yield words("units_repeated", repeated=repeated, units=len(counts))


def _of_drifts(trend: Trend) -> Iterator[Words]:
    """Stations and fixtures that drift against the others."""
    for each in trend.drifts:
        effect, group = each.effect, group_name(each.group)
        yield words(
            "drifts_apart", group=Words(_capitalised(group.en), group.zh), level=each.level, units=each.units,
            others=group, blocks=each.blocks,
            size=interval(effect.value, effect.lo, effect.hi, trend.series.unit_of_measure),
        )  # fmt: skip


def _shift_parts(series: MetricSeries, shift: LevelShift) -> dict[str, Words]:
    before, after, at = (moment(series, point) for point in (shift.first, shift.last, shift.at))
    return {
        "whose": words("shift_of_station" if shift.station else "shift_of_all", station=shift.station),
        "when": words("shift_when", before=before, after=after, at=at),
        "size": interval(shift.size, shift.lo, shift.hi, series.unit_of_measure),
    }


def _shift(series: MetricSeries, shift: LevelShift) -> Words:
    there = "shift_units" if shift.station else "shift_units_all"
    units = words("shift_units_few" if shift.units < LEAST_UNITS else there, n=shift.units)
    doubt = NOTHING if shift.is_plain else words("shift_doubt", chance=shift.wander)
    sentence = "shift" if shift.is_certain else "shift_possible"
    return words(sentence, **_shift_parts(series, shift), units=units, doubt=doubt)


def _unsteady(series: MetricSeries, found: LevelShifts) -> Words:
    assert found.unsteady is not None
    largest = NOTHING
    if (shift := found.unsteady.largest) is not None:
        parts = _shift_parts(series, shift)
        parts["whose"] = Words(parts["whose"].en[0].lower() + parts["whose"].en[1:], parts["whose"].zh)
        largest = words("unsteady_largest", **parts)
    deviation = f"{found.unsteady.deviation:.2g}{behind(series.unit_of_measure)}"
    return words("unsteady", deviation=deviation, largest=largest)


def _possible_drifts(trend: Trend) -> Iterator[Words]:
    """Drifts that are not significant among so many charts, and that noise seldom shows."""
    for chart in trend.charts:
        chance = chart.drift_chance
        if chance is not None and chart.drift_is_by_chance and chance <= _POSSIBLE and chart.in_control:
            charts = words("one_of_one" if chart.tested == 1 else "of_charts", n=chart.tested)
            text = words("drift_possible", chance=chance, charts=charts, **drift_parts(chart))
            yield _about(trend, [chart.name], text)


def _nothing(trend: Trend) -> Words:
    is_judged = any(chart.in_control is not None for chart in trend.charts)
    comparison = trend.comparison
    differences = () if isinstance(comparison, NotComputed) else comparison.differences
    compared = sorted({each.group for each in differences})
    if not is_judged and not compared:
        return words("too_little")
    groups = (
        words("nothing_between", names=joined(map(group_name, compared), ", ", "、"), s="s" * (len(compared) == 1))
        if compared
        else NOTHING
    )
    beyond = [(chart.counts[0], chart.chance.expected[0]) for chart in trend.charts if chart.chance is not None]
    n, expected = sum(each for each, _ in beyond), sum(each for _, each in beyond)
    outside = words("nothing_beyond", n=n, s="s" * (n > 1), expected=expected) if n else NOTHING
    return words("nothing", groups=groups, beyond=outside)


def _about(trend: Trend, names: list[str], text: Words) -> Words:
    """A sentence on these charts; without their names where all units share one."""
    whose = NOTHING
    if trend.by is not None:
        whose = words("about", group=group_name(trend.by), names=listed(names))
    return Words(_capitalised(f"{whose.en}{text.en}"), f"{whose.zh}{text.zh}")


def _capitalised(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


def _of_groups(trend: Trend) -> Iterator[Words]:
    """Significant differences between the levels of groups; a level that drifts has no difference."""
    if isinstance(trend.comparison, NotComputed):
        return
    reported: set[str] = set()
    drifting = {each.group for each in trend.drifts}
    for each in trend.comparison.differences:
        if each.adjusted > FALSE_ALARM or reported & set(each.confounded) or each.group in drifting:
            continue
        if each.confounded:
            reported.add(each.group)
        yield _difference(each, trend.comparison, trend.series.unit_of_measure, _since(each, trend))


def _of_scatters(trend: Trend) -> Iterator[Words]:
    """Levels of groups that scatter more than the others; where there are none, those that scatter less."""
    found = trend.scatters.differences
    between = "scatter_first" if len(set(trend.series.unit)) < trend.series.value.size else "scatter_all"
    plain = [each for each in found if each.chance <= FALSE_ALARM and not each.lo <= 1.0 <= each.hi]
    for name in dict.fromkeys(each.group for each in plain):
        own = [each for each in plain if each.group == name]
        for each in [each for each in own if each.ratio > 1.0] or own:
            group = group_name(name)
            yield words(
                "scatter", group=Words(_capitalised(group.en), group.zh), level=each.level, against=group,
                of=words("scatter_within" if each.is_within_units else between), ratio=each.ratio, lo=each.lo,
                hi=each.hi,
            )  # fmt: skip


def _since(found: Difference, trend: Trend) -> Words:
    """From when on a difference of stations is, where one of them has a change of level."""
    changed = list(dict.fromkeys(each.station for each in trend.found.shifts if each.station))
    changed = [each for each in changed if not found.against or each in {found.level, found.against}]
    return words("since_change", station=listed(changed)) if changed and found.group == "station" else NOTHING


def _difference(found: Difference, comparison: GroupComparison, unit: str, since: Words) -> Words:
    effect = found.effect
    higher = effect.value > 0
    lo, hi = (effect.lo, effect.hi) if higher else (-effect.hi, -effect.lo)
    group = group_name(found.group)
    against = words("against_level" if found.against else "against_others", group=group, level=found.against)
    return words(
        "difference", group=Words(_capitalised(group.en), group.zh), level=found.level,
        size=interval(abs(effect.value), lo, hi, unit), way=words("higher" if higher else "lower"), against=against,
        since=since, why=_attribution(found, comparison, unit),
    )  # fmt: skip


def _attribution(found: Difference, comparison: GroupComparison, unit: str) -> Words:
    """The cause of a difference, as far as it can be known."""
    group = group_name(found.group)
    nested = words("units_of_one", n=found.units, of=found.elsewhere) if not found.on_both else NOTHING
    if found.confounded:
        others = joined(map(group_name, found.confounded), " and ", "、")
        return joined([nested, words("confounded", names=others, group=group)], "", "")
    if found.group == "lot":
        return nested
    of_group = [each for each in comparison.pairs if each.group == found.group]
    levels = {found.level, found.against}
    pair = next((each for each in of_group if {each.level, each.against} == levels), None)
    elsewhere = [each.units for each in of_group if not found.against and found.level in {each.level, each.against}]
    if pair is None:
        if elsewhere:
            return words("units_elsewhere", n=max(elsewhere))
        several = found.on_both > 1
        few = words(
            "units_few_on_both", n=found.on_both, s="s" * several, was="were" if several else "was", least=LEAST_PAIRS
        )
        return few if found.on_both else joined([nested, words("units_on_one")], "", "")
    sign = 1 if pair.level == found.level else -1
    lo, hi = sorted((sign * pair.effect.lo, sign * pair.effect.hi))
    proof = words("proof" if lo > 0 or hi < 0 else "proof_none", group=group)
    size = interval(sign * pair.effect.value, lo, hi, unit)
    return words("units_on_both", units=pair.units, size=size, proof=proof)


def _of_components(trend: Trend) -> Iterator[Words]:
    """Components of variance, where repeated measurements or groups separate them."""
    found = trend.components
    if "unit" not in found and len(found) < 2:
        return
    names = {"unit": "between_units", "residual": "between_measurements"}
    if "unit" not in found:
        names["residual"] = "between_units_measured"
    same = coinciding(trend.found.rest, GROUPS)
    included = words("with_groups", groups=joined(map(group_name, same), ", ", "、")) if same else NOTHING
    parts = []
    for name in sorted(found, key=lambda name: (name not in names, name == "residual", name)):
        # the upper bound of few levels may be far away: two digits of each suffice
        value, lo, hi = (f"{each:.2g}" for each in found[name])
        whose = words(names.get(name, "between_levels"), group=group_name(name))
        if name == ("unit" if "unit" in found else "residual"):
            whose = joined([whose, included], "", "")
        unit = behind(trend.series.unit_of_measure)
        parts.append(words("component", name=whose, unit=unit, value=value, lo=lo, hi=hi))
    several = [name for name in GROUPS if len(set(trend.found.rest.groups[name])) > 1]
    unknown = [name for name in several if name not in found and name not in same]
    lacking = words("components_lacking", names=joined(_between(unknown), ", ", "、")) if unknown else NOTHING
    yield words("components", parts=joined(parts), without=_without(trend), lacking=lacking)


def _between(groups: Iterable[str]) -> Iterator[Words]:
    return (words("between_levels", group=group_name(name)) for name in groups)


def _without(trend: Trend) -> Words:
    """What was taken off before the components were computed."""
    drifting = list(trend.found.drifting)
    taken = {
        "of_shifts": bool(trend.found.shifts), "of_drifts": bool(trend.drifts), "of_drifting": bool(drifting),
    }  # fmt: skip
    what = [words(key, names=listed(drifting)) for key, is_so in taken.items() if is_so]
    return words("components_without", what=joined(what, ", ", "、")) if what else NOTHING


def _of_capability(trend: Trend) -> Iterator[Words]:
    """Capability of each chart, or why there is none."""
    refused: dict[Words, list[str]] = {}
    for chart, found, limits in zip(trend.charts, trend.capabilities, trend.specifications, strict=True):
        if isinstance(found, NotComputed):
            refused.setdefault(found.why, []).append(chart.name)
        else:
            yield _about(trend, [chart.name], _capable(chart, found, limits))
    if trend.by == "unit" and len(trend.charts) > 1:
        return
    for why, names in refused.items():
        yield _about(trend, names, words("no_capability", why=why))


def _capable(chart: Chart, found: Capability, limits: SpecifiedLimits) -> Words:
    charted, lacking = chart.series.value.size, len(chart.series.first_of_units().without_interval)
    indices = {name: index for name, index in (("Cp", found.cp), ("Cpk", found.cpk)) if index is not None}
    noise = NOTHING
    if found.measurement_share is not None:
        some = words("share_of", n=found.share_of) if found.share_of < found.n else NOTHING
        noise = words("share", share=f"{float(f'{found.measurement_share * 100:.2g}'):g} %", of=some)
    sides = [f"{sign} {side:.6g}" for sign, side in (("≥", limits.lower), ("≤", limits.upper)) if side is not None]
    return words(
        "capability", n=found.n, of=NOTHING if found.n == found.units else words("values_of", units=found.units),
        first=words("capability_first", every=charted) if charted > found.n else NOTHING,
        lacking=words("capability_lacking", n=lacking) if lacking else NOTHING, noise=noise,
        normal=NOTHING if found.is_normal else words("not_normal"),
        indices=joined((words("index", name=name, **each._asdict()) for name, each in indices.items()), ", ", ", "),
        sides=f"{', '.join(sides)}{behind(chart.series.unit_of_measure)}", source=limits.source,
        rule=words(f"rule_{limits.rule or 'interval'}"),
    )  # fmt: skip


def _without_interval(series: MetricSeries) -> Iterator[Words]:
    """How many values have no interval, whose, and why."""
    units: dict[str, dict[str, None]] = {}
    for at in series.without_interval:
        units.setdefault(series.remarks[at] if series.remarks else "", {})[series.unit[at]] = None
    parts = []
    for remark, of in units.items():
        why = words("why", why=Words(remark, in_chinese(remark))) if remark else NOTHING
        parts.append(words("lacking_of", names=listed([*of]), why=why))
    if parts:
        n, others = len(series.without_interval), len(parts) - _MOST_NAMED
        more = [words("more_reasons", n=others)] if others > 0 else []
        has, count = ("has", "counts") if n == 1 else ("have", "count")
        every = joined(parts[:_MOST_NAMED] + more)
        yield words("without_interval", n=n, of=series.value.size, has=has, count=count, parts=every)


def _excluded(series: MetricSeries) -> Iterator[Words]:
    if series.excluded:
        more = [f"+{len(series.excluded) - _MOST_NAMED}"] if len(series.excluded) > _MOST_NAMED else []
        yield words("excluded", n=len(series.excluded), runs=listed([*series.excluded[:_MOST_NAMED], *more]))


def _left_out(trend: Trend) -> Iterator[Words]:
    series = trend.series
    yield from _without_interval(series)
    yield from _excluded(series)
    refused = [(chart.name, chart.limits) for chart in trend.charts if isinstance(chart.limits, NotComputed)]
    by_reason: dict[Words, list[str]] = {}
    for name, found in refused:
        by_reason.setdefault(found.why, []).append(name)
    for why, names in by_reason.items():
        named = [name for name in names if name]
        whose = words("no_limits_of", names=listed(named)) if named else NOTHING
        yield words("no_limits", whose=whose, why=why)
    if trend.found.wild:
        wild = [f"{series.unit[at]}, {moment(series, at)}" for at in trend.found.wild]
        yield words("wild_left_out", values=listed(wild) if len(wild) == 1 else listed([f"({each})" for each in wild]))
    several = [name for name in GROUPS if len(set(series.groups[name])) > 1]
    if not isinstance(trend.comparison, NotComputed):
        for each in trend.comparison.left_out:
            yield words("not_compared", each=each)
    elif several:
        which = joined(map(group_name, several), ", ", "、")
        yield words("not_compared", each=words("groups_not_compared", names=which, why=trend.comparison.why))
    if trend.scatters.left_out:
        yield words("not_compared", each=joined(trend.scatters.left_out))
    yield from (words("other_measure", n=n, measure=measure) for measure, n in series.other_measures.items())
    if series.without_value:
        yield words("without_value", n=series.without_value, metric=series.metric)
    if not series.dated:
        yield words("undated")
    if series.undated:
        yield words("undated_left_out", n=series.undated, runs=listed(list(series.undated_runs)))
    if series.others:
        kinds = [str(each) for each in series.others]
        more = [f"{len(kinds) - 6} more"] if len(kinds) > 6 else []
        yield words("other_kinds", kinds="; ".join(kinds[:6] + more))
