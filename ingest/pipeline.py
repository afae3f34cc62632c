"""The whole path in one process: source -> Zenoh -> recorder (log, lake) and estimators. No server, no open port."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from storage.event_log import EventLog, Recovery
from storage.recorder import Recorder
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.delivery import DurablePublisher
from stream.errors import GyrofleetError
from stream.events import AnyDocument
from stream.worker import EstimationWorker
from stream.zenoh_bus import ZenohBus

# Small enough that most of the lake is made while samples still come in.
EMBEDDED_ROTATE_BYTES = 32 << 20


class EmbeddedPipeline:
    """Everything between a source and a store, started together and ended in order.

    Parameters
    ----------
    folder : Path
        The store; made if it does not exist.
    role : str
        Who writes, for the message that another writer gets.
    estimate_every_s : float
        Interval between estimates in the signals' time, seconds.
    listen : sequence of str
        Endpoints on which others may listen in; none by default.
    rotate_bytes : int
        Payload after which a segment of the log is sealed.
    on_document : callable, optional
        Called with every estimate and decision, in the worker's thread.

    Raises
    ------
    StoreError
        If the store cannot be written, or another process writes it.
    """

    def __init__(
        self,
        folder: Path,
        role: str,
        *,
        estimate_every_s: float = 600.0,
        listen: Sequence[str] = (),
        rotate_bytes: int = EMBEDDED_ROTATE_BYTES,
        on_document: Callable[[AnyDocument], None] | None = None,
    ) -> None:
        with ExitStack() as stack:
            self.store = Store.create(folder)
            stack.enter_context(WriterLock(self.store, role))
            log = EventLog(self.store, rotate_bytes=rotate_bytes)
            self.recovered: list[Recovery] = log.recovered
            bus = stack.enter_context(ZenohBus(listen=listen))
            publishers = [stack.enter_context(DurablePublisher(bus)) for _ in range(2)]

            def give_up(failure: GyrofleetError) -> None:
                for publisher in publishers:
                    publisher.fail(str(failure))

            self._publisher, self._estimates = publishers
            # the worker listens first: what the recorder acknowledges, the worker has
            self.worker = EstimationWorker(bus, self._estimates, every_s=estimate_every_s, on_document=on_document)
            self.recorder = stack.enter_context(Recorder(self.store, bus, log, on_failure=give_up))
            self._stack = stack.pop_all()

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        """Send samples; waits while recorder or estimators are far behind.

        Raises
        ------
        DeliveryError
            If nothing is acknowledged for a minute.
        """
        self.worker.wait_for_room()
        self._publisher.send_batch(key, batch)

    def send_event(self, key: str, document: AnyDocument) -> None:
        """Send a run document; waits and raises like `send_batch`."""
        self._publisher.send_event(key, document)

    def complete_estimates(self) -> None:
        """Wait until everything sent is in the log and the estimates of the runs that have ended are published.

        Raises
        ------
        GyrofleetError
            If any part failed.
        """
        self._publisher.drain()
        self.worker.close()
        self._estimates.drain()

    def finish(self) -> None:
        """Wait until everything sent and estimated is in the lake.

        Raises
        ------
        GyrofleetError
            If any part failed.
        """
        self.complete_estimates()
        self._publisher.drain()
        self.recorder.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
