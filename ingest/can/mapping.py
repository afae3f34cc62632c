"""Which signal of a CAN database is which signal of which unit: a TOML file, or every signal under its own name.

One table a message::

    [[message]]
    message = "IMU"
    ids = { "FOG-0231" = 0x101, "FOG-0232" = 0x102 }   # or: unit = "FOG-0231", where the id is the database's
    signals = { YawRate = "rate", Temp = { signal = "temperature", unit_of_measure = "degC" } }
    counter = { signal = "Counter", modulus = 16 }
    checksum = { signal = "Crc", algorithm = "crc8_sae_j1850", first_byte = 0, last_byte = 6 }
    interval_s = 0.001
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from ingest.can.checksum import CHECKSUMS
from ingest.can.database import arbitration_id, id_text, load_messages, own_names, unit_of_measure
from ingest.can.decode import MessageLayout, SignalLayout
from stream.errors import BadInput
from stream.identity import check_name
from stream.toml_text import decode_toml

if TYPE_CHECKING:
    from cantools.database.can import Message

_LARGEST_ID = (1 << 29) - 1


class SignalEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a signal of the database is called here, and its unit of measure where the database's is wrong."""

    signal: str
    unit_of_measure: str | None = None


class CounterEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The signal that counts frames, from 0 to `modulus` - 1 (by default all its bits hold)."""

    signal: str
    modulus: int | None = None


class ChecksumEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The signal with a checksum over bytes `first_byte` to `last_byte` but its own, with `prefix` before them."""

    signal: str
    algorithm: str
    first_byte: int = 0
    last_byte: int | None = None
    prefix: tuple[int, ...] = ()


class MessageEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One ``[[message]]``.

    Parameters
    ----------
    message: Name in the database.
    unit: The unit that sends it, under the database's own id.
    ids: Unit to arbitration id, where many units send it.
    channels: Unit to channel, where one unit is on each.
    multiplexer, units: A signal, and unit to its raw value, where it says whose frame it is.
    channel: The channel that counts; by default any.
    signals: Name in the database to name here; by default all, in lower case.
    counter, checksum: How lost and damaged frames are found.
    interval_s: Sample interval, seconds. With a counter, sample n is at exactly n intervals after the first.
    """

    message: str
    unit: str | None = None
    ids: dict[str, int] = {}
    channels: dict[str, int] = {}
    multiplexer: str | None = None
    units: dict[str, int] = {}
    channel: int | None = None
    signals: dict[str, str | SignalEntry] = {}
    counter: CounterEntry | None = None
    checksum: ChecksumEntry | None = None
    interval_s: float | None = None


class MappingFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A mapping file."""

    message: tuple[MessageEntry, ...]


@dataclass(frozen=True)
class SignalPlan:
    """A signal to decode, and what it is called here."""

    layout: SignalLayout
    signal: str
    unit_of_measure: str

    @property
    def is_counts(self) -> bool:
        """Whether it travels as 32-bit integers with scale and offset."""
        return self.layout.field.fits_counts


@dataclass(frozen=True)
class CounterPlan:
    """The signal that counts frames."""

    signal: str
    modulus: int


@dataclass(frozen=True)
class ChecksumPlan:
    """The signal with a checksum, and which bytes it is over."""

    signal: str
    algorithm: str
    octets: tuple[int, ...]
    prefix: tuple[int, ...]


@dataclass(frozen=True)
class MessagePlan:
    """A message to decode; `cycle_ns` is the interval that the database states, 0 where it states none."""

    layout: MessageLayout
    signals: tuple[SignalPlan, ...]
    counter: CounterPlan | None = None
    checksum: ChecksumPlan | None = None
    interval_ns: int | None = None
    cycle_ns: int = 0

    @property
    def is_on_grid(self) -> bool:
        """Whether a sample's time comes from its number."""
        return self.counter is not None and self.interval_ns is not None


@dataclass(frozen=True)
class Route:
    """Frames that are one unit's: by arbitration id, and where set by channel and a multiplexer's raw value."""

    unit: str
    arbitration_id: int
    message: MessagePlan
    channel: int | None = None
    selector: tuple[str, int] | None = None


@dataclass(frozen=True)
class CanPlan:
    """What is to be decoded from a bus, and whose samples it makes.

    Parameters
    ----------
    routes: Whose frame is whose.
    remarks: What was found odd in database or mapping, for people.
    """

    routes: tuple[Route, ...]
    remarks: tuple[str, ...] = ()

    @property
    def units(self) -> tuple[str, ...]:
        """The units, each once, in the order of the routes."""
        return tuple(dict.fromkeys(route.unit for route in self.routes))

    @property
    def signals(self) -> tuple[tuple[str, str, str], ...]:
        """Unit, signal and unit of measure of everything that can come."""
        return tuple((r.unit, s.signal, s.unit_of_measure) for r in self.routes for s in r.message.signals)


