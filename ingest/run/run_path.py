"""Where a run is sent: to a recorder in another process, or into a store that this process records."""

import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple
from uuid import NAMESPACE_URL, uuid5

from ingest.run.pipeline import EmbeddedPipeline
from ingest.run.replaying import estimated_every_s
from storage.recording.client import HeldClaim, RecorderClient
from storage.store import Store, writer_endpoint
from stream.console import Stop, notes
from stream.delivery.publisher import DurablePublisher, Sender
from stream.delivery.spool import Spool
from stream.errors import BadInput, DeliveryError
from stream.events import AnyDocument
from stream.transport.zenoh_bus import ZenohBus
from stream.worker.estimated_signals import EstimatedSignals

INTERRUPTED = 130  # exit code
PATIENCE_S = 5.0
_LONGEST_FOLDER_BYTES = 200
_RECORDER_PATIENCE_S = 3.0


class Destination(NamedTuple):
    """Where a run goes."""

    folder: Path  # the store
    connect: str | None  # where the recorder listens; None where this process records
    spools: Path  # folder of the spools, or, where `is_given`, that of this run's
    spool_bytes: int  # how much may wait in the spool
    is_given: bool

    @classmethod
    def chosen(
        cls, run: str | None, folder: Path, connect: str | None, spool_folder: Path | None, spool_mb: int
    ) -> "Destination":
        """What the options say; raises BadInput if the run's name is too long for a folder."""
        connect = connect or writer_endpoint(folder)
        if spool_folder is None:
            check_spool_name(run or "")
        spools = spool_folder or spools_of(folder, is_remote=connect is not None)
        return cls(folder, connect, spools, spool_mb << 20, spool_folder is not None)


class Elsewhere(NamedTuple):
    """A recorder in another process, and the bus on which it is reached."""

    bus: ZenohBus
    endpoint: str


class RunPath(NamedTuple):
    """Where a run is sent; `folder` is the store, None where another process records."""

    sender: Sender
    publisher: DurablePublisher
    finish: Callable[[], None]
    where: str
    folder: Path | None


class TroubleWatch:
    """Reports what keeps samples from being recorded: once when it begins or changes, and once when it is over."""

    def __init__(self, publisher: DurablePublisher, report: Callable[[str], None]) -> None:
        self._publisher, self._report = publisher, report
        self._trouble: str | None = None

    def look(self) -> None:
        """Report what has changed since the last look."""
        paused = self._publisher.paused
        trouble = self._publisher.warning or (f"the recorder pauses: {paused}" if paused else None)
        if trouble != self._trouble:
            self._trouble = trouble
            self._report(f"warning: {trouble}" if trouble else "recording goes on")


def spools_of(folder: Path, *, is_remote: bool) -> Path:
    """Folder of the spools of a store's runs: in the store, or beside a folder that is no store of this computer."""
    if is_remote and not (folder / "store.json").exists():
        return folder.with_name(folder.name + "-spool")
    return folder / "spool"


def check_spool_name(run: str) -> None:
    """Raise BadInput where the folder of a run's spool, which has its name, could not be made."""
    if (size := len(run.encode())) > _LONGEST_FOLDER_BYTES:
        raise BadInput(
            f"--run {run} has {size} bytes in UTF-8, and the folder of its spool is named after it: "
            f"{_LONGEST_FOLDER_BYTES} at most; give a shorter one, or --spool FOLDER"
        )


@contextmanager
def recorder_at(connect: str | None) -> Iterator[Elsewhere | None]:
    """Connect to the recorder at `connect`, before a spool is made, or raise BusError; None for this process."""
    if connect is None:
        yield None
        return
    with ZenohBus(connect=[connect]) as bus:
        yield Elsewhere(bus, connect)


@contextmanager
def opened_spool(folder: Path, spool_folder: Path, max_bytes: int, *, is_remote: bool) -> Iterator[Spool]:
    """Open a run's spool, after its store where this process records; raises GyrofleetError if it cannot."""
    if not is_remote:
        Store.create(folder)
    with Spool(spool_folder, max_bytes=max_bytes) as spool:
        for damage in spool.damages:
            notes().print(f"warning: the spool is damaged: {damage}", soft_wrap=True, markup=False)
        yield spool


@contextmanager
def path_to(
    folder: Path,
    run: str,
    elsewhere: Elsewhere | None,
    spool: Spool,
    every_s: float | None = None,
    estimated: EstimatedSignals = EstimatedSignals(),
    units: Sequence[str] = (),
    on_document: Callable[[AnyDocument], None] | None = None,
) -> Iterator[RunPath]:
    """Send to a recorder elsewhere, or record and estimate in this process; raises GyrofleetError if the store cannot
    be written, or another source sends the same units in a run of this id.

    `every_s` is the interval between estimates in the signals' time; by default that of the run so far. Nobody else may
    send `units` to the same recorder in this run. `on_document` takes the estimates of this process.
    """
    if elsewhere is not None:
        with ExitStack() as stack:
            client = _client(elsewhere.bus, folder, spool)
            claim = None
            if client is not None:
                holder = uuid5(NAMESPACE_URL, f"{socket.gethostname()}/{spool.folder.absolute()}").hex
                claim = stack.enter_context(
                    HeldClaim(client, [(unit, run) for unit in units], f"gyrofleet run {run}", holder=holder)
                )
            publisher = stack.enter_context(
                DurablePublisher(elsewhere.bus, spool=spool, only_store=None if client is None else client.store)
            )
            if claim is not None:
                claim.on_loss = publisher.fail
            where = f"to the recorder at {elsewhere.endpoint}"
            yield RunPath(publisher, publisher, publisher.drain, where, None)
    else:
        # of the same interval as those of a `gyrofleet estimate` that may have begun them, else they would differ
        every_s = every_s or estimated_every_s(folder, run)
        with EmbeddedPipeline(
            folder, "gyrofleet run", spool=spool, estimate_every_s=every_s, estimated=estimated, on_document=on_document
        ) as pipeline:
            where = f"recorded in this process to {folder}"
            yield RunPath(pipeline, pipeline.publisher, pipeline.finish, where, folder)


def _client(bus: ZenohBus, folder: Path, spool: Spool) -> RecorderClient | None:
    """The recorder of the store that has the run, else of `folder`, else any; None where none answers yet."""
    wanted = spool.store
    if not wanted and (folder / "store.json").exists():
        wanted = Store.open(folder).identity
    try:
        return RecorderClient(bus, wanted=wanted or None, patience_s=_RECORDER_PATIENCE_S)
    except DeliveryError:
        warning = "warning: no recorder answers yet; whether another source sends the same run is not known"
        notes().print(warning, soft_wrap=True, markup=False)
        return None


def left_behind(path: RunPath, where: str, hint: str) -> str:
    """Wait a little for the recorder; what waits in the spool, and how to resume."""
    until = time.monotonic() + PATIENCE_S
    path.publisher.drain(lambda: time.monotonic() > until)
    left = path.publisher.outstanding
    if left:
        path.publisher.abandon()
    else:
        path.finish()
    kept = f"{left} messages wait in {where}; " if left else ""
    return f"{kept}give the same command {hint}, with --end to end it"


def drain(path: RunPath, trouble: TroubleWatch, stop: Stop) -> None:
    """Wait until all of it is recorded; after a request to stop, not for long."""

    def is_given_up() -> bool:
        trouble.look()
        return stop.asked_at is not None and time.monotonic() > stop.asked_at + PATIENCE_S

    path.publisher.drain(is_given_up)
