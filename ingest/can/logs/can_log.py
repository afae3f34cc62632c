"""Logs of CAN frames: BLF, ASC, TRC, candump and MF4, read by python-can and given out in blocks.

Its times of day are float seconds with a resolution of a quarter of a microsecond; they are rounded to whole ones.
"""

import importlib.util
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import can
from can.io.generic import MessageReader

from ingest.can.frames import EXTENDED, MOST_BYTES, CanFrame, FrameBlock, frame_block
from ingest.can.logs.bounds import check_bounds, check_objects
from ingest.can.logs.echoes import Echoes
from ingest.can.logs.mf4 import mf4_reader
from ingest.can.logs.structure import LEAST_BYTES, MAGIC, find_damage
from ingest.can.logs.text_logs import AscReader, CandumpReader, TrcReader, lines_left_out
from ingest.can.summary import LogFrameCounts, logged_by
from ingest.tables.sample_file import CAN_LOG_SUFFIXES
from stream.errors import BadInput

BLOCK_FRAMES = 10_000

_UTC_FROM_S = 1e8
_MOST_S = 4.6e9  # in 2115; later moments are beyond stream.bounds
_MOST_CHANNEL = 2**15 - 1
_MOST_DIGITS = 9
_HELD_BYTES = 64 << 20
Progress = Callable[[float], None]


class CanLog:
    r"""One log file; raises BadInput if it cannot be opened, or is no such log.

    `zone` is the time zone of a time of day that states none, as in ASC and TRC; by default UTC.

    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name) / "bench.log"
    >>> _ = path.write_text("(1500000000.000100) can0 123#0102\n(1500000000.010100) can0 1ABCDEF0#FF\n")
    >>> log = CanLog(path)
    >>> [block.t_ns.tolist() for block in log.blocks()]
    [[1500000000000100000, 1500000000010100000]]
    >>> folder.cleanup()
    """

    def __init__(self, path: Path, zone: str | None = None) -> None:
        self.path, self._zone = path, zone
        self.damage = self.note = ""
        self.counts, self._echoes = LogFrameCounts(), Echoes()
        self._channels: dict[str, int] = {}
        self._held: list[FrameBlock] | None = None
        _check_kind(path)
        check_bounds(path)
        _stop(self._open())

    def blocks(self, progress: Progress | None = None) -> Iterator[FrameBlock]:
        """Frames in the file's order, up to damage; after a complete read up to 64 MB stay in memory for the next."""
        if self._held is not None:
            yield from self._held
            if progress is not None:
                progress(1.0)
            return
        self.counts, self._echoes = LogFrameCounts(), Echoes()
        self.damage, self.note = find_damage(self.path)
        held: list[FrameBlock] | None = []
        held_bytes, size = 0, max(self.path.stat().st_size, 1)
        reader = self._open()
        try:
            for frames, place in self._with_reports(self._frames(reader)):
                block = frame_block(frames)
                yield block
                held_bytes += block.data.nbytes + 16 * len(block)
                if held is not None and held_bytes <= _HELD_BYTES:
                    held.append(block)
                else:
                    held = None
                if progress is not None:
                    progress(min(place / size, 1.0))
            self.damage = "; ".join(filter(None, [self.damage, lines_left_out(reader)]))
            if getattr(reader, "has_local_time", False):
                zone = f"its time of day has no zone and is taken as of {self._zone or 'UTC'}"
                advice = "" if self._zone else "; give --time-zone if that is not right"
                self.note = "; ".join(filter(None, [self.note, zone + advice]))
        finally:
            _stop(reader)
        self._held = held

    def _with_reports(self, found: Iterator[tuple[list[CanFrame], int]]) -> Iterator[tuple[list[CanFrame], int]]:
        """What is found, and as damage what the reader logs of parts that it leaves out."""
        with logged_by("asammdf", "can") as logged:
            yield from found
        self._add_damage(logged)

    def _add_damage(self, logged: list[str]) -> None:
        if logged:
            more = f", and {len(logged) - 1} more" if len(logged) > 1 else ""
            self.damage = self.damage or f"left out what cannot be read: {logged[0]}{more}"

    def _frames(self, reader: MessageReader) -> Iterator[tuple[list[CanFrame], int]]:
        """Lists of frames, with the position in the file behind them."""
        frames: list[CanFrame] = []
        messages = iter(reader)
        while True:
            try:
                message = next(messages)
            except StopIteration:
                break
            except Exception as error:  # noqa: BLE001  readers raise whatever bad bytes lead to
                stated = " ".join(str(error).split()) or type(error).__name__
                self.damage = self.damage or f"damaged behind frame {self.counts.all}: {stated}"
                break
            frames += filter(None, [self._frame(message)])
            if len(frames) >= BLOCK_FRAMES:
                yield frames, _place(reader)
                frames = []
        if frames:
            yield frames, _place(reader)
        # a BLF that is cut reads short without an error; what it holds back is the only sign of it
        if not self.damage and isinstance(reader, can.BLFReader) and reader._tail:  # noqa: SLF001
            stated = reader.object_count or "an unknown number"
            self.damage = f"cut short inside a frame, behind frame {self.counts.all} of {stated}"

    def _frame(self, message: can.Message) -> CanFrame | None:
        if message.is_error_frame:
            self.counts.errors += 1
            return None
        if message.is_remote_frame:
            self.counts.remote += 1
            return None
        channel = self._channel(message.channel)
        if (
            not abs(message.timestamp) < _MOST_S  # nor NaN
            or abs(channel) > _MOST_CHANNEL
            or not 0 <= message.arbitration_id < EXTENDED
            or len(message.data) > MOST_BYTES
        ):
            self.counts.unusable += 1
            return None
        identifier = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
        seconds = message.timestamp
        t_ns = round(seconds * 1e6) * 1000 if seconds >= _UTC_FROM_S else round(seconds * 1e9)
        frame = CanFrame(t_ns, channel, identifier, bytes(message.data))
        if self._echoes.is_echo(frame, is_rx=message.is_rx):
            self.counts.echoes += 1
            return None
        self.counts.data += 1
        return frame

    def _channel(self, channel: object) -> int:
        """Number of a channel; names that end in none are numbered as they come."""
        if isinstance(channel, int):
            return channel
        name = "0" if channel is None else str(channel)
        if name not in self._channels:
            digits = name[len(name.rstrip("0123456789")) :]
            self._channels[name] = int(digits) if 0 < len(digits) <= _MOST_DIGITS else len(self._channels)
        return self._channels[name]

    def _open(self) -> MessageReader:
        try:
            with warnings.catch_warnings(), logged_by("asammdf", "can") as logged:
                # asammdf warns of what it repairs in an unfinished file; `find_damage` reports it
                warnings.simplefilter("ignore")
                reader = _READERS[self.path.suffix.lower()](self.path, self._zone)
            self._add_damage(logged)
            return reader
        except BadInput:
            raise
        except Exception as error:  # readers raise whatever bad bytes lead to
            stated = " ".join(str(error).split()) or type(error).__name__
            what = f"{self.path.suffix} log of CAN frames"
            raise BadInput(f"{self.path}: cannot be read as a {what}: {stated}") from error


