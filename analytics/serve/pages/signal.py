"""The page of a signal: a stretch of it with others beside it, its Allan deviation, and the same in SQL."""

import re
from bisect import bisect_right
from typing import Any

import msgspec

from analytics.serve.api.operation import Call, link
from analytics.serve.api.query import allan as allan_api
from analytics.serve.api.query import signals as api
from analytics.serve.api.rows import Name, dictionaries
from analytics.serve.pages.frame.page import shown
from analytics.serve.pages.frame.zones import common_zone, typed, zone_of_run, zoned
from stream.errors import BadInput
from stream.quantities import report_unit

_TABLE_POINTS = 100
_MOST_BESIDE = 4
_MOST_LISTED = 40
# what is shown beside a signal unless something else is asked for: its compensated form, and one of each of these
_USUAL = (r"(chamber_|case_)?temperature.*", r"(table|input|reference)_rate")
# signals of the unit itself, and those of the run's devices: names that the unit does not have
_OTHERS = """
select unit, signal, any_value(unit_of_measure) as unit_of_measure from internal.served_signals
where run = $run and (unit = $unit or signal not in
  (select signal from internal.served_signals where run = $run and unit = $unit))
group by unit, signal having not (unit = $unit and signal = $signal)
order by unit <> $unit, unit, signal limit $most
"""


class SignalPageAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which stretch, and what is beside it: ``SIGNAL`` of the same unit, ``UNIT/SIGNAL`` of another, or ``none``."""

    from_: str | None = msgspec.field(default=None, name="from")
    to: str | None = None
    beside: tuple[Name, ...] = ()


@shown("/signals/{unit}/{run}/{signal}", "signal.html.jinja", is_slow=True, shared_s=0.5)
def signal(call: Call, asked: SignalPageAsked) -> dict[str, Any]:
    """A stretch of a signal."""
    zone = zone_of_run(call, call.path["run"]) or common_zone(call)
    wrong = None
    try:
        first, last = zoned(asked.from_, zone), zoned(asked.to, zone)
        few = api.SignalAsked(from_=first, to=last, points=_TABLE_POINTS)
        found = api.signal(call, few)
    except BadInput as error:  # the form stays, with what was typed
        first, last, few, wrong = None, None, api.SignalAsked(points=_TABLE_POINTS), str(error)
        found = api.signal(call, few)
    of = (found.unit, found.run, found.signal)
    others = _others(call, found)
    chosen = _chosen(asked.beside, others, found)
    beside = [_beside(call, found, few, *each) for each in chosen]
    return {
        "found": found,
        "allan": _allan(call),
        "allan_unit": report_unit(found.unit_of_measure)[0],
        "others": [(_name(found.unit, *each), *each, each in chosen) for each in others],
        "beside": beside,
        "zooms": _zooms(found, asked.beside),
        "sql": _statement(found),
        "data": link("api", "signals", *of, points=1000, **{"from": first, "to": last}),
        "allan_data": link("api", "allan", *of),
        "zone": zone,
        "from_typed": typed(found.from_ns, zone) if first else (asked.from_ or "") if wrong else "",
        "to_typed": typed(found.to_ns, zone) if last else (asked.to or "") if wrong else "",
        "wrong": wrong,
    }


def _others(call: Call, found: api.SignalBuckets) -> list[tuple[str, str]]:
    """Unit and name of the signals that can be shown beside one."""
    given = {"unit": found.unit, "run": found.run, "signal": found.signal, "most": _MOST_LISTED}
    known = [(row["unit"], row["signal"]) for row in dictionaries(call.views, _OTHERS, given)]
    live = [(found.unit, name) for name in call.service.live.tail.signals(found.unit, found.run)]
    return list(dict.fromkeys([*known, *(each for each in live if each[1] != found.signal)]))


def _chosen(asked: tuple[str, ...], others: list[tuple[str, str]], found: api.SignalBuckets) -> list[tuple[str, str]]:
    """Those that are asked for; by default its compensated form, a temperature and a rate."""
    if asked:
        return [each for each in others if _name(found.unit, *each) in asked][:_MOST_BESIDE]
    usual = (re.escape(f"{found.signal}_compensated"), *_USUAL)
    first = ([each for each in others if re.fullmatch(pattern, each[1])][:1] for pattern in usual)
    return [each for few in first for each in few]


def _beside(call: Call, found: api.SignalBuckets, few: api.SignalAsked, unit: str, signal: str) -> dict[str, Any]:
    """Another signal over the same stretch, with its mean at each row of the table."""
    stretch = api.SignalAsked(from_=str(found.from_ns), to=str(found.to_ns), points=few.points)
    path = {"unit": unit, "run": found.run, "signal": signal}
    with Call(call.service, call.person, call.state, path) as other_call:
        other = api.signal(other_call, stretch)
    rows = (bisect_right(other.t_ns, t_ns + found.bucket_ns) - 1 for t_ns in found.t_ns)
    return {
        "name": _name(found.unit, unit, signal),
        "unit_of_measure": other.unit_of_measure,
        "means": [None if row < 0 else other.mean[row] for row in rows],
        "url": link("api", "signals", unit, found.run, signal),
        "page": link("signals", unit, found.run, signal),
    }


def _name(own: str, unit: str, signal: str) -> str:
    return signal if unit == own else f"{unit}/{signal}"


def _allan(call: Call) -> allan_api.Allan | None:
    """Its curve; None if that takes long: the page asks for it when it is there."""
    known = allan_api.known_allan(call)
    if known is not None or allan_api.is_long(call):
        return known
    return allan_api.allan(call, allan_api.AllanAsked(source="samples"))


def _zooms(found: api.SignalBuckets, beside: tuple[str, ...]) -> dict[str, str | None]:
    """Addresses of the stretches beside, around and within this one."""
    of = ("signals", found.unit, found.run, found.signal)
    length = found.to_ns - found.from_ns

    def at(first_ns: int, stop_ns: int) -> str:
        return link(*of, **{"from": first_ns, "to": stop_ns}, beside=beside)

    largest = max(range(len(found.t_ns)), key=lambda i: found.max[i] - found.min[i], default=None)
    width = max(found.bucket_ns, 1)
    return {
        "all": link(*of, beside=beside),
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
