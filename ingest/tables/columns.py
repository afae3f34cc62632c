"""The header of a table: the meaning of each column.

``signal[unit]`` is a signal, ``time[s]`` (or another unit of time) the time; ``unit`` and ``run`` say whose samples a
row holds, the step words in which step it lies. Titles of other programs, ``Gyro X (deg/s)``, ``Gyro X [deg/s]``,
``Time (s)``, are understood: blanks in such a name become ``_``, and it is then written in lower case.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from ingest.tables.rows import Room
from ingest.tables.steps import WORD_NAMES, WordColumn, word_column
from ingest.tables.times import MAX_NS, ns_per_unit
from ingest.tables.timing.dated_clocks import DatedClock, find_dated_clock, why_no_moment
from ingest.tables.timing.plain_times import excel_days, what_times_hold
from ingest.tables.titles import (
    SQUARE,
    how_to_name,
    is_misread_unit,
    is_time_name,
    is_usable,
    no_samples,
    plain_letters,
    title_parts,
    usable_name,
)
from ingest.tables.units import column_unit, is_temperature, time_unit
from stream.channel_names import STANDARD_CHANNELS
from stream.errors import BadInput
from stream.events import StepWords
from stream.identity import check_name

_STAMP_UNITS = frozenset({"iso", "iso8601", "utc", "datetime", "date"})
_TEMPERATURE = re.compile(r"(?i)t|temp|temperature?|gyro_?temp(erature)?|(?P<metrics>(陀螺仪?|产品)?温度)")
_LARGE_SECONDS = re.compile("[MG]s(ec)?")  # megaseconds, where milliseconds are meant
_S_NS, _DAY_NS = 10**9, 86_400 * 10**9
_MOST_PROBLEMS = 8  # in one error


@dataclass(frozen=True)
class TableOptions:
    """What the command line adds to a table; raises BadInput if a number is outside its range."""

    unit: str | None = None  # whose samples these are, if no column says so
    run: str | None = None  # likewise; by default the file's name without suffix
    start_ns: int | None = None  # the run's start, nanoseconds UTC: added to times that count from it
    sample_rate_hz: float | None = None  # sampling rate in Hz of a file without a time column
    skip_bad: bool = False  # leave bad rows out instead of refusing the file
    batch_samples: int | None = None  # most samples in a batch; by default as `usual_batch_samples`
    words: StepWords | None = None  # step words of all rows, if no column has them
    renames: tuple[tuple[str, str], ...] = ()  # a column's title or name, and another: ``gyro_x``, ``gyro_x[deg/s]``
    time_zone: str | None = None  # of time stamps that name none
    room: Room = field(default_factory=Room, compare=False)  # for small files between the two passes over them

    def __post_init__(self) -> None:
        if self.sample_rate_hz is not None and not 1e-9 <= self.sample_rate_hz <= 1e9:
            raise BadInput(f"sample rate {self.sample_rate_hz!r} Hz: give a number from 1e-9 to 1e9")
        if self.start_ns is not None and not -MAX_NS <= self.start_ns <= MAX_NS:
            first, last = (datetime.fromtimestamp(math.floor(end / 1e9), UTC) for end in (-MAX_NS, MAX_NS))
            sound = f"give a moment from {first:%Y-%m-%d} to {last:%Y-%m-%d}"
            raise BadInput(f"start {self.start_ns / 1e9:.0f} s from 1970: {sound}")
        if self.batch_samples is not None and self.batch_samples < 1:
            raise BadInput(f"batches of {self.batch_samples} samples: give at least 1")


@dataclass(frozen=True)
class SignalColumn:
    """A column of samples of the signal `name` in `unit_of_measure`."""

    title: str
    name: str
    unit_of_measure: str


@dataclass(frozen=True)
class TimeColumn:
    """The column of times: numbers of `ns_per_unit` nanoseconds, or of a type of time stamps or of durations.

    With `date_title`, its time stamps are times of day whose date that column has.
    """

    title: str
    ns_per_unit: int
    is_stamp: bool = False
    is_duration: bool = False
    date_title: str | None = None


@dataclass
class Columns:
    """Meaning of the columns of a table; `unit` and `run` are titles of columns."""

    signals: list[SignalColumn] = field(default_factory=list)
    time: TimeColumn | None = None
    unit: str | None = None
    run: str | None = None
    words: list[WordColumn] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    blank: list[str] = field(default_factory=list)

    @property
    def text_titles(self) -> list[str]:
        """Titles of the columns that are read as text: unit, run and step words."""
        return [title for title in (self.unit, self.run) if title is not None] + [word.title for word in self.words]

    @property
    def numeric_titles(self) -> list[str]:
        """Titles of the columns that are read as numbers: signals, and times that are no time stamps."""
        times = [self.time.title] if self.time is not None and not self.time.is_stamp else []
        return [signal.title for signal in self.signals] + times


def read_header(
    path: Path,
    titles: Sequence[str],
    options: TableOptions,
    stamps: Collection[str] = (),
    durations: Mapping[str, str] | None = None,
    unsuited: Mapping[str, str] | None = None,
    first: Mapping[str, str] | None = None,
    sample: Callable[[str], Sequence[str]] = lambda _: (),
    blank: Collection[str] = (),
) -> Columns:
    """Find the meaning of columns; raises BadInput if titles break the contract.

    `stamps` are titles of columns of time stamps, `durations` of columns of durations, with the unit of each;
    `unsuited` of columns that are neither times nor numbers, with what they hold; `first` are the first cells of a text
    table, `sample` gives the first cells of one of its columns;
    `blank` are names of columns without title and cells.
    """
    try:
        _refuse_repeated("column", [title for title in titles if title.strip()])
        reader = _HeaderReader(titles, options, stamps, durations or {}, unsuited or {}, first or {}, sample)
        reader.columns.blank.extend(blank)
        _add_all(reader, titles)
        columns = reader.columns
        _refuse_repeated_signals(columns.signals)
        _refuse_repeated("column", [word.word for word in columns.words])
        _check_complete(columns, titles, options)
    except BadInput as error:
        raise type(error)(f"{path}: {error}") from error
    return columns


def _add_all(reader: "_HeaderReader", titles: Sequence[str]) -> None:
    """Read every title, and report all that cannot be read in one error."""
    problems: list[BadInput] = []
    for number, title in enumerate(titles, 1):
        try:
            reader.add(title, number)
        except BadInput as error:
            problems.append(error)
    if problems:
        texts = [str(error) for error in problems[:_MOST_PROBLEMS]]
        if more := len(problems) - len(texts):
            texts.append(f"and {more} more columns")
        raise type(problems[0])("; ".join(texts))


def _refuse_repeated(kind: str, names: Sequence[str]) -> None:
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        raise BadInput(f"{kind} {repeated[0]!r} stands in the header more than once; remove or rename one")


def _refuse_repeated_signals(signals: Sequence[SignalColumn]) -> None:
    for name, count in Counter(signal.name for signal in signals).items():
        if count > 1:
            first, second = [signal.title for signal in signals if signal.name == name][:2]
            raise BadInput(
                f"signal {name!r} stands in the header more than once, as {first!r} and {second!r}; give one another "
                f"name: --rename '{second}=NAME'"
            )


class _HeaderReader:
    def __init__(
        self, titles: Sequence[str], options: TableOptions, stamps: Collection[str], durations: Mapping[str, str],
        unsuited: Mapping[str, str], first: Mapping[str, str], sample: Callable[[str], Sequence[str]],
    ) -> None:  # fmt: skip
        self.columns = Columns()
        self._first, self._sample = first, sample
        self._stamps, self._durations, self._unsuited = stamps, durations, unsuited
        self._renames: dict[str, str] = {}
        for old, new in options.renames:
            found = [title for title in titles if old in {title, title_parts(title)[0]}]
            if len(found) != 1:
                many = f"{len(found)} columns are called so" if found else f"the columns are {', '.join(titles)}"
                raise BadInput(f"--rename {old!r}: {many}; give the title of one column")
            if self._renames.get(found[0], new) != new:
                raise BadInput(f"--rename {old!r}: given twice, as {self._renames[found[0]]!r} and {new!r}; give one")
            self._renames[found[0]] = new
        names = {title: title_parts(self._renames.get(title, title))[0] for title in titles}
        self._dated_clock = find_dated_clock(names, first)
        # of `Time [s]`; beside others that may be the time, nobody knows
        times = [title for title in titles if is_time_name(title_parts(title)[0])]
        self._only_time = times[0] if len(times) == 1 and not options.sample_rate_hz else None

    def add(self, title: str, number: int) -> None:
        if not title.strip():
            raise BadInput(f"column {number} has no title; {SQUARE} or remove it")
        if (why := self._why_left_out(title, number)) is not None:
            self.columns.remarks.append(why)
            return
        if self._dated_clock is not None and title in self._dated_clock:
            self._add_dated_clock(title, self._dated_clock)
            return
        name, unit, is_foreign = title_parts(title)
        if title in self._renames:
            name, new_unit, _ = title_parts(self._renames[title])
            if None not in (unit, new_unit) and unit != new_unit:
                self.columns.remarks.append(
                    f"warning: column {title!r}: its numbers are taken as {new_unit}, as --rename says, and are not "
                    f"converted from {unit}"
                )
            unit, is_foreign = unit if new_unit is None else new_unit, False
            unit = None if name in {"unit", "run"} | WORD_NAMES and new_unit is None else unit
        is_time = is_time_name(name)
        is_stamp = title in self._stamps
        is_typed = is_stamp or title in self._durations
        lacking = None if name in {"unit", "run"} | WORD_NAMES else why_no_moment(self._first.get(title, ""))
        if lacking is not None:
            raise BadInput(self._not_as_moment(title, lacking))
        if name == "time" or (
            is_time and (is_typed or ((is_foreign or title == self._only_time) and _is_of_time(unit)))
        ):
            self._add_time(title, unit, is_stamp=is_stamp, is_foreign=is_foreign)
        elif name in {"unit", "run"}:
            self._add_owner(title, name, unit)
        elif name in WORD_NAMES:
            self.columns.words.append(word_column(title, name, unit))
        elif title in self._unsuited:
            raise BadInput(self._not_suited(title, is_time=is_time))
        elif unit is None or not name:
            held = "time stamps" if is_stamp else "durations" if is_typed else ""
            found = what_times_hold(title, self._sample(title)) if is_time and not held else None
            raise BadInput(how_to_name(title, name, held) if found is None else self._holds(title, found))
        else:
            self._add_signal(title, name, unit, is_foreign=is_foreign)

    def _why_left_out(self, title: str, number: int) -> str | None:
        """Why a column is no part of the import, if so."""
        if self._renames.get(title) == "":
            return f"column {title!r} is left out, as --rename says"
        if title in self.columns.blank:
            return f"column {number} has no title and no cells: it is left out"
        name, unit, _ = title_parts(title)
        why = no_samples(name, lambda: self._sample(title)) if title not in self._renames and unit is None else None
        return None if why is None else f"column {title!r} {why}: it is left out"

    def _add_dated_clock(self, title: str, found: DatedClock) -> None:
        lacking = why_no_moment(self._first[title], has_date=True)
        if lacking is not None:
            raise BadInput(self._not_as_moment(title, lacking))
        if title == found.date:
            return  # with the column of times of day
        if self.columns.time is not None:
            raise BadInput(f"columns {self.columns.time.title!r} and {title!r} are both times; keep one")
        self.columns.time = TimeColumn(title, 1, is_stamp=True, date_title=found.date)
        self.columns.remarks.append(f"the times are columns {found.date!r} and {found.clock!r} together")

    def _add_time(self, title: str, unit: str | None, *, is_stamp: bool, is_foreign: bool) -> None:
        if self.columns.time is not None:
            raise BadInput(f"columns {self.columns.time.title!r} and {title!r} are both times; keep one")
        if title in self._unsuited:
            raise BadInput(self._not_suited(title, is_time=True))
        if is_stamp:
            self.columns.time = TimeColumn(title, 1, is_stamp=True)
            if unit is not None and plain_letters(unit) not in _STAMP_UNITS and not is_foreign:
                self.columns.remarks.append(f"column {title!r} holds time stamps; its unit [{unit}] is ignored")
            return
        if (own := self._durations.get(title)) is not None:
            self.columns.time = TimeColumn(title, ns_per_unit(own), is_duration=True)
            if unit is not None and time_unit(unit) != own:
                self.columns.remarks.append(f"column {title!r} holds durations, in {own}; its unit [{unit}] is ignored")
            return
        self.columns.time = self._numbers_of_time(title, unit)

    def _numbers_of_time(self, title: str, unit: str | None) -> TimeColumn:
        if unit is None:
            if (found := what_times_hold(title, self._sample(title))) is not None:
                raise BadInput(self._holds(title, found))
            raise BadInput(f"column {title!r} has no unit; name it 'time[s]' or 'time[ns]'")
        if _LARGE_SECONDS.fullmatch(unit.strip()):
            raise BadInput(f"column {title!r}: {unit.strip()} are 1e6 or 1e9 seconds; write 'ms', or 's'")
        if plain_letters(unit) in _STAMP_UNITS:
            raise BadInput(f"column {title!r} begins with no time stamp, like 2026-11-21T18:00:00.5Z")
        try:
            ns = ns_per_unit(time_unit(unit))
        except BadInput as error:
            raise type(error)(f"column {title!r}: {error}; name it 'time[s]' or 'time[ns]'") from error
        if ns in (_S_NS, _DAY_NS):
            first = self._first.get(title, "")
            found = excel_days(first, lambda: self._sample(title), in_days=ns == _DAY_NS)
            if found is not None:
                raise BadInput(self._not_as_moment(title, found))
        return TimeColumn(title, ns)

    @staticmethod
    def _holds(title: str, found: str) -> str:
        return f"column {title!r} has no unit, and holds {found}; to leave it out: --rename '{title}='"

    @staticmethod
    def _not_as_moment(title: str, lacking: str) -> str:
        leave_out = f"leave it out: --rename '{title}=' (without times give --sample-rate)"
        return f"column {title!r} holds {lacking}; or {leave_out}"

    def _not_suited(self, title: str, *, is_time: bool) -> str:
        holds, leave_out = f"column {title!r} holds {self._unsuited[title]}", f"leave it out: --rename '{title}='"
        if is_time:
            dated = "time stamps with a date, as durations since the start, or as numbers, 'time[s]'"
            return f"{holds}; write times as {dated}, or {leave_out} (without times give --sample-rate)"
        return f"{holds}, expected numbers; convert it, or {leave_out}"

    def _add_owner(self, title: str, name: str, unit: str | None) -> None:
        if unit is not None:
            raise BadInput(f"column {title!r} holds names and takes no unit; name it {name!r}")
        if (other := getattr(self.columns, name)) is not None:
            raise BadInput(f"columns {other!r} and {title!r} both say the {name}; keep one")
        setattr(self.columns, name, title)

    def _add_signal(self, title: str, name: str, unit: str, *, is_foreign: bool) -> None:
        if is_foreign and is_misread_unit(title, name, unit):
            raise BadInput(
                f"column {title!r} reads as {name!r} in {unit}, a unit of time, and is no time: give its unit, as "
                f"--rename '{title}={usable_name(name)}[deg/h]', or leave it out: --rename '{title}='"
            )
        is_foreign = is_foreign or re.search(r"\s", name) is not None
        signal = re.sub(r"[\s/*$?#]+", "_", name).strip("_.@").lower() if is_foreign else name
        is_standard = name.lower() in STANDARD_CHANNELS and name not in STANDARD_CHANNELS and title not in self._renames
        signal = name.lower() if is_standard else signal
        try:
            if is_standard or (is_foreign and name != signal and not is_usable(name)):
                self.columns.remarks.append(f"column {title!r} is signal {check_name('signal', signal)}")
            else:
                signal = check_name("signal", name)
            measure, remark = column_unit(unit, signal)
        except BadInput as error:
            hint = "" if is_usable(name) else f"; or give --rename '{title}={usable_name(name)}'"
            raise type(error)(f"column {title!r}: {error}{hint}") from error
        if remark:
            is_warning = remark.startswith("warning: ")
            text = f"column {title!r}: {remark.removeprefix('warning: ')}"
            self.columns.remarks.append(f"warning: {text}" if is_warning else text)
        named = _TEMPERATURE.fullmatch(signal)
        if named is not None and signal != "temperature" and is_temperature(measure):
            who = "metrics and error models look" if named["metrics"] is None else "error models, not metrics, look"
            self.columns.remarks.append(
                f"warning: column {title!r}: {who} for the unit's temperature under the name temperature: give "
                f"--rename '{title}=temperature' if it is that"
            )
        self.columns.signals.append(SignalColumn(title, signal, measure))


def _is_of_time(unit: str | None) -> bool:
    try:
        return unit is not None and (plain_letters(unit) in _STAMP_UNITS or ns_per_unit(time_unit(unit)) > 0)
    except BadInput:
        return False


def _check_complete(columns: Columns, titles: Sequence[str], options: TableOptions) -> None:
    if not columns.signals:
        raise BadInput("no column holds a signal; name at least one like 'rate[deg/s]'")
    if columns.time is None and options.sample_rate_hz is None:
        near = [title for title in titles if is_time_name(title_parts(title)[0]) or _is_of_time(title_parts(title)[1])]
        hint = f" ({near[0]!r} is not it: rename it, as with --rename '{near[0]}=time')" if near else ""
        raise BadInput(f"no column 'time[s]' or 'time[ns]'{hint}; add one, or give --sample-rate")
    if columns.time is not None and options.sample_rate_hz is not None:
        raise BadInput(f"--sample-rate is given, but column {columns.time.title!r} says the times; leave out one")
    for kind in ("unit", "run"):
        if getattr(options, kind) is not None and getattr(columns, kind) is not None:
            raise BadInput(f"--{kind} is given, but a column {kind!r} says it too; leave out one")
    given = set() if options.words is None else set(msgspec.to_builtins(options.words))
    for column in columns.words:
        if column.word in given:
            raise BadInput(f"--{column.word} is given, but a column {column.title!r} says it too; leave out one")
    if columns.unit is None and options.unit is None:
        raise BadInput("which unit? give --unit U or a column 'unit'")