class _BlfReader(can.BLFReader):
    """python-can's, which repeats an object that states fewer bytes than its head has for ever."""

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        check_objects(self._tail + data)
        yield from super()._parse_container(data)


def _stop(reader: MessageReader) -> None:
    with suppress(AttributeError):  # asammdf's, of a damaged file
        reader.stop()


_READERS: dict[str, Callable[[Path, str | None], MessageReader]] = {
    ".blf": lambda path, _: _BlfReader(path),
    ".trc": TrcReader,
    ".log": lambda path, _: CandumpReader(path),
    ".asc": AscReader,
    ".mf4": lambda path, _: mf4_reader(path),
}


def _check_kind(path: Path) -> None:
    suffix = path.suffix.lower()
    if suffix not in CAN_LOG_SUFFIXES:
        raise BadInput(f"{path}: unknown kind of CAN log {suffix!r}; known are {' '.join(sorted(CAN_LOG_SUFFIXES))}")
    try:
        if path.is_dir():
            raise BadInput(f"{path}: a directory; give a file")
        if not path.is_file() and path.exists():
            raise BadInput(f"{path}: a pipe or a device, and it is read twice; give a file")
        if path.stat().st_size == 0:
            raise BadInput(f"{path}: the file is empty")
        with path.open("rb") as file:
            begin = file.read(max(LEAST_BYTES.values()))
    except OSError as error:
        raise BadInput(f"{path}: cannot be opened ({error.strerror or error})") from error
    if suffix in MAGIC and (not begin.startswith(MAGIC[suffix]) or len(begin) < LEAST_BYTES[suffix]):
        raise BadInput(f"{path}: cannot be read as a {suffix} log of CAN frames: it does not begin like one")
    if suffix == ".mf4" and importlib.util.find_spec("asammdf") is None:
        raise BadInput(f"{path}: reading MF4 needs asammdf, which is not installed: pip install 'gyrofleet[mf4]'")


def _place(reader: Any) -> int:
    try:
        return int(reader.file.tell())
    except (OSError, ValueError, AttributeError):
        return 0
