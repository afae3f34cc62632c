"""A connection to an instrument that speaks SCPI over VISA: TCP, VXI-11, USB, GPIB, serial."""

import re
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple, TypeVar

import msgspec

from ingest.instruments.base import Options
from ingest.instruments.visa import UnaskedLine, VisaLine
from ingest.station_clock import StationClock
from stream.errors import BadInput, InstrumentError

Result = TypeVar("Result")

NUMBER = r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*"
_OVERLOAD = 9.9e37  # SCPI-99 7.2.1.4: infinity is 9.9e37, not a number 9.91e37
_CLOSING_S = 0.05  # within which an instrument closes the connection that does so after each answer
_MOST_ERRORS = 20  # in its queue; after these the same answer would be repeated endlessly


class ScpiOptions(Options, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of the table of any SCPI instrument.

    `backend` is the VISA library: ``@py`` is pyvisa-py, ``bench.yaml@sim`` a simulation; by default a vendor's library
    where one is installed, else pyvisa-py. `identity` is a regular expression to be found in its answer to ``*IDN?``:
    empty for any answer, ``none`` for an instrument without ``*IDN?``. `answers` are regular expressions by the name of
    the query, whose first group is the number; by default the answer is a number and nothing else.
    """

    resource: str  # ``TCPIP::192.168.1.20::5025::SOCKET``, ``TCPIP::192.168.1.20::INSTR``, ``ASRL/dev/ttyUSB0::INSTR``
    backend: str = ""  # VISA library
    timeout_s: float = 2.0  # time to connect and to answer, seconds of the computer
    identity: str = ""  # regular expression in the answer to ``*IDN?``
    check_errors: bool = True  # whether ``SYST:ERR?`` is asked after each command
    acknowledgement: str = ""  # regular expression of the line with which it answers each command; empty if it does not
    read_termination: str = "\n"  # end of its answers
    write_termination: str = "\n"  # end of commands
    baud_rate: int | None = None  # of a serial line
    commands: dict[str, str] = msgspec.field(default_factory=dict)  # commands that differ from the default, by name
    answers: dict[str, str] = msgspec.field(default_factory=dict)  # regular expressions by the name of the query


class UnusableAnswer(InstrumentError):
    """An answer that gives no value; the connection is in order."""


class NoNumber(UnusableAnswer):
    """An answer that is no number."""


class ScpiAnswer(NamedTuple):
    """An answer without its termination."""

    text: str
    t_ns: int  # middle between the query and its answer, on the station's clock
    round_trip_ns: int  # time between the query and its answer; the uncertainty of `t_ns` is half of it


class ScpiConnection:
    """One instrument behind a VISA resource.

    A request that fails because the connection does is repeated once over a new connection, so every command must be
    repeatable: ``RATE 10``, never ``RATE UP``. After a failure the connection is closed, so that a late answer is never
    taken for that to the next query. The methods raise InstrumentError if it cannot be reached or refuses. Raises
    BadInput if a regular expression of the options is invalid, or the time-out is not positive. `prepare` is called
    after each connection, also a rebuilt one: an instrument that was off has lost its configuration.
    """

    def __init__(
        self, who: str, options: ScpiOptions, clock: StationClock, prepare: Callable[[], None] | None = None
    ) -> None:
        self.who = f"{who} at {options.resource}"
        self._options, self._clock, self._prepare = options, clock, prepare
        self._line: VisaLine | None = None
        self._is_wanted = False
        self._is_connecting = False
        self._closes = False  # the connection after an answer: what follows the identity needs another one
        self._lock = threading.RLock()
        self.identity = ""
        self.reconnects = 0
        self.unasked = 0  # lines that came without a query
        if not 0.0 < options.timeout_s <= 600.0:
            raise BadInput(f"{self.who}: timeout_s is {options.timeout_s}: more than 0 and at most 600 s")
        if options.baud_rate is not None and options.baud_rate <= 0:
            raise BadInput(f"{self.who}: baud_rate is {options.baud_rate}; it is more than 0 bit/s, such as 9600")
        for name in ("identity", "acknowledgement"):
            checked_pattern(f"{self.who}: {name}", getattr(options, name))

    def open(self) -> str:
        """Connect; returns the answer to ``*IDN?``."""
        with self._lock:
            self._is_wanted = True
            self._disconnect()
            self._connect()
            return self.identity

    def close(self) -> None:
        """Disconnect; never raises."""
        self._is_wanted = False
        with self._lock:
            self._disconnect()

    def ask(self, query: str) -> ScpiAnswer:
        """Send a query."""
        return self._twice(lambda: self._exchange(query), query)

    def number(self, query: str, pattern: str = NUMBER) -> tuple[float, ScpiAnswer]:
        """Query a number: the first group of `pattern`, which must match the whole answer."""
        answer = self.ask(query)
        found = re.fullmatch(pattern, answer.text)
        try:
            value = float(found[1]) if found else None
        except (ValueError, TypeError, IndexError):
            value = None
        if value is None:
            raise NoNumber(
                f"{self.who}: asked {query!r} it answered {_short(answer.text)}, which is not a number; "
                f"check the query and its answer's pattern in the station file"
            )
        if not abs(value) < _OVERLOAD:
            raise UnusableAnswer(
                f"{self.who}: asked {query!r} it answered {_short(answer.text)}: it is overloaded or cannot measure; "
                f"check its range and its wiring"
            )
        return value, answer

    def check_in_step(self, most_s: float) -> None:
        """Raise InstrumentError, and disconnect, if a line comes without a query; waits `most_s` for it at most."""
        with self._lock:
            try:
                if self._line is None or self._line.is_in_step(most_s):
                    return
            except OSError:  # closed: the next request connects again
                return
            self._disconnect()
        raise InstrumentError(
            f"{self.who} sent one line more than it was asked for: what it answered last may belong to other queries, "
            "and is left out"
        )

    def command(self, command: str) -> None:
        """Send a command, and check that it was accepted."""
        self._twice(lambda: self._give(command), command)

    def _give(self, command: str) -> None:
        expected = self._options.acknowledgement
        if not expected:
            self._write(command)
        elif not re.search(expected, text := self._exchange(command).text):
            raise InstrumentError(f"{self.who}: given {command!r} it answered {_short(text)} instead of {expected!r}")
        if self._options.check_errors and (errors := self._errors()):
            raise InstrumentError(f"{self.who}: given {command!r} it reports {'; '.join(errors)}; it did not do it")

    def _errors(self) -> list[str]:
        """The contents of its error queue, which is empty afterwards."""
        errors: list[str] = []
        while len(errors) < _MOST_ERRORS:
            text = self._exchange("SYST:ERR?").text.strip()
            code = re.match(r"([-+]?\d+)", text)
            if code is None:
                raise InstrumentError(
                    f"{self.who}: asked 'SYST:ERR?' it answered {_short(text)}, which is no error number; "
                    f"if it does not know this query, say check_errors = false in the station file"
                )
            if int(code[1]) == 0:
                break
            errors.append(text)
        return errors

    def _twice(self, do: Callable[[], Result], request: str) -> Result:
        """Do it, and once more over a new connection where the connection fails; one thread at a time."""
        with self._lock:
            if not self._is_wanted:
                raise InstrumentError(f"{self.who} is not open: {request!r} was not sent")
            try:
                return self._once(do)
            except _ConnectionFailed:
                self._disconnect()
            if self._is_connecting:  # the caller of `_connect` repeats
                raise _ConnectionFailed(f"{self.who}: {request!r} was not answered")
            try:
                return self._once(do)
            except _ConnectionFailed:
                self._disconnect()
                raise

    def _once(self, do: Callable[[], Result]) -> Result:
        if self._line is None:
            self._connect()
            self.reconnects += 1
        return do()

    def _connect(self) -> None:
        options = self._options
        was_connecting, self._is_connecting = self._is_connecting, True
        try:
            self._line = self._new_line()
            self._line.discard_greeting()
            self._identify()
            self._closes = self._line.is_closed(_CLOSING_S)
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
                f"{self.who} cannot be reached: {error}; check that it is on, connected, and in no other use"
            ) from error
        finally:
            self._is_connecting = was_connecting

    def _new_line(self) -> VisaLine:
        options = self._options
        terminations = options.read_termination, options.write_termination
        return VisaLine(options.backend, options.resource, options.timeout_s, terminations, options.baud_rate)

    def _identify(self) -> None:
        if self._options.identity == "none":
            self.identity = "without identity"
            return
        self.identity = self._exchange("*IDN?").text.strip()
        if not self.identity or not re.search(self._options.identity, self.identity):
            wanted = repr(self._options.identity) if self._options.identity else "a name"
            raise InstrumentError(
                f"{self.who}: asked '*IDN?' it answered {_short(self.identity)}, expected was {wanted}; "
                f"another instrument is at this address, or the station file expects the wrong one"
            )

    def _disconnect(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            with suppress(Exception):  # a connection that cannot be closed is broken
                line.close()

    def _write(self, text: str) -> None:
        assert self._line is not None
        try:
            if self._closes and self._is_connecting and self._line.is_closed(_CLOSING_S):
                self._disconnect()
                self._line = self._new_line()
            self._line.write(text)
        except Exception as error:
            self.unasked += isinstance(error, UnaskedLine)
            raise _ConnectionFailed(f"{self.who}: {text!r} cannot be sent: {error}") from error

    def _exchange(self, text: str) -> ScpiAnswer:
        assert self._line is not None
        sent_ns = self._clock.now_ns()
        self._write(text)
        try:
            answer = self._line.read()
        except Exception as error:
            raise _ConnectionFailed(
                f"{self.who}: {text!r} was not answered within {self._options.timeout_s:g} s: {error}"
            ) from error
        received_ns = self._clock.now_ns()
        return ScpiAnswer(answer, (sent_ns + received_ns) // 2, received_ns - sent_ns)


class _ConnectionFailed(InstrumentError):
    """The connection failed, not the instrument: a second attempt may succeed."""


def checked_pattern(what: str, pattern: str, *, has_group: bool = False) -> str:
    """Return `pattern` if it is a regular expression, with a group where one is needed."""
    try:
        groups = re.compile(pattern).groups
    except re.error as error:
        raise BadInput(f"{what}: {pattern!r} is not a regular expression: {error}") from None
    if has_group and not groups:
        raise BadInput(f"{what}: {pattern!r} has no group: put parentheses round the number, as in 'V=(.*) D/S'")
    return pattern


def _short(text: str) -> str:
    return repr(text if len(text) <= 80 else text[:77] + "...")
