"""A moment as people write it: with a date, a time and a time zone."""

import re
from datetime import UTC, datetime, timedelta

from stream.errors import BadInput

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# Python's own moments end there
_BEYOND_MICROSECONDS = re.compile(r":\d\d[.,]\d{6}(\d{1,3})")


def moment_ns(text: str, option: str = "--start") -> int:
    """Nanoseconds UTC of the moment that an option was given; raises BadInput if it is no moment, or has no time zone.

    >>> moment_ns("2026-11-21T18:00:00+08:00"), moment_ns("2026-11-21T10:00:00.000000001Z")
    (1795255200000000000, 1795255200000000001)
    """
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise BadInput(
            f"{option} {text!r} is not a moment; write it with date, time and time zone, as 2026-11-21T18:00:00+08:00"
        ) from error
    if moment.tzinfo is None:
        whole = moment.replace(tzinfo=UTC).isoformat().removesuffix("+00:00")
        raise BadInput(f"{option} {text!r} has no time zone; add one, as in {whole}+08:00 or {whole}Z")
    beyond = _BEYOND_MICROSECONDS.search(text)
    nanoseconds = int(beyond[1].ljust(3, "0")) if beyond else 0
    return (moment - _EPOCH) // timedelta(microseconds=1) * 1000 + nanoseconds
