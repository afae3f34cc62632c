"""Serves simulated instruments on TCP, each at its own port."""

import socket
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Self

from ingest.simulator.scpi.device import DeviceFault, SimulatedDevice
from stream.errors import BadInput

_LONGEST_LINE = 65536


class ScpiServer:
    r"""Several simulated instruments in one process; raises BadInput if a port is taken.

    >>> from ingest.simulator.scpi.chamber import SimulatedChamber
    >>> from ingest.station_clock import StationClock
    >>> with ScpiServer({"C1": SimulatedChamber(StationClock())}) as server:
    ...     with socket.create_connection((server.host, server.port("C1"))) as line:
    ...         _ = line.sendall(b"*IDN?\n")
    ...         line.recv(100)
    b'GYROFLEET,SIMULATED CHAMBER,0,1\n'
    """

    host = "127.0.0.1"

    def __init__(self, devices: Mapping[str, SimulatedDevice], ports: Mapping[str, int] | None = None) -> None:
        self.devices = dict(devices)
        self._ports = {name: (ports or {}).get(name, 0) for name in devices}
        self._outlets: dict[str, _Outlet] = {}
        try:
            for name in self.devices:
                self.plug(name)
        except BaseException:
            self.close()
            raise

    def port(self, name: str) -> int:
        """Port of an instrument."""
        return self._ports[name]

    def resource(self, name: str) -> str:
        """VISA resource of an instrument."""
        return f"TCPIP::{self.host}::{self.port(name)}::SOCKET"

    def plug(self, name: str) -> None:
        """Plug an instrument in, at the port it had before."""
        if name in self._outlets:
            return
        try:
            outlet = _Outlet(self.devices[name], self.host, self._ports[name])
        except OSError as error:
            what = f"simulated instrument {name} cannot listen at {self.host}:{self._ports[name]}"
            raise BadInput(f"{what}: {error}; choose another port") from error
        self._ports[name] = outlet.port
        self._outlets[name] = outlet

    def unplug(self, name: str) -> None:
        """Unplug an instrument: its connections break, and it cannot be reached."""
        if outlet := self._outlets.pop(name, None):
            outlet.close()

    def close(self) -> None:
        """Unplug all."""
        for name in list(self._outlets):
            self.unplug(name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Outlet:
    """One instrument's port, and a thread for it and for each connection."""

    def __init__(self, device: SimulatedDevice, host: str, port: int) -> None:
        self._device = device
        self._listener = socket.create_server((host, port))
        self.port = int(self._listener.getsockname()[1])
        self._is_closed = False
        self._lock = threading.Lock()
        self._lines: dict[socket.socket, threading.Thread] = {}
        self._thread = threading.Thread(target=self._accept, name=f"scpi {self.port}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        with self._lock:
            self._is_closed = True
            lines = dict(self._lines)
        for each in (self._listener, *lines):
            with suppress(OSError):  # wakes the thread that waits on it
                each.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for thread in (self._thread, *lines.values()):
            thread.join(5.0)

    def _accept(self) -> None:
        while True:
            try:
                line, _ = self._listener.accept()
            except OSError:
                return
            with self._lock:
                if self._is_closed:
                    line.close()
                    return
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                thread = threading.Thread(target=self._serve, args=(line,), name=f"scpi {self.port} line", daemon=True)
                self._lines[line] = thread
                thread.start()

    def _serve(self, line: socket.socket) -> None:
        try:
            with suppress(OSError), line, line.makefile("rb") as incoming:
                while text := incoming.readline(_LONGEST_LINE):
                    if self._device.fault is DeviceFault.DROP:
                        self._device.fault = DeviceFault.NONE
                        return
                    answer = self._device.handle(text.decode("latin-1").strip())
                    if answer is not None:
                        line.sendall(answer.encode("latin-1") + b"\n")
        finally:
            with self._lock:
                self._lines.pop(line, None)
