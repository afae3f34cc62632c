"""A station: its place, instruments, buses and slots; a TOML file."""

import datetime as dt
import fcntl
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar
from zoneinfo import ZoneInfo

import msgspec

from ingest.can.bus.interface import CanBusOptions
from ingest.instruments.base import Instrument, Options, instrument_kinds
from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.visa import resource_trouble
from ingest.measurement_standards import DETAIL, Standard, standards_text
from ingest.station_clock import StationClock
from stream.decoding import converted
from stream.errors import BadInput
from stream.files.toml_text import decode_toml
from stream.identity import Place, check_name
from stream.mistakes import collected, listed, mistakes

Stated = TypeVar("Stated", bound=Standard)
# JJF and GJB stand on Earth: what lies outside is a slip of the unit
_RANGES = {
    "latitude_deg": (-90.0, 90.0, ""),
    "altitude_m": (-5_000.0, 10_000.0, " m"),
    "gravity_m_per_s2": (9.7, 9.9, " m/s^2"),
}


class StationLocation(msgspec.Struct, frozen=True, kw_only=True):
    """Location of a station; what is not known is None."""

    latitude_deg: float | None = None  # geodetic latitude, positive north
    time_zone: str | None = None  # IANA name, such as ``Asia/Shanghai``; it defines "the same day"
    altitude_m: float | None = None  # above the ellipsoid or the sea
    gravity_m_per_s2: float | None = None  # measured value; else it follows from latitude and altitude

    def check(self, named: Callable[[str], str]) -> None:
        """Raise BadInput, with fields as `named` names them, if it is no place on Earth."""
        for name, (least, most, unit) in _RANGES.items():
            if (value := getattr(self, name)) is not None and not least <= value <= most:
                raise BadInput(f"{named(name)} is {value:g}; it lies between {least:g} and {most:g}{unit}")
        try:
            ZoneInfo("UTC" if self.time_zone is None else self.time_zone)
        except (ValueError, KeyError, OSError) as error:
            what = f"{named('time_zone')} is {self.time_zone!r}, which is not known"
            raise BadInput(f"{what}; write it as Asia/Shanghai, or UTC") from error

    @property
    def details(self) -> dict[str, str]:
        """Details in the first document of a run."""
        gravity = self.gravity_m_per_s2
        if gravity is None and self.latitude_deg is not None and self.altitude_m is not None:
            gravity = normal_gravity_m_per_s2(self.latitude_deg, self.altitude_m)
        details = {
            "latitude_deg": None if self.latitude_deg is None else f"{self.latitude_deg:.10g}",
            "time_zone": self.time_zone,
            "altitude_m": None if self.altitude_m is None else f"{self.altitude_m:.10g}",
            "gravity_m_per_s2": None if gravity is None else f"{gravity:.6g}",
        }
        return {name: text for name, text in details.items() if text is not None}


def normal_gravity_m_per_s2(latitude_deg: float, altitude_m: float) -> float:
    """Gravity of the WGS 84 ellipsoid at a height above it (Somigliana's formula, second order in the height).

    >>> [round(normal_gravity_m_per_s2(latitude_deg, 0.0), 6) for latitude_deg in (0.0, 45.0, 90.0)]
    [9.780325, 9.806198, 9.832185]
    """
    square = math.sin(math.radians(latitude_deg)) ** 2
    at_ellipsoid = 9.7803253359 * (1 + 0.00193185265241 * square) / math.sqrt(1 - 0.00669437999013 * square)
    axis_m, flattening, ratio = 6_378_137.0, 1 / 298.257223563, 0.00344978650684
    height = altitude_m / axis_m
    return at_ellipsoid * (1 - 2 * (1 + flattening + ratio - 2 * flattening * square) * height + 3 * height**2)


class ClockTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[clock]`: for a station that is simulated as a whole; see `StationClock`."""

    speed: float = 1.0
    start_ns: int | None = None
    origin_s: float | None = None


class BusTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[buses.NAME]`: a CAN bus with gyros; `dbc` databases and `mapping` (signals of units) lie beside the file."""

    bus: CanBusOptions  # the interface, as below
    dbc: tuple[str, ...]  # databases of its frames, beside the file
    mapping: str  # file that says which frames are of which unit, beside the file


class LineTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[lines.NAME]`: a serial line with one gyro; `layout` is the file that describes its frames."""

    port: str  # of the computer, as /dev/ttyUSB0 or COM3
    baud: int = 115_200  # bits per second
    unit: str  # serial number of its gyro
    layout: str  # file with the layout of its frames, beside the file


class SlotTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[slots.NAME]`: where a unit is mounted: its fixture, and the instrument that powers it."""

    fixture: str = ""  # name of its place, which trends compare
    power: str | None = None  # name of the instrument that powers it


class StationTable(StationLocation, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[station]`: names, place on Earth, and time zone (what is "the same day")."""

    site: str  # plant or laboratory, of which it is one station
    name: str  # of the station
    time_zone: str = "UTC"  # IANA name, such as `Asia/Shanghai`
    simulated: bool = False  # whether its data are simulated; runs, reports and certificates say so
    security: str = ""  # folder of its certificate, beside the file; "mtls" is the folder `security`


class StandardTable(Standard, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[standards.NAME]`: a measurement standard that is not connected: a level, a north reference, a fixture."""


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    station: StationTable
    clock: ClockTable = ClockTable()
    instruments: dict[str, dict[str, Any]] = {}
    standards: dict[str, dict[str, Any]] = {}
    buses: dict[str, BusTable] = {}
    lines: dict[str, LineTable] = {}
    slots: dict[str, SlotTable] = {}
    settings: dict[str, str] = {}
    security: str = ""  # as in [station]


class Station(msgspec.Struct, frozen=True, kw_only=True):
    """A station as its file describes it, checked."""

    path: Path  # the file; other files that it names lie beside it
    table: StationTable
    clock: ClockTable
    instruments: Mapping[str, tuple[str, Options]]  # kind and options of every instrument by its name
    standards: Mapping[str, StandardTable]  # that are not connected
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

    @property
    def all_standards(self) -> dict[str, tuple[str, Standard]]:
        """Kind and statement of every instrument, and of every standard that is not connected, by its name."""
        connected: dict[str, tuple[str, Standard]] = dict(self.instruments)
        return connected | {name: ("", each) for name, each in self.standards.items()}

    @property
    def standards_details(self) -> dict[str, str]:
        """What is stated of its standards, as a detail of a run; empty where nothing is."""
        every = self.all_standards
        is_stated = any(each.serial or each.certificate or each.uncertainty for _, each in every.values())
        return {DETAIL: standards_text(every)} if is_stated else {}

    def make_clock(self) -> StationClock:
        """The station's clock."""
        return StationClock(self.clock.speed, self.clock.start_ns, self.clock.origin_s)

    def make_instruments(self, clock: StationClock) -> dict[str, Instrument]:
        """Every instrument by its name, not opened yet."""
        kinds, found = instrument_kinds(), list[str]()
        made: dict[str, Instrument] = {}
        for name, (kind, options) in self.instruments.items():
            with collected(found):
                made[name] = kinds[kind](name, options, clock)
        if found:
            raise BadInput(f"{self.path}: {listed(found)}")
        return made

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
        """Instruments and standards whose calibration ends before the last day of a run, each as a sentence."""
        found = []
        for name, (kind, standard) in self.all_standards.items():
            if standard.calibration_due is None:
                continue
            due = dt.date.fromisoformat(standard.calibration_due)
            if due < last:
                serial = f", serial {standard.serial}" if standard.serial else ""
                word, during = ("was", "") if due < first else ("is", ", before the run ends")
                found.append(f"the {kind or 'standard'} {name}{serial} {word} due for calibration on {due}{during}")
        return found


