"""The whole path in one process: source -> Zenoh -> recorder (log, lake) and estimators. No server, no open port."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from storage.log.event_log import EventLog
from storage.log.recovery import Recovery
from storage.log.tail import LogTail
from storage.recording.recorder import Recorder
from storage.store import Store, WriterLock
from stream.batch import SampleBatch
from stream.delivery.publisher import DurablePublisher
from stream.delivery.spool import Spool
from stream.errors import GyrofleetError
from stream.events import AnyDocument
from stream.status.proven_status import on_bus
from stream.terminal.console import notes
from stream.transport.zenoh_bus import ZenohBus
from stream.worker.estimated_signals import EstimatedSignals
from stream.worker.worker import EstimationWorker

# Small enough that most of the lake is made while samples still come in.
EMBEDDED_ROTATE_BYTES = 32 << 20


class EmbeddedPipeline:
    """Everything between a source and a store, started together and ended in order.

    `role` says who writes, for the message that another writer gets. Estimates come every `estimate_every_s` of the
    signals' time, and `on_document` gets them, decisions and verdicts, in the worker's thread. A segment of the log is
    sealed after a payload of `rotate_bytes`. `on_warning` gets warnings of the recorder; by default they are printed.
    What the `spool` holds already is sent first. `estimated` are angular rates by default, and what has limits. Raises
    StoreError if the store cannot be written, or another process writes it.
    """

    def __init__(
        self, folder: Path, role: str, *, estimate_every_s: float = 600.0, listen: Sequence[str] = (),
        rotate_bytes: int = EMBEDDED_ROTATE_BYTES, on_document: Callable[[AnyDocument], None] | None = None,
        on_warning: Callable[[str], None] | None = None, spool: Spool | None = None,
        estimated: EstimatedSignals = EstimatedSignals(),
    ) -> None:  # fmt: skip
        with ExitStack() as stack:
            self.store = Store.create(folder)
            stack.enter_context(WriterLock(self.store, role))
            log = EventLog(self.store, rotate_bytes=rotate_bytes)
            self.recovered: list[Recovery] = log.recovered
            bus = stack.enter_context(ZenohBus(listen=listen, is_embedded=True))
            self.put_status = on_bus(bus)
            self._estimates = stack.enter_context(DurablePublisher(bus))
            publishers = [self._estimates]

            def give_up(failure: GyrofleetError) -> None:
                for publisher in publishers:
                    publisher.fail(str(failure))

            # the worker listens first: what the recorder acknowledges, the worker has
            self.worker = EstimationWorker(
                bus, self._estimates, every_s=estimate_every_s, on_document=on_document, estimated=estimated,
                log=LogTail(self.store),  # a run that was begun before is estimated from its beginning
            )  # fmt: skip
            warn = on_warning or (lambda warning: notes().print(f"warning: {warning}", soft_wrap=True))
            self.recorder = stack.enter_context(Recorder(self.store, bus, log, on_warning=warn, on_failure=give_up))
            # the source comes last: with a spool it sends at once
            self.publisher = stack.enter_context(DurablePublisher(bus, spool=spool))
            publishers.append(self.publisher)
            if self.recorder.failure is not None:
                give_up(self.recorder.failure)
            self._stack = stack.pop_all()

    def send_batch(self, key: str, batch: SampleBatch) -> None:
        """Send samples, waiting for slow estimators; raises DeliveryError if nothing is acknowledged for a minute."""
        self.worker.wait_for_room()
        self.publisher.send_batch(key, batch)

    def send_event(self, key: str, document: AnyDocument) -> None:
        """Send a run document; waits and raises like `send_batch`."""
        self.publisher.send_event(key, document)

    def finish(self) -> None:
        """Wait until everything sent and estimated is in the lake; raises GyrofleetError if any part failed."""
        self.publisher.drain()
        self.worker.close()
        self._estimates.drain()
        self.publisher.drain()  # what estimates led to, such as early decisions
        self.recorder.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)
