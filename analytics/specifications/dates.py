"""From when until when a specification holds: dates as they stand in TOML."""

from datetime import UTC, date, datetime, timedelta

from stream.errors import BadInput

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_DAY = timedelta(days=1)


def begin_ns(value: object, where: str) -> int | None:
    """First moment of a date, or the moment itself, in ns UTC; None stays None.

    Raises
    ------
    BadInput: If it is neither a date nor a moment with a time zone.

    Examples
    --------
    >>> begin_ns(date(1970, 1, 2), "spec.toml: valid_from") == 86400 * 10**9
    True
    """
    return _moment_ns(value, where, is_end=False)


def end_ns(value: object, where: str) -> int | None:
    """Moment from which it does not hold any more: a date counts with its whole day.

    Raises
    ------
    BadInput: If it is neither a date nor a moment with a time zone.

    Examples
    --------
    >>> end_ns(date(1970, 1, 1), "spec.toml: valid_until") == 86400 * 10**9
    True
    """
    return _moment_ns(value, where, is_end=True)


def told_moment(t_ns: int | None) -> str | None:
    """A moment for people, ``2026-11-21`` or ``2026-11-21T10:00:00Z``.

    Examples
    --------
    >>> told_moment(0), told_moment(3_600_000_000_000)
    ('1970-01-01', '1970-01-01T01:00:00Z')
    """
    if t_ns is None:
        return None
    moment = _EPOCH + timedelta(microseconds=t_ns // 1000)
    return moment.strftime("%Y-%m-%d") if t_ns % (86_400 * 10**9) == 0 else moment.strftime("%Y-%m-%dT%H:%M:%SZ")


def _moment_ns(value: object, where: str, *, is_end: bool) -> int | None:
    if value is None:
        return None
    if isinstance(value, datetime):
        if value.tzinfo is None:
            raise BadInput(f"{where}: {value.isoformat()} has no time zone; add one, or give the date alone")
        since = value - _EPOCH
    elif isinstance(value, date):
        since = datetime(value.year, value.month, value.day, tzinfo=UTC) - _EPOCH + (_DAY if is_end else timedelta())
    else:
        raise BadInput(f"{where}: {value!r} is no date; write it as 2026-01-01, without quotes (it counts in UTC)")
    return (since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000
