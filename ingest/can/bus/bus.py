"""A CAN bus as a live source: one thread drains the interface, another decodes the frames in blocks."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from ingest.can.bus.backlog import Backlog, Taken
from ingest.can.bus.columns import FrameColumns, ReceiveClock
from ingest.can.bus.faults import Losses, Outage
from ingest.can.bus.frame_reports import FrameReports
from ingest.can.bus.interface import CanBusOptions, CanIntake, filter_in_interface, open_intake
from ingest.can.frames import FrameBlock
from ingest.can.summary import MessageCount
from ingest.source_fault import Fault
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.errors import InstrumentError
from stream.transport.bus import call_handlers

__all__ = ["CanBus", "CanBusCounts", "CanBusOptions", "Decoder"]

_WAIT_S = 0.05
BLOCK_S = 0.05
_LAST_LOOK_S = 0.5  # on a bus under load the last look never ends by itself
_CHECK_S = 0.5
_BLOCK_FRAMES = 16_384


class Decoder(Protocol):
    """Makes samples of frames: a `CanDecoder`."""

    def take(self, block: FrameBlock) -> list[SampleBatch]:
        """Decode a block; the batches that are complete by then."""

    def finish(self) -> list[SampleBatch]:
        """The batches of all buffered samples."""


@dataclass(frozen=True)
class CanBusCounts:
    """Account of a bus so far, in frames unless stated otherwise."""

    received: int = 0  # everything that was read from the interface: data, remote and error frames, and malformed ones
    decoded: int = 0  # data frames that the decoder has taken
    unknown: int = 0  # of these, frames of identifiers that are not mapped, if the interface does not filter them
    remote_frames: int = 0
    error_frames: int = 0
    malformed: int = 0  # too long, with an impossible identifier, or a datagram of somebody else
    undecoded: int = 0  # data frames on which the decoder failed
    overrun: int = 0  # frames that were read and not kept, because decoding or delivery was too slow
    interface_overrun: int = 0  # frames that the operating system dropped, and a controller's reports of dropping some
    undelivered: int = 0  # samples whose delivery failed
    bus_off: int = 0  # times that the controller went there
    error_passive: int = 0  # likewise
    outages: int = 0  # times that the interface was lost


class CanBus:
    """One bus, from `start` to `stop`, once.

    An interface that is lost, or a controller that is off the bus, is reported and opened again with growing pauses
    until it is there; frames received before are kept, and the gap shows in times and frame counters.

    The `decoder` is used by this bus alone. `deliver` gets every batch in the decoding thread; while it waits, at most
    `most_waiting` frames wait, and those beyond are lost, counted and reported. `report` gets sentences in either
    thread. `wanted` are mapped identifiers, bit 31 set if of 29 bits; by default all. Frames are collected for
    `block_s`. `reopen_s` are the first and longest pause before a lost interface is opened again, seconds.
    `frame_counts` gives the decoder's account of each message: lost, repeated and late frames are reported; `mapping`
    names the file that states their intervals.

    >>> import can
    >>> class Nothing:
    ...     def take(self, block): return []
    ...     def finish(self): return []
    >>> options = CanBusOptions(interface="virtual", channel="doctest")
    >>> with CanBus(options, StationClock(), Nothing(), print, print) as bus:
    ...     with can.Bus("doctest", interface="virtual", ignore_config=True) as sender:
    ...         sender.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=[1, 2]))
    >>> bus.counts.decoded
    1
    """

    def __init__(
        self, options: CanBusOptions, clock: StationClock, decoder: Decoder, deliver: Callable[[SampleBatch], None],
        report: Callable[[str], None], *, wanted: Collection[int] | None = None, block_s: float = BLOCK_S,
        most_waiting: int = 200_000, reopen_s: tuple[float, float] = (0.1, 5.0),
        frame_counts: Callable[[], Iterable[MessageCount]] = tuple, mapping: str = "its mapping",
    ) -> None:  # fmt: skip
        self.options, self._clock, self._decoder, self._deliver = options, clock, decoder, deliver
        self._report_to = report
        self._wanted = None if wanted is None else np.array(sorted(wanted), np.uint32)
        self._block_s = block_s
        self._counted: Counter[str] = Counter()
        self._counting = threading.Lock()
        self._backlog = Backlog(most_waiting, min(_BLOCK_FRAMES, most_waiting))
        self._outage = Outage(self._report, *reopen_s)
        self._failures: set[str] = set()
        self._overruns = Losses(self._report, "had no room and were lost: decoding or delivery is too slow")
        self._interface_overruns = Losses(
            self._report, "were lost before they could be read: the computer is too busy or net.core.rmem_max too small"
        )
        self._malformed = Losses(self._report, "are no frames of this bus and were left out: is fd set right")
        self._frame_reports = FrameReports(frame_counts, self._report, mapping)
        self._intake: CanIntake | None = None
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=work, name=f"gyrofleet-can-{options.channel}-{what}", daemon=True)
            for work, what in ((self._read, "read"), (self._decode, "decode"))
        ]

    @property
    def counts(self) -> CanBusCounts:
        """Account of the bus so far."""
        with self._counting:
            return CanBusCounts(**self._counted)

    @property
    def clock_source(self) -> str:
        """Where the receive times come from; known from the first frame on."""
        return "no frame yet" if self._intake is None else self._intake.clock.source

    @property
    def is_open(self) -> bool:
        """Whether the interface is there, as far as is known."""
        return self._intake is not None and self._outage.is_over and not self._stopping.is_set()

    def faults(self) -> dict[tuple[str, Fault], str]:
        """What keeps samples of units from being used, as far as their frames show it."""
        return self._frame_reports.faults

    def start(self) -> None:
        """Open the interface and begin to receive; raises InstrumentError if it cannot be opened or was started."""
        if self._intake is not None or self._stopping.is_set():
            raise InstrumentError(f"{self.options.name} was started before; make a new one for another run")
        self._intake = self._opened()
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Decode and deliver what has been received, and close the interface; from any thread, more than once."""
        self._stopping.set()
        for thread in self._threads:
            if thread.ident is not None and thread is not threading.current_thread():
                thread.join()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _opened(self) -> CanIntake:
        intake, bus = open_intake(self.options, ReceiveClock(self._clock, self._report))
        if bus is not None and self._wanted is not None and self.options.filter:
            filter_in_interface(bus, self._wanted.tolist())
        return intake

    def _read(self) -> None:
        """Drain the interface until it is to be stopped; the first of the two threads."""
        intake = self._intake
        check_s = stop_s = 0.0
        while intake is not None:
            is_last = self._stopping.is_set()
            stop_s = stop_s or (time.monotonic() + _LAST_LOOK_S if is_last else 0.0)
            frames: list[Any] = []
            failure = None
            try:
                intake.take(0.0 if is_last else _WAIT_S, frames)
                if time.monotonic() > check_s:
                    check_s = time.monotonic() + _CHECK_S
                    intake.check()
            except Exception as error:  # noqa: BLE001  a driver raises whatever it likes when its device is gone
                failure = f"{type(error).__name__}: {error}"
            if frames:
                lost = self._backlog.put(intake, frames, intake.clock.now_s())
                self._count(received=len(frames), overrun=lost)
                self._overruns.add(lost)
            if is_last and (failure or not frames or time.monotonic() > stop_s):
                break
            if failure is not None:
                intake = self._reopened(intake, f"{failure}; it is opened again as soon as it is there")
            elif intake.is_off:
                intake = self._off(intake)
            else:
                self._outage.update(is_receiving=intake.gives_data)
        if intake is not None:
            intake.close()
        self._backlog.close()

    def _off(self, intake: CanIntake) -> CanIntake | None:
        """The intake to continue with while the controller is off the bus."""
        self._count(bus_off=self._outage.is_over)
        why = "the controller is off the bus; look at wiring, termination and bit rate"
        if intake.reopens:
            return self._reopened(intake, why, is_off=True)
        intake.is_off = False
        again = f"ip link set {self.options.channel} type can restart"
        self._outage.failed(f"{why}, and unless restart-ms is set, `{again}`", is_off=True)
        return intake

    def _reopened(self, intake: CanIntake, failure: str, *, is_off: bool = False) -> CanIntake | None:
        """Another intake in place of one that has failed; None if the bus is stopped before there is one."""
        intake.close()
        while True:
            self._count(outages=self._outage.is_over)
            if self._stopping.wait(self._outage.failed(failure, is_off=is_off)):
                return None
            try:
                self._intake = self._opened()
            except InstrumentError as error:
                failure = str(error)
            else:
                return self._intake

    def _decode(self) -> None:
        """Decode and deliver until the backlog is closed; the second of the two threads."""
        while (taken := self._backlog.take(self._block_s)) is not None:
            for each in taken:
                self._decode_block(each)
            self._frame_reports.update()
        self._deliver_all(self._guarded("what was still to be decoded is lost", self._decoder.finish) or [])
        for losses in (self._overruns, self._interface_overruns, self._malformed):
            losses.flush()
        self._frame_reports.update(at_once=True)

    def _decode_block(self, taken: Taken) -> None:
        """Raw frames -> columns -> times -> samples -> delivery."""
        intake = taken.intake
        columns = self._guarded("what the interface gave cannot be read", lambda: intake.columns(taken.frames))
        if columns is None:
            self._count(malformed=len(taken.frames))
            self._malformed.add(len(taken.frames))
            return
        self._account(intake, columns)
        frames = len(columns.stamps_s)
        if not frames:
            return
        times_ns = intake.clock.times_ns(columns.stamps_s, taken.read_s)
        channel = np.full(frames, self.options.number, np.int16)
        block = FrameBlock(times_ns, channel, columns.arbitration_id, columns.length, columns.data)
        batches = self._guarded("frames cannot be decoded", lambda: self._decoder.take(block))
        self._count(**{"undecoded" if batches is None else "decoded": frames})
        self._deliver_all(batches or [])

    def _account(self, intake: CanIntake, columns: FrameColumns) -> None:
        """Count everything beside data frames, and follow the state of the controller."""
        frames = len(columns.stamps_s)
        overruns = columns.overflows + columns.overruns
        unknown = 0 if self._wanted is None else frames - int(np.isin(columns.arbitration_id, self._wanted).sum())
        self._count(
            unknown=unknown, error_frames=columns.error_frames, remote_frames=columns.remote_frames,
            malformed=columns.malformed, interface_overrun=overruns,
        )  # fmt: skip
        if overruns:
            self._interface_overruns.add(overruns)
        if columns.malformed:
            self._malformed.add(columns.malformed)
        intake.gives_data = not columns.is_off and (intake.gives_data or frames > 0)
        intake.is_off = intake.is_off or bool(columns.is_off)
        if columns.is_passive is not None:
            intake.is_passive = columns.is_passive
        if intake.is_passive != intake.is_reported_passive:
            intake.is_reported_passive = intake.is_passive
            self._count(error_passive=intake.is_passive)
            self._report(f"the controller is error {'passive' if intake.is_passive else 'active again'}")

    def _deliver_all(self, batches: list[SampleBatch]) -> None:
        def deliver(batch: SampleBatch) -> bool:
            self._deliver(batch)
            return True

        for batch in batches:
            if not self._guarded("samples cannot be delivered", lambda batch=batch: deliver(batch)):  # type: ignore[misc]
                self._count(undelivered=len(batch))

    def _guarded(self, what: str, work: Callable[[], Any]) -> Any:
        """Result of `work`; None if it raises, which is reported once until it works again."""
        try:
            done = work()
        except Exception as error:  # noqa: BLE001  whatever it is, receiving continues
            if what not in self._failures:
                self._failures.add(what)
                self._report(f"{what}: {type(error).__name__}: {error}")
            return None
        self._failures.discard(what)
        return done

    def _count(self, **more: int) -> None:
        with self._counting:
            self._counted.update(more)

    def _report(self, text: str) -> None:
        call_handlers([lambda name, _: self._report_to(f"{name}: {text}")], self.options.name, b"")
