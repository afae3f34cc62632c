"""The command `gyrofleet compensate`."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.security.rights import Role
from stream.terminal.console import print_json, reporting, store_option, until_stopped
from stream.terminal.security_options import secured

if TYPE_CHECKING:
    from stream.events import AnyDocument


@click.command("compensate")
@store_option
@click.option("--connect", help="Where the recorder listens; by default, where the one listens that writes the store.")
@click.option(
    "--watch-every", "watch_every_s", type=click.FloatRange(min=1.0), default=60.0, show_default=True,
    help="Seconds between looks at runs that have been recorded, which may refuse a model.",
)  # fmt: skip
@configured("compensate")
@reporting
@logged("compensate")
@secured(Role.ESTIMATOR)
def compensate(folder: Path, connect: str | None, watch_every_s: float, *, as_json: bool) -> None:
    """Take off what the live error models predict, as SIGNAL_compensated beside the raw signal, until stopped.

    Stopped or killed and started again, it goes on where it stood: nothing is lost, nothing is there twice. Recorded
    runs are watched: a model that explains them worse than the one before it is rolled back. A model that is promoted
    or rolled back acts from a unit's next power-on or run on.
    """
    from analytics.loop.live.compensation_worker import CompensationWorker
    from analytics.loop.live.residual_watch import watch_store
    from storage.store import Store, only_one, recorder_endpoint, writer_endpoint
    from stream.delivery.publisher import DurablePublisher
    from stream.errors import BusError
    from stream.transport.zenoh_bus import ZenohBus

    connect = connect or writer_endpoint(folder)
    if connect is None:
        raise BusError(f"no `gyrofleet record` writes {folder} now; start one, or give --connect with its address")
    if connect != recorder_endpoint(folder):
        raise BusError(
            f"{connect} is not where the recorder of {folder} listens: compensation reads the log of the store that it "
            "sends to; give --store with that recorder's folder"
        )
    log, store = RoleLog("compensate"), Store.open(folder)

    def show(document: "AnyDocument") -> None:
        if as_json:
            print_json(document)
        else:
            log.write("info", "compensated", format_document(document))

    with (
        only_one(folder / "checkpoints" / "compensate.lock", "gyrofleet compensate"),
        ZenohBus(connect=[connect]) as bus,
        DurablePublisher(bus, only_store=store.identity) as publisher,
        until_stopped() as stopped,
    ):
        worker = CompensationWorker(store, publisher, on_document=show)
        log.write("info", "compensating", f"compensating what {folder} records; Ctrl-C ends")
        watch_at = time.monotonic()
        while True:
            worker.look(lambda: stopped.wait(0.0))
            if time.monotonic() >= watch_at:
                for document in watch_store(store):
                    show(document)
                watch_at = time.monotonic() + watch_every_s
            if stopped.wait(worker.pause_s):
                break
        publisher.drain()
    log.write("info", "ended", f"{worker.samples:,} compensated samples sent", samples=worker.samples)


def format_document(document: "AnyDocument") -> str:
    """One line on a document for people.

    >>> from stream.events import NoteAdded
    >>> format_document(NoteAdded(run="r1", t_ns=0, text="door opened"))
    'door opened'
    """
    from stream.events import CompensationStarted, ModelActivated, NoteAdded, ResidualWatched

    match document:
        case CompensationStarted():
            model = f"version {document.version} of its error model"
            return f"run {document.run}, unit {document.unit}: {document.compensated} by {model}"
        case ResidualWatched():
            if document.gain is None:
                return f"{document.stretch}, unit {document.unit}: not watched: {document.reason}"
            now = f"gains {document.gain:.2f}, cusum {document.cusum:.2f} of {document.threshold:.2f}"
            line = f"{document.stretch}, unit {document.unit}: version {document.version} {now}"
            again = f"; refused: trace the unit again with `gyrofleet diagnose --unit {document.unit}`"
            return line + (again if document.is_refused else "")
        case ModelActivated():
            return f"unit {document.unit}: version {document.version} is {document.stage}: {document.reason}"
        case NoteAdded():
            return document.text
    return type(document).__name__
