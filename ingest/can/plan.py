"""The plan of decoding a bus or log: which frames are whose, and which samples they give."""

from dataclasses import dataclass

from ingest.can.decode import MessageLayout, SignalLayout
from ingest.can.frames import pgn_key

OF_PGN = 1 << 30  # marks keys of J1939 routes; no arbitration id has it


@dataclass(frozen=True)
class SignalPlan:
    """A signal to decode, with its name and unit of measure in gyrofleet."""

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
    """The signal with a checksum, and the bytes that it covers."""

    signal: str
    algorithm: str
    octets: tuple[int, ...]
    prefix: tuple[int, ...]


@dataclass(frozen=True)
class MessagePlan:
    """A message to decode; `cycle_ns` is the interval that the database states, 0 if it states none.

    With counter and interval a sample's time comes from its number: it is on a grid.
    """

    layout: MessageLayout
    signals: tuple[SignalPlan, ...]
    counter: CounterPlan | None = None
    checksum: ChecksumPlan | None = None
    interval_ns: int | None = None
    cycle_ns: int = 0


@dataclass(frozen=True)
class Route:
    """Frames of one unit: by arbitration id, and if set by channel, by a multiplexer's raw value, by J1939 source.

    The PGN of a J1939 message counts, not priority and source address of its id.
    """

    unit: str
    arbitration_id: int
    message: MessagePlan
    channel: int | None = None
    selector: tuple[str, int] | None = None
    is_j1939: bool = False
    source: int | None = None

    @property
    def key(self) -> int:
        """Key by which frames are looked up."""
        return pgn_key(self.arbitration_id) | OF_PGN if self.is_j1939 else self.arbitration_id


@dataclass(frozen=True)
class CanPlan:
    """The routes of a bus or log, and remarks about database and mapping for the user."""

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

    @property
    def wanted(self) -> frozenset[int] | None:
        """Arbitration ids to ask an interface for; None for all, as J1939 sources are not known beforehand."""
        if any(route.is_j1939 for route in self.routes):
            return None
        return frozenset(route.arbitration_id for route in self.routes)
