"""A station: its place, instruments, buses and slots; a TOML file."""

import datetime as dt
import fcntl
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import msgspec

from ingest.can.bus.interface import CanBusOptions
from ingest.instruments.base import Instrument, Options, instrument_kinds
from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.visa import resource_trouble
from ingest.station.location import StationLocation
from ingest.station_clock import StationClock
from stream.errors import BadInput
from stream.identity import Place, check_name
from stream.toml_text import decode_toml


class ClockTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[clock]`: for a station that is simulated as a whole; see `StationClock`."""

    speed: float = 1.0
    start_ns: int | None = None
    origin_s: float | None = None


class BusTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[buses.NAME]`: a CAN bus with gyros; `dbc` databases and `mapping` (signals of units) lie beside the file."""

    bus: CanBusOptions
    dbc: tuple[str, ...]
    mapping: str


class LineTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[lines.NAME]`: a serial line with one gyro; `layout` is the file that describes its frames."""

    port: str
    baud: int = 115_200
    unit: str
    layout: str


class SlotTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[slots.NAME]`: where a unit is mounted: its fixture, and the instrument that powers it."""

    fixture: str = ""
    power: str | None = None


class StationTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[station]`: names, place on Earth (see `StationLocation`), and time zone (what is "the same day")."""

    site: str
    name: str
    latitude_deg: float | None = None
    altitude_m: float | None = None
    gravity_m_per_s2: float | None = None
    time_zone: str = "UTC"
    simulated: bool = False

    @property
    def location(self) -> StationLocation:
        """Where it stands."""
        return StationLocation(**{name: getattr(self, name) for name in StationLocation.__struct_fields__})


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    station: StationTable
    clock: ClockTable = ClockTable()
    instruments: dict[str, dict[str, Any]] = {}
    buses: dict[str, BusTable] = {}
    lines: dict[str, LineTable] = {}
    slots: dict[str, SlotTable] = {}
    settings: dict[str, str] = {}


class Station(msgspec.Struct, frozen=True, kw_only=True):
    """A station as its file describes it, checked."""

    path: Path  # the file; other files that it names lie beside it
    table: StationTable
    clock: ClockTable
    instruments: Mapping[str, tuple[str, Options]]  # kind and options of every instrument by its name
    buses: Mapping[str, BusTable]
    lines: Mapping[str, LineTable]
    slots: Mapping[str, SlotTable]
    settings: Mapping[str, str]  # instrument of each setting of a procedure: ``{"rate": "table"}``

    def day(self, t_ns: int) -> dt.date:
        """The day at the station."""
        return dt.datetime.fromtimestamp(t_ns / 1e9, ZoneInfo(self.table.time_zone)).date()

    @property
    def place(self) -> Place:
        """Site and station, as samples carry them."""
        return Place(self.table.site, self.table.name)

    def make_clock(self) -> StationClock:
        """The station's clock."""
        return StationClock(self.clock.speed, self.clock.start_ns, self.clock.origin_s)

    def make_instruments(self, clock: StationClock) -> dict[str, Instrument]:
        """Every instrument by its name, not opened yet."""
        kinds = instrument_kinds()
        return {name: kinds[kind](name, options, clock) for name, (kind, options) in self.instruments.items()}

    @contextmanager
    def held(self) -> Iterator[None]:
        """Have the station for one run alone; raises BadInput if another run of this computer has it."""
        with self.path.open("rb") as file:
            with suppress(OSError):  # some file systems have no locks
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise BadInput(
                        f"another gyrofleet run is at work at station {self.table.name} ({self.path}); wait until it "
                        f"has ended, or stop it"
                    ) from None
            yield

    def beside(self, name: str) -> Path:
        """A file that the station file names."""
        return self.path.parent / name

    def overdue(self, first: dt.date, last: dt.date) -> list[str]:
        """Instruments whose calibration ends before the last day of a run, each as a sentence."""
        found = []
        for name, (kind, options) in self.instruments.items():
            if options.calibration_due is None:
                continue
            due = dt.date.fromisoformat(options.calibration_due)
            if due < last:
                serial = f", serial {options.serial}" if options.serial else ""
                word = "was" if due < first else "is"
                during = "" if due < first else ", before the run ends"
                found.append(f"the {kind} {name}{serial} {word} due for calibration on {due}{during}")
        return found


