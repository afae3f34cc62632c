"""What the cells of a column of times hold that are no time stamps: plain numbers, dates in digits, days of Excel."""

import re
from collections.abc import Callable, Sequence
from itertools import pairwise

from ingest.tables.times import NUMBER

_COMPACT = re.compile(
    r"(19|20)\d\d(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])([01]\d|2[0-3])[0-5]\d(?:[0-5]\d(?:\.?\d{1,9})?)?", re.ASCII
)
_WITHOUT_HOUR = re.compile(r"\d{1,3}:[0-5]\d[.,]\d+", re.ASCII)
_EXCEL_DAY = re.compile(r"[345]\d{4}(?:[.,]\d*)?", re.ASCII)  # 1982-02-18 to 2064-04-07
_S_PER_DAY = 86_400
_USUAL_STEPS_S = frozenset({*range(1, 11), 12, 15, 20, 30, 60, 120, 300, 600})
_FORMAT = "in Excel, format the column as yyyy-mm-dd hh:mm:ss.000 and save the file again"


def excel_days(first: str, cells: Callable[[], Sequence[str]], *, in_days: bool = False) -> str | None:
    """The first cell and what to do, if the cells are moments as Excel counts them, in days from 1900; else None.

    Seconds of a day are numbers of the same size. Days are known by steps of a usual number of seconds, that as
    fractions of a day do not end after a few digits, or by steps below one second. With `in_days` the numbers are days
    by their title: then no step is needed, as counted from 1970 they would lie decades ahead.

    >>> excel_days("46329.336805556", lambda: ["46329.336805556", "46329.336817130", "46329.336828704"])[:46]
    "'46329.336805556', days as Excel counts them: "
    >>> excel_days("46329.01", lambda: ["46329.01", "46329.02", "46329.03"])
    """
    if _EXCEL_DAY.fullmatch(first) is None:
        return None
    written = [cell.replace(",", ".") for cell in cells() if cell]
    if not all(map(_EXCEL_DAY.fullmatch, written)):
        return None
    if in_days or _are_steps_of_days(written, [float(cell) for cell in written]):
        return f"{first!r}, days as Excel counts them: {_FORMAT}"
    return None


def _are_steps_of_days(written: Sequence[str], days: Sequence[float]) -> bool:
    places = max(len(cell.partition(".")[2]) for cell in written)
    steps = [after - before for before, after in pairwise(days) if after != before]
    if places < 5 or not steps or min(steps) < 0:
        return False
    step, in_s = sum(steps) / len(steps), sum(steps) / len(steps) * _S_PER_DAY
    if in_s < 0.99:
        return True
    off = 10.0**-places * 1.01 / len(steps)  # both ends are rounded
    is_usual = abs(in_s - round(in_s)) <= off * _S_PER_DAY < 0.5 and round(in_s) in _USUAL_STEPS_S
    return is_usual and abs(step - round(step, 6)) > off


def what_times_hold(title: str, cells: Sequence[str]) -> str | None:
    """What a column that is the time by its title holds without a unit, and what to do; None for other cells.

    >>> what_times_hold("时间", ["0", "1"])
    "plain numbers, as '0': if seconds, give --rename '时间=time[s]', if milliseconds, time[ms]"
    >>> what_times_hold("时间", ["20261103080500"])
    "'20261103080500', a date without separators: write it as 2026-11-03 08:05:00"
    """
    first = next((cell for cell in cells if cell), "")
    if _COMPACT.fullmatch(first):
        parts = [first[:4], first[4:6], first[6:8]], [first[8:10], first[10:12], first[12:14] or "00"]
        return f"{first!r}, a date without separators: write it as {'-'.join(parts[0])} {':'.join(parts[1])}"
    if _WITHOUT_HOUR.fullmatch(first):
        return f"{first!r}, minutes and seconds without their hour, as Excel shows times of day: {_FORMAT}"
    if (found := excel_days(first, lambda: cells)) is not None:
        return found
    if NUMBER.fullmatch(first.replace(",", ".")):
        return f"plain numbers, as {first!r}: if seconds, give --rename '{title}=time[s]', if milliseconds, time[ms]"
    return None
