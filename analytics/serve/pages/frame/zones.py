"""Time zones: that of the station where a moment was, else the one of all stations."""

from contextlib import suppress
from datetime import UTC, datetime, tzinfo
from functools import lru_cache
from zoneinfo import ZoneInfo

from analytics.serve.api.operation import Call
from stream.errors import BadInput, GyrofleetError

DEFAULT = "UTC"
_ZONES = "select distinct time_zone from internal.served_runs where time_zone is not null"
_OF_RUN = "select time_zone, date_known from internal.served_runs where run = $run"


def common_zone(call: Call) -> str:
    """The zone of all stations of a store; UTC where there is none, or more than one."""
    found: set[str] = set()
    with suppress(GyrofleetError):  # the page of the store reports a damaged lake, and needs a zone as well
        key = ("time zones", call.state.tag)
        found |= call.service.memo.result(key, lambda: frozenset(name for (name,) in call.views.rows(_ZONES)))
    found |= {run.time_zone for run in list(call.service.live.floor.runs.values()) if run.time_zone is not None}
    return found.pop() if len(found) == 1 else DEFAULT


def zone_of_run(call: Call, run: str) -> str | None:
    """The zone that a run states, if it states one; UTC where its date is unknown."""
    for zone, is_date_known in call.fresh.rows(_OF_RUN, {"run": run}):
        return None if zone is None and is_date_known else str(zone) if is_date_known else DEFAULT
    return None


def local(t_ns: int, name: str) -> tuple[str, str]:
    """A moment at a place, to the second, and the zone that it is in: UTC if there is no such zone.

    A moment that clocks show twice, as summer time ends, has its offset from UTC.

    >>> local(1_795_255_200_000_000_000, "Asia/Shanghai"), local(1_795_255_200_000_000_000, "Mars/Base")
    (('2026-11-21 18:00:00', 'Asia/Shanghai'), ('2026-11-21 10:00:00', 'UTC'))
    >>> local(1_792_888_200_000_000_000, "Europe/Berlin")
    ('2026-10-25 02:30:00+02:00', 'Europe/Berlin')
    """
    zone = _zone(name)
    moment = datetime.fromtimestamp(t_ns // 10**9, zone)
    return f"{moment:%Y-%m-%d %H:%M:%S}{_offset(moment)}", DEFAULT if zone is UTC else name


def _offset(moment: datetime) -> str:
    """The offset of a moment whose time of day occurs twice; else nothing."""
    return moment.isoformat()[-6:] if moment.replace(fold=0).utcoffset() != moment.replace(fold=1).utcoffset() else ""


def zoned(text: str | None, name: str) -> str | None:
    """A moment that a person typed: one that states no zone is in this one; anything else is left as it is.

    Raises BadInput for a time that clocks of the zone show twice, or skip.

    >>> zoned("2026-11-21 18:00", "Asia/Shanghai"), zoned("2026-11-21T10:00:00Z", "Asia/Shanghai"), zoned("noon", "UTC")
    ('2026-11-21T18:00:00+08:00', '2026-11-21T10:00:00Z', 'noon')

    All digits are kept:

    >>> zoned("2026-11-21 10:00:00.000000001", "UTC")
    '2026-11-21T10:00:00.000000001+00:00'

    With the name of the zone behind it, as pages show moments, it is the same:

    >>> zoned("2026-11-21 18:00:00 Asia/Shanghai", "Asia/Shanghai"), zoned("2026-11-21 10:00 UTC", "Asia/Shanghai")
    ('2026-11-21T18:00:00+08:00', '2026-11-21T10:00:00+00:00')
    """
    text = (text or "").strip()
    if not text:
        return None
    if text.endswith((f" {name}", f" {DEFAULT}")):
        text, _, name = text.rpartition(" ")
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return text
    if moment.tzinfo is not None or text.isdecimal():
        return text
    beyond = text[26:29] if text[19:20] == "." and len(text) > 26 else ""  # Python's moments end at microseconds
    early, late = (moment.replace(tzinfo=_zone(name), fold=fold) for fold in (0, 1))
    if early.utcoffset() != late.utcoffset():
        is_twice = early.astimezone(UTC) < late.astimezone(UTC)
        what = "is there twice, as clocks are set back" if is_twice else "is skipped, as clocks are set forward"
        raise BadInput(f"{text} in {name} {what}: add {early.isoformat()[-6:]} or {late.isoformat()[-6:]}")
    if not beyond:
        return early.isoformat()
    whole = early.isoformat(timespec="microseconds")
    return whole[:26] + beyond + whole[26:]


def typed(t_ns: int, name: str) -> str:
    """A moment as `zoned` reads it, to the microsecond.

    >>> typed(1_795_255_200_500_000_000, "Asia/Shanghai")
    '2026-11-21 18:00:00.500000'
    """
    moment = datetime.fromtimestamp(t_ns // 10**9, _zone(name)).replace(microsecond=t_ns % 10**9 // 1000)
    return moment.replace(tzinfo=None).isoformat(" ") + _offset(moment)


@lru_cache
def _zone(name: str) -> tzinfo:
    try:
        return UTC if name == DEFAULT else ZoneInfo(name)
    except (ValueError, KeyError, OSError):
        return UTC
