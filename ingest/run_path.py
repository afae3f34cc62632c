"""Where a live run is sent: to a recorder elsewhere, or into a store that this process records."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from ingest.pipeline import EmbeddedPipeline
from ingest.replaying import estimated_every_s
from stream.delivery import DurablePublisher, Sender
from stream.spool import Spool
from stream.zenoh_bus import ZenohBus


class RunPath(NamedTuple):
    """Where a run is sent to; `folder` is the store, None where it is another process's."""

    sender: Sender
    publisher: DurablePublisher
    finish: Callable[[], None]
    where: str
    folder: Path | None


@contextmanager
def path_to(
    folder: Path, run: str, connect: str | None, spool: Spool, every_s: float | None = None
) -> Iterator[RunPath]:
    """Open the way to a recorder, or record in this process.

    Parameters
    ----------
    folder : Path
        The store, where it is recorded in this process.
    run : str
        Id of the run.
    connect : str, optional
        Where the recorder listens.
    spool : Spool
        Keeps what the recorder does not have yet.
    every_s : float, optional
        Interval between estimates, seconds of the signals' time; by default that which the run was begun with.

    Raises
    ------
    GyrofleetError
        If the recorder cannot be reached, or the store not be written.
    """
    if connect is not None:
        with ZenohBus(connect=[connect]) as bus, DurablePublisher(bus, spool=spool) as publisher:
            yield RunPath(publisher, publisher, publisher.drain, f"to the recorder at {connect}", None)
    else:
        # of the same interval as those of a `gyrofleet estimate` that may have begun them, else they would differ
        every_s = every_s or estimated_every_s(folder, run)
        with EmbeddedPipeline(folder, "gyrofleet run", spool=spool, estimate_every_s=every_s) as pipeline:
            where = f"recorded in this process to {folder}"
            yield RunPath(pipeline, pipeline.publisher, pipeline.finish, where, folder)
