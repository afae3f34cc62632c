"""The page of a signal: a stretch of it, its Allan deviation, and the same in SQL."""

from typing import Any

from analytics.serve.api import allan as allan_api
from analytics.serve.api import signals as api
from analytics.serve.api.operation import Call, link
from analytics.serve.pages.page import shown
from analytics.serve.pages.zones import zone_of_run

_TABLE_POINTS = 100


@shown("/signals/{unit}/{run}/{signal}", "signal.html.jinja", is_slow=True)
def signal(call: Call, asked: api.SignalAsked) -> dict[str, Any]:
    """A stretch of a signal."""
    few = api.SignalAsked(from_=asked.from_, to=asked.to, points=min(asked.points, _TABLE_POINTS))
    found = api.signal(call, few)
    of = (found.unit, found.run, found.signal)
    others = call.views.rows(
        "select signal from signals where unit = $unit and run = $run order by signal",
        {"unit": found.unit, "run": found.run},
    )
    live = call.service.live.tail.signals(found.unit, found.run)
    return {
        "found": found,
        "allan": _allan(call),
        "others": sorted(({name for (name,) in others} | set(live)) - {found.signal}),
        "zooms": _zooms(found),
        "sql": _statement(found),
        "data": link("api", "signals", *of, points=1000, **{"from": asked.from_, "to": asked.to}),
        "allan_data": link("api", "allan", *of),
        "zone": zone_of_run(call, found.run),
    }


def _allan(call: Call) -> allan_api.Allan | None:
    """Its curve; None if that takes long: the page asks for it when it is there."""
    known = allan_api.known_allan(call)
    if known is not None or allan_api.is_long(call):
        return known
    return allan_api.allan(call, allan_api.AllanAsked(source="samples"))


def _zooms(found: api.SignalBuckets) -> dict[str, str | None]:
    """Addresses of the stretches beside, around and within this one."""
    of = ("signals", found.unit, found.run, found.signal)
    length = found.to_ns - found.from_ns

    def at(first_ns: int, stop_ns: int) -> str:
        return link(*of, **{"from": first_ns, "to": stop_ns})

    largest = max(range(len(found.t_ns)), key=lambda i: found.max[i] - found.min[i], default=None)
    width = max(found.bucket_ns, 1)
    return {
        "all": link(*of),
        "before": at(found.from_ns - length // 2, found.to_ns - length // 2),
        "after": at(found.from_ns + length // 2, found.to_ns + length // 2),
        "out": at(found.from_ns - length // 2, found.to_ns + length // 2),
        "in": at(found.from_ns + length // 4, found.to_ns - length // 4) if length > 4 else None,
        "widest": None
        if largest is None or not found.bucket_ns
        else at(found.t_ns[largest] - width // 2, found.t_ns[largest] + width + width // 2),
    }


def _statement(found: api.SignalBuckets) -> str:
    """The same stretch in SQL."""
    names = {name: getattr(found, name).replace("'", "''") for name in ("unit", "run", "signal")}
    where = " and ".join(f"{name} = '{value}'" for name, value in names.items())
    table = "samples" if found.source in ("samples", "raw") else found.source
    value = "value" if table == "samples" else "n, mean, lo, hi"
    return (
        f"select t_ns, time, {value}, unit_of_measure from {table}\n"  # noqa: S608  shown to people
        f"where {where}\n  and t_ns between {found.from_ns} and {found.to_ns}\norder by t_ns"
    )
