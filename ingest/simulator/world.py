"""What acts on simulated gyros, told from the process of the instruments to that of the gyros.

The instruments' courses are exact functions of time, so it is these that are told and not samples of them: what
happened up to the moment that an answer states will not change any more, and can be computed for any time before.
"""

import json
import socket
import socketserver
import threading
from collections.abc import Mapping
from typing import Any

from ingest.simulator.scpi.device import SimulatedDevice
from ingest.simulator.timeline import Stretch
from stream.errors import InstrumentError

_PATIENCE_S = 5.0


class WorldServer:
    """Tells the courses of simulated instruments to whoever asks.

    Parameters
    ----------
    devices: By name; those without a course are left out.
    port: Where to listen, on the loopback; any free one by default.

    Examples
    --------
    >>> from ingest.simulator.scpi.rate_table import SimulatedRateTable
    >>> from ingest.station_clock import StationClock
    >>> clock = StationClock(speed=1000.0)
    >>> real, copy = (SimulatedRateTable(clock, ripple_deg_per_s=0.0) for _ in range(2))
    >>> with WorldServer({"table": real}) as server, World("127.0.0.1", server.port, {"table": copy}) as world:
    ...     real.handle("RATE:SETP 20")
    ...     clock.sleep(10.0)
    ...     now_ns = world.look()
    >>> float(copy.rate_deg_per_s(now_ns)), float(copy.angle_deg(now_ns)) == float(real.angle_deg(now_ns))
    (20.0, True)
    """

    def __init__(self, devices: Mapping[str, SimulatedDevice], port: int = 0) -> None:
        courses = {name: device.course for name, device in devices.items() if device.course is not None}

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                for line in self.rfile:
                    since = json.loads(line)
                    told = {name: course.since(since.get(name, 0)) for name, course in courses.items()}
                    answer = {
                        "now_ns": min(now_ns for now_ns, _ in told.values()),
                        "courses": {name: stretches for name, (_, stretches) in told.items()},
                    }
                    self.wfile.write(json.dumps(answer).encode() + b"\n")

        class Server(socketserver.ThreadingTCPServer):
            allow_reuse_address = True
            daemon_threads = True

        self._server = Server(("127.0.0.1", port), Handler)
        self.port: int = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, name="gyrofleet-world", daemon=True).start()

    def close(self) -> None:
        """Tell no more."""
        self._server.shutdown()
        self._server.server_close()

    def __enter__(self) -> "WorldServer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class World:
    """Copies of instruments in another process, which follow them.

    Parameters
    ----------
    host, port: Where they are told.
    copies: Made like the originals, by the same names.

    Raises
    ------
    InstrumentError: If nobody tells them there.
    """

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

    def look(self) -> int:
        """Let the copies follow; the time up to which they do, nanoseconds.

        Raises
        ------
        InstrumentError: If the process of the instruments has ended.
        """
        try:
            self._socket.sendall(json.dumps(self._since).encode() + b"\n")
            answer: dict[str, Any] = json.loads(self._lines.readline() or b"null") or {}
        except OSError as error:
            raise InstrumentError(f"the simulated instruments do not answer: {error}") from error
        if not answer:
            raise InstrumentError("the process of the simulated instruments has ended")
        for name, told in answer["courses"].items():
            course = self._copies[name].course
            assert course is not None
            kind = type(course.now)
            course.follow([Stretch(start_ns, kind(*state)) for start_ns, state in told])
            self._since[name] = answer["now_ns"]
        return int(answer["now_ns"])

    def close(self) -> None:
        """Follow no more."""
        self._lines.close()
        self._socket.close()

    def __enter__(self) -> "World":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
