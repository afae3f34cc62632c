"""A serial port with a gyro: read in a thread, opened again after it was unplugged."""

import errno
import os
import stat
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import UUID

from ingest.serial.frame_layout import FrameLayout
from ingest.serial.serial_frames import SerialFrames
from ingest.source_fault import Fault
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.errors import InstrumentError

_LOOK_S = 0.05
_LONG_S = 1.0  # a delivery that takes longer waits for room
BATCH_S = 0.25
_MOST_BYTES = 1 << 16
_FIRST_PAUSE_S = 0.5
_LONGEST_PAUSE_S = 10.0
_REPORT_EVERY_S = _NO_FRAME_S = 10.0


class SerialLine:
    """Reads one gyro from a serial port: ``/dev/ttyUSB0``, or any address that pyserial opens.

    `deliver` gets each batch in this line's thread. While it waits nothing is read, and once the operating system's
    buffer is full frames are lost, which their counters tell. If it raises, reading ends with a report. Bytes are
    collected for `batch_s` of the computer.
    """

    def __init__(
        self, port: str, baud: int, layout: FrameLayout, unit: str, run: str, epoch: UUID, clock: StationClock,
        deliver: Callable[[SampleBatch], None], report: Callable[[str], None], *, batch_s: float = BATCH_S,
        layout_name: str = "its layout",
    ) -> None:  # fmt: skip
        self.frames = SerialFrames(layout, unit, run, epoch, is_live=clock.speed == 1.0)
        self.error: Exception | None = None
        self._unit, self._layout_name = unit, layout_name
        self._who = f"unit {unit} at {port}"
        self._address, self._baud = port, baud
        self._clock = clock
        self._deliver, self._report = deliver, report
        self._batch_s = batch_s
        self._port: Any = None
        self._bytes = bytearray()
        self._arrived_ns = 0
        self._waited_s = 0.0  # for deliveries, since the last report
        self._unframed = 0  # bytes since the last frame
        self._framed_s = self._came_s = time.monotonic()
        self._reported = (0, 0, 0, 0)
        self._reported_s = -_REPORT_EVERY_S
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self) -> None:
        """Open the port; raises InstrumentError if it fails."""
        if self._port is None:
            self._port = open_port(self._address, self._baud, self.frames.layout, self._who)

    def start(self) -> None:
        """Begin to read; a port that cannot be opened is reported and tried again."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=f"serial {self._address}", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Deliver the received frames and end; never raises."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def faults(self) -> dict[tuple[str, Fault], str]:
        """What keeps the unit's samples from being used, as far as the line shows it."""
        found = {}
        seen = self.frames.times.seen
        if seen is not None and seen.is_wrong:
            found[self._unit, Fault.INTERVAL] = seen.warning(self._who, self._layout_name)
        now_s = time.monotonic()
        if self._unframed and now_s - self._framed_s >= _NO_FRAME_S and now_s - self._came_s < _NO_FRAME_S / 2:
            found[self._unit, Fault.NO_FRAME] = (
                f"{self._who}: {self._unframed:,} bytes have come in {now_s - self._framed_s:.0f} s and none made a "
                f"frame of {self._layout_name}: check sync, length and checksum there, and baud = {self._baud}; "
                "lines of text cannot be described"
            )
        return found

    def _run(self) -> None:
        try:
            try:
                self._read_reconnecting()
            finally:
                self._close()
            self._decode()
            self._give(self.frames.finish(self._clock.now_ns()))
            self._report_losses(at_once=True)
        except Exception as error:  # noqa: BLE001  whatever it is, the user must know that reading has ended
            self.error = error
            self._report(f"{self._who} is not read any more: {error}")

    def _read_reconnecting(self) -> None:
        pause_s, is_down = _FIRST_PAUSE_S, False
        while not self._stop.is_set():
            try:
                self.open()
                if is_down:
                    self._report(f"{self._who} is there again")
                pause_s, is_down = _FIRST_PAUSE_S, False
                self._read_until_stopped()
            except (InstrumentError, OSError) as error:
                self._close()
                if not is_down:
                    text = str(error) if isinstance(error, InstrumentError) else f"{self._who} cannot be read: {error}"
                    self._report(f"{text}; it is tried again until it is there")
                is_down = True
                self._stop.wait(pause_s)
                pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)

    def _read_until_stopped(self) -> None:
        due_s = time.monotonic() + self._batch_s
        while not self._stop.is_set():
            part = self._port.read(max(1, min(self._port.in_waiting, _MOST_BYTES)))
            if part:
                self._bytes += part
                self._arrived_ns = self._clock.now_ns()
            if time.monotonic() >= due_s or len(self._bytes) >= _MOST_BYTES:
                self._decode()
                due_s = time.monotonic() + self._batch_s

    def _decode(self) -> None:
        if self._bytes:
            data = bytes(self._bytes)
            self._bytes.clear()
            frames, self._came_s = self.frames.counts.frames, time.monotonic()
            batches = self.frames.feed(data, self._arrived_ns)
            if self.frames.counts.frames > frames:
                self._unframed, self._framed_s = 0, self._came_s
            else:
                self._unframed += len(data)
            self._give(batches)
            self._report_losses()

    def _give(self, batches: list[SampleBatch]) -> None:
        began_s = time.monotonic()
        for batch in batches:
            self._deliver(batch)
        waited_s = time.monotonic() - began_s
        self._waited_s += waited_s if waited_s > _LONG_S else 0.0

    def _report_losses(self, *, at_once: bool = False) -> None:
        """Report losses since the last report, at most once in 10 s."""
        counts = self.frames.counts
        now = (counts.lost, counts.repeated, counts.dropped_bytes, counts.restarts)
        is_due = self.frames.times.watch.is_settled and time.monotonic() - self._reported_s >= _REPORT_EVERY_S
        if now == self._reported or not (at_once or is_due):
            return
        lost, repeated, dropped, restarts = (after - before for after, before in zip(now, self._reported, strict=True))
        self._reported, self._reported_s = now, time.monotonic()
        why = f" (it was not read for {self._waited_s:.0f} s, while its samples waited)" if self._waited_s else ""
        self._waited_s = 0.0
        self._report(
            f"{self._who}: {lost} frames lost{why}, {repeated} repeated, {dropped} bytes that belong to no frame, "
            f"{restarts} new starts of the counter; {counts.frames} frames in all are good"
        )

    def _close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with suppress(Exception):  # a port that cannot be closed is gone
                port.close()


