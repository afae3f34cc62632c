"""Readers of CAN logs in text: python-can's, and what it leaves out of ASC, TRC and candump.

A line that cannot be read costs that line and is counted, the first frame of an ASC is not lost with its header, times
that are differences are added up, and the time of day in a header is of a time zone.
"""

import io
import itertools
import re
from collections import deque
from datetime import datetime, timedelta, tzinfo
from decimal import Decimal
from pathlib import Path
from typing import Any, cast
from zoneinfo import ZoneInfo

import can
from can.io.asc import ASC_MESSAGE_REGEX
from can.util import dlc2len

_MOST_TEXT = 60
_MOST_AHEAD = 20  # lines
_CANDUMP = re.compile(
    r"\(([0-9.e+]+|nan|inf)\)\s+\S+\s+[0-9A-Fa-f]{1,8}#(#[0-9A-Fa-f])?([Rr]\d*|([0-9A-Fa-f]{2})*)(\s+[RTrt])?"
)
_ASC_DATA = re.compile(r"\sd\s+[0-9A-Fa-f]{1,2}(?:\s+[0-9A-Fa-f]{2})+\s")
_HEX_BYTE, _DECIMAL_BYTE = re.compile("[0-9A-Fa-f]{2}"), re.compile("[0-9]{1,3}")
_TIMED = re.compile(r"(\s*)(\d+\.\d+)(\s.*)", re.DOTALL)
# lines of TRC that are no frames: bus information of 1.0, warnings, errors, status and marks of the later forms
_TRC_EVENTS = frozenset({"FFFFFFFF", "Warng", "Error", "ST", "EC", "ER", "EV"})
_CLOCK_FORMATS = ("%m %d %I:%M:%S.%f %p %Y", "%m %d %I:%M:%S %p %Y", "%m %d %H:%M:%S.%f %Y", "%m %d %H:%M:%S %Y")
_MONTHS = ("Jan", "Feb", "Mar|Mär", "Apr", "May|Mai", "Jun", "Jul", "Aug", "Sep", "Oct|Okt", "Nov", "Dec|Dez")
_SCREEN = "it is what candump shows on a screen: write the log with `candump -l`, or -L"


class LogLines(io.TextIOWrapper):
    """Lines of a log in text; those that cannot be read are counted, `is_difference` adds up their times."""

    def __init__(self, path: Path) -> None:
        super().__init__(path.open("rb"), encoding="utf-8", errors="replace")
        self.bad = 0
        self.first_bad = ""
        self.number = 0
        self.is_difference = False
        self._sum = Decimal(0)
        self._last = ""
        self._ahead: deque[str] = deque()

    def __next__(self) -> str:  # type: ignore[override]
        """The next line."""
        self._last = self._ahead.popleft() if self._ahead else super().__next__()
        self.number += 1
        return self._timed(self._last)

    def read_again(self) -> None:
        """Give the last line once more."""
        self._ahead.appendleft(self._last)
        self.number -= 1

    def next_time_s(self) -> float | None:
        """Time of the next event, as its line will be given; None if there is none in the next lines."""
        self._ahead.extend(itertools.islice(iter(super().__next__, None), max(0, _MOST_AHEAD - len(self._ahead))))
        events = (line for line in self._ahead if "start of measurement" not in line.lower())
        found = next(filter(None, map(_TIMED.fullmatch, events)), None)
        if found is None:
            return None
        return float(Decimal(found[2]) + (self._sum if self.is_difference else 0))

    def leave_out(self, why: str) -> None:
        """Count the last line as one that cannot be read."""
        self.bad += 1
        text = " ".join(self._last.split())
        shown = text if len(text) <= _MOST_TEXT else f"{text[:_MOST_TEXT]}..."
        self.first_bad = self.first_bad or f"line {self.number}, {shown!r}: {why}"

    def _timed(self, line: str) -> str:
        if not self.is_difference or (found := _TIMED.fullmatch(line)) is None:
            return line
        self._sum += Decimal(found[2])
        return f"{found[1]}{self._sum}{found[3]}"


