"""Who uses which serial device, in the files of stations: one device has one user."""

from collections.abc import Mapping

from ingest.instruments.scpi import ScpiOptions
from ingest.instruments.visa import serial_port
from ingest.serial.serial_line import device_of
from ingest.station.station import LineTable, Station
from stream.errors import BadInput


class SerialDevices:
    """The users of serial devices by station file; `add` raises BadInput for the second user of a device."""

    def __init__(self) -> None:
        self._users: dict[str, tuple[str, str, str]] = {}

    def add(self, station: Station, lines: Mapping[str, LineTable]) -> None:
        """Add these lines of a station and its instruments, by whichever path they name their devices."""
        here = str(station.path)
        ports = [(f"lines.{name}", line.port) for name, line in lines.items()]
        for name, (_, options) in station.instruments.items():
            if isinstance(options, ScpiOptions) and (port := serial_port(options.resource)) is not None:
                ports.append((f"instruments.{name}", port))
        for user, port in ports:
            path, other, other_port = self._users.setdefault(device_of(port), (here, user, port))
            if (path, other) != (here, user):
                whose = other if path == here else f"{other} of {path}"
                named = port if port == other_port else f"{other_port} and {port}"
                raise BadInput(
                    f"{here}: {whose} and {user} are on one serial device, {named}: each would take part of what "
                    "comes; give each its own"
                )