def load_station(path: Path) -> Station:
    """Read a station file; raises BadInput, with the place in it, if it cannot be read or describes no station."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(f"the station file {path} cannot be read: {error.strerror}; give --station FILE") from error
    try:
        tree = decode_toml(content, dict[str, Any])
    except msgspec.MsgspecError as error:
        raise BadInput(f"{path}: {error}") from error
    found = list(mistakes(tree, _File))
    wrong = {name for name, kind in _TABLES.items() if name in tree and any(mistakes(tree[name], kind))}
    # what can be read is checked as well
    sound = {name: value for name, value in tree.items() if name in _TABLES and name not in wrong}
    file = converted(_ANYWHERE | sound, _File, is_toml=True)
    instruments: dict[str, tuple[str, Options]] = {}
    standards: dict[str, StandardTable] = {}
    with collected(found):
        if "station" in sound:
            _check_place(file.station)
    with collected(found):
        _check_clock(file.clock)
    for name, table in file.instruments.items():
        with collected(found):
            instruments[name] = _options(name, table)
    with collected(found):
        _check_resources(instruments)
    for name, table in file.standards.items():
        with collected(found):
            standards[name] = _standard(name, table, file.instruments)
    for name, line in file.lines.items():
        if line.baud <= 0:
            found.append(f"lines.{name}.baud is {line.baud}; it is more than 0 bit/s, such as 115200")
    settings: dict[str, str] = {}
    if len(instruments) == len(file.instruments) and "instruments" not in wrong:
        for name, slot in file.slots.items():
            with collected(found):
                _check_power(f"slots.{name}.power is {slot.power!r}", slot.power, instruments)
        with collected(found):
            settings = _settings(file.settings, instruments)
    if found:
        raise BadInput(f"{path}: {listed(found)}")
    return Station(
        path=path, table=file.station, clock=file.clock, instruments=instruments, standards=standards, buses=file.buses,
        lines=file.lines, slots=file.slots, settings=settings,
    )  # fmt: skip


_TABLES = {field.encode_name: field.type for field in msgspec.structs.fields(_File)}
_ANYWHERE = {"station": {"site": "site", "name": "station"}}


def _check_place(station: StationTable) -> None:
    for what, name in (("site", station.site), ("station", station.name)):
        check_name(what, name)
    station.check(lambda field: f"station.{field}")


def _check_clock(clock: ClockTable) -> None:
    if not 0.0 < clock.speed <= 1e6:
        raise BadInput(f"clock.speed is {clock.speed:g}; it is more than 0 and at most 1e6 times real time")
    if clock.speed != 1.0 and (clock.start_ns is None or clock.origin_s is None):
        raise BadInput(
            f"clock.speed is {clock.speed:g} without clock.start_ns and clock.origin_s: the clocks of two "
            f"processes would not agree; a real station has no [clock]"
        )


def _options(name: str, table: dict[str, Any]) -> tuple[str, Options]:
    check_name("instrument", name)
    kinds = instrument_kinds()
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in kinds:
        known = ", ".join(sorted(kinds))
        raise BadInput(f"instruments.{name}.kind is {kind!r}; gyrofleet knows {known}")
    rest = _plain(table)
    del rest["kind"]
    options: Options = _checked(f"instruments.{name} (a {kind})", rest, kinds[kind].options_type)
    if not 0.0 < options.sample_interval_s < float("inf"):
        raise BadInput(
            f"instruments.{name}.sample_interval_s is {options.sample_interval_s:g}; it is read every so many "
            f"seconds, more than 0"
        )
    if isinstance(options, ScpiOptions) and (trouble := resource_trouble(options.resource)) is not None:
        raise BadInput(f"instruments.{name}.resource is {options.resource!r}: {trouble}")
    return kind, options


def _check_resources(instruments: Mapping[str, tuple[str, Options]]) -> None:
    """Refuse two instruments at one address: what is meant for one would be sent to the other."""
    names: dict[str, str] = {}
    for name, (_, options) in instruments.items():
        if isinstance(options, ScpiOptions):
            other = names.setdefault(options.resource.upper(), name)
            if other != name:
                raise BadInput(
                    f"instruments.{other} and instruments.{name} have the same resource, {options.resource}: "
                    f"commands for one would be sent to the other; give each its own"
                )


def _checked(where: str, table: dict[str, Any], kind: type[Stated]) -> Stated:
    """A table as what is stated of a standard; BadInput has each of its mistakes."""
    if wrong := [f"{where}: {each}" for each in mistakes(table, kind)]:
        raise BadInput(*wrong)
    try:
        found = converted(table, kind)
        found.check()
    except (msgspec.ValidationError, ValueError, BadInput) as error:
        raise BadInput(f"{where}: {error}") from error
    return found


def _plain(table: dict[str, Any]) -> dict[str, Any]:
    """A table with dates as texts: a date without quotes is a TOML date."""
    return {key: value.isoformat() if isinstance(value, dt.date) else value for key, value in table.items()}


def _standard(name: str, table: dict[str, Any], instruments: Mapping[str, object]) -> StandardTable:
    check_name("standard", name)
    if name in instruments:
        raise BadInput(f"standards.{name} has the name of an instrument; state its uncertainty there")
    return _checked(f"standards.{name}", _plain(table), StandardTable)


def _check_power(found: str, power: str | None, instruments: Mapping[str, tuple[str, Options]]) -> None:
    if power is not None and power not in instruments:
        raise BadInput(f"{found}, which is no instrument of this station")
    if power is not None and "output" not in instrument_kinds()[instruments[power][0]].settings:
        raise BadInput(f"{found}, a {instruments[power][0]}, which has no output to switch")


def _settings(given: Mapping[str, str], instruments: Mapping[str, tuple[str, Options]]) -> dict[str, str]:
    """Instrument of each setting: as the file says, else the only one that has it."""
    kinds = instrument_kinds()
    able: dict[str, list[str]] = {}
    for name, (kind, _) in instruments.items():
        for what in kinds[kind].settings:
            able.setdefault(what, []).append(name)
    for what, name in given.items():
        if name not in able.get(what, []):
            raise BadInput(f"settings.{what} is {name!r}; those that can be set to it: {able.get(what, [])}")
    return {what: names[0] for what, names in able.items() if len(names) == 1} | dict(given)
