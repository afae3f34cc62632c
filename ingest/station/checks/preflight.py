"""Checks before a run at a station: obstacles are found before anything is written."""

import ctypes
import datetime as dt
import shlex
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple

from ingest.instruments.base import Instrument
from ingest.station.checks.room import RunRoom, existing, run_room
from ingest.station.sources import StationSources
from ingest.station.station import Station
from storage.recording.disk_watch import DiskWatch, format_bytes
from storage.segments.disk import DISK, Disk
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import GyrofleetError, InstrumentError

_EARLIEST = dt.datetime(2024, 1, 1, tzinfo=dt.UTC)  # a computer without a battery begins in 1970 or 2000
_CLOCK_TOLERANCE_S = 300.0
_TIME_ERROR = 5  # of adjtimex(2): nothing keeps the clock right


class Preflight(NamedTuple):
    """Identity of each instrument by its name, and warnings that do not prevent the run."""

    instruments: Mapping[str, str]
    warnings: tuple[str, ...]
    room: RunRoom | None = None  # where the store is on this computer
    measured: Mapping[str, Mapping[str, str]] = {}  # by instrument and signal, with the unit of measure


def preflight(
    stack: ExitStack, station: Station, instruments: Mapping[str, Instrument], sources: StationSources, *,
    folders: Sequence[Path], now_ns: int, duration_s: float, store: Path | None = None, recorded_s: float = 0.0,
    waited: Collection[str] = (), disk: Disk = DISK,
) -> Preflight:  # fmt: skip
    """Check instruments, buses, serial lines, disks, clock and calibration dates; all obstacles are reported at once.

    The instruments are asked once for their signals and the settings that are `waited` for, and stay open until the
    stack is left. `folders` will be written; the clock is compared with the newest run of those that are stores.
    `store` is to take `recorded_s` seconds of all sources: that its disk has too little room is a warning, as the
    estimate is rough and room may be made meanwhile. Raises InstrumentError, with every obstacle, if the run could not
    be recorded.
    """
    stops: list[str] = []
    warnings: list[str] = []
    found: dict[str, str] = {}
    measured: dict[str, Mapping[str, str]] = {}
    for name, instrument in instruments.items():
        try:
            found[name] = instrument.open()
        except InstrumentError as error:
            folder = shlex.quote(str(station.path.parent))
            plays = f"; this station is simulated: `gyrofleet simulate {folder}` plays it"
            stops.append(f"{error}{plays if station.table.simulated else ''}")
        else:
            stack.callback(instrument.close)
            try:
                measured[name] = _measured(
                    instrument, [each for each in sorted(waited) if station.settings.get(each) == name]
                )
            except InstrumentError as error:
                stops.append(str(error))
            warnings += [f"{fault}; {what} has no value now" for what, fault in instrument.faults.items()]
    stops += sources.cannot_be_opened()
    stops += filter(None, [_disk_trouble(folder, disk) for folder in folders])
    warnings += station.overdue(station.day(now_ns), station.day(now_ns + round(duration_s * 1e9)))
    if not station.table.simulated:
        stops += filter(None, [_clock_trouble(now_ns, folders)])
        if _clock_state() == _TIME_ERROR:
            warnings.append(
                "nothing keeps the computer's clock right (no NTP or PTP): times of two computers cannot be compared; "
                "`timedatectl set-ntp true` mends it"
            )
    if len(stops) == 1:
        raise InstrumentError(stops[0])
    if stops:
        listed = "".join(f"\n- {stop}" for stop in stops)
        raise InstrumentError(f"{len(stops)} things stand in the way of the run; nothing was written:{listed}")
    room = None
    if store is not None:
        with suppress(OSError):  # an obstacle already
            room = run_room(sources.flows(), recorded_s, store, disk)
            warnings += filter(None, [room.warning])
    return Preflight(found, tuple(f"warning: {warning}" for warning in warnings), room, measured)


def _measured(instrument: Instrument, settings: Sequence[str]) -> dict[str, str]:
    """What an instrument measures now, with units of measure."""
    units = {**instrument.settings, **instrument.signals}
    return {each.signal: f"{each.value:.6g} {units.get(each.signal, '')}" for each in instrument.try_out(settings)}


def _disk_trouble(folder: Path, disk: Disk) -> str | None:
    """Why a folder could not take a run; None where it could."""
    there = existing(folder)
    try:
        reserve = DiskWatch(there, disk).reserve_bytes
        space = disk.space(there)
    except OSError as error:
        return f"the disk of {folder} cannot be looked at: {error.strerror}"
    if space.free >= 2 * reserve:
        return None
    return (
        f"{format_bytes(space.free)} free of {format_bytes(space.total)} on the disk of {folder}, and recording pauses "
        f"below {format_bytes(reserve)}: free space, or give --store on another disk"
    )


def _clock_trouble(now_ns: int, folders: Sequence[Path]) -> str | None:
    """Why the time of day cannot be right; None where it can."""
    now = dt.datetime.fromtimestamp(now_ns / 1e9, dt.UTC)
    shown = f"the computer's clock shows {now:%Y-%m-%d %H:%M} UTC"
    if now < _EARLIEST:
        return f"{shown}: set it, since every sample carries its time"
    for store in folders:
        newest_ns = _newest_ns(store)
        if newest_ns is not None and newest_ns > now_ns + _CLOCK_TOLERANCE_S * 1e9:
            newest = dt.datetime.fromtimestamp(newest_ns / 1e9, dt.UTC)
            return f"{shown}, but {store} has a run of a station that ended {newest:%Y-%m-%d %H:%M} UTC: set the clock"
    return None


def _newest_ns(store: Path) -> int | None:
    """End of the newest run that was measured here; None where there is none, or the store cannot be read."""
    if not (store / "store.json").exists():
        return None
    query = (
        "select epoch_ns(max(ended)) as newest from runs where starts_with(source, 'station ') and not simulated "
        "and date_known"
    )
    try:
        with Catalog(Store.open(store)) as catalog:
            newest: int | None = catalog.rows(query)[0][0]
    except GyrofleetError:
        return None  # opening the store to write reports what is wrong with it
    return newest


def _clock_state() -> int | None:
    """State of the kernel's clock, see adjtimex(2); None where it cannot be read."""
    try:
        library = ctypes.CDLL(None, use_errno=True)
        return int(library.adjtimex(ctypes.create_string_buffer(512)))  # all zero: it is only read
    except (OSError, AttributeError):
        return None