class AscReader(can.ASCReader):
    """ASC; `zone` is that of the time of day in its header."""

    file: LogLines

    def __init__(self, path: Path, zone: str | None) -> None:
        super().__init__(_AscLines(path), relative_timestamp=False)
        self._zone = zone
        self.has_local_time = False

    def _extract_header(self) -> None:
        super()._extract_header()
        # the line behind the header is of the record where no line on internal events ends the header
        self.file.read_again()
        self.file.is_difference = self.timestamps_format == "relative"

    def _datetime_to_timestamp(self, datetime_string: str) -> float:  # type: ignore[override]
        begin_s = _clock_time(datetime_string).replace(tzinfo=_zone_of(self._zone)).timestamp()
        is_block, self.has_local_time = self.has_local_time, True
        first_s = self.file.next_time_s() if is_block else None
        if first_s is None:
            return begin_s
        # times in a block of a trigger count from the block, or go on from the start of the measurement
        goes_on = abs(self.start_time + first_s - begin_s) < abs(first_s)
        return self.start_time if goes_on else begin_s

    def _process_classic_can_frame(self, line: str, msg_kwargs: dict[str, Any]) -> can.Message:
        return self._read(super()._process_classic_can_frame, line, msg_kwargs)

    def _process_fd_can_frame(self, line: str, msg_kwargs: dict[str, Any]) -> can.Message:
        return self._read(super()._process_fd_can_frame, line, msg_kwargs)

    def _process_data_string(self, data_str: str, data_length: int, msg_kwargs: dict[str, Any]) -> None:
        # python-can takes any token for a byte, and does not miss those that are not there
        byte, tokens = (_HEX_BYTE if self._converted_base == 16 else _DECIMAL_BYTE), data_str.split()
        wrong = [token for token in tokens[:data_length] if byte.fullmatch(token) is None]
        is_longer = not msg_kwargs.get("is_fd") and any(map(byte.fullmatch, tokens[data_length : data_length + 1]))
        if wrong or is_longer or len(tokens) < data_length:
            raise ValueError(f"{wrong[0]!r} is no byte" if wrong else f"it does not have {data_length} bytes")
        super()._process_data_string(data_str, data_length, msg_kwargs)

    def _read(self, read: Any, line: str, given: dict[str, Any]) -> can.Message:
        try:
            found: can.Message = read(line, given)
        except (ValueError, IndexError) as error:
            self.file.leave_out(" ".join(str(error).split()))
            return cast("can.Message", None)  # its caller leaves none out
        return found


class _AscLines(LogLines):
    def __next__(self) -> str:  # type: ignore[override]
        """The next line; one with data that python-can takes for no frame is counted, and given as it is."""
        line = super().__next__()
        text = line.strip()
        if ASC_MESSAGE_REGEX.match(text) or not text[:1].isdigit() or "J1939TP" in text:
            return line
        if _ASC_DATA.search(f"{text} "):
            self.leave_out("not like 0.0100 1 100 Rx d 8 01 02 03 04 05 06 07 08")
        return line


class CandumpReader(can.CanutilsLogReader):
    """A log of candump."""

    file: LogLines

    def __init__(self, path: Path) -> None:
        super().__init__(_CandumpLines(path))


class _CandumpLines(LogLines):
    def __next__(self) -> str:  # type: ignore[override]
        """The next line that is one of candump."""
        while True:
            line = super().__next__()
            text = line.strip()
            if not text or _CANDUMP.fullmatch(text):
                return line
            is_screen = bool(re.search(r"\s\[\d+\]\s", f" {text} "))
            self.leave_out(_SCREEN if is_screen else "not like (1436509052.249713) can0 123#0102")


class TrcReader(can.TRCReader):
    """TRC of PCAN; `zone` is that of the time of day in its header."""

    file: LogLines

    def __init__(self, path: Path, zone: str | None) -> None:
        super().__init__(LogLines(path))
        self._zone = zone

    @property
    def has_local_time(self) -> bool:
        """Whether its header has a time of day."""
        return bool(self._start_time)

    def _extract_header(self) -> str:
        line: str = super()._extract_header()
        if self._start_time:
            read_as_utc = datetime(1970, 1, 1) + timedelta(seconds=self._start_time)
            self._start_time = read_as_utc.replace(tzinfo=_zone_of(self._zone)).timestamp()
        return line

    def _parse_line(self, line: str) -> can.Message | None:
        cells = tuple(line.split(maxsplit=self._num_columns))
        try:
            found = self._parse_cols(cells)
            if found is not None and not found.is_remote_frame and len(found.data) != dlc2len(found.dlc):
                raise ValueError(f"it does not have {dlc2len(found.dlc)} bytes")
        except (ValueError, IndexError) as error:
            found = None
            if cells:
                self.file.leave_out("cells are missing" if isinstance(error, IndexError) else str(error))
        else:
            if found is None and not _TRC_EVENTS.intersection(cells):
                self.file.leave_out("neither a frame nor another event")
            elif found is not None and isinstance(found.channel, int):
                found.channel -= 1  # of the first bus it is 0, as python-can has it of all other formats
        return found


def lines_left_out(reader: object) -> str:
    """A sentence on the lines of a log in text that could not be read; empty if all could."""
    lines = getattr(reader, "file", None)
    if not isinstance(lines, LogLines) or not lines.bad:
        return ""
    some = f"{lines.bad} of {lines.number} lines cannot be read and are left out"
    return f"{some}, the first is {lines.first_bad}"


def _clock_time(text: str) -> datetime:
    """A time of day of an ASC without its day of the week, in English or German.

    >>> _clock_time("Nov 21 06:00:00.000 pm 2026"), _clock_time("Mär 1 18:00:00 2026")
    (datetime.datetime(2026, 11, 21, 18, 0), datetime.datetime(2026, 3, 1, 18, 0))
    """
    for number, names in enumerate(_MONTHS, 1):
        text = re.sub(rf"\b({names})\b", f"{number:02}", text)
    for form in _CLOCK_FORMATS:
        try:
            return datetime.strptime(text, form)
        except ValueError:
            continue
    raise ValueError(f"its date {text!r} cannot be read")


def _zone_of(name: str | None) -> tzinfo:
    return ZoneInfo(name or "UTC")
