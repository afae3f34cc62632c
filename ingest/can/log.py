"""Logs of CAN frames: BLF, ASC, TRC, candump and MF4, read by python-can and given out in blocks.

Times of day are float seconds there, which tell apart a quarter of a microsecond; they are rounded to whole ones.
"""

import importlib.util
import os
import struct
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
from can.io.generic import MessageReader

from ingest.can.frames import EXTENDED, MOST_BYTES, Frame, FrameBlock, frame_block
from ingest.can.summary import LOG_SUFFIXES, FrameCounts
from stream.errors import BadInput

BLOCK_FRAMES = 10_000

_UTC_FROM_S = 1e8
_MOST_S = 9e9  # what nanoseconds of 64 bits hold, rounded down
_MOST_CHANNEL = 2**15 - 1
_MOST_DIGITS = 9
_HELD_BYTES = 64 << 20
_BLF_HEADER = struct.Struct("<4sLBBBBBBBBQQLL")
_BLF_OBJECT = struct.Struct("<4sHHLL")
_BLF_HEADER_BYTES = 144
_MF4_UNFINISHED = b"UnFinMF "
_BEGINS: dict[str, tuple[bytes, ...]] = {".blf": (b"LOGG",), ".mf4": (b"MDF ", _MF4_UNFINISHED)}
_LEAST_BYTES = {".blf": _BLF_HEADER_BYTES, ".mf4": 8}

Progress = Callable[[float], None]