def device_of(port: str) -> str:
    """What a port is, whichever of its paths or addresses names it.

    >>> device_of("/dev/null") == device_of("/dev/../dev/null") != device_of("/dev/zero")
    True
    >>> device_of("socket://Box-1:7000"), device_of("rfc2217://box-1:7000?logging=debug"), device_of("spy:///dev/null")
    ('box-1:7000', 'box-1:7000', '1:3')
    """
    scheme, _, rest = port.partition("://")
    if rest and scheme.lower() in {"socket", "rfc2217"}:
        return rest.partition("?")[0].rstrip("/").lower()
    if rest and scheme.lower() in {"spy", "alt"}:
        port = rest.partition("?")[0]
    with suppress(OSError, ValueError):
        about = Path(port).stat()
        if stat.S_ISCHR(about.st_mode):
            return f"{os.major(about.st_rdev)}:{os.minor(about.st_rdev)}"
    return os.path.realpath(port)


def open_port(address: str, baud: int, layout: FrameLayout | None, who: str) -> Any:
    """Open a serial port of pyserial for frames of a layout, which no other process may read; else InstrumentError."""
    import serial

    bits: dict[str, Any] = {}
    if layout is not None:
        bits = {"bytesize": layout.data_bits, "parity": layout.parity, "stopbits": layout.stop_bits}
    try:
        return serial.serial_for_url(address, baud, timeout=_LOOK_S, exclusive=True, **bits)
    except (OSError, ValueError) as error:  # serial's own errors are OSErrors
        if isinstance(error, OSError) and error.errno in {errno.EAGAIN, errno.EBUSY}:
            raise InstrumentError(f"{who}: the port is in use by another process, as another run; end that") from error
        todo = "see that it is plugged in and free"
        raise InstrumentError(f"{who}: the port cannot be opened: {error}; {todo}") from error
