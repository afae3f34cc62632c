"""The floor: as it is now, and its changes as server-sent events."""

import functools
import time
from collections.abc import AsyncIterator
from typing import Any

import anyio.to_thread
import msgspec
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from analytics.floor import UnitNow
from analytics.serve.answer_cache import Answer
from analytics.serve.api.encoding import accepted
from analytics.serve.api.operation import Call, Nothing, get
from analytics.serve.api.rows import iso
from analytics.serve.doors.admission import admitted
from analytics.serve.doors.roles import Role
from analytics.serve.live.broadcast import event
from analytics.serve.live.packed import BEGIN, packed
from analytics.serve.problems import TooMany
from analytics.serve.service import Service
from stream.decoding import converted
from stream.errors import NotFound
from stream.terminal.console import json_text

_MOST_LISTENERS = 1000
_MOST_OF_ONE = 200
_LONGEST_S = 3600.0
_SHARED_S, _WHOLE_S = 0.25, 1.0
_EVENT_STREAM = "text/event-stream"
_RETRY, _SILENCE = b"retry: 2000\n\n", b": \n\n"


class FloorDocument(msgspec.Struct, frozen=True, kw_only=True):
    """The floor: runs, and a row for each unit.

    `columns` names the cells of `units`, `state_columns` those of `states`: number of the unit, code of its verdict so
    far in `verdicts`, whether early decisions gave it, whether it is silent, number of its step in `steps`, seconds
    left, the value nearest its limit divided by the limit, second since 1970 in which its last sample arrived,
    whether it is released before the end of its run.
    """

    version: int
    time_ns: int
    verdicts: list[str]
    columns: list[str]
    state_columns: list[str]
    steps: list[str]
    runs: list[dict[str, Any]]
    units: list[list[Any]]
    states: list[list[Any]]
    lag_s: float
    problem: str | None


class UnitFloor(msgspec.Struct, frozen=True, kw_only=True):
    """A unit on the floor: each limit with its newest estimate and early decision."""

    unit: str
    run: str
    site: str
    station: str
    slot: str | None
    product: str | None
    step: str
    silent: bool
    last_arrival_ns: int
    last_arrival: str | None
    t_ns: int | None
    verdict: str
    early: str
    released: str | None
    left_s: float | None
    checks: list[dict[str, Any]]
    estimates: list[dict[str, Any]]


@get("/api/floor", is_kept=False, shared_s=_SHARED_S)
def floor(call: Call, asked: Nothing) -> FloorDocument:
    """All units on the floor as they are now; /api/live has the changes from this version on."""
    del asked
    return converted(call.service.live.document(_SHARED_S), FloorDocument, strict=False)


@get("/api/floor/{unit}", is_kept=False)
def unit_floor(call: Call, asked: Nothing) -> UnitFloor:
    """A unit on the floor: newest estimates with their bounds, limits, early decisions, last sample."""
    del asked
    name = call.path["unit"]
    with call.service.live.unit(name) as unit:
        if unit is None:
            raise NotFound(f"unit {name!r} is not on the floor; /api/units/{name} has what is stored of it")
        return _unit_floor(unit)


def _unit_floor(unit: UnitNow) -> UnitFloor:
    return UnitFloor(
        unit=unit.unit, run=unit.run.run, site=unit.run.place.site, station=unit.run.place.station, slot=unit.slot,
        product=unit.product, step=unit.step, silent=unit.is_silent, last_arrival_ns=unit.arrival_ns,
        last_arrival=iso(unit.arrival_ns) if unit.arrival_ns else None, t_ns=unit.t_ns, verdict=unit.verdict,
        early=unit.early, left_s=unit.left_s,
        released=None if unit.released is None else unit.released.verdict.value, checks=checks_of(unit),
        estimates=[msgspec.to_builtins(each) for each in unit.estimates.values()],
    )  # fmt: skip


def checks_of(unit: UnitNow) -> list[dict[str, Any]]:
    """Each limit of a unit with its newest estimate and its early decision."""
    rows = []
    for limit in {**dict.fromkeys(unit.limits), **dict.fromkeys(unit.checks)}:
        check, decision = unit.checks.get(limit), unit.decisions.get(limit)
        rows.append(
            msgspec.to_builtins(limit)
            | {
                "value": None if check is None else check.value,
                "lo": None if check is None else check.lo,
                "hi": None if check is None else check.hi,
                "reason": None if check is None else check.reason,
                "decision": None if decision is None else decision.outcome,
                "rule": None if decision is None else decision.rule,
                "decision_reason": None if decision is None else decision.reason,
                "decision_reason_zh": None if decision is None else decision.reason_zh,
            }
        )
    return rows


async def live(request: Request, *, service: Service) -> Response:
    """Changes of the floor as server-sent events: first ``floor``, all of it, then each ``change``, within some 0.1 s.

    A browser that comes back with Last-Event-ID gets what it has missed, if that is kept, instead of all.
    """
    person = admitted(request.scope, Role.VIEWER)
    headers = {"X-Accel-Buffering": "no", "Vary": "Accept-Encoding"}
    if request.method == "HEAD":
        return Response(media_type=_EVENT_STREAM, headers=headers)
    if service.changes.listeners >= _MOST_LISTENERS or service.listening[person.name] >= _MOST_OF_ONE:
        raise TooMany("too many pages listen to the floor", 10.0)
    nonce, _, number = request.headers.get("last-event-id", "").partition("-")
    version = int(number) if nonce == service.nonce and number.isdecimal() and len(number) < 16 else -1
    is_packed = "gzip" in accepted(request.headers.get("accept-encoding", ""))
    first = packed(_RETRY) if is_packed else _RETRY
    if version < 0 or not service.changes.has_after(version):
        version, first = await _whole(service, is_packed=is_packed)
    events = _of_person(service, person.name, _events(service, version, first, is_packed=is_packed))
    if is_packed:
        headers["Content-Encoding"] = "gzip"
    return StreamingResponse(events, media_type=_EVENT_STREAM, headers=headers)


async def _whole(service: Service, *, is_packed: bool) -> tuple[int, bytes]:
    """Version of the whole floor and its event, shared with those who come within a second: changes follow for each."""
    make = functools.partial(_encoded, service, is_packed=is_packed)
    answer = await service.cache.answer(("live", str(is_packed)), make, _WHOLE_S)
    if not service.changes.has_after(int(answer.headers[0][1])):
        answer = await make()
    return int(answer.headers[0][1]), answer.body


async def _encoded(service: Service, *, is_packed: bool) -> Answer:
    def encode() -> Answer:
        document = service.live.document()
        version = document["version"]
        first = _RETRY + event("floor", f"{service.nonce}-{version}", json_text(document).encode())
        return Answer(packed(first) if is_packed else first, _EVENT_STREAM, (("version", str(version)),))

    return await anyio.to_thread.run_sync(encode, limiter=service.fast, abandon_on_cancel=True)


async def _of_person(service: Service, name: str, events: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """Events, counted as one page of a person: nobody takes the places of all others."""
    service.listening[name] += 1
    try:
        async for each in events:
            yield each
    finally:
        service.listening[name] -= 1


async def _events(service: Service, version: int, first: bytes, *, is_packed: bool) -> AsyncIterator[bytes]:
    ends_s = time.monotonic() + _LONGEST_S  # the browser comes back, and says who it is once more
    yield BEGIN + first if is_packed else first
    silence = packed(_SILENCE) if is_packed else _SILENCE
    async for change in service.changes.after(version, is_packed=is_packed):
        yield silence if change is None else change
        if time.monotonic() > ends_s:
            return
