"""VISA resources: their names, and what the library under them does not do by itself."""

import difflib
import errno
import os
import re
import select
import socket
import time
from functools import cache
from typing import Any

_BUILT_IN = ("TCPIP", "ASRL", "GPIB", "USB")
_INTERFACES = (*_BUILT_IN, "VXI", "PXI", "VICP", "PRLGX-TCPIP", "PRLGX-ASRL")
_EXAMPLES = "TCPIP::192.168.1.20::5025::SOCKET, ASRL/dev/ttyUSB0::INSTR or GPIB0::8::INSTR"


def resource_trouble(resource: str) -> str | None:
    """Why a text cannot be the name of a resource, and what to write; None where it can.

    A name without a colon may be an alias that a vendor's library knows.
    """
    if not resource.strip():
        return f"it is empty; write it as {_EXAMPLES}"
    if ":" not in resource:
        return None
    upper = resource.upper()
    if not upper.startswith(_INTERFACES):
        given = re.split(r"\d*:|/", upper, maxsplit=1)[0]
        near = difflib.get_close_matches(given, _INTERFACES, n=1)
        hint = f"did you mean {near[0]}?" if near else f"write it as {_EXAMPLES}"
        return f"VISA knows no interface {given!r}, {hint}"
    if one_colon := re.fullmatch(r"TCPIP\d*::([^:]+):(\d+)(::\w+)?", upper):
        return f"one colon is before the port, did you mean TCPIP::{one_colon[1].lower()}::{one_colon[2]}::SOCKET?"
    from pyvisa.rname import InvalidResourceName, ResourceName

    try:
        ResourceName.from_string(resource)
    except InvalidResourceName as error:
        # pyvisa does not know every form of the other interfaces
        return f"{error}; write it as {_EXAMPLES}" if upper.startswith(_BUILT_IN) else None
    return None


def serial_port(resource: str) -> str | None:
    """The path of the serial port that a resource is; None of others.

    >>> serial_port("ASRL/dev/ttyUSB0::INSTR"), serial_port("ASRL3::INSTR")
    ('/dev/ttyUSB0', None)
    """
    found = re.fullmatch(r"ASRL(\D.*?)(?:::INSTR)?", resource.strip(), re.IGNORECASE)
    return found and found[1]


@cache
def _manager(backend: str) -> Any:
    """The one manager of a VISA library; the search for vendors' libraries takes a third of a second."""
    import pyvisa

    return pyvisa.ResourceManager(backend)


_LEAST_WAIT_S, _WAIT_TIMES, _FORGETS = 0.05, 1.2, 0.9
_GREETING_S, _MOST_GREETINGS = 0.1, 20


class UnaskedLine(ConnectionResetError):
    """A line came without a query."""


class LineClosed(ConnectionResetError):
    """The instrument has closed the connection."""


class VisaLine:
    """An open VISA resource; all but `close` raise errors of pyvisa, of the socket, or bare ones of pyvisa-py."""

    def __init__(
        self, backend: str, resource: str, timeout_s: float, terminations: tuple[str, str], baud_rate: int | None
    ) -> None:
        self._timeout_s = timeout_s
        self._written_s = self._answered_s = 0.0  # when it was written last, and how long answers take
        milliseconds = max(1, round(timeout_s * 1e3))
        self._resource = _manager(backend).open_resource(resource, open_timeout=milliseconds)
        self._resource.timeout = milliseconds
        self._resource.read_termination, self._resource.write_termination = terminations
        if baud_rate is not None:
            self._resource.baud_rate = baud_rate
        if hasattr(port := getattr(self._session(), "interface", None), "exclusive"):
            self._hold(port)
        self._socket = self._raw_socket()
        if self._socket is not None:
            # pyvisa-py takes a refused connection for success, and cannot set its own attribute
            if refusal := self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                self._resource.close()
                raise OSError(refusal, os.strerror(refusal))
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _hold(self, port: Any) -> None:
        """Have a serial port of pyvisa-py alone; OSError if another process has it."""
        try:
            port.exclusive = True
        except OSError as error:
            self._resource.close()
            raise OSError(errno.EBUSY, "the port is in use by another process, as another run") from error

    def _raw_socket(self) -> socket.socket | None:
        """The socket under a raw TCP resource of pyvisa-py; None for every other resource."""
        found = getattr(self._session(), "interface", None)
        return found if isinstance(found, socket.socket) else None

    def _session(self) -> Any:
        """The session of pyvisa-py; None of another library."""
        sessions = getattr(self._resource.visalib, "sessions", None)
        return sessions.get(self._resource.session) if isinstance(sessions, dict) else None

    def _has_read_more(self) -> bool:
        """Whether pyvisa-py has read more than the answer, but for what ends lines."""
        return bool(bytes(getattr(self._session(), "_pending_buffer", b"")).strip(b"\r\n \t\0"))

    def write(self, text: str) -> None:
        """Send a line, after making sure that no earlier answer waits to be read."""
        if self._socket is not None:
            from pyvisa.constants import BufferOperation

            if self._has_read_more():
                raise UnaskedLine("the instrument sent a line without a query")
            self._resource.flush(BufferOperation.discard_read_buffer_no_io)
            if self._has_more(0.0):
                raise UnaskedLine("the instrument sent a line without a query")
        self._resource.write(text, encoding="latin-1")
        self._written_s = time.monotonic()

    def discard_greeting(self) -> None:
        """Read what it sends by itself within a tenth of a second of the connection, as some terminal servers do."""
        for _ in range(_MOST_GREETINGS):
            if not self._has_more(_GREETING_S):
                return
            self._resource.read(encoding="latin-1")

    def is_closed(self, within_s: float) -> bool:
        """Whether the instrument has closed the connection, or does so within some time."""
        try:
            self._has_more(within_s)
        except LineClosed:
            return True
        return False

    def is_in_step(self, most_s: float) -> bool:
        """Whether no further line comes in the time that an answer takes, at most `most_s`.

        One that does is the answer to a query that a surplus line has been taken for. Lines that are no raw TCP
        connections pair queries and answers themselves, or cannot be waited for.
        """
        return not self._has_more(min(max(_LEAST_WAIT_S, _WAIT_TIMES * self._answered_s), most_s))

    def _has_more(self, within_s: float) -> bool:
        """Whether anything comes within some time; LineClosed if the instrument has closed the connection."""
        if self._has_read_more():
            return True
        if self._socket is None or not select.select([self._socket], [], [], within_s)[0]:
            return False
        if not self._socket.recv(1, socket.MSG_PEEK):
            raise LineClosed("the instrument closed the connection")
        return True

    def read(self) -> str:
        """Read a line."""
        if self._socket is not None:
            # pyvisa-py spins for the whole time-out where the other side has closed
            if not select.select([self._socket], [], [], self._timeout_s)[0]:
                raise TimeoutError("no answer")
            if not self._socket.recv(1, socket.MSG_PEEK):
                raise LineClosed("the instrument closed the connection")
        found = str(self._resource.read(encoding="latin-1"))
        self._answered_s = max(_FORGETS * self._answered_s, time.monotonic() - self._written_s)
        return found

    def close(self) -> None:
        """Close it."""
        self._resource.close()
