"""Times of a table: from cells to int64 nanoseconds, exactly rounded, and onto the run's clock."""

import re
from datetime import UTC, datetime, timedelta
from decimal import ROUND_HALF_EVEN, Context, Decimal, InvalidOperation
from typing import Any

import numpy as np
import pyarrow as pa

from stream.batch import BoolArray, FloatArray, IntArray
from stream.errors import BadInput
from stream.quantities import conversion

MAX_NS = 2**62
UTC_FROM_NS = 10**17
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
STAMP = re.compile(
    r"(?P<date>\d{4}-\d\d-\d\d)(?:[T ](?P<time>\d\d:\d\d(?::\d\d)?)(?:(?<=:\d\d:\d\d)[.,](?P<fraction>\d+))?"
    r"\s?(?P<zone>Z|[+-]\d\d(?::?\d\d)?)?)?",
    re.ASCII,
)

# year first, as programs in China and Japan write it, or with single digits
_YEAR_FIRST = re.compile(
    r"(\d{4})(?:[-/.](\d{1,2})[-/.](\d{1,2})|年\s?(\d{1,2})月\s?(\d{1,2})日)(?:[T\s]?\s*(上午|下午)?\s*"
    r"(\d{1,2})[:时](\d{1,2})(?:[:分](?:(\d{1,2})([.,]\d+)?)?秒?)?\s?(Z|[+-]\d\d(?::?\d\d)?)?)?",
    re.ASCII,
)
_LOOSE_DATE = re.compile(r"\d{4}(?:/|-\d-|-\d\d-\d(?!\d)|-\d\d-\d\d[T ]\d:)", re.ASCII)

_NS_PER_S = 10**9
_MOST_DIGITS = 40
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# Arrow applies no daylight-saving time from then on
_FIRST_YEAR_WITHOUT_RULES = 2038
_PLAIN_STAMP = r"^\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d{1,9})?)?"
_ZONE = r"(Z|[+-]\d\d(:?\d\d)?)$"


def ns_per_unit(unit: str) -> int:
    """Nanoseconds in one `unit` of time."""
    factor, _ = conversion(unit, "ns")
    if factor < 1 or factor != int(factor):
        raise BadInput(f"unit of time {unit!r} is no whole number of nanoseconds; use s or ns")
    return int(factor)


def decimal_places(ns: int) -> int | None:
    """Decimal places that a number of units of `ns` nanoseconds needs; None if `ns` is no power of ten."""
    places = len(str(ns)) - 1
    return places if ns == 10**places and places <= 9 else None


def ns_from_floats(times: FloatArray, ns: int) -> tuple[IntArray, BoolArray]:
    """Nanoseconds nearest to `times` in units of `ns` nanoseconds; and which are out of range or not finite.

    The whole part is split off first: it is exact, so that only the fraction is rounded.
    """
    with np.errstate(invalid="ignore"):
        wrong = ~(np.abs(times) <= MAX_NS / ns)
    if wrong.any():
        times = np.where(wrong, 0.0, times)
    whole = np.floor(times)
    fraction = np.rint((times - whole) * ns)
    return whole.astype(np.int64) * ns + fraction.astype(np.int64), wrong


def ns_from_integers(times: IntArray, ns: int) -> tuple[IntArray, BoolArray]:
    """Nanoseconds in `times` in units of `ns` nanoseconds, and which of them are out of range."""
    limit = MAX_NS // ns
    wrong = (times > limit) | (times < -limit)
    return (np.where(wrong, 0, times) if wrong.any() else times) * ns, wrong


def ns_from_decimals(times: pa.Array, places: int) -> tuple[IntArray, BoolArray]:
    """Nearest nanosecond to decimal `times` in units of 10**`places` ns, and which are out of range.

    A decimal of scale `places` is the number of nanoseconds itself, in 128 bits.
    """
    if times.type != pa.decimal128(38, places):
        import pyarrow.compute as pc

        wide = times.cast(pa.decimal128(38, max(times.type.scale, places)))
        times = pc.round(wide, places, "half_to_even").cast(pa.decimal128(38, places))
    words = np.frombuffer(times.buffers()[1], np.int64).reshape(-1, 2)[times.offset : times.offset + len(times)]
    low, high = words[:, 0], words[:, 1]
    wrong = (high != low >> 63) | (low > MAX_NS) | (low < -MAX_NS)
    return np.ascontiguousarray(low), wrong


def ns_from_text(text: str, ns: int) -> int | None:
    """Nanosecond nearest to the number in `text`, in units of `ns` nanoseconds; None if out of range.

    >>> ns_from_text("1763683200.0100000005", 10**9)
    1763683200010000000
    """
    places = decimal_places(ns)
    if places is None:
        array, wrong = ns_from_floats(np.array([float(text)]), ns)
        return None if wrong[0] else int(array[0])
    try:
        number = Decimal(text)
    except InvalidOperation:  # an exponent that no number has
        return None
    if number.adjusted() > _MOST_DIGITS:
        return None
    if number.adjusted() < -_MOST_DIGITS:
        return 0
    context = Context(prec=len(text) + 2 * _MOST_DIGITS, rounding=ROUND_HALF_EVEN)
    nearest = int(context.to_integral_value(context.scaleb(number, places)))
    return nearest if abs(nearest) <= MAX_NS else None


