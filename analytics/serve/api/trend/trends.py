"""Trends of metrics, yield, and what units fail by."""

from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypedDict, cast

import msgspec

from analytics.serve.api.operation import Call, Nothing, get, link
from analytics.serve.api.rows import Limit, Name, dictionaries, page_of
from analytics.specifications.verdicts import GROUP_ARGUMENTS, UNGIVEN, Group, GroupKind
from stream.errors import BadInput, NotFound

if TYPE_CHECKING:
    from analytics.metric_registry.registry import MetricHeader
    from analytics.trends.series import MetricSeries

_COUNTS = """
select metric, count(value) as n, count(distinct unit) as units, count(*) - count(value) as without_value
from unit_metrics group by metric
"""
# a unit is judged by what was measured in the group, as in yield_by; without a group by all of it
_VERDICTS = f"""
with each_limit as (
  select unit, metric, specification,
    worst_rank(verdict, is_unjudged) as rank, latest_rank(verdict, is_unjudged, date_known, t_ns) as latest
  from internal.verdicts_in({GROUP_ARGUMENTS}) where $metric = '' or metric = $metric
  group by unit, signal, metric, subject, standard, specification
), in_group as (
  select unit, unit_verdict(min(rank), count(specification)) as verdict,
    unit_verdict(min(latest), count(specification)) as latest_verdict,
    count(*) filter (verdict_of_rank(rank) = 'PASS') as passed,
    count(*) filter (verdict_of_rank(rank) = 'FAIL') as failed,
    count(*) filter (verdict_of_rank(rank) = 'MARGINAL') as marginal,
    count(*) filter (verdict_of_rank(rank) = 'NO_DATA') as no_data,
    coalesce(list(distinct metric order by metric) filter (verdict_of_rank(rank) = 'FAIL'), []) as failures,
    coalesce(list(distinct metric order by metric) filter (verdict_of_rank(rank) = 'MARGINAL'), []) as undecided,
    coalesce(list(distinct metric order by metric) filter (verdict_of_rank(rank) = 'NO_DATA'), []) as lacking
  from each_limit group by unit
  union all by name
  select distinct unit, 'NO_DATA' as verdict, 'NO_DATA' as latest_verdict, 0 as passed, 0 as failed, 0 as marginal,
    0 as no_data, [] as failures, [] as undecided, [] as lacking
  from internal.unlimited_in({GROUP_ARGUMENTS}) where $metric = ''
), shown as (
  from unit_verdicts where not $is_group
  union all by name
  select u.unit, u.product, u.lot, g.* exclude (unit), u.reason from unit_verdicts u join in_group g using (unit)
  where $is_group
)
from shown where unit > $after and ($verdict = '' or verdict = $verdict) order by unit limit $rows
"""  # noqa: S608  our own statement
_TIMES = (("day", "%Y-%m-%d", "2026-03-29"), ("week", "%G-W%V-%u", "2026-W13"), ("month", "%Y-%m", "2026-03"))
_FILLED = {"day": "", "week": "-1", "month": ""}
ChartsBy = Literal["", "unit", "product", "station", "fixture", "lot"]
AnyVerdict = Literal["", "PASS", "FAIL", "MARGINAL", "NO_DATA"]


class MetricRow(msgspec.Struct, frozen=True, kw_only=True):
    """A metric with its names, and how many units have it."""

    metric: str
    en: str
    zh: str
    unit_of_measure: str
    better: str
    clauses: list[str]
    values: int
    units: int
    without_value: int


class Metrics(msgspec.Struct, frozen=True, kw_only=True):
    """All metrics."""

    metrics: list[MetricRow]


class TrendAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which metric of which units; `parameter` as ``average_s=100``, `since` as 2026-11-21."""

    metric: Name
    by: ChartsBy = ""
    unit: tuple[Name, ...] = ()
    signal: Name = ""
    standard: Name = ""
    lot: Name = ""
    station: Name = ""
    fixture: Name = ""
    product: Name = ""
    parameter: tuple[Name, ...] = ()
    since: Name = ""
    baseline: Annotated[int, msgspec.Meta(ge=8)] | None = None
    sigma: Literal["median_moving_range", "moving_range", "deviation"] = "median_moving_range"


class GroupAsked(msgspec.Struct, frozen=True, kw_only=True):
    """What was measured in a group: `day` as 2026-03-29, `week` as 2026-W13, `month` as 2026-03; empty asks for all."""

    product: Name = ""
    lot: Name = ""
    station: Name = ""
    fixture: Name = ""
    day: Name = ""
    week: Name = ""
    month: Name = ""
    run: Name = ""
    unit: tuple[Name, ...] = ()
    since: Name = ""

    @property
    def group(self) -> Group:
        """The group; BadInput where a time is none."""
        from analytics.evaluation.selection import day_or_moment

        for name, form, example in _TIMES:
            value = getattr(self, name)
            try:
                if value:
                    datetime.strptime(value + _FILLED[name], form)
            except ValueError:
                raise BadInput(f"{name} {value!r} is not like {example}") from None
        since_day, since_ns = day_or_moment(self.since, "since")
        return Group(
            self.product,
            self.lot,
            self.station,
            self.fixture,
            self.day,
            self.week,
            self.month,
            self.run,
            self.unit,
            since_ns,
            since_day,
        )

    @property
    def asked_group(self) -> dict[str, Any]:
        """The fields that name the group."""
        return {name: getattr(self, name) for name in GroupAsked.__struct_fields__}


class YieldAsked(GroupAsked, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """By which parts of which group; `name` is the part whose failures are counted, by default all are."""

    by: GroupKind = "lot"
    name: Name = ""


YieldGroup = TypedDict(
    "YieldGroup",
    {
        "name": str | None,
        "units": int,
        "passed": int,
        "failed": int,
        "marginal": int,
        "no_data": int,
        "first_passed": int,
        "first_judged": int,
        "latest_passed": int,
        "latest_judged": int,
        "yield": float | None,
        "yield_lo": float | None,
        "yield_hi": float | None,
        "not_all_limits": int,
        "not_judged": list[str],
        "unjudged": list[str],
        "withdrawn": list[str],
        "decision_rules": list[str],
        "reason": str | None,
    },
)
"""Units of a group by verdict, and its yield; as the table ``yield_by``."""


class Yield(msgspec.Struct, frozen=True, kw_only=True):
    """Yield of each group with its 95 % interval, of units that were judged; and what units fail by."""

    by: str
    name: str
    groups: list[YieldGroup]
    pareto: list[dict[str, Any]]


class VerdictsAsked(GroupAsked, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which units: those measured in a group or against limits of a `metric`, judged by what was measured there."""

    verdict: AnyVerdict = ""
    metric: Name = ""
    limit: Limit = 200  # as `Paged`, which cannot be a second base
    after: Name = ""


class UnitVerdict(TypedDict):
    """A unit with its verdict; as the table ``unit_verdicts``."""

    unit: str
    product: str | None
    lot: str | None
    verdict: str
    latest_verdict: str
    passed: int
    failed: int
    marginal: int
    no_data: int
    failures: list[str]
    undecided: list[str]
    lacking: list[str]
    reason: str | None


class UnitVerdicts(msgspec.Struct, frozen=True, kw_only=True):
    """A page of verdicts by the specifications; the next page and its `after`, None on the last."""

    units: list[UnitVerdict]
    after: str | None
    next: str | None


@get("/api/metrics", table="metrics", is_slow=True)
def list_metrics(call: Call, asked: Nothing) -> Metrics:
    """All metrics: names, clauses, and how many units have a value."""
    from analytics.metric_registry.registry import metrics

    del asked
    counts = {row["metric"]: row for row in dictionaries(call.metrics, _COUNTS)}
    none = {"n": 0, "units": 0, "without_value": 0}
    return Metrics(metrics=[_metric_row(metric.header, counts.get(name, none)) for name, metric in metrics().items()])


