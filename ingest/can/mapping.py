"""From databases and a mapping file to a plan; without a mapping every signal comes under its own name."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ingest.can.database import has_id, is_j1939, load_database, own_id, own_names
from ingest.can.decode import MessageLayout, SignalLayout
from ingest.can.frames import EXTENDED, arbitration_id, id_text
from ingest.can.mapping_file import ChecksumEntry, CounterEntry, MessageEntry, SignalEntry, read_mapping
from ingest.can.plan import CanPlan, ChecksumPlan, CounterPlan, MessagePlan, Route, SignalPlan
from ingest.checksums import CAN_CHECKSUMS
from ingest.tables.units import database_remark, database_unit
from stream.errors import BadInput
from stream.identity import check_name

if TYPE_CHECKING:
    from cantools.database.can import Message

Occurring = Callable[[], Collection[int]]

_LARGEST_ID = (1 << 29) - 1
_NO_SOURCE = 0xFE  # databases write the null address where any source may send
_NOTHING: Mapping[str, int] = {}


class CanMapping:
    """Databases and the mapping of their signals; makes the plan of a bus, or of each log.

    Without a mapping file every signal of the databases is of `unit`, under its own name; with one, `unit` is whose the
    messages are of which it does not say it. `variants` has ids by names that several messages have. Raises BadInput.
    """

    def __init__(
        self, dbc_paths: Sequence[Path], path: Path | None = None, *, unit: str | None = None,
        variants: Mapping[str, int] = _NOTHING,
    ) -> None:  # fmt: skip
        self._place = str(path) if path else ", ".join(map(str, dbc_paths))
        self._entries = None if path is None else read_mapping(path)
        self._unit = None if unit is None else check_name("unit", unit)
        self._variants = dict(variants)
        self._messages = [message for each in dbc_paths for message in load_database(each)]
        if not self._messages:
            raise BadInput(f"{self._place}: no message in it")
        names = {message.name for message in self._messages}
        if unknown := sorted(self._variants.keys() - names):
            raise BadInput(f"--message {unknown[0]}: no message of that name in the CAN database")
        self._depends_on_log = len(names) < len(self._messages) or any(map(is_j1939, self._messages))
        self._plan: CanPlan | None = None
        self._remarks: list[str] = []

    def plan(self, occurring: Occurring | None = None) -> CanPlan:
        """The plan for a log, whose ids `occurring` gives if they matter; raises BadInput if it cannot be made."""
        if self._plan is not None and not self._depends_on_log:
            return self._plan
        self._remarks = []
        ids = frozenset(occurring()) if occurring is not None and self._depends_on_log else None
        routes = list(self._automatic_routes(ids) if self._entries is None else self._mapped_routes(self._entries, ids))
        if not routes:
            raise BadInput(f"{self._place}: no message with signals is mapped")
        _refuse_twins(self._place, routes)
        self._remarks += _of_one_identifier(routes)
        self._plan = CanPlan(tuple(routes), tuple(self._remarks))
        return self._plan

    def _automatic_routes(self, ids: frozenset[int] | None) -> Iterator[Route]:
        assert self._unit is not None
        messages = [each for name in dict.fromkeys(m.name for m in self._messages) for each in self._chosen(name, ids)]
        names = own_names(messages)
        for message in messages:
            where = f"{self._place}: message {message.name}"
            plan = self._message(MessageEntry(message=message.name), message, where, names)
            if not plan.signals:
                continue
            route = Route(self._unit, own_id(message), plan, is_j1939=is_j1939(message))
            yield from self._by_source(route, message, ids or ()) if route.is_j1939 else [route]

    def _mapped_routes(self, entries: Sequence[MessageEntry], ids: frozenset[int] | None) -> Iterator[Route]:
        places = [f"{self._place}: message {entry.message}" for entry in entries]
        found = [self._find(entry, ids, where) for entry, where in zip(entries, places, strict=True)]
        by_name = {message.name: message for message in [*reversed(self._messages), *found]}
        names = own_names(list(by_name.values()))
        for entry, message, where in zip(entries, found, places, strict=True):
            plan = self._message(entry, message, where, names)
            if plan.signals:
                yield from self._routes(entry, message, plan, where)

    def _chosen(self, name: str, ids: frozenset[int] | None) -> "list[Message]":
        """The variants of a message to take: the chosen one, or those that occur."""
        found = [message for message in self._messages if message.name == name]
        if name in self._variants:
            wanted = self._variants[name]
            chosen = [each for each in found if (own_id(each) & ~EXTENDED) == wanted][:1]
            if not chosen:
                raise BadInput(f"--message {name}: no variant has id {wanted:#x}; there are {_ids(found)}")
            return chosen
        if len(found) == 1 or ids is None:
            return found
        met = [each for each in found if any(has_id(each, identifier) for identifier in ids)]
        signals = [signal.name.lower() for each in met for signal in each.signals]
        if len(met) > 1 and len(set(signals)) < len(signals):
            first = own_id(met[0]) & ~EXTENDED
            raise BadInput(
                f"{self._place}: {len(met)} variants of message {name} occur in the log: {_ids(met)}; "
                f"choose one with --message {name}={first:#x}"
            )
        if met:
            self._remarks.append(
                f"message {name} has {len(found)} variants in the CAN database ({_ids(found)}); "
                f"{_ids(met)} occurs in the log and is taken"
            )
        return met

    def _find(self, entry: MessageEntry, ids: frozenset[int] | None, where: str) -> "Message":
        found = [message for message in self._messages if message.name == entry.message]
        if not found:
            known = ", ".join(sorted(message.name for message in self._messages)[:12])
            raise BadInput(f"{where}: not in the CAN database, which has {known or 'none'}; correct its name")
        if entry.id is not None:
            found = [each for each in found if (own_id(each) & ~EXTENDED) == entry.id]
            if not found:
                raise BadInput(f"{where}: no message of that name has id {entry.id:#x} in the CAN database")
        elif len(found) > 1:
            found = self._chosen(entry.message, ids) or found
        if len(found) > 1:
            raise BadInput(
                f"{where}: {len(found)} messages of the databases have that name ({_ids(found)}); give one database, "
                f"`id` in the mapping, or --message {entry.message}=ID"
            )
        return found[0]

    def _by_source(self, route: Route, message: "Message", ids: Collection[int]) -> Iterator[Route]:
        """A route for each source of a J1939 message; signals of all but the main source carry its address."""
        sources = sorted({identifier & 0xFF for identifier in ids if has_id(message, identifier)})
        own = route.arbitration_id & 0xFF
        main = own if own in sources and own != _NO_SOURCE else next(iter(sources), None)
        yield replace(route, source=main)
        if len(sources) > 1:
            listed = ", ".join(f"0x{source:02x}" for source in sources)
            self._remarks.append(
                f"message {message.name} comes from sources {listed}: signals of all but 0x{main:02x} end in .saNN; "
                f"`sources` in a mapping gives each its unit"
            )
        for source in sources:
            if source != main:
                signals = tuple(replace(each, signal=f"{each.signal}.sa{source:02x}") for each in route.message.signals)
                yield replace(route, source=source, message=replace(route.message, signals=signals))

    def _message(
        self, entry: MessageEntry, message: "Message", where: str, names: Mapping[tuple[str, str], str]
    ) -> MessagePlan:
        layout = MessageLayout.of(message)
        interval_ns = None
        if entry.interval_s is not None:
            if not 1e-6 <= entry.interval_s <= 1e6:
                raise BadInput(f"{where}: interval_s = {entry.interval_s:g}: expected 1e-6 to 1e6 seconds")
            interval_ns = round(entry.interval_s * 1e9)
        for name, why in layout.unusable.items():
            self._remarks.append(f"message {layout.name}, signal {name}: left out, {why} in the CAN database")
        in_lower_case = {
            name: names.get((message.name, name), f"{message.name}.{name}".lower()) for name in layout.signals
        }
        wanted = entry.signals or in_lower_case
        return MessagePlan(
            layout, tuple(self._signal(layout, name, as_, where) for name, as_ in wanted.items()),
            _counter(layout, entry.counter, where), _checksum(message, layout, entry.checksum, where), interval_ns,
            round((message.cycle_time or 0) * 1e6),
        )  # fmt: skip

    def _signal(self, layout: MessageLayout, name: str, as_: str | SignalEntry, where: str) -> SignalPlan:
        entry = SignalEntry(as_) if isinstance(as_, str) else as_
        found = _known(layout, name, where)
        text = entry.unit_of_measure if entry.unit_of_measure is not None else found.unit_of_measure
        measure, is_known = database_unit(text, name)
        if not is_known:
            self._remarks.append(
                f"message {layout.name}, signal {name}: unit of measure {text!r} is not known; it is kept as it is and "
                "converted to no other (unit_of_measure in a mapping gives a known one)"
            )
        elif remark := database_remark(text, measure, entry.signal):
            self._remarks.append(f"message {layout.name}, signal {name}: {remark}")
        return SignalPlan(found, _named(where, "signal", entry.signal), measure)

    def _routes(self, entry: MessageEntry, message: "Message", plan: MessagePlan, where: str) -> Iterator[Route]:
        ways = [entry.unit, entry.ids, entry.channels, entry.sources, entry.units]
        mine = entry.unit or (None if any(ways) else self._unit)
        known = "unit, ids, channels, sources, or multiplexer with units"
        if not any(ways) and mine is None:
            raise BadInput(f"{where}: say whose it is: {known}; or give --unit")
        if sum(map(bool, ways)) > 1 or bool(entry.multiplexer) != bool(entry.units):
            raise BadInput(f"{where}: say whose it is in one way: {known}")
        if entry.channels and entry.channel is not None:
            raise BadInput(f"{where}: give channels or channel, not both")
        if (entry.sources or entry.source is not None) and not is_j1939(message):
            raise BadInput(f"{where}: it is no J1939 message in the CAN database, and has no source address")
        for unit in [mine] if mine else [*entry.ids, *entry.channels, *entry.sources, *entry.units]:
            _named(where, "unit", unit)
            identifier = own_id(message)
            if unit in entry.ids:
                if not 0 <= entry.ids[unit] <= _LARGEST_ID:
                    raise BadInput(f"{where}: ids: {entry.ids[unit]:#x} of unit {unit} is no id of 11 or 29 bits")
                identifier = arbitration_id(entry.ids[unit], is_extended=bool(message.is_extended_frame))
            selector = None
            if entry.multiplexer:
                _known(plan.layout, entry.multiplexer, where)
                selector = (entry.multiplexer, entry.units[unit])
            channel, source = entry.channels.get(unit, entry.channel), entry.sources.get(unit, entry.source)
            is_of_pgn = is_j1939(message) and not entry.ids
            yield Route(unit, identifier, plan, channel, selector, is_j1939=is_of_pgn, source=source)


def _ids(messages: "Sequence[Message]") -> str:
    return ", ".join(id_text(own_id(message)) for message in messages)


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
    if entry.algorithm not in CAN_CHECKSUMS:
        raise BadInput(f"{where}: checksum {entry.algorithm!r} is not known; known are {', '.join(CAN_CHECKSUMS)}")
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


def _refuse_twins(place: str, routes: Sequence[Route]) -> None:
    """Refuse two messages that give the same signal of one unit."""
    seen: dict[tuple[str, str], Route] = {}
    for route in routes:
        for signal in route.message.signals:
            other = seen.setdefault((route.unit, signal.signal), route)
            if other is not route:
                both = " and ".join(f"{r.message.layout.name} ({id_text(r.arbitration_id)})" for r in (other, route))
                raise BadInput(f"{place}: unit {route.unit}, signal {signal.signal} comes from {both}; rename one")
        names = [signal.signal for signal in route.message.signals]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise BadInput(f"{place}: message {route.message.layout.name} makes signal {twice[0]} twice; rename one")


def _named(where: str, kind: str, name: str) -> str:
    try:
        return check_name(kind, name)
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from error


def _of_one_identifier(routes: list[Route]) -> Iterator[str]:
    """Remarks on messages that are read from the same frames."""
    of_frames: dict[tuple[int, str], dict[str, None]] = {}
    for route in routes:
        if route.channel is None and route.selector is None and route.source is None:
            of_frames.setdefault((route.key, route.unit), {})[route.message.layout.name] = None
    for (key, _), names in of_frames.items():
        if len(names) > 1:
            first, *others = names
            more = ", ".join(others)
            yield f"messages {first} and {more} have one identifier, {key:#x}: all are read from its frames"
