"""Base class of simulated SCPI instruments: headers, the error queue, and faults on demand."""

import re
import threading
from collections import deque
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any, TypeVar

from ingest.simulator.scpi.timeline import Timeline
from ingest.station_clock import StationClock
from stream.batch import FloatArray

Given = TypeVar("Given")
Handler = Callable[[str], str | None]


class DeviceFault(StrEnum):
    """Faults of a simulated instrument."""

    NONE = "NONE"
    DROP = "DROP"  # the connection closes at the next line, once
    REFUSE = "REFUSE"  # commands are refused with an error
    UNSETTLED = "UNSETTLED"  # commands are accepted and do nothing
    GARBAGE = "GARBAGE"  # answers are unreadable
    SILENT = "SILENT"  # there are no answers


class Refused(Exception):
    """A command that puts an error into the instrument's queue."""


class SimulatedDevice:
    """One simulated instrument, given a line at a time; of its headers ``TEMPerature:SETPoint`` matches TEMP:SETP too.

    >>> device = SimulatedDevice("GYROFLEET,NOTHING,0,1", StationClock(), {}, {"TEMPerature:ACTual?": lambda: "25.0"})
    >>> device.handle("temp:act?;*idn?")
    '25.0;GYROFLEET,NOTHING,0,1'
    >>> device.handle("VOLT 5")
    >>> device.handle("SYST:ERR?")
    '-113,"Undefined header"'
    >>> device.handle("SYST:ERR?")
    '0,"No error"'
    """

    course: Timeline[Any] | None = None

    def __init__(
        self, identity: str, clock: StationClock, settings: Mapping[str, Callable[[float], None]],
        queries: Mapping[str, Callable[[], str]], words: Mapping[str, Callable[[str], None]] | None = None,
    ) -> None:  # fmt: skip
        self.clock, self.identity = clock, identity
        self.fault = DeviceFault.NONE
        self.lines: deque[str] = deque(maxlen=1000)
        self._errors: deque[str] = deque(maxlen=20)
        self._lock = threading.Lock()
        self._settings = [(_header(name), handler) for name, handler in settings.items()]
        self._words = [(_header(name), handler) for name, handler in (words or {}).items()]
        common = {
            "*IDN?": lambda: self.identity,
            "*OPC?": lambda: "1",
            "SYSTem:ERRor[:NEXT]?": lambda: self._errors.popleft() if self._errors else '0,"No error"',
            "SIMulation:FAULt?": lambda: self.fault.value,
        }
        self._queries = [(_header(name), handler) for name, handler in {**common, **queries}.items()]

    def now(self, quantity: Callable[[int], FloatArray], decimals: int) -> str:
        """The present value of a quantity, as an answer."""
        return f"{single(quantity(self.clock.now_ns())):.{decimals}f}"

    def handle(self, line: str) -> str | None:
        """Execute a line; returns the answer, if there is one."""
        with self._lock:
            self.lines.append(line)
            parts = [self._part(part.strip().lstrip(":")) for part in line.split(";")]
        answers = [answer for answer in parts if answer is not None]
        if not answers or self.fault is DeviceFault.SILENT:
            return None
        return "\x07?garbage\xb0" if self.fault is DeviceFault.GARBAGE else ";".join(answers)

    def _part(self, text: str) -> str | None:
        header, _, parameter = text.partition(" ")
        for pattern, query in self._queries:
            if pattern.fullmatch(header):
                return query()
        try:
            self._do(header, parameter.strip())
        except Refused as refused:
            self._errors.append(str(refused))
        return None

    def _do(self, header: str, parameter: str) -> None:
        if header.upper() in {"", "*CLS"}:
            self._errors.clear()
            return
        if _FAULT.fullmatch(header):
            if parameter.upper() not in DeviceFault.__members__:
                raise Refused('-224,"Illegal parameter value"')
            self.fault = DeviceFault(parameter.upper())
            return
        for pattern, setting in self._settings:
            if not pattern.fullmatch(header):
                continue
            try:
                value = float({"ON": "1", "OFF": "0"}.get(parameter.upper(), parameter))
            except ValueError:
                raise Refused('-104,"Data type error"') from None
            self._unless_at_fault(setting, value)
            return
        for pattern, take in self._words:
            if pattern.fullmatch(header):
                self._unless_at_fault(take, parameter)
                return
        raise Refused('-113,"Undefined header"')

    def _unless_at_fault(self, do: Callable[[Given], None], given: Given) -> None:
        if self.fault is DeviceFault.REFUSE:
            raise Refused('-221,"Settings conflict;door open"')
        if self.fault is not DeviceFault.UNSETTLED:
            do(given)


def within(value: float, low: float, high: float) -> float:
    """Return a parameter within its range; any other is refused."""
    if not low <= value <= high:
        raise Refused('-222,"Data out of range"')
    return value


def single(values: FloatArray) -> float:
    """The one value of a quantity at one time."""
    return float(values.reshape(()))


def _header(name: str) -> re.Pattern[str]:
    """Regular expression of a header: capitals are its short form, brackets are optional."""
    words = re.sub(
        r"([A-Z]+)([a-z]+)", r"\1(?:\2)?", re.sub(r"([*?])", r"\\\1", name).replace("[", "(~").replace("]", ")?")
    )
    return re.compile(words.replace("(~", "(?:"), re.IGNORECASE)


_FAULT = _header("SIMulation:FAULt")