def load_station(path: Path) -> Station:
    """Read a station file; raises BadInput, with the place in it, if it cannot be read or describes no station."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(f"the station file {path} cannot be read: {error.strerror}; give --station FILE") from error
    try:
        file = decode_toml(content, _File)
    except msgspec.MsgspecError as error:
        raise BadInput(f"{path}: {error}") from error
    for what, name in (("site", file.station.site), ("station", file.station.name)):
        check_name(what, name)
    file.station.location.check(lambda field: f"{path}: station.{field}")
    _check_clock(path, file.clock)
    instruments = {name: _options(path, name, table) for name, table in file.instruments.items()}
    slots = {name: _slot(path, name, slot, instruments) for name, slot in file.slots.items()}
    settings = _settings(path, file.settings, instruments)
    return Station(
        path=path, table=file.station, clock=file.clock, instruments=instruments, buses=file.buses, lines=file.lines,
        slots=slots, settings=settings,
    )  # fmt: skip


def _check_clock(path: Path, clock: ClockTable) -> None:
    if not 0.0 < clock.speed <= 1e6:
        raise BadInput(f"{path}: clock.speed is {clock.speed:g}; it is more than 0 and at most 1e6 times real time")
    if clock.speed != 1.0 and (clock.start_ns is None or clock.origin_s is None):
        raise BadInput(
            f"{path}: clock.speed is {clock.speed:g} without clock.start_ns and clock.origin_s: the clocks of two "
            f"processes would not agree; a real station has no [clock]"
        )


def _options(path: Path, name: str, table: dict[str, Any]) -> tuple[str, Options]:
    check_name("instrument", name)
    kinds = instrument_kinds()
    kind = table.get("kind")
    if kind not in kinds:
        known = ", ".join(sorted(kinds))
        raise BadInput(f"{path}: instruments.{name}.kind is {kind!r}; gyrofleet knows {known}")
    # a date without quotes is a TOML date
    rest = {key: value.isoformat() if isinstance(value, dt.date) else value for key, value in table.items()}
    del rest["kind"]
    try:
        options = msgspec.convert(rest, kinds[kind].options_type)
        if options.calibration_due is not None:
            dt.date.fromisoformat(options.calibration_due)
    except (msgspec.ValidationError, ValueError) as error:
        raise BadInput(f"{path}: instruments.{name} (a {kind}): {error}") from error
    if not 0.0 < options.sample_interval_s < float("inf"):
        raise BadInput(
            f"{path}: instruments.{name}.sample_interval_s is {options.sample_interval_s:g}; it is read every so many "
            f"seconds, more than 0"
        )
    if isinstance(options, ScpiOptions) and (trouble := resource_trouble(options.resource)) is not None:
        raise BadInput(f"{path}: instruments.{name}.resource is {options.resource!r}: {trouble}")
    return kind, options


def _slot(path: Path, name: str, slot: SlotTable, instruments: Mapping[str, tuple[str, Options]]) -> SlotTable:
    if slot.power is None:
        return slot
    if slot.power not in instruments:
        raise BadInput(f"{path}: slots.{name}.power is {slot.power!r}, which is no instrument of this station")
    kind, _ = instruments[slot.power]
    if "output" not in instrument_kinds()[kind].settings:
        raise BadInput(f"{path}: slots.{name}.power is {slot.power!r}, a {kind}, which has no output to switch")
    return slot


def _settings(path: Path, given: Mapping[str, str], instruments: Mapping[str, tuple[str, Options]]) -> dict[str, str]:
    """Instrument of each setting: as the file says, else the only one that has it."""
    kinds = instrument_kinds()
    able: dict[str, list[str]] = {}
    for name, (kind, _) in instruments.items():
        for what in kinds[kind].settings:
            able.setdefault(what, []).append(name)
    found: dict[str, str] = {}
    for what, name in given.items():
        if name not in able.get(what, []):
            raise BadInput(f"{path}: settings.{what} is {name!r}; those that can be set to it: {able.get(what, [])}")
        found[what] = name
    for what, names in able.items():
        if what not in found and len(names) == 1:
            found[what] = names[0]
    return found
