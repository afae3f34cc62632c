"""The page of trends: the sentences first, then charts as tables, yield, and what units fail by."""

from typing import Any, Literal

import msgspec

from analytics.serve.api import trends as api
from analytics.serve.api.operation import Call, Nothing, link
from analytics.serve.api.rows import Name
from analytics.serve.pages.page import shown
from analytics.serve.pages.zones import DEFAULT


class TrendPageAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """As `TrendAsked`, without a metric at first."""

    metric: Name = ""
    by: Literal["", "unit", "station", "fixture", "lot"] = ""
    unit: tuple[Name, ...] = ()
    signal: Name = ""
    standard: Name = ""
    lot: Name = ""
    station: Name = ""
    fixture: Name = ""
    product: Name = ""
    parameter: tuple[Name, ...] = ()
    since: Name = ""
    yield_by: Literal["lot", "station", "fixture", "day"] = "lot"


@shown("/trends", "trends.html.jinja", is_slow=True)
def trends(call: Call, asked: TrendPageAsked) -> dict[str, Any]:
    """The trend of a metric."""
    metrics = api.list_metrics(call, Nothing()).metrics
    fields = {name: value for name, value in msgspec.to_builtins(asked).items() if name != "yield_by"}
    found = None
    if asked.metric:
        found = api.trend(call, api.TrendAsked(**fields | {"unit": asked.unit, "parameter": asked.parameter}))
    return {
        "found": found,
        "metrics": metrics,
        "shares": api.list_yield(call, api.YieldAsked(by=asked.yield_by)),
        "data": link("api", "trends", **fields) if asked.metric else "/api/metrics",
        "has_table": not asked.metric,
        "zone": DEFAULT,  # the trend itself gives its times in UTC
    }