def automatic_plan(dbc_paths: Sequence[Path], unit: str) -> CanPlan:
    """Every signal of the databases under its own name, all of one unit.

    Raises
    ------
    BadInput: If a database cannot be read, or holds no message.
    """
    check_name("unit", unit)
    messages = load_messages(dbc_paths)
    if not messages:
        raise BadInput(f"{_names(dbc_paths)}: no message in it")
    entries = [MessageEntry(message=message.name, unit=unit) for message in messages]
    return _Builder(_names(dbc_paths), messages).plan(entries)


def load_mapping(path: Path, dbc_paths: Sequence[Path], unit: str | None = None) -> CanPlan:
    """Read a mapping file against its CAN databases.

    Parameters
    ----------
    path: The mapping.
    dbc_paths: The databases.
    unit: Whose the messages are of which the mapping does not say it.

    Raises
    ------
    BadInput: If a file cannot be read, or the mapping names what the databases do not have; the message says where.
    """
    try:
        mapping = decode_toml(path.read_bytes(), MappingFile)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror or error})") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: {error}; see `gyrofleet can scan --write` for a mapping to begin with") from error
    return _Builder(str(path), load_messages(dbc_paths), unit).plan(mapping.message)


class _Builder:
    """Puts mapping and databases together."""

    def __init__(self, place: str, messages: "list[Message]", unit: str | None = None) -> None:
        self._place = place
        self._unit = unit
        self._messages = messages
        self._names = own_names(messages)
        self._remarks: list[str] = []

    def plan(self, entries: "Sequence[MessageEntry]") -> CanPlan:
        routes: list[Route] = []
        is_automatic = len(entries) == len(self._messages) and all(entry.unit for entry in entries)
        for number, entry in enumerate(entries):
            where = f"{self._place}: message {entry.message}"
            # databases may name two messages alike; asked for in order, each is met
            message = (
                self._messages[number] if is_automatic and self._is_at(number, entry) else self._find(entry, where)
            )
            plan = self._message(entry, message, where)
            if plan.signals:
                routes += self._routes(entry, message, plan, where)
        if not routes:
            raise BadInput(f"{self._place}: no message with signals is mapped")
        _refuse_twins(self._place, routes)
        return CanPlan(tuple(routes), tuple(self._remarks))

    def _is_at(self, number: int, entry: MessageEntry) -> bool:
        return self._messages[number].name == entry.message

    def _find(self, entry: MessageEntry, where: str) -> "Message":
        found = [message for message in self._messages if message.name == entry.message]
        if not found:
            known = ", ".join(sorted(message.name for message in self._messages)[:12])
            raise BadInput(f"{where}: not in the CAN database, which has {known or 'none'}; correct its name")
        if len(found) > 1:
            raise BadInput(f"{where}: {len(found)} messages of the databases have that name; give one database")
        return found[0]

    def _message(self, entry: MessageEntry, message: "Message", where: str) -> MessagePlan:
        layout = MessageLayout.of(message)
        interval_ns = None
        if entry.interval_s is not None:
            if not 1e-6 <= entry.interval_s <= 1e6:
                raise BadInput(f"{where}: interval_s = {entry.interval_s:g}: expected 1e-6 to 1e6 seconds")
            interval_ns = round(entry.interval_s * 1e9)
        for name, why in layout.unusable.items():
            self._remarks.append(f"message {layout.name}, signal {name}: left out, {why} in the CAN database")
        wanted = entry.signals or {name: self._names[message.name, name] for name in layout.signals}
        return MessagePlan(
            layout,
            tuple(self._signal(layout, name, as_, where) for name, as_ in wanted.items()),
            _counter(layout, entry.counter, where),
            _checksum(message, layout, entry.checksum, where),
            interval_ns,
            round((message.cycle_time or 0) * 1e6),
        )

    def _signal(self, layout: MessageLayout, name: str, as_: str | SignalEntry, where: str) -> SignalPlan:
        entry = SignalEntry(as_) if isinstance(as_, str) else as_
        found = _known(layout, name, where)
        text = entry.unit_of_measure if entry.unit_of_measure is not None else found.unit_of_measure
        measure, is_known = unit_of_measure(text, name)
        if not is_known:
            self._remarks.append(f"message {layout.name}, signal {name}: unit of measure {text!r} is not known")
        return SignalPlan(found, check_name("signal", entry.signal), measure)

    def _routes(self, entry: MessageEntry, message: "Message", plan: MessagePlan, where: str) -> Iterator[Route]:
        ways = [bool(entry.unit), bool(entry.ids), bool(entry.channels), bool(entry.units)]
        mine = entry.unit or (None if any(ways) else self._unit)
        if sum(ways) != 1 and mine is None:
            raise BadInput(f"{where}: say whose it is: unit, ids, channels, or multiplexer with units; or give --unit")
        if sum(ways) > 1 or bool(entry.multiplexer) != bool(entry.units):
            raise BadInput(f"{where}: say whose it is in one way: unit, ids, channels, or multiplexer with units")
        if entry.channels and entry.channel is not None:
            raise BadInput(f"{where}: give channels or channel, not both")
        own = arbitration_id(message.frame_id, is_extended=bool(message.is_extended_frame))
        for unit in [mine] if mine else [*entry.ids, *entry.channels, *entry.units]:
            check_name("unit", unit)
            identifier = own
            if unit in entry.ids:
                if not 0 <= entry.ids[unit] <= _LARGEST_ID:
                    raise BadInput(f"{where}: ids: {entry.ids[unit]:#x} of unit {unit} is no id of 11 or 29 bits")
                identifier = arbitration_id(entry.ids[unit], is_extended=bool(message.is_extended_frame))
            selector = None
            if entry.multiplexer:
                _known(plan.layout, entry.multiplexer, where)
                selector = (entry.multiplexer, entry.units[unit])
            yield Route(unit, identifier, plan, entry.channels.get(unit, entry.channel), selector)


