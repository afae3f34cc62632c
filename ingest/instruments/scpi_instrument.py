"""What all SCPI instruments have in common: commands by name, limits, and how they settle."""

from collections.abc import Mapping
from string import Formatter
from types import MappingProxyType
from typing import Any, ClassVar

from msgspec.structs import asdict

from ingest.instruments.base import Instrument, Reading
from ingest.instruments.scpi import NUMBER, ScpiConnection, ScpiOptions, checked_pattern
from ingest.instruments.settling import Settling
from ingest.station_clock import StationClock
from stream.errors import BadInput, InstrumentError


class ScpiInstrument(Instrument):
    """An instrument behind a VISA resource; a subclass is mostly tables.

    Parameters
    ----------
    name, options, clock: As of every `Instrument`; the options are those of the subclass.

    Attributes
    ----------
    commands: Its commands and queries by name, ``{value}`` being what is set; other braces name options. The station
        file may word each otherwise, or say "" for one that the instrument does not have.
    set_by, settled_by, measured_by: Name of the command by setting, of the query that says how far a setting is
        reached, and of the query by signal.

    Raises
    ------
    BadInput: If the station file words a command that this instrument does not know, or words it wrongly.
    """

    commands: ClassVar[Mapping[str, str]] = MappingProxyType({})
    set_by: ClassVar[Mapping[str, str]] = MappingProxyType({})
    settled_by: ClassVar[Mapping[str, str]] = MappingProxyType({})
    measured_by: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        super().__init__(name, options, clock)
        self.who = f"{self.names['en']} {name}"
        self._commands = self._worded(options)
        self._patterns = {key: self._pattern(key, options) for key in self._commands}
        self._settling: dict[str, Settling] = {}
        self.connection = ScpiConnection(self.who, options, clock, self.prepare)
        for what in self.settings:
            low, high = self.limits(what)
            if not low <= high:
                raise BadInput(f"{self.who}: {what} from {low:g} to {high:g} {self.settings[what]} leaves nothing")

    def open(self) -> str:
        """Connect; what it answers to ``*IDN?``."""
        return self.connection.open()

    def close(self) -> None:
        """Let go of it; never raises."""
        self.connection.close()

    def prepare(self) -> None:
        """Tell it how it is to measure; called after every connection."""

    def limits(self, what: str) -> tuple[float, float]:
        """Lowest and highest value of a setting, in its unit."""
        raise NotImplementedError

    def settling(self, what: str, value: float) -> Settling:
        """When a setting counts as reached."""
        raise NotImplementedError

    def set(self, what: str, value: float) -> None:
        """Command a setting; what is beyond its limits is refused before anything is sent."""
        if what not in self.settings:
            super().set(what, value)
        low, high = self.limits(what)
        if not low <= value <= high:
            raise InstrumentError(
                f"{self.who}: {what} of {value:g} {self.settings[what]} is not within {low:g} to {high:g} "
                f"{self.settings[what]}, which the station file allows; nothing was sent"
            )
        self.give(self.set_by[what], value)
        if what in self.settled_by:
            self._settling[what] = self.settling(what, value)

    def is_settled(self, what: str) -> bool:
        """Measure how far a setting is reached, and say whether it is."""
        if what not in self.settings:
            raise BadInput(f"the {self.who} has no {what}: it has {', '.join(self.settings) or 'no settings'}")
        if what not in self.settled_by:
            return True
        if what not in self._settling:
            raise InstrumentError(f"{self.who}: {what} was never set, so it cannot be settled; set it first")
        reading = self._read(self.settled_by[what])
        return self._settling[what].see(reading.t_ns, reading.value)

    def sample(self) -> list[Reading]:
        """Measure every signal once."""
        readings = []
        for signal, query in self.measured_by.items():
            reading = self._read(query)
            for what, settling in self._settling.items():
                if self.settled_by[what] == query:
                    settling.see(reading.t_ns, reading.value)
            readings.append(reading._replace(signal=signal))
        return readings

    def give(self, name: str, value: float | None = None) -> None:
        """Give the command of this name; one that the station file has emptied is not given."""
        if text := self._text(name, value):
            self.connection.command(text)

    def has(self, name: str) -> bool:
        """Whether the instrument has the command of this name."""
        return bool(self._commands[name])

    def _read(self, query: str) -> Reading:
        text = self._text(query, None)
        if not text:
            raise InstrumentError(f"{self.who}: the station file says that it has no query {query!r}, which is needed")
        value, answer = self.connection.number(text, self._patterns[query])
        return Reading(query, answer.t_ns, value)

    def _text(self, name: str, value: float | None) -> str:
        return self._commands[name].format(value=value, **asdict(self.options))

    def _worded(self, options: ScpiOptions) -> dict[str, str]:
        for table, given in (("commands", options.commands), ("answers", options.answers)):
            for name in given:
                if name not in self.commands:
                    raise BadInput(
                        f"{self.who}: {table} has {name!r}, which it does not use: it uses {', '.join(self.commands)}"
                    )
        worded = {**self.commands, **options.commands}
        sets = set(self.set_by.values())
        known = {**asdict(options), "value": 1.0}
        for name, text in worded.items():
            try:
                fields = {field for _, field, _, _ in Formatter().parse(text) if field is not None}
                text.format(**known)
            except (ValueError, LookupError, AttributeError, TypeError) as error:
                raise BadInput(f"{self.who}: command {name} = {text!r} cannot be filled in: {error!r}") from None
            if text and (name in sets) != ("value" in fields):
                rule = "needs {value} where the value goes" if name in sets else "sets nothing, so it has no {value}"
                raise BadInput(f"{self.who}: command {name} = {text!r} {rule}")
        return worded

    def _pattern(self, name: str, options: ScpiOptions) -> str:
        return checked_pattern(f"{self.who}: answer {name}", options.answers.get(name, NUMBER))