def match_stamp(text: str) -> re.Match[str] | None:
    """The parts of a time stamp in ISO 8601, or with another year-first date; None if it is none.

    >>> [match_stamp(each)[0] for each in ("2026/1/8 9:05:03.5", "2026年11月8日 下午1时05分", "2026-11-21T10:00Z")]
    ['2026-01-08T09:05:03.5', '2026-11-08T13:05', '2026-11-21T10:00Z']
    """
    if (found := STAMP.fullmatch(text)) is not None:
        return found
    written = _YEAR_FIRST.fullmatch(text)
    if written is None:
        return None
    year, month, day, month_zh, day_zh, half, hour, minute, second, fraction, zone = written.groups()
    date = f"{year}-{month or month_zh:0>2}-{day or day_zh:0>2}"
    if hour is None:
        return STAMP.fullmatch(date)
    of_day = int(hour)
    if half is not None:
        if not 1 <= of_day <= 12:
            return None
        of_day = of_day % 12 + 12 * (half == "下午")
    seconds = "" if second is None else f":{second:0>2}{fraction or ''}"
    return STAMP.fullmatch(f"{date}T{of_day:02d}:{minute:0>2}{seconds}{zone or ''}")


def ns_from_stamp(text: str, zone: str) -> int | None:
    """Nanoseconds UTC of a time stamp, in `zone` if it names none; None if it is no moment.

    >>> ns_from_stamp("2026-11-21 18:00:00.5", "Asia/Shanghai"), ns_from_stamp("2026-11-21T10:00:00,5Z", "UTC")
    (1795255200500000000, 1795255200500000000)
    """
    match = match_stamp(text)
    if match is None:
        return None
    from zoneinfo import ZoneInfo

    try:
        moment = datetime.fromisoformat(f"{match['date']}T{match['time'] or '00:00'}{match['zone'] or ''}")
        if moment.tzinfo is None:
            written, moment = moment, moment.replace(tzinfo=ZoneInfo(zone))
            if moment.astimezone(UTC).astimezone(ZoneInfo(zone)).replace(tzinfo=None) != written:
                return None  # the clock was set forward over it
        whole_s = (moment.astimezone(UTC) - _EPOCH) // timedelta(seconds=1)
    except (ValueError, OverflowError):
        return None
    fraction = Decimal("0." + (match["fraction"] or "0")[:_MOST_DIGITS]).scaleb(9, Context(prec=2 * _MOST_DIGITS))
    found = whole_s * _NS_PER_S + int(fraction.to_integral_value(ROUND_HALF_EVEN))
    return found if abs(found) <= MAX_NS else None


def numpy_of(numbers: pa.Array) -> Any:
    """Numbers without nulls as an array of NumPy; their own `to_numpy` imports pandas where that is installed."""
    return np.from_dlpack(numbers)


def ns_from_stamps(cells: pa.Array, zone: str) -> IntArray | None:
    """`ns_from_stamp` of many cells at once; None if one of them must be read by itself."""
    import pyarrow.compute as pc

    cells = pc.replace_substring_regex(pc.utf8_trim(cells, " \t"), r"\s([Z+-])", r"\1")
    cells = pc.replace_substring(cells, ",", ".")
    ends = (cells[0], cells[-1]) if len(cells) else ()
    if any(_LOOSE_DATE.match(each.as_py() or "") for each in ends):
        cells = _with_dashes(cells)
    try:
        if pc.all(pc.match_substring_regex(cells, _PLAIN_STAMP + _ZONE)).as_py():
            found = cells.cast(pa.timestamp("ns", "UTC"))
        elif pc.all(pc.match_substring_regex(cells, _PLAIN_STAMP + "$")).as_py():
            local = cells.cast(pa.timestamp("ns"))
            if pc.any(pc.greater_equal(pc.year(local), _FIRST_YEAR_WITHOUT_RULES)).as_py():
                return None
            found = pc.assume_timezone(local, zone, ambiguous="earliest")
        else:
            return None
    except pa.ArrowInvalid:
        return None
    times_ns = numpy_of(found.cast(pa.int64()))
    return None if (np.abs(times_ns) > MAX_NS).any() else times_ns


