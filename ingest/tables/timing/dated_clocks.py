"""Times in two columns, a date and a time of day, as many loggers write them; and what a time stamp lacks."""

import re
from collections.abc import Mapping
from typing import NamedTuple

import pyarrow as pa

from ingest.tables.times import match_stamp

_CLOCK = re.compile(r"\d{1,2}:\d\d(?::\d\d(?:[.,]\d+)?)?(?:\s?(?:Z|[+-]\d\d(?::?\d\d)?|[AaPp][Mm]))?", re.ASCII)
_TWELVE_HOURS = re.compile(r"[AaPp][Mm]$")
_YEAR_LAST = re.compile(r"\d{1,2}([/.-])\d{1,2}\1(\d\d(?:\d\d)?)(?:[T\s].*)?", re.ASCII)
_OF_DATES = frozenset({"date", "datum", "日期"})
_OF_CLOCKS = frozenset({"time", "timeofday", "clock", "zeit", "uhrzeit", "时间", "时刻"})


class DatedClock(NamedTuple):
    """Titles of the columns of dates and of times of day that make the times together."""

    date: str
    clock: str


def is_clock(cell: str) -> bool:
    """Whether a cell is a time of day without a date.

    >>> [is_clock(each) for each in ("8:00", "23:59:59.5", "08:00:00,000", "8:00:00 PM", "2026-11-20 08:00", "8")]
    [True, True, True, True, False, False]
    """
    return _CLOCK.fullmatch(cell) is not None


def is_date(cell: str) -> bool:
    """Whether a cell is a date with the year first, and no time of day."""
    stamp = match_stamp(cell)
    return stamp is not None and stamp["time"] is None


def find_dated_clock(names: Mapping[str, str], first: Mapping[str, str]) -> DatedClock | None:
    """The columns, by title, whose names and first cells are a date and a time of day; None if there are not one each.

    The first date may be missing.

    >>> find_dated_clock({"Datum": "Datum", "Uhrzeit": "Uhrzeit"}, {"Datum": "2026-11-20", "Uhrzeit": "08:00:00,5"})
    DatedClock(date='Datum', clock='Uhrzeit')
    """

    def letters(title: str) -> str:
        return re.sub(r"[\W_]", "", names[title]).lower()

    dates = [title for title, cell in first.items() if letters(title) in _OF_DATES and (not cell or _has_date(cell))]
    clocks = [title for title, cell in first.items() if is_clock(cell) and letters(title) in _OF_CLOCKS]
    return DatedClock(dates[0], clocks[0]) if len(dates) == len(clocks) == 1 else None


def _has_date(cell: str) -> bool:
    return is_date(cell) or _YEAR_LAST.fullmatch(cell) is not None


def why_no_moment(cell: str, *, has_date: bool = False) -> str | None:
    """What a first cell holds that is nearly a time stamp, and what to write; None for all others.

    With `has_date` a time of day lacks nothing, as its date stands in another column.

    >>> why_no_moment("20.11.2026 08:00")[:75]
    "'20.11.2026 08:00', with day or month first, which programs read either way"
    >>> why_no_moment("2026-11-20"), why_no_moment("1.5"), why_no_moment("08:00", has_date=True)
    (None, None, None)
    """
    if (date := _YEAR_LAST.fullmatch(cell)) is not None:
        what = "with day or month first" if len(date[2]) > 2 else "a date with two digits for the year"
        return f"{cell!r}, {what}, which programs read either way: write the year first, as 2026-11-20"
    if not is_clock(cell):
        return None
    if _TWELVE_HOURS.search(cell):
        return f"{cell!r}, a time of day in twelve hours: write 24 hours, as 20:00:00"
    if has_date:
        return None
    return (
        f"{cell!r}, a time of day without a date: write the date before it, as 2026-11-20 {cell}, or in a column "
        "'Date' beside 'Time'"
    )


def joined(date: str, clock: str) -> str:
    """A time stamp of two cells; nothing that is one if they are no date and no time of day.

    >>> joined("2026-11-20", "8:00:00,5"), joined("2026-11-20 08:00", "8:00")
    ('2026-11-20 08:00:00,5', '2026-11-20 08:00 08:00')
    """
    return f"{date} 0{clock}" if clock[1:2] == ":" else f"{date} {clock}"


def joined_cells(dates: pa.Array, clocks: pa.Array) -> pa.Array:
    """`joined` of many cells without nulls."""
    import pyarrow.compute as pc

    dates, clocks = (pc.utf8_trim(each, " \t") for each in (dates, clocks))
    clocks = pc.replace_substring_regex(clocks, r"^(\d:)", r"0\1")
    return pc.binary_join_element_wise(dates, clocks, " ")
