"""Base class of SCPI instruments: commands by name, limits, and settling."""

import math
from collections.abc import Collection, Mapping
from string import Formatter
from typing import Any, ClassVar

from msgspec.structs import asdict

from ingest.instruments.base import NOTHING, Instrument, Moving, Reading
from ingest.instruments.scpi import NUMBER, NoNumber, ScpiConnection, ScpiOptions, UnusableAnswer, checked_pattern
from ingest.station_clock import StationClock
from stream.errors import BadInput, InstrumentError
from stream.quantities import check_unit, is_angular_rate


class Settling:
    """Settled once every measurement of `stable_s` lies inside a band; at 0 s, one measurement is enough.

    >>> settling = Settling(target=40.0, band=0.5, stable_s=60.0)
    >>> [settling.update(round(t_s * 1e9), deg_c) for t_s, deg_c in [(0, 39.0), (30, 39.6), (60, 39.9), (90, 40.1)]]
    [False, False, False, True]
    >>> settling.update(100 * 10**9, 40.6), settling.update(110 * 10**9, 40.0), settling.update(170 * 10**9, 40.0)
    (False, False, True)

    Once it has settled, `departure` is how far it is off where three measurements in a row were off by more than twice
    the band; 0 otherwise.

    >>> [settling.update(180 * 10**9, 90.0) for _ in range(3)][-1], settling.departure, settling.text("degC")
    (False, 50.0, '90 degC measured, 40 +-0.5 degC set')
    """

    def __init__(self, target: float, band: float, stable_s: float) -> None:
        if not (band >= 0.0 and stable_s >= 0.0):
            raise BadInput(f"settled within {band} for {stable_s} s: neither can be negative")
        self._target, self.band = target, band
        self._stable_ns = round(stable_s * 1e9)
        self._since_ns: int | None = None
        self._has_settled = False
        self._measured = math.nan
        self._far = 0  # measurements in a row

    def update(self, t_ns: int, value: float) -> bool:
        """Take a measurement; whether it is settled."""
        self._measured = value
        self._far = 0 if abs(value - self._target) <= 2.0 * self.band else self._far + 1
        if not abs(value - self._target) <= self.band:
            self._since_ns = None
            return False
        self._since_ns = t_ns if self._since_ns is None else self._since_ns
        is_settled = t_ns - self._since_ns >= self._stable_ns
        self._has_settled = self._has_settled or is_settled
        return is_settled

    @property
    def departure(self) -> float:
        """How far what had settled is off now."""
        return abs(self._measured - self._target) if self._has_settled and self._far >= _FAR_IN_A_ROW else 0.0

    def text(self, unit: str) -> str:
        """What is measured and what is set."""
        measured = "nothing" if math.isnan(self._measured) else f"{self._measured:.6g} {unit}"
        return f"{measured} measured, {self._target:g} +-{self.band:g} {unit} set"


_FAR_IN_A_ROW = 3
_REST = 1e-3  # of the largest rate: a table's rate at rest, where twice its band is less
_RECONNECTED_IN_A_ROW = 3
_ABSOLUTE_ZERO_DEG_C = -273.15