def _known(layout: MessageLayout, name: str, where: str) -> SignalLayout:
    if name in layout.unusable:
        why = layout.unusable[name]
        raise BadInput(f"{where}: signal {name} cannot be decoded: {why} in the CAN database; mend it there")
    if name not in layout.signals:
        raise BadInput(f"{where}: has no signal {name} in the CAN database; it has {', '.join(layout.signals)}")
    return layout.signals[name]


def _counter(layout: MessageLayout, entry: CounterEntry | None, where: str) -> CounterPlan | None:
    if entry is None:
        return None
    field = _known(layout, entry.signal, where).field
    modulus = 1 << field.bits if entry.modulus is None else entry.modulus
    if field.is_float or not 2 <= modulus <= 1 << min(field.bits, 32):
        raise BadInput(f"{where}: counter {entry.signal} of {field.bits} bits cannot count modulo {modulus}")
    return CounterPlan(entry.signal, modulus)


def _checksum(
    message: "Message", layout: MessageLayout, entry: ChecksumEntry | None, where: str
) -> ChecksumPlan | None:
    if entry is None:
        return None
    if entry.algorithm not in CHECKSUMS:
        raise BadInput(f"{where}: checksum {entry.algorithm!r} is not known; known are {', '.join(CHECKSUMS)}")
    field = _known(layout, entry.signal, where).field
    if field.bits != 8 or field.first_bit % 8 or field.is_float:
        raise BadInput(f"{where}: checksum {entry.signal} is not one whole byte")
    last = message.length - 1 if entry.last_byte is None else entry.last_byte
    octets = tuple(i for i in range(entry.first_byte, last + 1) if i != field.first_bit // 8)
    if entry.first_byte < 0 or last >= message.length or not octets or any(not 0 <= b <= 255 for b in entry.prefix):
        raise BadInput(
            f"{where}: checksum over bytes {entry.first_byte} to {last}: the message has bytes 0 to "
            f"{message.length - 1}, and prefix takes numbers 0 to 255"
        )
    return ChecksumPlan(entry.signal, entry.algorithm, octets, entry.prefix)


def _refuse_twins(place: str, routes: list[Route]) -> None:
    """Two messages that make one signal of one unit would make nonsense of it."""
    seen: dict[tuple[str, str], Route] = {}
    for route in routes:
        for signal in route.message.signals:
            other = seen.setdefault((route.unit, signal.signal), route)
            if other is not route:
                both = " and ".join(f"{r.message.layout.name} ({id_text(r.arbitration_id)})" for r in (other, route))
                raise BadInput(f"{place}: unit {route.unit}, signal {signal.signal} comes from {both}; rename one")
        names = [signal.signal for signal in route.message.signals]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise BadInput(f"{place}: message {route.message.layout.name} makes signal {twice[0]} twice; rename one")


def _names(paths: Sequence[Path]) -> str:
    return ", ".join(str(path) for path in paths)
