"""The header of a table: what each column is, by the import contract.

``signal[unit]`` is a signal, ``time[s]`` (or another unit of time) the time; ``unit`` and ``run`` say whose
samples a row holds, the step words in which step it lies. Nothing else is accepted.
"""

import difflib
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from ingest.tables.steps import WORD_NAMES, WordColumn, word_column
from ingest.tables.times import MAX_NS, ns_per_unit
from stream.errors import BadInput
from stream.events import StepWords
from stream.identity import check_name
from stream.quantities import check_unit

_TITLE = re.compile(r"\s*([^\[\]]*?)\s*(?:\[([^\[\]]*)\])?\s*")
_LOOKS_LIKE_TIME = frozenset({"t", "time", "timestamp", "times", "epoch", "clock", "date", "datetime"})


@dataclass(frozen=True)
class TableOptions:
    """What the command line adds to a table.

    Parameters
    ----------
    unit, run: Whose samples these are, where no column says so. Without a run, it is named as the file is, less the
        suffix.
    start_ns: The run's start, nanoseconds UTC: added to times that count from it.
    sample_rate_hz: Sampling rate in Hz of a file without a time column.
    skip_bad: Leave bad rows out instead of refusing the file.
    batch_samples: Most samples in a batch.
    words: Words of a step that hold for all rows, where no column says them.

    Raises
    ------
    BadInput: If a number is outside its range.

    Examples
    --------
    >>> TableOptions(unit="FOG-0231").batch_samples
    1000
    """

    unit: str | None = None
    run: str | None = None
    start_ns: int | None = None
    sample_rate_hz: float | None = None
    skip_bad: bool = False
    batch_samples: int = 1000
    words: StepWords | None = None

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.sample_rate_hz is not None and not 1e-9 <= self.sample_rate_hz <= 1e9:
            raise BadInput(f"sample rate {self.sample_rate_hz!r} Hz: give a number from 1e-9 to 1e9")
        if self.start_ns is not None and not -MAX_NS <= self.start_ns <= MAX_NS:
            latest = datetime.fromtimestamp(math.floor(MAX_NS / 1e9), UTC)
            raise BadInput(f"start {self.start_ns} ns: give a moment before {latest:%Y-%m-%d} UTC")
        if self.batch_samples < 1:
            raise BadInput(f"batches of {self.batch_samples} samples: give at least 1")


@dataclass(frozen=True)
class SignalColumn:
    """A column of samples of the signal `name` in `unit_of_measure`."""

    title: str
    name: str
    unit_of_measure: str


@dataclass(frozen=True)
class TimeColumn:
    """The column of times, in units of `ns_per_unit` nanoseconds."""

    title: str
    ns_per_unit: int


@dataclass
class Columns:
    """What the columns of a table are; `unit` and `run` are titles of columns, where there are such."""

    signals: list[SignalColumn] = field(default_factory=list)
    time: TimeColumn | None = None
    unit: str | None = None
    run: str | None = None
    words: list[WordColumn] = field(default_factory=list)

    @property
    def text_titles(self) -> list[str]:
        """Titles of the columns that are read as text: unit, run and step words."""
        return [title for title in (self.unit, self.run) if title is not None] + [word.title for word in self.words]


def read_header(path: Path, titles: Sequence[str], options: TableOptions) -> Columns:
    """Say what the columns with `titles` are.

    Raises
    ------
    BadInput: If a title does not keep the contract, or something is missing or given twice.

    Examples
    --------
    >>> columns = read_header(Path("a.csv"), ["time[s]", "rate[deg/s]", "unit"], TableOptions())
    >>> columns.signals
    [SignalColumn(title='rate[deg/s]', name='rate', unit_of_measure='deg/s')]
    """
    columns = Columns()
    try:
        _refuse_repeated("column", titles)
        for number, title in enumerate(titles, 1):
            _add(columns, title, number)
        _refuse_repeated("signal", [signal.name for signal in columns.signals])
        _refuse_repeated("column", [word.word for word in columns.words])
        _check_complete(columns, titles, options)
    except BadInput as error:
        raise type(error)(f"{path}: {error}") from error
    return columns


def _refuse_repeated(kind: str, names: Sequence[str]) -> None:
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise BadInput(f"{kind} {repeated[0]!r} stands in the header more than once; remove or rename one")


def _add(columns: Columns, title: str, number: int) -> None:
    match = _TITLE.fullmatch(title)
    name, unit = (match[1], match[2]) if match else (title.strip(), None)
    if not title.strip():
        raise BadInput(f"column {number} has no title; name it like 'rate[deg/s]' or remove it")
    if name == "time":
        _add_time(columns, title, unit)
    elif name in {"unit", "run"}:
        _add_owner(columns, title, name, unit)
    elif name in WORD_NAMES:
        columns.words.append(word_column(title, name, unit))
    elif unit is None or not name:
        raise BadInput(_how_to_name(title, name, match is not None))
    else:
        try:
            columns.signals.append(SignalColumn(title, check_name("signal", name), check_unit(unit.strip())))
        except BadInput as error:
            raise type(error)(f"column {title!r}: {error}") from error


def _add_time(columns: Columns, title: str, unit: str | None) -> None:
    if columns.time is not None:
        raise BadInput(f"columns {columns.time.title!r} and {title!r} are both times; keep one")
    if unit is None:
        raise BadInput(f"column {title!r} has no unit; name it 'time[s]' or 'time[ns]'")
    try:
        columns.time = TimeColumn(title, ns_per_unit(unit.strip()))
    except BadInput as error:
        raise type(error)(f"column {title!r}: {error}; name it 'time[s]' or 'time[ns]'") from error


def _add_owner(columns: Columns, title: str, name: str, unit: str | None) -> None:
    if unit is not None:
        raise BadInput(f"column {title!r} holds names and takes no unit; name it {name!r}")
    if getattr(columns, name) is not None:
        raise BadInput(f"columns {getattr(columns, name)!r} and {title!r} both say the {name}; keep one")
    setattr(columns, name, title)


def _how_to_name(title: str, name: str, is_readable: bool) -> str:
    if not is_readable or not name:
        return f"column {title!r} cannot be read; name it like 'rate[deg/s]'"
    if _is_number(name):
        return f"column {title!r} is a number: the first line must be the header, like 'time[s],rate[deg/s]'"
    if name.lower() in _LOOKS_LIKE_TIME:
        return f"column {title!r} has no unit; if it is the time, give it in seconds and name it 'time[s]'"
    near = difflib.get_close_matches(name.lower(), [*WORD_NAMES, "unit", "run"], n=1, cutoff=0.8)
    hint = f" (or did you mean {near[0]!r}?)" if near else ""
    return f"column {title!r} has no unit; name it like '{name}[deg/s]', or '{name}[1]' if it has none{hint}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _check_complete(columns: Columns, titles: Sequence[str], options: TableOptions) -> None:
    if not columns.signals:
        raise BadInput("no column holds a signal; name at least one like 'rate[deg/s]'")
    if columns.time is None and options.sample_rate_hz is None:
        near = [title for title in titles if title.partition("[")[0].strip().lower() in _LOOKS_LIKE_TIME]
        hint = f" ({near[0]!r} is not it: rename it)" if near else ""
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
