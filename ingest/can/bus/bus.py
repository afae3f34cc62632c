"""A CAN bus as a live source: one thread drains the interface, another decodes what it has in blocks."""

import threading
import time
from collections import Counter
from collections.abc import Callable, Collection
from typing import Any, Protocol, Self

import numpy as np

from ingest.can.bus.backlog import Backlog, Taken
from ingest.can.bus.clock import ReceiveClock
from ingest.can.bus.columns import Columns
from ingest.can.bus.counts import CanBusCounts
from ingest.can.bus.intake import Intake, open_intake
from ingest.can.bus.losses import Losses
from ingest.can.bus.open import CanBusOptions, filter_in_interface
from ingest.can.bus.outage import Outage
from ingest.can.frames import FrameBlock
from ingest.station_clock import StationClock
from stream.batch import SampleBatch
from stream.errors import InstrumentError
from stream.transport.bus import call_handlers

__all__ = ["CanBus", "CanBusCounts", "CanBusOptions", "Decoder"]

_WAIT_S = 0.05
_LAST_LOOK_S = 0.5  # on a bus under load the last look never ends by itself
_CHECK_S = 0.5
_BLOCK_FRAMES = 16_384


class Decoder(Protocol):
    """Makes samples of frames: a `CanDecoder`."""

    def take(self, block: FrameBlock) -> list[SampleBatch]:
        """Decode a block; the batches that are complete by then."""

    def finish(self) -> list[SampleBatch]:
        """What still waits for more of its kind."""


