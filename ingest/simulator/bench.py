"""The instruments of a simulated station, and their motion in the process of the gyros.

The course of an instrument is an exact function of time. The instruments' process therefore sends courses, not samples:
the course before the time that an answer states does not change any more.
"""

import json
import socket
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ingest.simulator.physics.positions import CarriedEnvironment, mounting_of
from ingest.simulator.scpi.chamber import SimulatedChamber
from ingest.simulator.scpi.device import SimulatedDevice
from ingest.simulator.scpi.electrical import SimulatedSupply
from ingest.simulator.scpi.tables import SimulatedRateTable, SimulatedVibrationTable
from ingest.simulator.scpi.timeline import Segment
from ingest.station_clock import StationClock
from stream.batch import IntArray
from stream.errors import InstrumentError

_PATIENCE_S = 5.0


class SimulatedBench(NamedTuple):
    """Chamber, rate table with an angular-vibration table on top, and supply."""

    chamber: SimulatedChamber
    table: SimulatedRateTable
    vibration: SimulatedVibrationTable
    supply: SimulatedSupply

    @classmethod
    def at(cls, clock: StationClock, positions: Sequence[str] = ()) -> "SimulatedBench":
        """New instruments on a clock; the table carries the units to these positions by itself."""
        tables = SimulatedRateTable(clock, positions=positions), SimulatedVibrationTable(clock)
        return cls(SimulatedChamber(clock), *tables, SimulatedSupply(clock))

    @property
    def named(self) -> dict[str, SimulatedDevice]:
        """The instruments by their names in the station's file."""
        return self._asdict()

    def environment(self, latitude_deg: float, position: str, interval_ns: int = 0) -> CarriedEnvironment:
        """Environment of the units: both tables turn about the same axis, inside the chamber.

        The units stand in `position` until the table carries them to another. With `interval_ns` values are those of
        the intervals of this length before the times.
        """
        mounting_of(position)

        def positions(t_ns: IntArray) -> tuple[tuple[str, ...], IntArray]:
            names, which = self.table.positions(t_ns)
            return tuple(name or position for name in names), which

        return CarriedEnvironment(
            latitude_deg, positions, temperature_deg_c=self.chamber.temperature_deg_c,
            rate_deg_per_s=lambda t_ns: self.table.rate_deg_per_s(t_ns) + self.vibration.rate_deg_per_s(t_ns),
            angle_deg=lambda t_ns: self.table.angle_deg(t_ns) + self.vibration.angle_deg(t_ns),
            interval_ns=interval_ns,
        )  # fmt: skip


class CourseDevice(SimulatedDevice):
    """Answers with the courses of simulated instruments since given times; served beside the instruments.

    >>> from ingest.simulator.scpi.server import ScpiServer
    >>> clock = StationClock(speed=1000.0)
    >>> real, copy = (SimulatedRateTable(clock, ripple_deg_per_s=0.0) for _ in range(2))
    >>> with ScpiServer({"world": CourseDevice(clock, {"table": real})}) as server:
    ...     with CourseClient(server.host, server.port("world"), {"table": copy}) as client:
    ...         real.handle("RATE:SETP 20")
    ...         clock.sleep(10.0)
    ...         now_ns = client.update()
    >>> float(copy.rate_deg_per_s(now_ns)), float(copy.angle_deg(now_ns)) == float(real.angle_deg(now_ns))
    (20.0, True)
    """

    def __init__(self, clock: StationClock, devices: Mapping[str, SimulatedDevice]) -> None:
        super().__init__("GYROFLEET,SIMULATED COURSES,0,1", clock, {}, {})
        self._courses = {name: device.course for name, device in devices.items() if device.course is not None}

    def handle(self, line: str) -> str:
        """Answer a line of JSON, times by instrument, with the time now and the segments from those times on."""
        since = json.loads(line)
        found = {name: course.since(since.get(name, 0)) for name, course in self._courses.items()}
        now_ns = min(now_ns for now_ns, _ in found.values())
        return json.dumps({"now_ns": now_ns, "courses": {name: segments for name, (_, segments) in found.items()}})


class CourseClient:
    """Updates copies of instruments, by the same names, with the courses of those in another process."""

    def __init__(self, host: str, port: int, copies: Mapping[str, SimulatedDevice]) -> None:
        self._copies = dict(copies)
        self._since = dict.fromkeys(copies, 0)
        try:
            self._socket = socket.create_connection((host, port), timeout=_PATIENCE_S)
        except OSError as error:
            raise InstrumentError(
                f"the simulated instruments cannot be reached at {host}:{port}: {error}; is their process running?"
            ) from error
        self._lines = self._socket.makefile("rb")

    def update(self) -> int:
        """Update the copies; returns the time up to which they are valid, nanoseconds."""
        try:
            self._socket.sendall(json.dumps(self._since).encode() + b"\n")
            answer: dict[str, Any] = json.loads(self._lines.readline() or b"null") or {}
        except OSError as error:
            raise InstrumentError(f"the simulated instruments do not answer: {error}") from error
        if not answer:
            raise InstrumentError("the process of the simulated instruments has ended")
        for name, segments in answer["courses"].items():
            course = self._copies[name].course
            assert course is not None
            kind = type(course.now)
            course.follow([Segment(start_ns, kind(*state)) for start_ns, state in segments])
            self._since[name] = answer["now_ns"]
        return int(answer["now_ns"])

    def close(self) -> None:
        """Disconnect."""
        self._lines.close()
        self._socket.close()

    def __enter__(self) -> "CourseClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