def _with_dashes(cells: pa.Array) -> pa.Array:
    """Stamps like 2026/1/8 9:05:03 as 2026-01-08 09:05:03."""
    import pyarrow.compute as pc

    for pattern, by in (
        (r"^(\d{4})/(\d{1,2})/(\d{1,2})", r"\1-\2-\3"), (r"^(\d{4})-(\d)-", r"\1-0\2-"),
        (r"^(\d{4}-\d\d)-(\d)([T ]|$)", r"\1-0\2\3"), (r"([T ])(\d):", r"\10\2:"),
    ):  # fmt: skip
        cells = pc.replace_substring_regex(cells, pattern, by)
    return cells


def ns_from_timestamps(times: pa.Array, zone: str) -> tuple[IntArray, BoolArray]:
    """Nanoseconds UTC of Arrow's time stamps without nulls, in `zone` if they have none; and which are out of range."""
    import pyarrow.compute as pc

    written, ns = times, {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}[times.type.unit]
    if times.type.tz is None:
        times = pc.assume_timezone(times, zone, ambiguous="earliest", nonexistent="latest")
    times_ns, wrong = ns_from_integers(numpy_of(times.cast(pa.int64())), ns)
    if written is not times:  # the clock was set forward over a time that does not exist
        wrong = wrong | pc.not_equal(pc.local_timestamp(times), written).to_numpy(zero_copy_only=False)
    return times_ns, wrong


def ns_from_index(index: IntArray, rate_hz: float) -> IntArray:
    """Times of samples `index` = 0, 1, 2, ... at `rate_hz`, nanoseconds."""
    whole_s, rest = np.divmod(index.astype(np.float64), rate_hz)
    return whole_s.astype(np.int64) * _NS_PER_S + np.rint(rest / rate_hz * _NS_PER_S).astype(np.int64)


def seconds_text(ns: int) -> str:
    """`ns` nanoseconds in seconds with all digits, for messages.

    >>> seconds_text(-1_500_000_000), seconds_text(0)
    ('-1.5 s', '0 s')
    """
    whole, fraction = divmod(abs(ns), _NS_PER_S)
    digits = f"{whole}.{fraction:09d}".rstrip("0").rstrip(".")
    return f"{'-' if ns < 0 else ''}{digits} s"


def stamp_text(ns: int) -> str:
    """A moment, `ns` nanoseconds UTC, in digits down to its own, for messages.

    >>> stamp_text(1_795_255_200_500_000_000), stamp_text(1_795_255_200_000_000_000)
    ('2026-11-21T10:00:00.5Z', '2026-11-21T10:00:00Z')
    """
    whole, _, fraction = str(np.datetime64(ns, "ns")).partition(".")
    return f"{whole}.{fraction}".rstrip("0").rstrip(".") + "Z"


class RunClock:
    """Whether a file's times are UTC or count from the run's start `start_ns`; the first good one decides.

    Time stamps (`is_stamps`) are UTC whatever their year, durations (`is_durations`) never; numbers are from 1973-03-03
    on, 1e8 s after 1970.
    """

    def __init__(self, start_ns: int | None, *, is_stamps: bool = False, is_durations: bool = False) -> None:
        self._start_ns, self._is_stamps, self._is_durations = start_ns, is_stamps, is_durations
        self._first_ns = 0
        self.is_utc: bool | None = None

    @property
    def date_known(self) -> bool:
        """Whether the times are UTC once they are on the run's clock."""
        return bool(self.is_utc) or self._start_ns is not None

    def settle(self, first_ns: int) -> None:
        """Decide by the time `first_ns`, as written; raises BadInput if it is UTC and a start is given as well."""
        self.is_utc = self._is_stamps or (not self._is_durations and first_ns >= UTC_FROM_NS)
        self._first_ns = first_ns
        if self.is_utc and self._start_ns is not None:
            first = stamp_text(first_ns) if self._is_stamps else f"{seconds_text(first_ns)} from 1970"
            raise BadInput(f"the times are UTC already (the first is {first}): leave out --start")

    def misplaced(self, times_ns: IntArray) -> BoolArray:
        """Which of the times, as written, are of the other kind than the first; of stamps, years away from it."""
        if self._is_stamps:
            return np.abs(times_ns - self._first_ns) >= UTC_FROM_NS
        if self._is_durations:
            return np.zeros(times_ns.shape, np.bool_)
        return (times_ns < UTC_FROM_NS) if self.is_utc else (times_ns >= UTC_FROM_NS)

    @property
    def expected(self) -> str:
        """What the times are expected to be, by the first one."""
        if self._is_stamps:
            return f"a time within 3 years of the first one, {stamp_text(self._first_ns)}"
        if self.is_utc:
            return "UTC, as the first time of the file: 1e8 s or more after 1970"
        return "below 1e8 s, as the first time: it counts from the start of the run"

    def as_written(self, time_ns: int) -> int:
        """A time on the run's clock as the file has it."""
        return time_ns - (self._start_ns or 0)

    def place(self, times_ns: IntArray) -> IntArray:
        """Put times, as written, onto the run's clock."""
        return times_ns if self._start_ns is None else times_ns + self._start_ns
