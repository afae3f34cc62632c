"""Remarks on the times of a table: dates in the future, local times that the end of summer time repeats, times that
are written too coarsely for the samples, sample rates that change.
"""

import shlex
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from ingest.tables.sample_file import SignalSummary
from ingest.tables.times import stamp_text
from ingest.tables.timing.grid import Sampling
from stream.defects.rate_changes import RateChange, remark_on_rate_changes

if TYPE_CHECKING:
    from zoneinfo import ZoneInfo

_DAY_NS = 86_400 * 10**9
_YEAR_NS = 365 * _DAY_NS
_MOST_DAYS = 4000
_MANY_REPEATED = 0.1  # of the rows


def future_remark(last_ns: int) -> str | None:
    """A warning if times reach further than a day beyond now, of which clocks are not wrong by chance.

    >>> future_remark(0) is None, future_remark(4_004_000_000 * 10**9)[:50]
    (True, 'warning: its times reach 2096-11-17, in the future')
    """
    if last_ns <= time.time_ns() + _DAY_NS:
        return None
    date = datetime.fromtimestamp(last_ns // 10**9, UTC).date()
    return (
        f"warning: its times reach {date}, in the future: they are taken to count from 1970-01-01, but days of Excel "
        "count from 1899-12-30 and seconds of LabVIEW from 1904-01-01; convert them, or give --start with times from 0"
    )


def unset_clock_remark(first_ns: int) -> str | None:
    """A warning if dated times begin in 1970, as those of a clock that was never set do.

    >>> unset_clock_remark(1_795_255_200 * 10**9) is None, unset_clock_remark(83 * 10**9)[:53]
    (True, 'warning: its times begin at 1970-01-01T00:01:23Z, in ')
    """
    if not 0 <= first_ns < _YEAR_NS:
        return None
    return (
        f"warning: its times begin at {stamp_text(first_ns)}, in 1970, where a clock that was never set begins: days "
        "and trends are of that date; if it is wrong, import the times as numbers from 0 with the true --start"
    )


def repeated_hour_remark(first_ns: int, last_ns: int, zone: str) -> str | None:
    """A warning if local times without a zone lie where the end of summer time repeats them.

    The first pass is taken for them, so that what was written in the second is an hour early.

    >>> at = int(datetime(2026, 10, 25, 0, 30, tzinfo=UTC).timestamp()) * 10**9
    >>> repeated_hour_remark(at, at + 10**9, "UTC") is None, repeated_hour_remark(at, at + 10**9, "Europe/Berlin")[:66]
    (True, 'warning: the clocks of Europe/Berlin were set back at 2026-10-25 0')
    """
    for begin_ns, change_ns, local in _repeated_hours(first_ns, last_ns, zone):
        if first_ns < change_ns and last_ns >= begin_ns:
            return (
                f"warning: the clocks of {zone} were set back at {local}, and time stamps of the hour before name no "
                "zone: they are taken as of the first pass; write them with their offset, as +02:00"
            )
    return None


def repeated_hour_advice(late_ns: tuple[int, int] | None, late: int, zone: str) -> str:
    """What to do about rows that go back in time, of which the first and last are given, at the end of summer time.

    Empty where one of them lies in no hour that the clocks of the zone repeat.

    >>> at = int(datetime(2026, 10, 25, 0, 30, tzinfo=UTC).timestamp()) * 10**9
    >>> repeated_hour_advice((at, at + 10**9), 2, "Europe/Berlin")[:83]
    '2 rows go back in time where the clocks of Europe/Berlin were set back at 2026-10-2'
    >>> repeated_hour_advice((at, at + 3600 * 10**9), 2, "Europe/Berlin"), repeated_hour_advice(None, 0, "UTC")
    ('', '')
    """
    if late_ns is None:
        return ""
    for begin_ns, change_ns, local in _repeated_hours(*late_ns, zone):
        if begin_ns <= late_ns[0] and late_ns[1] < change_ns:
            which = "1 row goes" if late == 1 else f"{late} rows go"
            return (
                f"{which} back in time where the clocks of {zone} were set back at {local}: the hour before came "
                "twice, and time stamps without a zone do not say which pass they are of; write them in UTC, or with "
                "their offset, as +02:00, or leave the second pass out with --skip-bad"
            )
    return ""


def _repeated_hours(first_ns: int, last_ns: int, zone: str) -> Iterator[tuple[int, int, str]]:
    """Hours that clocks show twice: begin and end of the first pass, nanoseconds UTC, and the end in local time."""
    from zoneinfo import ZoneInfo

    place, first = ZoneInfo(zone), datetime.fromtimestamp(first_ns // 10**9, UTC)
    days = min((last_ns - first_ns) // _DAY_NS + 2, _MOST_DAYS)
    for day in range(-1, days):
        begin = first + timedelta(days=day)
        back = _offset(begin, place) - _offset(begin + timedelta(days=1), place)
        if back <= timedelta(0):
            continue
        hours = (begin + timedelta(minutes=minute) for minute in range(24 * 60 + 1))
        change = next(at for at in hours if _offset(at, place) != _offset(begin, place)).replace(
            second=0, microsecond=0
        )
        change_ns, back_ns = int(change.timestamp()) * 10**9, int(back.total_seconds()) * 10**9
        yield change_ns - back_ns, change_ns, (change + _offset(begin, place)).strftime("%Y-%m-%d %H:%M")


def coarse_times_remark(title: str, step_ns: int, dt_ns: int, signals: int, *, has_gaps: bool = False) -> str:
    """A warning that even samples have times rounded to steps of more than a quarter of their interval.

    Where there are gaps, nothing else is advised: even times would close them. Between one and two steps, samples every
    step of which some are missing evenly have the same times.

    >>> coarse_times_remark("time[s]", 7812500, 10**7, 1)[:86]
    "warning: column 'time[s]' is written in steps of 0.0078125 s, and samples of 1 signal "
    """
    even = "write them with more digits" if has_gaps else _evenly(title, f"{1e9 / dt_ns:.4g}")
    missing = ""
    if step_ns < dt_ns < 2 * step_ns:
        missing = (
            f"; samples every {step_ns / 1e9:.6g} s of which {1 - step_ns / dt_ns:.0%} are missing, evenly, have the "
            "same times"
        )
    which = "1 signal come" if signals == 1 else f"{signals} signals come"
    return (
        f"warning: column {title!r} is written in steps of {step_ns / 1e9:.6g} s, and samples of {which} every "
        f"{dt_ns / 1e9:.6g} s on average: their times are taken as they are, as irregular, and single losses are not "
        f"seen{missing}; {even}"
    )


def even_losses_remarks(signals: Sequence[SignalSummary], title: str = "") -> Iterator[str]:
    """Warnings on samples that are missing so evenly that their times may be rounded instead; with a table's column.

    Where another signal of the unit has samples at the times between, they are missing.
    """
    most: dict[tuple[str, str, int], int] = {}
    for each in signals:
        key = each.unit, each.run, each.sampling.dt_ns
        most[key] = max(most.get(key, 0), each.sampling.samples)
    alike = Counter(
        (each.sampling.dt_ns, each.sampling.even_dt_ns, _has_long_gaps(each.sampling))
        for each in signals
        if each.sampling.even_dt_ns and each.sampling.samples == most[each.unit, each.run, each.sampling.dt_ns]
    )
    for (dt_ns, even_ns, has_gaps), number in alike.items():
        which = "1 signal" if number == 1 else f"{number} signals"
        every, step = round(even_ns / (even_ns - dt_ns)), f"{dt_ns / 1e9:.6g} s"
        rounded, advice = "the log rounds its times", ""
        if title:
            rounded = f"column {title!r} is rounded"
            advice = "; if so, write them with more digits"
            if not has_gaps:  # even times would close them
                advice = f"; {_evenly(title, f'{1e9 / even_ns:.6g}')}"
        yield (
            f"warning: of {which} about one sample in {every} is missing, evenly, by times in whole steps of {step}; "
            f"samples every {even_ns / 1e9:.6g} s of which none is missing have the same times where {rounded} to "
            f"{step}: the times do not show which is true, and the samples are taken as missing{advice}"
        )


def _has_long_gaps(sampling: Sampling) -> bool:
    """Whether more than one sample is missing in any gap."""
    span_ns = sampling.t_last_ns - sampling.t_first_ns
    return round(span_ns / sampling.dt_ns) + 1 - sampling.samples > sampling.gaps


def rate_change_remarks(signals: Sequence[SignalSummary]) -> Iterator[str]:
    """Warnings on signals whose sample rate changes in the file, one for all that change alike."""
    alike: dict[tuple[str, str, tuple[RateChange, ...]], list[SignalSummary]] = {}
    for each in signals:
        alike.setdefault((each.unit, each.run, each.sampling.rate_changes), []).append(each)
    for (unit, run, changes), found in alike.items():
        if (remark := remark_on_rate_changes(changes)) is None:
            continue
        names = ", ".join(each.signal for each in found)
        sampling = found[0].sampling
        effect = (
            "it is taken as irregular, and its Allan deviation needs --resample" if sampling.irregular else
            f"what is computed of the run takes one sample every {sampling.dt_ns / 1e9:g} s, and the others as missing"
        )  # fmt: skip
        yield (
            f"warning: unit {unit}, run {run}, {names}: {remark[0]}; {effect}; to judge each rate by itself, import "
            "the parts as runs of their own"
        )


def repeated_times_advice(title: str, repeated: int, rows: int) -> str:
    """What to do about a file in which many rows have the time of the row before; empty where they are few.

    >>> repeated_times_advice("time[s]", 3, 100), repeated_times_advice("time[s]", 60, 100)[:50]
    ('', '60 of its 100 rows have the time of the row before')
    """
    if repeated < _MANY_REPEATED * rows:
        return ""
    return (
        f"{repeated} of its {rows} rows have the time of the row before: column {title!r} is written with too few "
        "digits (32-bit floats have seven), or the file has several units without a column 'unit'; "
        f"{_evenly(title, 'RATE_HZ')}"
    )


def _evenly(title: str, rate_hz: str) -> str:
    leave_out = shlex.quote(f"{title}=")
    return f"if they were taken evenly, --rename {leave_out} --sample-rate {rate_hz} places them so"


def _offset(at: datetime, place: "ZoneInfo") -> timedelta:
    return at.astimezone(place).utcoffset() or timedelta(0)
