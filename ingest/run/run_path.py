"""Where a run is sent: to a recorder in another process, or into a store that this process records."""

import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import NamedTuple
from uuid import NAMESPACE_URL, uuid5

from ingest.run.pipeline import EmbeddedPipeline
from ingest.run.replaying import estimated_every_s
from storage.recording.client import HeldClaim, RecorderClient
from storage.store import Store, writer_endpoint
from stream.delivery.publisher import DurablePublisher, Sender
from stream.delivery.spool import Spool
from stream.errors import BadInput, DeliveryError, WireError
from stream.events import AnyDocument, EarlyDecision, VerdictGiven
from stream.identity import EstimateKey, Place, estimate_key, parse_key
from stream.status.proven_status import on_bus
from stream.status.role_status import RoleStatus
from stream.terminal.console import Stop, notes
from stream.transport.zenoh_bus import ZenohBus
from stream.wire.event_validation import decode_received
from stream.worker.estimated_signals import EstimatedSignals
from stream.worker.limit_checks import VERDICT
from stream.worker.signal_analysis import EARLY_DECISION

INTERRUPTED = 130  # exit code
PATIENCE_S = 5.0
_LONGEST_FOLDER_BYTES = 200
_RECORDER_PATIENCE_S = 3.0


class Destination(NamedTuple):
    """Where a run goes."""

    folder: Path  # the store
    connect: str | None  # where the recorder listens; None where this process records
    spools: Path  # folder of the spools, or, where `is_given`, that of this run's
    spool_bytes: int = 4 << 30  # how much may wait in the spool
    is_given: bool = False

    @classmethod
    def chosen(
        cls, run: str | None, folder: Path, connect: str | None, spool_folder: Path | None, spool_mb: int
    ) -> "Destination":
        """What the options say; raises BadInput if the run's name is too long for the folder of its spool."""
        connect = connect or writer_endpoint(folder)
        if spool_folder is not None:
            return cls(folder, connect, spool_folder, spool_mb << 20, is_given=True)
        if (size := len((run or "").encode())) > _LONGEST_FOLDER_BYTES:
            raise BadInput(
                f"--run {run} has {size} bytes in UTF-8, and the folder of its spool is named after it: "
                f"{_LONGEST_FOLDER_BYTES} at most; give a shorter one, or --spool FOLDER"
            )
        # in the store, or beside a folder that is no store of this computer
        is_beside = connect is not None and not (folder / "store.json").exists()
        spools = folder.with_name(folder.name + "-spool") if is_beside else folder / "spool"
        return cls(folder, connect, spools, spool_mb << 20)


class RunPath(NamedTuple):
    """Where a run is sent; `folder` is the store, None where another process records."""

    sender: Sender
    publisher: DurablePublisher
    finish: Callable[[], None]
    where: str
    folder: Path | None
    put_status: Callable[[RoleStatus], None]


class TroubleWatch:
    """Reports what keeps samples from being recorded: once when it begins or changes, and once when it is over.

    So it reports that nobody judges them, if `silence` says so, and that the run's state is not written, if `unsaved`
    does.
    """

    def __init__(
        self, publisher: DurablePublisher, report: Callable[[str], None],
        silence: Callable[[], str | None] = lambda: None, unsaved: Callable[[], str | None] = lambda: None,
    ) -> None:  # fmt: skip
        self._publisher, self._report, self._silence, self._unsaved = publisher, report, silence, unsaved
        self._trouble: str | None = None
        self._is_silent = False

    def look(self) -> None:
        """Report what has changed since the last look."""
        paused = self._publisher.paused
        trouble = self._publisher.warning or self._unsaved() or (f"the recorder pauses: {paused}" if paused else None)
        if trouble != self._trouble:
            self._trouble = trouble
            self._report(f"warning: {trouble}" if trouble else "recording goes on")
        silence = self._silence()
        if (silence is not None) is not self._is_silent:
            self._is_silent = silence is not None
            self._report(f"warning: {silence}" if silence else "estimates of these units come")


def recorder_at(connect: str | None) -> AbstractContextManager[ZenohBus | None]:
    """Connect to the recorder at `connect`, before a spool is made, or raise BusError; None for this process."""
    return nullcontext() if connect is None else ZenohBus(connect=[connect])


@contextmanager
def opened_spool(to: Destination, spool_folder: Path) -> Iterator[Spool]:
    """Open a run's spool, after its store where this process records; raises GyrofleetError if it cannot."""
    if to.connect is None:
        Store.create(to.folder)
    with Spool(spool_folder, max_bytes=to.spool_bytes) as spool:
        for damage in spool.damages:
            notes().print(f"warning: the spool is damaged: {damage}", soft_wrap=True)
        yield spool


