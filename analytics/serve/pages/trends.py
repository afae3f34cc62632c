"""The page of trends: the sentences first, then charts as tables, yield, and what units fail by."""

from typing import Any

import msgspec

from analytics.serve.api.operation import Call, Nothing, NotYet, link
from analytics.serve.api.rows import Name
from analytics.serve.api.trend import trend_pictures as pictures
from analytics.serve.api.trend import trends as api
from analytics.serve.pages.frame.page import shown
from analytics.serve.pages.frame.zones import DEFAULT, common_zone, zoned
from analytics.specifications.verdicts import GROUP_KINDS, UNGIVEN, GroupKind

_MOST_CHARTS = 24
_OF_PAGE = ("yield_by", "group")


class TrendPageAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """As `TrendAsked`, without a metric at first."""

    metric: Name = ""
    by: api.ChartsBy = ""
    unit: tuple[Name, ...] = ()
    signal: Name = ""
    standard: Name = ""
    lot: Name = ""
    station: Name = ""
    fixture: Name = ""
    product: Name = ""
    parameter: tuple[Name, ...] = ()
    since: Name = ""
    yield_by: GroupKind = "lot"
    group: Name = ""


@shown("/trends", "trends.html.jinja", is_slow=True, shared_s=1.0)
def trends(call: Call, asked: TrendPageAsked) -> dict[str, Any]:
    """The trend of a metric."""
    fields = {name: value for name, value in msgspec.structs.asdict(asked).items() if name not in _OF_PAGE}
    group = {name: fields[name] for name in api.GroupAsked.__struct_fields__ if name in fields}
    shares = api.YieldAsked(by=asked.yield_by, name=asked.group, **group)
    try:
        metrics = api.list_metrics(call, Nothing()).metrics
    except NotYet:
        if not call.is_partial:
            raise
        data = link("api", "trends", **fields) if asked.metric else "/api/metrics"
        return {
            "found": None, "metrics": api.named_metrics(), "here": fields, "zone": DEFAULT, "data": data,
            "has_table": not asked.metric, "is_whole": False, "local_zone": common_zone(call),
        }  # fmt: skip
    of_yield = {"by": asked.yield_by, "name": asked.group} | group
    content = {
        "found": None,
        "is_whole": True,
        "metrics": metrics,
        "shares": api.list_yield(call, shares),
        "yields": {
            "picture": pictures.yield_picture(call, api.YieldAsked(by=asked.yield_by, **group)),
            "url": link("api", "yield", "groups", by=asked.yield_by, **group),
        },
        "pareto": {
            "picture": pictures.pareto_picture(call, shares), "url": link("api", "yield", "pareto", **of_yield)
        },
        "here": fields,
        "in_group": group,
        "kinds": GROUP_KINDS,
        "ungiven": UNGIVEN,
        "data": link("api", "trends", **fields) if asked.metric else "/api/metrics",
        "has_table": not asked.metric,
        "zone": DEFAULT,  # the trend itself gives its times in UTC
        "local_zone": common_zone(call),
    }  # fmt: skip
    return content | (_of_metric(call, fields) if asked.metric else {})


def _of_metric(call: Call, fields: dict[str, Any]) -> dict[str, Any]:
    """The trend with its pictures, and the other kinds of values of its metric."""
    fields = fields | {"since": zoned(fields["since"], common_zone(call)) or ""}
    question = api.TrendAsked(**fields)
    found = api.trend(call, question)
    charts = [
        (
            chart,
            {
                "picture": pictures.trend_chart(call, pictures.ChartAsked(**fields, chart=i)),
                "url": link("api", "trends", "chart", **fields, chart=i),
            },
        )
        for i, chart in enumerate(found["charts"][:_MOST_CHARTS])
    ]
    others = [
        (
            ", ".join([each["standard"], *(f"{name}={value}" for name, value in each["parameters"].items())]),
            link("trends", **fields | _kind(each)),
        )
        for each in found.get("other_kinds", [])
    ]
    values = pictures.trend_values(call, question)
    return {
        "found": found,
        "values": {"picture": values, "url": link("api", "trends", "values", **fields)},
        "charts": charts,
        "others": others,
    }


def _kind(each: dict[str, Any]) -> dict[str, Any]:
    return {
        "standard": each["standard"],
        "parameter": [f"{name}={value}" for name, value in each["parameters"].items()],
    }


@shown("/verdicts", "verdicts.html.jinja", is_slow=True, shared_s=1.0)
def verdicts(call: Call, asked: api.VerdictsAsked) -> dict[str, Any]:
    """Units with their verdicts by the specifications: of a lot, a station, a fixture, a day, or by one metric."""
    found = api.list_verdicts(call, asked)
    fields = msgspec.to_builtins(asked)
    names = {row.metric: row for row in api.list_metrics(call, Nothing()).metrics}
    return {
        "found": found,
        "names": names,
        "next": link("verdicts", **fields | {"after": found.after}) if found.after else None,
        "data": link("api", "verdicts", **fields),
    }