class ScpiInstrument(Instrument):
    """An instrument behind a VISA resource; a subclass is mostly tables.

    In its commands and queries ``{value}`` is the value that is set, other braces name options. The station file may
    replace each of them, or say "" for one that the instrument does not have; BadInput for an unknown or invalid one.
    """

    commands: ClassVar[Mapping[str, str]] = NOTHING  # commands and queries by name
    set_by: ClassVar[Mapping[str, str]] = NOTHING  # command of a setting; by default ``set_`` and its name
    settled_by: ClassVar[Mapping[str, str]] = NOTHING  # query that measures a setting; by default that of its name
    measured_by: ClassVar[Mapping[str, str]] = NOTHING  # query of a signal

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        super().__init__(name, options, clock)
        self.who = f"{self.names['en']} {name}"
        self._set_by = {what: self.set_by.get(what, f"set_{what}") for what in self.settings}
        self._settled_by = {what: what for what in self.settings if what in self.commands} | dict(self.settled_by)
        self._commands = self._checked_commands(options)
        answers = {name: options.answers.get(name, NUMBER) for name in self.commands}
        self._patterns = {
            name: checked_pattern(f"{self.who}: answer {name}", each, has_group=True) for name, each in answers.items()
        }
        self._settling: dict[str, Settling] = {}
        self._reconnected = 0  # turns in a row
        self.connection = ScpiConnection(self.who, options, clock, self.prepare)
        self._check_names()
        for what in self.settings:
            low, high = self.limits(what)
            if not low <= high:
                raise BadInput(f"{self.who}: {what} from {low:g} to {high:g} {self.settings[what]} is an empty range")
            self.settling(what, high)

    def _check_names(self) -> None:
        """BadInput where the class names a command that it does not have, or a unit that there is not."""
        wanted = {f"setting {what}": self._set_by[what] for what in self.settings}
        wanted |= {f"measuring {what}": query for what, query in self._settled_by.items()}
        wanted |= {f"signal {signal}": query for signal, query in self.measured_by.items()}
        for what, command in wanted.items():
            if command not in self.commands:
                raise BadInput(
                    f"{self.who}: {what} is done by {command!r}, which is not one of its commands: "
                    f"{', '.join(self.commands) or 'it has none'}"
                )
        for unit in (*self.settings.values(), *self.signals.values()):
            check_unit(unit)

    def settling_of(self, what: str) -> Settling | None:
        """How a setting does that was commanded and is measured; None of others."""
        return self._settling.get(what)

    def open(self) -> str:
        """Connect; returns the answer to ``*IDN?``."""
        return self.connection.open()

    def close(self) -> None:
        """Disconnect; never raises."""
        self.connection.close()

    def prepare(self) -> None:
        """Configure it; called after every connection."""

    def limits(self, what: str) -> tuple[float, float]:
        """Lowest and highest value of a setting, in its unit."""
        raise BadInput(f"{self.who}: its class does not say within which limits {what} may be set; define `limits`")

    def settling(self, what: str, value: float) -> Settling:
        """Criterion by which a setting has settled."""
        raise BadInput(f"{self.who}: its class does not say when {what} of {value:g} has settled; define `settling`")

    def set(self, what: str, value: float) -> None:
        """Command a setting; a value beyond its limits is not sent."""
        if what not in self.settings:
            super().set(what, value)
        low, high = self.limits(what)
        if not low <= value <= high:
            raise InstrumentError(
                f"{self.who}: {what} of {value:g} {self.settings[what]} is not within {low:g} to {high:g} "
                f"{self.settings[what]}, which the station file allows; nothing was sent"
            )
        self.give(self._set_by[what], value)
        if what in self._settled_by:
            self._settling[what] = self.settling(what, value)

    def is_settled(self, what: str) -> bool:
        """Measure a setting; whether it has settled."""
        if what not in self.settings:
            raise BadInput(f"the {self.who} has no {what}: it has {', '.join(self.settings) or 'no settings'}")
        if what not in self._settled_by:
            return True
        if what not in self._settling:
            raise InstrumentError(f"{self.who}: {what} was never set, so it cannot be settled; set it first")
        reading = self._read(self._settled_by[what])
        return self._settling[what].update(reading.t_ns, reading.value)

    def try_out(self, settings: Collection[str]) -> list[Reading]:
        """Ask each query of a signal, and of `settings` that will be waited for, once; `faults` as of `sample`.

        InstrumentError where answers are no numbers, with all of them, or where one more comes than was asked for.
        """
        asked = {query: signal for signal, query in self.measured_by.items() if self._text(query)}
        for what in (each for each in settings if each in self._settled_by):
            asked.setdefault(self._settled_by[what], what)
        readings, faults, wrong = [], dict[str, str](), []
        for query, what in asked.items():
            try:
                readings.append(self._read(query)._replace(signal=what))
            except NoNumber as error:
                wrong.append(str(error))
            except UnusableAnswer as error:
                faults[what] = str(error)
        if wrong:
            raise InstrumentError("; ".join(wrong))
        self.faults = faults
        self._check_in_step()
        return readings

    def moving(self) -> Moving | None:
        """The first angular rate that can be set and is measured not to be at rest."""
        rates = (what for what, unit in self.settings.items() if is_angular_rate(unit) and what in self._settled_by)
        for what in (each for each in rates if self._text(self._settled_by[each])):
            value, unit = self._read(self._settled_by[what]).value, self.settings[what]
            if not abs(value) <= max(2.0 * self.settling(what, 0.0).band, _REST * self.limits(what)[1]):
                return Moving(abs(value), f"{what} is commanded to 0 {unit}, {value:.4g} {unit} measured")
        return None

    def sample(self) -> list[Reading]:
        """Measure every signal once; one whose answer gives no value is in `faults`, the others have theirs.

        InstrumentError if none has a value, or an answer may belong to another query.
        """
        readings, faults = [], dict[str, str]()
        unasked, reconnects = self.connection.unasked, self.connection.reconnects
        for signal, query in self.measured_by.items():
            if not self._text(query):
                continue
            try:
                reading = self._read(query)
            except UnusableAnswer as error:
                faults[signal] = str(error)
                continue
            if self.connection.unasked != unasked:
                raise InstrumentError(
                    f"{self.who} sent a line without a query since it was read last: a value of that turn may be the "
                    "answer to another query"
                )
            for what, settling in self._settling.items():
                if self._settled_by[what] == query:
                    settling.update(reading.t_ns, reading.value)
            readings.append(reading._replace(signal=signal))
        if faults and not readings:
            raise InstrumentError(next(iter(faults.values())))
        self.faults = faults
        self._note_closing(self.connection.reconnects > reconnects)
        self._check_in_step()
        return readings

    def _check_in_step(self) -> None:
        self.connection.check_in_step(self.clock.computer_s(self.options.sample_interval_s) / 4)

    def _note_closing(self, is_reconnected: bool) -> None:
        """Note an instrument that has to be connected again turn by turn."""
        self._reconnected = self._reconnected + 1 if is_reconnected else 0
        if self._reconnected == _RECONNECTED_IN_A_ROW:
            note = (
                f"{self.who} had to be connected again in {self._reconnected} turns in a row: it, or the terminal "
                "server before it, closes the connection after an answer; its values are kept, and take longer"
            )
            self.notes = (note,)

    def give(self, name: str, value: float | None = None) -> None:
        """Send the command of this name, unless it is empty."""
        if text := self._text(name, value):
            self.connection.command(text)

    def _read(self, query: str) -> Reading:
        text = self._text(query)
        if not text:
            raise InstrumentError(f"{self.who}: the query {query!r} is empty in the station file, and it is needed")
        value, answer = self.connection.number(text, self._patterns[query])
        is_temperature = any(self.signals[name] == "degC" for name, asked in self.measured_by.items() if asked == query)
        if is_temperature and value < _ABSOLUTE_ZERO_DEG_C:
            raise UnusableAnswer(
                f"{self.who}: asked {text!r} it answered {value:g} degC, which is below absolute zero; check its sensor"
            )
        return Reading(query, answer.t_ns, value)

    def _text(self, name: str, value: float | None = None) -> str:
        return self._commands[name].format(value=value, **asdict(self.options))

    def _checked_commands(self, options: ScpiOptions) -> dict[str, str]:
        for table, given in (("commands", options.commands), ("answers", options.answers)):
            if unknown := [name for name in given if name not in self.commands]:
                raise BadInput(
                    f"{self.who}: {table} has {unknown[0]!r}, which it does not use: it uses {', '.join(self.commands)}"
                )
        commands = {**self.commands, **options.commands}
        known = {**asdict(options), "value": 1.0}
        for name, text in commands.items():
            try:
                fields = {field for _, field, _, _ in Formatter().parse(text) if field is not None}
                text.format(**known)
            except (ValueError, LookupError, AttributeError, TypeError) as error:
                raise BadInput(f"{self.who}: command {name} = {text!r} cannot be filled in: {error!r}") from None
            sets = name in self._set_by.values()
            if text and sets != ("value" in fields):
                rule = "needs {value} where the value goes" if sets else "sets nothing, so it has no {value}"
                raise BadInput(f"{self.who}: command {name} = {text!r} {rule}")
        return commands