@contextmanager
def path_to(
    to: Destination, run: str, bus: ZenohBus | None, spool: Spool, every_s: float | None = None,
    estimated: EstimatedSignals = EstimatedSignals(), units: Sequence[str] = (),
    on_document: Callable[[AnyDocument], None] | None = None, station: str = "",
    on_estimate: Callable[[], None] = lambda: None,
) -> Iterator[RunPath]:  # fmt: skip
    """Send to the recorder on a bus, or record and estimate in this process; raises GyrofleetError if the store cannot
    be written, or another source sends the same units in a run of this id.

    `every_s` is the interval between estimates in the signals' time; by default that of the run so far. Nobody else may
    send `units` of `station` to the same recorder in this run. `on_document` takes early decisions and verdicts;
    `on_estimate` is called for each estimate of another process.
    """
    if bus is not None:
        with ExitStack() as stack:
            client, claim = _client(bus, to.folder, spool), None
            if client is not None:
                holder = uuid5(NAMESPACE_URL, f"{socket.gethostname()}/{spool.folder.absolute()}").hex
                owners = [(unit, run) for unit in units]
                claim = stack.enter_context(
                    HeldClaim(client, owners, f"gyrofleet run {run}", holder=holder, station=station)
                )
            only_store = None if client is None else client.store
            publisher = stack.enter_context(DurablePublisher(bus, spool=spool, only_store=only_store))
            if on_document is not None:
                _listen(bus, run, units, on_document, on_estimate)
            if claim is not None:
                claim.on_loss = publisher.fail
            where = f"to the recorder at {to.connect}"
            yield RunPath(publisher, publisher, publisher.drain, where, None, on_bus(bus))
    else:
        # of the same interval as those of a `gyrofleet estimate` that may have begun them, else they would differ
        every_s = every_s or estimated_every_s(to.folder, run)
        with EmbeddedPipeline(
            to.folder, "gyrofleet run", spool=spool, estimate_every_s=every_s, estimated=estimated,
            on_document=on_document,
        ) as pipeline:  # fmt: skip
            where = f"recorded in this process to {to.folder}"
            yield RunPath(pipeline, pipeline.publisher, pipeline.finish, where, to.folder, pipeline.put_status)


def _listen(
    bus: ZenohBus, run: str, units: Sequence[str], on_document: Callable[[AnyDocument], None],
    on_estimate: Callable[[], None],
) -> None:  # fmt: skip
    """Take early decisions and verdicts on a run's units from the estimators on the bus, and notice the others."""
    wanted = frozenset(units)

    def take(key: str, payload: bytes) -> None:
        with suppress(BadInput, WireError):  # the recorder quarantines and reports it
            parsed = parse_key(key)
            if not isinstance(parsed, EstimateKey) or parsed.unit not in wanted:
                return
            on_estimate()
            if parsed.estimator not in {EARLY_DECISION, VERDICT}:
                return
            document = decode_received(payload).document
            if isinstance(document, EarlyDecision | VerdictGiven) and document.run == run and document.unit in wanted:
                on_document(document)

    # a station is admitted to its own keys only
    own = "*" if bus.credentials is None else bus.credentials.principal.name
    bus.subscribe(estimate_key(Place("*", own), "*", "*", "*"), take)


def _client(bus: ZenohBus, folder: Path, spool: Spool) -> RecorderClient | None:
    """The recorder of the store that has the run, else of `folder`, else any; None where none answers yet."""
    wanted = spool.store
    if not wanted and (folder / "store.json").exists():
        wanted = Store.open(folder).identity
    try:
        return RecorderClient(bus, wanted=wanted or None, patience_s=_RECORDER_PATIENCE_S)
    except DeliveryError:
        warning = "warning: no recorder answers yet; whether another source sends the same run is not known"
        notes().print(warning, soft_wrap=True)
        return None


def left_behind(path: RunPath, where: str) -> str:
    """Wait a little for the recorder; what waits in the spool, and how to resume."""
    until = time.monotonic() + PATIENCE_S
    path.publisher.drain(lambda: time.monotonic() > until)
    left, lost = path.publisher.outstanding, path.publisher.not_kept
    if left:
        path.publisher.abandon()
    else:
        path.finish()
    kept = f"{left - lost} messages wait in {where}; " if left > lost else ""
    if lost:
        kept += f"{lost} messages could not be written there and are lost; "
    return f"{kept}give the same command to resume, with --end to end it"


def drain(path: RunPath, trouble: TroubleWatch, stop: Stop) -> None:
    """Wait until all of it is recorded; after a request to stop, not for long."""

    def is_given_up() -> bool:
        trouble.look()
        return stop.asked_at is not None and time.monotonic() > stop.asked_at + PATIENCE_S

    path.publisher.drain(is_given_up)
