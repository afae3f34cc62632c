"""A connection to an instrument that speaks SCPI, over whatever VISA reaches: TCP, VXI-11, USB, GPIB, serial."""

import os
import re
import select
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any, NamedTuple, TypeVar

import msgspec

from ingest.instruments.base import Options
from ingest.station_clock import StationClock
from stream.errors import BadInput, InstrumentError

Result = TypeVar("Result")

NUMBER = r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*"
_OVERLOAD = 9.9e37  # SCPI-99 7.2.1.4: infinity is 9.9e37, not a number 9.91e37
_MOST_ERRORS = 20  # in its queue, before we believe that it answers the same for ever


class ScpiOptions(Options, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the table of any SCPI instrument may say.

    Parameters
    ----------
    resource: VISA resource: ``TCPIP::192.168.1.20::5025::SOCKET``, ``TCPIP::192.168.1.20::INSTR``,
        ``ASRL/dev/ttyUSB0::INSTR``.
    backend: VISA library: ``@py`` is pyvisa-py, ``bench.yaml@sim`` a simulation; by default a vendor's library where
        one is installed, else pyvisa-py.
    timeout_s: How long it may take to connect, and to answer, seconds of the computer.
    identity: Regular expression that is to be found in its answer to ``*IDN?``; empty for any answer. ``none`` is for
        an instrument that does not know ``*IDN?``.
    check_errors: Whether ``SYST:ERR?`` is asked after each command.
    acknowledgement: Regular expression of the line with which it answers each command; empty where commands are not
        answered.
    read_termination, write_termination: What ends an answer and a command.
    baud_rate: Of a serial line.
    commands: Commands that are worded otherwise than this program does by default, by name.
    answers: Regular expressions, by the name of the query, whose first group is the number in its answer; by default
        the answer is a number and nothing else.
    """

    resource: str
    backend: str = ""
    timeout_s: float = 2.0
    identity: str = ""
    check_errors: bool = True
    acknowledgement: str = ""
    read_termination: str = "\n"
    write_termination: str = "\n"
    baud_rate: int | None = None
    commands: dict[str, str] = msgspec.field(default_factory=dict)
    answers: dict[str, str] = msgspec.field(default_factory=dict)


class Answer(NamedTuple):
    """What an instrument answered.

    Attributes
    ----------
    text: The answer without its termination.
    t_ns: Middle between the request and its answer, on the station's clock.
    round_trip_ns: Between the request and its answer, on the station's clock: `t_ns` is certain to half of it.
    """

    text: str
    t_ns: int
    round_trip_ns: int


class ScpiConnection:
    """One instrument behind a VISA resource.

    A request that fails because the connection does is tried once more over a new connection, so every command must
    be one that may be given twice: ``RATE 10``, never ``RATE UP``. After a failure the connection is closed: an answer
    that comes too late is never taken for that to the next question.

    Parameters
    ----------
    who: What messages call the instrument: ``temperature chamber C1``.
    options: How it is reached.
    clock: The station's clock.
    prepare: Called after each connection, also one that was rebuilt: an instrument that was off has forgotten how it is
        to measure.

    Raises
    ------
    BadInput: If a regular expression of the options is none, or the time-out is not positive.
    """

    def __init__(
        self, who: str, options: ScpiOptions, clock: StationClock, prepare: Callable[[], None] | None = None
    ) -> None:
        self.who = f"{who} at {options.resource}"
        self._options = options
        self._clock = clock
        self._prepare = prepare
        self._resource: Any = None
        self._is_wanted = False
        self._is_busy = False
        self._lock = threading.RLock()
        self.identity = ""
        self.reconnects = 0
        if not 0.0 < options.timeout_s <= 600.0:
            raise BadInput(f"{self.who}: timeout_s is {options.timeout_s}: more than 0 and at most 600 s")
        for name in ("identity", "acknowledgement"):
            checked_pattern(f"{self.who}: {name}", getattr(options, name))

    @property
    def is_connected(self) -> bool:
        """Whether there is a connection at this moment."""
        return self._resource is not None

    def open(self) -> str:
        """Connect anew; the answer to ``*IDN?``.

        Raises
        ------
        InstrumentError: If it cannot be reached or is another one.
        """
        with self._lock:
            self._is_wanted = True
            self._disconnect()
            self._connect()
            return self.identity

    def close(self) -> None:
        """Let go of it; never raises."""
        self._is_wanted = False
        with self._lock:
            self._disconnect()

    def ask(self, query: str) -> Answer:
        """Ask a question.

        Raises
        ------
        InstrumentError: If it does not answer, twice.
        """
        return self._twice(lambda: self._exchange(query), query)

    def number(self, query: str, pattern: str = NUMBER) -> tuple[float, Answer]:
        """Ask for a number: the first group of `pattern`, which the whole answer is to match.

        Raises
        ------
        InstrumentError: If it does not answer, or with what is no number, or says that it cannot measure.
        """
        answer = self.ask(query)
        found = re.fullmatch(pattern, answer.text)
        try:
            value = float(found[1]) if found else None
        except (ValueError, TypeError, IndexError):
            value = None
        if value is None:
            raise InstrumentError(
                f"{self.who}: asked {query!r} it answered {_short(answer.text)}, which is not a number; "
                f"see that the query and its answer's pattern in the station file are those of this instrument"
            )
        if not abs(value) < _OVERLOAD:
            raise InstrumentError(
                f"{self.who}: asked {query!r} it answered {_short(answer.text)}: it is overloaded or cannot measure; "
                f"see its range and its wiring"
            )
        return value, answer

    def command(self, command: str) -> None:
        """Give a command, and see that it was accepted.

        Raises
        ------
        InstrumentError: If it cannot be reached, or refuses.
        """
        self._twice(lambda: self._give(command), command)

    def _give(self, command: str) -> None:
        expected = self._options.acknowledgement
        if expected:
            text = self._exchange(command).text
            if not re.search(expected, text):
                raise InstrumentError(
                    f"{self.who}: given {command!r} it answered {_short(text)} instead of {expected!r}"
                )
        else:
            self._write(command)
        if self._options.check_errors and (errors := self._errors()):
            raise InstrumentError(f"{self.who}: given {command!r} it reports {'; '.join(errors)}; it did not do it")

    def _errors(self) -> list[str]:
        """What is in its queue of errors, which is empty afterwards."""
        errors: list[str] = []
        for _ in range(_MOST_ERRORS):
            text = self._exchange("SYST:ERR?").text.strip()
            code = re.match(r"([-+]?\d+)", text)
            if code is None:
                raise InstrumentError(
                    f"{self.who}: asked 'SYST:ERR?' it answered {_short(text)}, which is no error number; "
                    f"if it does not know this question, say check_errors = false in the station file"
                )
            if int(code[1]) == 0:
                return errors
            errors.append(text)
        return errors

    def _twice(self, do: Callable[[], Result], request: str) -> Result:
        """Do it, and once more over a new connection where the connection fails; one thread at a time."""
        with self._lock:
            return self._twice_alone(do, request)

    def _twice_alone(self, do: Callable[[], Result], request: str) -> Result:
        if not self._is_wanted:
            raise InstrumentError(f"{self.who} is not open: {request!r} was not sent")
        try:
            if self._resource is None:
                self._connect()
                self.reconnects += 1
            return do()
        except _ConnectionFailed:
            self._disconnect()
        if self._is_busy:  # asked while connecting: whoever connects tries again
            raise _ConnectionFailed(f"{self.who}: {request!r} was not answered")
        try:
            self._connect()
            self.reconnects += 1
            return do()
        except _ConnectionFailed:
            self._disconnect()
            raise

    def _connect(self) -> None:
        options = self._options
        milliseconds = max(1, round(options.timeout_s * 1e3))
        was_busy, self._is_busy = self._is_busy, True
        try:
            self._resource = _manager(options.backend).open_resource(options.resource, open_timeout=milliseconds)
            self._resource.timeout = milliseconds
            self._resource.read_termination = options.read_termination
            self._resource.write_termination = options.write_termination
            if options.baud_rate is not None:
                self._resource.baud_rate = options.baud_rate
            if (plain := _socket_of(self._resource)) is not None:
                if refusal := plain.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):  # which pyvisa-py takes for success
                    raise OSError(refusal, os.strerror(refusal))
                plain.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # pyvisa-py cannot set its own attribute
            self._identify()
            if options.check_errors:
                self._write("*CLS")
            if self._prepare is not None:
                self._prepare()
        except InstrumentError:
            self._disconnect()
            raise
        except Exception as error:  # pyvisa-py raises bare ones where it cannot connect
            self._disconnect()
            raise _ConnectionFailed(
                f"{self.who} cannot be reached: {error}; see that it is on, connected, and that nobody else holds it"
            ) from error
        finally:
            self._is_busy = was_busy

    def _identify(self) -> None:
        if self._options.identity == "none":
            self.identity = "not asked who it is"
            return
        self.identity = self._exchange("*IDN?").text.strip()
        if not self.identity or not re.search(self._options.identity, self.identity):
            wanted = repr(self._options.identity) if self._options.identity else "a name"
            raise InstrumentError(
                f"{self.who}: asked '*IDN?' it answered {_short(self.identity)}, expected was {wanted}; "
                f"another instrument is at this address, or the station file expects the wrong one"
            )

    def _disconnect(self) -> None:
        resource, self._resource = self._resource, None
        if resource is not None:
            with suppress(Exception):  # what cannot be closed is gone
                resource.close()

    def _write(self, text: str) -> None:
        try:
            self._look_at_line()
            self._resource.write(text, encoding="latin-1")
        except Exception as error:  # of pyvisa, of the socket, of pyvisa-py itself
            raise _ConnectionFailed(f"{self.who}: {text!r} cannot be sent: {error}") from error

    def _exchange(self, text: str) -> Answer:
        sent_ns = self._clock.now_ns()
        self._write(text)
        try:
            self._await_answer()
            answer = self._resource.read(encoding="latin-1")
        except Exception as error:  # as above
            raise _ConnectionFailed(
                f"{self.who}: {text!r} was not answered within {self._options.timeout_s:g} s: {error}"
            ) from error
        received_ns = self._clock.now_ns()
        return Answer(answer, (sent_ns + received_ns) // 2, received_ns - sent_ns)

    def _look_at_line(self) -> None:
        """Make sure that nothing waits to be read that would be taken for the next answer."""
        plain = _socket_of(self._resource)
        if plain is None:
            return
        from pyvisa.constants import BufferOperation

        self._resource.flush(BufferOperation.discard_read_buffer_no_io)
        if select.select([plain], [], [], 0.0)[0]:
            raise ConnectionResetError("the instrument closed the connection, or spoke without being asked")

    def _await_answer(self) -> None:
        """Wait for the first byte: pyvisa-py spins for the whole time-out where the other side has closed."""
        plain = _socket_of(self._resource)
        if plain is None:
            return
        if not select.select([plain], [], [], self._options.timeout_s)[0]:
            raise TimeoutError("no answer")
        if not plain.recv(1, socket.MSG_PEEK):
            raise ConnectionResetError("the instrument closed the connection")


class _ConnectionFailed(InstrumentError):
    """The line failed, not the instrument: worth a second attempt."""


@cache
def _manager(backend: str) -> Any:
    """The one manager of a VISA library; looking for the libraries of vendors takes a third of a second."""
    import pyvisa

    return pyvisa.ResourceManager(backend)


def checked_pattern(what: str, pattern: str) -> str:
    """Return `pattern` if it is a regular expression.

    Raises
    ------
    BadInput: If it is none.
    """
    try:
        re.compile(pattern)
    except re.error as error:
        raise BadInput(f"{what}: {pattern!r} is not a regular expression: {error}") from None
    return pattern


def _socket_of(resource: Any) -> socket.socket | None:
    """The socket under a raw TCP resource of pyvisa-py; None for every other resource."""
    sessions = getattr(resource.visalib, "sessions", None)
    try:
        found = getattr(sessions[resource.session], "interface", None) if isinstance(sessions, dict) else None
    except KeyError:
        return None
    return found if isinstance(found, socket.socket) else None


def _short(text: str) -> str:
    return repr(text if len(text) <= 80 else text[:77] + "...")
