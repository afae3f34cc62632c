"""Steps of a run, from the step words beside its samples."""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from uuid import NAMESPACE_URL, uuid5

import msgspec

from ingest.tables.times import NUMBER
from stream.errors import BadInput
from stream.events import StepEnded, StepStarted, StepWords
from stream.quantities import check_unit, conversion, is_angular_rate

_TEXT_WORDS = frozenset({"procedure", "step", "position", "axis", "phase"})
# Title in a file -> field of StepWords and its unit of measure (None: as the source means it).
_NUMBER_WORDS: dict[str, tuple[str, str | None]] = {
    "rate_command": ("rate_command_deg_per_s", "deg/s"),
    "temperature_command": ("temperature_command_deg_c", "degC"),
    "frequency": ("frequency_hz", "Hz"),
    "amplitude": ("amplitude", None),
    "settle": ("settle_s", "s"),
}
WORD_NAMES = _TEXT_WORDS | _NUMBER_WORDS.keys() | {"repeat", "room"}

_YES_NO = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
_INTEGER = re.compile(r"[+-]?[0-9]{1,18}(?:\.0*)?")
_MOST_CHARACTERS = 1000
_NAMESPACE = uuid5(NAMESPACE_URL, "gyrofleet/step")


@dataclass(frozen=True)
class WordColumn:
    """A column of the field `word` of StepWords; factor and offset convert its unit of measure to the field's."""

    title: str
    word: str
    factor: float = 1.0
    offset: float = 0.0
    decimal_mark: str = field(default=".", repr=False)

    def read(self, cell: object) -> Any:
        """Value of a cell, None if it is empty; BadInput says what is expected instead of an unreadable one."""
        text = cell_text(cell)
        if not text:
            return None
        if self.word in _TEXT_WORDS:
            if len(text) > _MOST_CHARACTERS:
                raise BadInput(f"at most {_MOST_CHARACTERS} characters")
            return text
        if self.word == "repeat":
            if _INTEGER.fullmatch(text) is None:
                raise BadInput("a whole number")
            return int(text.partition(".")[0])
        if self.word == "room":
            if text.lower() not in _YES_NO:
                raise BadInput("yes or no (also true, false, 1, 0)")
            return _YES_NO[text.lower()]
        text = text.replace(self.decimal_mark, ".")
        value = float(text) * self.factor + self.offset if NUMBER.fullmatch(text) else math.nan
        if not math.isfinite(value):
            raise BadInput(f"a number with a decimal {'point' if self.decimal_mark == '.' else 'comma'}")
        return value


def cell_text(cell: object) -> str:
    """Text of a cell of a name or a step word of any type; '' if it is empty, BadInput if it is NaN or infinite.

    >>> cell_text(231.0), cell_text(" FOG-1 "), cell_text(None)
    ('231', 'FOG-1', '')
    """
    if isinstance(cell, float):
        if not math.isfinite(cell):
            raise BadInput("a name or a number (null where there is none)")
        return str(int(cell)) if cell.is_integer() else repr(cell)
    return str(cell).strip() if cell is not None else ""


def word_column(title: str, name: str, unit: str | None) -> WordColumn:
    """Column of the step word `name`, whose values are in `unit` (None if the title names none)."""
    if name not in _NUMBER_WORDS:
        if unit is not None:
            raise BadInput(f"column {title!r}: the step word {name} is written without a unit; name it {name!r}")
        return WordColumn(title, name)
    word, canonical = _NUMBER_WORDS[name]
    if canonical is None:
        if unit is not None:
            check_unit(unit)
        return WordColumn(title, word)
    if unit is None:
        raise BadInput(f"column {title!r} has no unit; name it '{name}[{canonical}]'")
    # pint counts angles as dimensionless, so that it would turn Hz into deg/s
    if is_angular_rate(check_unit(unit)) != is_angular_rate(canonical):
        raise BadInput(f"column {title!r}: {unit!r} cannot be turned into {canonical!r}; name it '{name}[{canonical}]'")
    return WordColumn(title, word, *conversion(unit, canonical))


def step_words(columns: Iterable[WordColumn], values: Iterable[Any]) -> StepWords | None:
    """Words of a step from the values of its columns; None if all are empty."""
    words = {column.word: value for column, value in zip(columns, values, strict=True) if value is not None}
    return StepWords(**words) if words else None


def word_texts(words: StepWords) -> dict[str, str]:
    """The words of a step as files name and write them.

    >>> word_texts(StepWords(step="cold", rate_command_deg_per_s=-10.0))
    {'step': 'cold', 'rate_command': '-10 deg/s'}
    """
    titles = {word: (title, unit) for title, (word, unit) in _NUMBER_WORDS.items()}
    texts = {}
    for name in words.__struct_fields__:
        if (value := getattr(words, name)) is not None:
            title, unit = titles.get(name, (name, None))
            text = f"{value:g}" if isinstance(value, float) else str(value)
            text = ("no", "yes")[value] if isinstance(value, bool) else text
            texts[title] = f"{text} {unit}" if unit else text
    return texts


def with_common_words(words: StepWords | None, common: StepWords | None) -> StepWords | None:
    """Words of a step, completed by those that apply to the whole file."""
    if common is None or words is None:
        return words or common
    own = {name: value for name in words.__struct_fields__ if (value := getattr(words, name)) is not None}
    return msgspec.structs.replace(common, **own)


class FileStep(NamedTuple):
    """A step of a file: its documents."""

    started: StepStarted
    ended: StepEnded


class StepTracker:
    """Tracks the step of every unit of every run; turns changes of its words into documents.

    The documents' identities are hashes of their content, so that one file gives the same documents each time.
    `steps` are those that have ended.
    """

    def __init__(self) -> None:
        self.steps: list[FileStep] = []
        self._words: dict[StepWords, StepWords] = {}  # many steps share few
        self._open: dict[tuple[str, str], tuple[StepStarted, int]] = {}

    def follow(
        self, unit: str, run: str, words: StepWords | None, *, first_ns: int, last_ns: int
    ) -> tuple[StepEnded | None, StepStarted | None]:
        """Add a stretch of rows with the same words; return the step that ended and the one that begins."""
        current = self._open.get((unit, run))
        if current is not None and current[0].words == words:
            self._open[unit, run] = current[0], last_ns
            return None, None
        ended = self.close(unit, run)
        if words is None:
            return ended, None
        words = self._words.setdefault(words, words)
        identity = msgspec.json.encode([run, unit, first_ns, words]).decode()
        started = StepStarted(run=run, unit=unit, t_ns=first_ns, words=words, uid=uuid5(_NAMESPACE, identity).hex)
        self._open[unit, run] = started, last_ns
        return ended, started

    def close(self, unit: str, run: str) -> StepEnded | None:
        """End the step that the unit is in, at its last row; None if it is in none."""
        current = self._open.pop((unit, run), None)
        if current is None:
            return None
        started, last_ns = current
        uid = uuid5(_NAMESPACE, f"end of {started.uid}").hex
        ended = StepEnded(run=run, unit=unit, t_ns=last_ns, step_uid=started.uid, uid=uid)
        self.steps.append(FileStep(started, ended))
        return ended

    def finish(self) -> tuple[FileStep, ...]:
        """End all steps; every step in the order of their ends."""
        for owner in list(self._open):
            self.close(*owner)
        return tuple(self.steps)

    def is_open(self, unit: str, run: str, words: StepWords | None) -> bool:
        """Whether the unit is in a step of exactly these words (None: in no step)."""
        current = self._open.get((unit, run))
        return (current[0].words if current is not None else None) == words