class CanBus:
    """One bus, from `start` to `stop`, once.

    An interface that is lost, or a controller that is off the bus, is reported and opened again, with pauses that
    grow, until it is there; what was received before is kept, and the gap shows in times and in counters of frames.

    Parameters
    ----------
    options: Which bus.
    clock: The station's clock.
    decoder: Makes samples of the frames. Used by this bus alone.
    deliver: Called with every batch, in the decoding thread. While it waits, frames wait, as many as fit.
    report: Called with a sentence for people, in either thread.
    wanted: Identifiers that are mapped, bit 31 set where of 29 bits; by default all.
    block_s: How long frames are gathered before they are decoded, seconds.
    most_waiting: Frames that may wait to be decoded; those beyond are lost, counted and reported.
    reopen_s: First and longest pause before a lost interface is opened again, seconds.

    Examples
    --------
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
        self,
        options: CanBusOptions,
        clock: StationClock,
        decoder: Decoder,
        deliver: Callable[[SampleBatch], None],
        report: Callable[[str], None],
        *,
        wanted: Collection[int] | None = None,
        block_s: float = 0.05,
        most_waiting: int = 200_000,
        reopen_s: tuple[float, float] = (0.1, 5.0),
    ) -> None:
        self.options = options
        self._clock = clock
        self._decoder = decoder
        self._deliver = deliver
        self._report = report
        self._wanted = None if wanted is None else np.array(sorted(wanted), np.uint32)
        self._block_s = block_s
        self._counted: Counter[str] = Counter()
        self._counting = threading.Lock()
        self._backlog = Backlog(most_waiting, min(_BLOCK_FRAMES, most_waiting))
        self._outage = Outage(self._tell, *reopen_s)
        self._failures: set[str] = set()
        self._overruns = Losses(self._tell, "had no room and were lost: decoding or delivery is too slow")
        self._interface_overruns = Losses(
            self._tell, "were lost before they could be read: the computer is too busy or net.core.rmem_max too small"
        )
        self._malformed = Losses(self._tell, "are no frames of this bus and were left out: is fd set right")
        self._intake: Intake | None = None
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=work, name=f"gyrofleet-can-{options.channel}-{what}", daemon=True)
            for work, what in ((self._read, "read"), (self._decode, "decode"))
        ]

    @property
    def counts(self) -> CanBusCounts:
        """What has come so far."""
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

    def start(self) -> None:
        """Open the interface and begin to receive.

        Raises
        ------
        InstrumentError: If it cannot be opened, or was started before.
        """
        if self._intake is not None or self._stopping.is_set():
            raise InstrumentError(f"{self.options.name} was started before; make a new one for another run")
        self._intake = self._opened()
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Decode and deliver what has been received, and let go of the interface; from any thread, more than once."""
        self._stopping.set()
        for thread in self._threads:
            if thread.ident is not None and thread is not threading.current_thread():
                thread.join()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _opened(self) -> Intake:
        intake, bus = open_intake(self.options, ReceiveClock(self._clock, self._tell))
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
            self._hand_on(intake, frames)
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

    def _off(self, intake: Intake) -> Intake | None:
        """What to go on with where the controller is off the bus."""
        self._count(bus_off=self._outage.is_over)
        why = "the controller is off the bus; look at wiring, termination and bit rate"
        if intake.reopens:
            return self._reopened(intake, why, is_off=True)
        intake.is_off = False
        again = f"ip link set {self.options.channel} type can restart"
        self._outage.failed(f"{why}, and unless restart-ms is set, `{again}`", is_off=True)
        return intake

    def _reopened(self, intake: Intake, failure: str, *, is_off: bool = False) -> Intake | None:
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

    def _hand_on(self, intake: Intake, frames: list[Any]) -> None:
        if not frames:
            return
        lost = self._backlog.put(intake, frames, intake.clock.now_s())
        self._count(received=len(frames), overrun=lost)
        self._overruns.note(lost)

    def _decode(self) -> None:
        """Decode and deliver until the backlog is closed; the second of the two threads."""
        while (taken := self._backlog.take(self._block_s)) is not None:
            for each in taken:
                self._decode_block(each)
        self._deliver_all(self._guarded("what was still to be decoded is lost", self._decoder.finish) or [])
        for losses in (self._overruns, self._interface_overruns, self._malformed):
            losses.flush()

    def _decode_block(self, taken: Taken) -> None:
        intake = taken.intake
        columns = self._guarded("what the interface gave cannot be read", lambda: intake.columns(taken.frames))
        if columns is None:
            self._count(malformed=len(taken.frames))
            self._malformed.note(len(taken.frames))
            return
        self._note(intake, columns)
        if not len(columns):
            return
        block = FrameBlock(
            intake.clock.times_ns(columns.stamps_s, taken.read_s),
            np.full(len(columns), self.options.number, np.int16),
            columns.arbitration_id,
            columns.length,
            columns.data,
        )
        batches = self._guarded("frames cannot be decoded", lambda: self._decoder.take(block))
        self._count(**{"undecoded" if batches is None else "decoded": len(block)})
        self._deliver_all(batches or [])

    def _note(self, intake: Intake, columns: Columns) -> None:
        """Count what came beside data frames, and what the controller said of itself."""
        unknown = 0
        if self._wanted is not None:
            unknown = len(columns) - int(np.isin(columns.arbitration_id, self._wanted).sum())
        overruns = columns.overflows + intake.new_overruns()
        self._count(
            unknown=unknown,
            error_frames=columns.error_frames,
            remote_frames=columns.remote_frames,
            malformed=columns.malformed,
            interface_overrun=overruns,
        )
        self._interface_overruns.note(overruns)
        self._malformed.note(columns.malformed)
        intake.gives_data = not columns.is_off and (intake.gives_data or len(columns) > 0)
        intake.is_off = intake.is_off or bool(columns.is_off)
        if columns.is_passive is not None:
            intake.is_passive = columns.is_passive
        if intake.is_passive != intake.is_told_passive:
            intake.is_told_passive = intake.is_passive
            self._count(error_passive=intake.is_passive)
            self._tell(
                "the controller is error passive" if intake.is_passive else "the controller is error active again"
            )

    def _deliver_all(self, batches: list[SampleBatch]) -> None:
        def deliver(batch: SampleBatch) -> bool:
            self._deliver(batch)
            return True

        for batch in batches:
            if not self._guarded("samples cannot be delivered", lambda batch=batch: deliver(batch)):  # type: ignore[misc]
                self._count(undelivered=len(batch))

    def _guarded(self, what: str, work: Callable[[], Any]) -> Any:
        """What `work` gives; None if it raises, which is told once until it works again."""
        try:
            done = work()
        except Exception as error:  # noqa: BLE001  whatever it is, receiving goes on
            if what not in self._failures:
                self._failures.add(what)
                self._tell(f"{what}: {type(error).__name__}: {error}")
            return None
        self._failures.discard(what)
        return done

    def _count(self, **more: int) -> None:
        with self._counting:
            self._counted.update(more)

    def _tell(self, text: str) -> None:
        call_handlers([lambda name, _: self._report(f"{name}: {text}")], self.options.name, b"")
