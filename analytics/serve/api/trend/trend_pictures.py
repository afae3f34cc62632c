"""Pictures of trends: all values over time, the control charts, yield by group, what units fail by."""

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from analytics.plots.picture import Axis, Curve, Label, Mark, Picture, Style
from analytics.serve.api.operation import Call, get, link
from analytics.serve.api.trend import trends
from analytics.specifications.verdicts import UNGIVEN, UNGIVEN_ZH
from analytics.trends.words import behind
from stream.errors import NotFound

if TYPE_CHECKING:
    from analytics.trends.series import MetricSeries

_MOST_GROUPS = 12
_FEW_UNITS = 8
_TIME = Axis(label=Label("time (UTC)", "时间（UTC）"), scale="time")


class ChartAsked(trends.TrendAsked, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """As for the trend, and which of its charts, from 0 on."""

    chart: Annotated[int, msgspec.Meta(ge=0)] = 0


@get("/api/trends/values", table="", is_slow=True)
def trend_values(call: Call, asked: trends.TrendAsked) -> Picture:
    """Every value of a metric over time, a curve for each group (station by default), with changes and limits."""
    found = trends.trend(call, asked)
    title = _title(found, asked.metric)
    if found["reason"] is not None:
        return Picture(title=title, x=_TIME, y=Axis(label=title), reason=Label.same(found["reason"]))
    series = trends.series_of(call, asked)
    times = [each / 1e9 for each in series.t_ns.tolist()]
    levels, groups = _levels(series.groups | {"unit": series.unit}, asked.by)
    curves = []
    for level in levels:
        rows = [i for i, each in enumerate(groups) if each == level]
        if not rows:
            continue
        values = [float(series.value[i]) for i in rows]
        curves.append(
            Curve(
                name=_shown(level), x=[times[i] for i in rows], y=list(values), style="points",
                lo=_bounds(series, 0, rows), hi=_bounds(series, 1, rows),
                texts=[f"{series.unit[i]} {series.run[i]}" for i in rows],
                links=[link("units", series.serial[i]) for i in rows],
            )
        )  # fmt: skip
    note = None
    if not series.dated:
        note = Label("Dates of some runs are unknown: moments of recording.", "部分试验日期未知：按记录时刻排列。")
    marks = [mark for shift in found["shifts"] if (mark := _shift(shift, found["unit_of_measure"])) is not None]
    return Picture(
        title=title, x=_TIME, y=Axis(label=title, unit=found["unit_of_measure"]),
        curves=[*curves, *_specified(found, found["dated"], times, series.t_ns.tolist())], marks=marks, note=note,
    )  # fmt: skip


def _bounds(series: "MetricSeries", side: int, rows: list[int]) -> list[float | None] | None:
    """The 95 % bounds of values on one side; None of a value without."""
    if series.bounds is None:
        return None
    found = [float(series.bounds[side, i]) for i in rows]
    return [each if each == each else None for each in found]


@get("/api/trends/chart", table="", is_slow=True)
def trend_chart(call: Call, asked: ChartAsked) -> Picture:
    """A control chart: values, centre and control limits, levels between changes, what the rules find, limits."""
    plain = {name: value for name, value in msgspec.structs.asdict(asked).items() if name != "chart"}
    found = trends.trend(call, trends.TrendAsked(**plain))
    title = _title(found, asked.metric)
    if found["reason"]:
        return Picture(title=title, x=_TIME, y=Axis(label=title), reason=Label.same(found["reason"]))
    if asked.chart >= len(found["charts"]):
        raise NotFound(f"there is no chart {asked.chart}: there are {len(found['charts'])}, from 0 on")
    chart = found["charts"][asked.chart]
    return chart_picture(chart, found, title)


def chart_picture(chart: dict[str, Any], found: dict[str, Any], title: Label) -> Picture:
    """The picture of one chart of a trend."""
    points, limits = chart["points"], chart["limits"]
    place = [float(number) for number in range(1, len(points) + 1)]
    times = [None if point["t_ns"] is None else point["t_ns"] / 1e9 for point in points]
    is_dated = found["dated"] and len(set(times)) == len(times)
    x = [float(each or 0.0) for each in times] if is_dated else place
    axis = _TIME if is_dated else Axis(label=Label("value, in the order of time", "数值，按时间顺序"))
    texts = [" ".join(filter(None, (point["unit"], point["run"], point["time"]))) for point in points]
    links = [link("units", point["serial"]) for point in points]
    values: list[float | None] = [point["charted"] for point in points]
    out: list[float | None] = [point["charted"] if point["rules"] else None for point in points]
    if is_adjusted := chart["is_adjusted"]:
        texts = [f"{text} {point['value']:.6g}" for text, point in zip(texts, points, strict=True)]
    curves = [Curve(name=title, x=x, y=values, style="both", texts=texts, links=links)]
    if any(each is not None for each in out):
        name = Label("found by the rules", "判异点")
        curves.append(Curve(name=name, x=x, y=out, style="alarm", texts=texts, links=links))
    curves += _levels_between(chart, x)
    lines: tuple[tuple[str, Label, Style], ...] = (
        ("centre", Label("centre", "中心线"), "centre"),
        ("lower", Label("lower control limit", "下控制限"), "control"),
        ("upper", Label("upper control limit", "上控制限"), "control"),
    )
    curves += [
        Curve(name=name, x=x, y=[limits[key]] * len(x), style=style)
        for key, name, style in lines
        if limits.get(key) is not None
    ]
    shown = Label(title.en if not chart["name"] else chart["name"], title.zh if not chart["name"] else chart["name"])
    # limits are of values, not of what is left of them
    specified = [] if is_adjusted else _specified(chart, found["dated"], x, [point["t_ns"] for point in points])
    of_units = Label(
        "Each value without what the report finds of stations and fixtures. The limits of the specification do not "
        "apply to these points; a point's text has its value.",
        "各点已扣除报告所指出的试验台与夹具影响。规范限值不适用于这些点；测得值见各点文字。",
    )
    of_places = Label(
        "Each value without its unit's own level: the level there plus the deviation from the value expected of the "
        "unit. The limits of the specification do not apply to these points; a point's text has its value.",
        "各点已扣除产品自身水平：为该处水平加上与该产品期望值之差。规范限值不适用于这些点；测得值见各点文字。",
    )
    note = of_units if found["by"] == "unit" else of_places
    return Picture(
        title=shown, x=axis, y=Axis(label=title, unit=found["unit_of_measure"]), curves=[*curves, *specified],
        note=note if is_adjusted else None,
    )  # fmt: skip


@get("/api/yield/groups", table="", is_slow=True)
def yield_picture(call: Call, asked: trends.YieldAsked) -> Picture:
    """Yield of all, or of each lot, station or other part, with its 95 % interval."""
    groups: list[dict[str, Any]] = msgspec.to_builtins(trends.list_yield(call, asked).groups)
    found = [row for row in groups if row["yield"] is not None]
    names = [row["name"] or UNGIVEN for row in found]
    percent = {name: [100 * row[name] for row in found] for name in ("yield", "yield_lo", "yield_hi")}
    curve = Curve(
        name=Label("yield", "合格率"), x=[float(i) for i in range(len(found))], y=list(percent["yield"]), style="bars",
        lo=list(percent["yield_lo"]), hi=list(percent["yield_hi"]), texts=names,
        links=[link("verdicts", **asked.asked_group | _part(asked.by, name)) for name in names],
    )  # fmt: skip
    none = Label("No unit was judged.", "没有已判定的产品。")
    return Picture(
        title=Label("Yield with its 95 % interval", "合格率及其 95 % 区间"),
        x=Axis(label=_GROUPS[asked.by], scale="names", names=[_shown(name) for name in names]),
        y=Axis(label=Label("yield", "合格率"), unit="%"),
        curves=[curve] if found else [], reason=None if found else none,
    )  # fmt: skip


@get("/api/yield/pareto", table="", is_slow=True)
def pareto_picture(call: Call, asked: trends.YieldAsked) -> Picture:
    """What units fail by, the most frequent first: share of all failures, and the shares added up."""
    rows = trends.list_yield(call, asked).pareto
    x, names = [float(i) for i in range(len(rows))], [Label(row["en"], row["zh"]) for row in rows]
    failing = Label("share of the failures", "占不合格的比例")
    group = asked.asked_group | _part(asked.by, asked.name)
    curves = [
        Curve(
            name=failing, x=x, y=[100 * row["share"] for row in rows], style="bars",
            texts=[row["metric"] for row in rows],
            links=[link("verdicts", metric=row["metric"], verdict="FAIL", **group) for row in rows],
        ),
        Curve(name=Label("added up", "累计"), x=x, y=[100 * row["cumulative_share"] for row in rows], style="both"),
    ]  # fmt: skip
    return Picture(
        title=Label("What units fail by", "不合格特性"),
        x=Axis(label=Label("characteristic", "特性"), scale="names", names=names),
        y=Axis(label=failing, unit="%"), curves=curves if rows else [],
        reason=None if rows else Label("No unit fails.", "没有不合格产品。"),
    )  # fmt: skip


def _part(kind: str, name: str | None) -> dict[str, str]:
    """The field of a question that names a part of a group."""
    return {kind: name} if name and kind != "all" else {}


def _shown(name: str) -> Label:
    """The name of a group; that of what has none is in the language of the page."""
    return Label(UNGIVEN, UNGIVEN_ZH) if name in {"", UNGIVEN} else Label.same(name)


_GROUPS = {
    "all": Label("all", "全部"), "product": Label("product", "产品型号"), "lot": Label("lot", "批次"),
    "station": Label("station", "试验台"), "fixture": Label("fixture", "夹具"), "day": Label("day", "日期"),
    "week": Label("week", "周"), "month": Label("month", "月"),
}  # fmt: skip


def _title(found: dict[str, Any], metric: str) -> Label:
    names = found.get("names") or {"en": metric, "zh": metric}
    return Label(names["en"], names["zh"])


def _levels(groups: dict[str, list[str]], by: str) -> tuple[list[str], list[str]]:
    """Groups by which values are distinguished: those asked for, else stations if several, else a few units."""
    names = [by] if by else ["station", "unit"]
    for name in names:
        levels = sorted(set(groups.get(name, [])))
        if (by and len(levels) <= _MOST_GROUPS) or 1 < len(levels) <= _FEW_UNITS:
            return levels, groups[name]
    return ["all"], ["all"] * len(groups["unit"])


def _specified(found: dict[str, Any], is_dated: bool, x: list[float], t_ns: list[int | None]) -> list[Curve]:
    """Limits of the specification, each over the values that were measured while it was valid."""
    sides = (("lower", Label("lower limit", "下限")), ("upper", Label("upper limit", "上限")))
    limits = found["specification"]
    if not is_dated or None in t_ns:
        stretches = [(limits, x)]
    else:
        moments = [(place, t or 0) for place, t in zip(x, t_ns, strict=True)]
        stretches = [
            (each, [place for place, t in moments if each["from_ns"] <= t < each["until_ns"]])
            for each in limits["stretches"]
        ]
    return [
        Curve(
            name=Label(f"{name.en} {valid['source'] or ''}".strip(), f"{name.zh} {valid['source'] or ''}".strip()),
            x=[min(places), max(places)], y=[valid[side], valid[side]], style="limit",
        )
        for valid, places in stretches
        for side, name in sides
        if valid[side] is not None and places
    ]  # fmt: skip


def _shift(shift: dict[str, Any], unit_of_measure: str) -> Mark | None:
    """A change of level as a mark; None where dates are unknown."""
    try:
        moment = datetime.fromisoformat(shift["time"]).replace(tzinfo=UTC)
    except ValueError:
        return None
    size = f"{shift['size']:+.3g}{behind(unit_of_measure)}"
    where = shift["station"] or ""
    doubt = ("perhaps ", "可能 ") if shift["lo"] <= 0.0 <= shift["hi"] else ("", "")
    en, zh = (f"{where} {word}{size}".strip() for word in doubt)
    return Mark(moment.timestamp(), Label(en, zh))


def _levels_between(chart: dict[str, Any], x: list[float]) -> list[Curve]:
    """Levels between changes, if there are any."""
    changes = chart["changes"].get("points", [])
    if not changes:
        return []
    edges = [0, *(change["at"] for change in changes), len(x)]
    level: list[float | None] = []
    for first, last, value in zip(edges, edges[1:], chart["changes"]["levels"], strict=False):
        level += [value] * (last - first)
    return [Curve(name=Label("level", "水平"), x=x, y=level, style="line")]