def _metric_row(header: "MetricHeader", count: dict[str, int]) -> MetricRow:
    from analytics.evaluation.selection import with_year

    return MetricRow(
        metric=header.id, en=header.en, zh=header.zh, unit_of_measure=header.unit, better=header.better,
        clauses=[f"{with_year(each.standard)} {each.clause}" for each in header.sources], values=count["n"],
        units=count["units"], without_value=count["without_value"],
    )  # fmt: skip


def named_metrics() -> list[MetricRow]:
    """All metrics, without what has come of them: that is not known yet."""
    from analytics.metric_registry.registry import metrics

    none = {"n": 0, "units": 0, "without_value": 0}
    return [_metric_row(metric.header, none) for metric in metrics().values()]


@get("/api/trends", is_slow=True)
def trend(call: Call, asked: TrendAsked) -> dict[str, Any]:
    """A metric over time: control charts, changes, drift, groups, capability, and a sentence on each result."""
    from analytics.trends.charts.capability import specified_limits
    from analytics.trends.charts.control_chart import Spread
    from analytics.trends.document import document
    from analytics.trends.trend import trend_of

    try:
        series = series_of(call, asked)
    except NotFound as error:
        return {"metric": asked.metric, "values": 0, "charts": [], "report": [], "reason": str(error)}
    found = trend_of(
        series, by=asked.by or None, baseline=asked.baseline, spread=Spread(asked.sigma),
        specification=specified_limits(call.store, series),
        limits_of=lambda part: specified_limits(call.store, part),
    )  # fmt: skip
    return document(found) | {"reason": None}


def series_of(call: Call, asked: TrendAsked) -> "MetricSeries":
    """The values that a trend is of; NotFound if there are none."""
    from analytics.evaluation.selection import dated, standard_named
    from analytics.trends.series import Choice, read_series

    choice = Choice(
        units=asked.unit, signal=asked.signal or None, parameters=_pairs(asked.parameter), lot=asked.lot or None,
        standard=standard_named(asked.standard) if asked.standard else None, station=asked.station or None,
        fixture=asked.fixture or None, product=asked.product or None,
        since_ns=dated(asked.since, "since") if asked.since else None,
    )  # fmt: skip
    return read_series(call.metrics, asked.metric, choice)


@get("/api/yield", table="groups", is_slow=True)
def list_yield(call: Call, asked: YieldAsked) -> Yield:
    """Yield of all, or by product, lot, place or time, and what units fail by, of all or of one part."""
    from analytics.specifications.verdicts import failures_in, yield_by

    groups = cast("list[YieldGroup]", yield_by(call.metrics, asked.by, asked.group))
    if asked.name and asked.name not in (names := [row["name"] or UNGIVEN for row in groups]):
        raise NotFound(f"no {asked.by} is named {asked.name!r}; there are {', '.join(names[:20]) or 'none'}")
    pareto = failures_in(call.metrics, asked.group.part(asked.by, asked.name))
    return Yield(by=asked.by, name=asked.name, groups=groups, pareto=pareto)


@get("/api/verdicts", table="units", is_slow=True)
def list_verdicts(call: Call, asked: VerdictsAsked) -> UnitVerdicts:
    """Units by name with their verdict by the specifications, and what they fail by."""
    if asked.metric:
        from analytics.metric_registry.registry import check_metrics

        check_metrics((asked.metric,))
    group = asked.group
    given = group.parameters | {
        "verdict": asked.verdict, "metric": asked.metric, "after": asked.after, "rows": asked.limit + 1,
        "is_group": group != Group() or bool(asked.metric),
    }  # fmt: skip
    found = cast("list[UnitVerdict]", dictionaries(call.metrics, _VERDICTS, given))
    units, has_more = page_of(found, asked.limit)
    after = units[-1]["unit"] if has_more else None
    following = msgspec.to_builtins(asked) | {"after": after}
    return UnitVerdicts(units=units, after=after, next=link("api", "verdicts", **following) if has_more else None)


def _pairs(parameters: tuple[str, ...]) -> dict[str, str]:
    found = {}
    for text in parameters:
        name, equals, value = text.partition("=")
        if not (equals and name and value):
            raise BadInput(f"parameter {text!r} is not like average_s=100")
        found[name.strip()] = value.strip()
    return found
