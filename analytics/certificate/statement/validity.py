"""How long a calibration is valid."""

import datetime as dt


def later(day: dt.date, months: int) -> dt.date:
    """The day before the same day so many months later, on which a validity ends.

    >>> later(dt.date(2026, 3, 2), 12), later(dt.date(2026, 1, 31), 1)
    (datetime.date(2027, 3, 1), datetime.date(2026, 2, 27))
    """
    years, month = divmod(day.month - 1 + months, 12)
    first = dt.date(day.year + years, month + 1, 1)
    following = dt.date(first.year + first.month // 12, first.month % 12 + 1, 1)
    return min(first + dt.timedelta(days=day.day - 1), following - dt.timedelta(days=1)) - dt.timedelta(days=1)