class CanLog:
    r"""One log file.

    Parameters
    ----------
    path: The file: .blf, .asc, .trc, .log (candump) or .mf4.

    Attributes
    ----------
    damage: What is wrong with the file, once it is read; empty where nothing is.
    counts: Frames of the file, once it is read.

    Raises
    ------
    BadInput: If it cannot be opened, or is no such log.

    Examples
    --------
    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = Path(folder.name) / "bench.log"
    >>> _ = path.write_text("(1500000000.000100) can0 123#0102\n(1500000000.010100) can0 1ABCDEF0#FF\n")
    >>> log = CanLog(path)
    >>> [block.t_ns.tolist() for block in log.blocks()]
    [[1500000000000100000, 1500000000010100000]]
    >>> folder.cleanup()
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage = ""
        self.counts = FrameCounts()
        self._channels: dict[str, int] = {}
        self._held: list[FrameBlock] | None = None
        _check_kind(path)
        self._open().stop()

    def blocks(self, progress: Progress | None = None) -> Iterator[FrameBlock]:
        """Frames in the order of the file; of a damaged file those before the damage.

        The frames of a file that has been read to its end once are kept, where they are not more than 64 MB.
        """
        if self._held is not None:
            yield from self._held
            if progress is not None:
                progress(1.0)
            return
        self.counts = FrameCounts()
        self.damage = _damage(self.path)
        held: list[FrameBlock] | None = []
        held_bytes = 0
        size = max(self.path.stat().st_size, 1)
        reader = self._open()
        try:
            for frames, place in self._frames(reader):
                block = frame_block(frames)
                yield block
                held_bytes += block.data.nbytes + 16 * len(block)
                if held is not None and held_bytes <= _HELD_BYTES:
                    held.append(block)
                else:
                    held = None
                if progress is not None:
                    progress(min(place / size, 1.0))
        finally:
            reader.stop()
        self._held = held

    def _frames(self, reader: MessageReader) -> Iterator[tuple[list[Frame], int]]:
        """Lists of frames, with the place in the file behind them."""
        frames: list[Frame] = []
        messages = iter(reader)
        while True:
            try:
                message = next(messages)
            except StopIteration:
                break
            except Exception as error:  # noqa: BLE001  readers raise whatever bad bytes lead to
                read = self.counts.all
                said = " ".join(str(error).split()) or type(error).__name__
                self.damage = self.damage or f"damaged behind frame {read}: {said}"
                break
            frame = self._frame(message)
            if frame is not None:
                frames.append(frame)
            if len(frames) >= BLOCK_FRAMES:
                yield frames, _place(reader)
                frames = []
        if frames:
            yield frames, _place(reader)
        self._check_complete(reader)

    def _frame(self, message: can.Message) -> Frame | None:
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
        self.counts.data += 1
        identifier = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
        return Frame(_ns(message.timestamp), channel, identifier, bytes(message.data))

    def _channel(self, channel: object) -> int:
        """Its number; names that end in none are numbered as they come."""
        if isinstance(channel, int):
            return channel
        name = "0" if channel is None else str(channel)
        if name not in self._channels:
            digits = name[len(name.rstrip("0123456789")) :]
            self._channels[name] = int(digits) if 0 < len(digits) <= _MOST_DIGITS else len(self._channels)
        return self._channels[name]

    def _check_complete(self, reader: MessageReader) -> None:
        """Hold what came against what the file says it has; a BLF that is cut reads short without an error."""
        said = getattr(reader, "object_count", 0)
        read = self.counts.all
        if not self.damage and isinstance(reader, can.BLFReader) and reader._tail:  # noqa: SLF001  the only sign of it
            self.damage = f"cut short inside a frame, behind frame {read} of {said or 'an unknown number'}"

    def _open(self) -> MessageReader:
        try:
            with warnings.catch_warnings():
                # asammdf warns of what it repairs in an unfinished file; `damage` says so
                warnings.simplefilter("ignore")
                return _reader(self.path)
        except BadInput:
            raise
        except Exception as error:  # readers raise whatever bad bytes lead to
            said = " ".join(str(error).split()) or type(error).__name__
            raise BadInput(f"{self.path}: cannot be read as a {self.path.suffix} log of CAN frames: {said}") from error


def _check_kind(path: Path) -> None:
    suffix = path.suffix.lower()
    if suffix not in LOG_SUFFIXES:
        raise BadInput(f"{path}: unknown kind of CAN log {suffix!r}; known are {' '.join(sorted(LOG_SUFFIXES))}")
    try:
        if path.is_dir():
            raise BadInput(f"{path}: a directory; give a file")
        if path.stat().st_size == 0:
            raise BadInput(f"{path}: the file is empty")
        with path.open("rb") as file:
            begin = file.read(_BLF_HEADER_BYTES)
    except OSError as error:
        raise BadInput(f"{path}: cannot be opened ({error.strerror or error})") from error
    if suffix in _BEGINS and (not begin.startswith(_BEGINS[suffix]) or len(begin) < _LEAST_BYTES[suffix]):
        raise BadInput(f"{path}: cannot be read as a {suffix} log of CAN frames: it does not begin like one")
    if suffix == ".mf4" and importlib.util.find_spec("asammdf") is None:
        raise BadInput(f"{path}: reading MF4 needs asammdf, which is not installed: pip install 'gyrofleet[mf4]'")


def _reader(path: Path) -> MessageReader:
    kinds: dict[str, Callable[..., MessageReader]] = {
        ".blf": can.BLFReader,
        ".trc": can.TRCReader,
        ".log": can.CanutilsLogReader,
    }
    suffix = path.suffix.lower()
    if suffix == ".asc":
        return can.ASCReader(path, relative_timestamp=False)
    if suffix == ".mf4":
        return can.MF4Reader(str(path))
    return kinds[suffix](path)


def _ns(seconds: float) -> int:
    return round(seconds * 1e6) * 1000 if seconds >= _UTC_FROM_S else round(seconds * 1e9)


def _place(reader: Any) -> int:
    try:
        return int(reader.file.tell())
    except (OSError, ValueError, AttributeError):
        return 0


def _damage(path: Path) -> str:
    """What the outer structure of a file says is wrong with it, read before its frames."""
    suffix = path.suffix.lower()
    if suffix == ".blf":
        return _blf_damage(path)
    if suffix == ".mf4":
        with path.open("rb") as file:
            if file.read(8) == _MF4_UNFINISHED:
                return "was not finished by its recorder; its last frames may be missing"
    if suffix in {".asc", ".log", ".trc"}:
        with path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            if file.read(1) not in b"\r\n":
                return "cut short: it ends inside a line"
    return ""


def _blf_damage(path: Path) -> str:
    """Walk the containers of a BLF: each has its length, and the head of the file says how long that is."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_BLF_HEADER.size)
        if len(head) < _BLF_HEADER.size:
            return "cut short inside its header"
        _, header_size, *_, said_size, _, _, _ = _BLF_HEADER.unpack(head)
        place = header_size
        while place < size:
            file.seek(place)
            base = file.read(_BLF_OBJECT.size)
            if not base.strip(b"\0"):
                break
            if len(base) < _BLF_OBJECT.size:
                return f"cut short at byte {size}, inside the head of a container"
            signature, _, _, object_size, _ = _BLF_OBJECT.unpack(base)
            if signature != b"LOBJ" or object_size < _BLF_OBJECT.size:
                return f"damaged at byte {place}: no container begins there"
            if place + object_size > size:
                return f"cut short at byte {size}, inside a container of {object_size} bytes"
            place += object_size + object_size % 4
    if said_size <= header_size < size:
        return "was not closed by its recorder; its last frames may be missing"
    if said_size > size:
        return f"cut short: its header says {said_size} bytes, there are {size}"
    return ""
