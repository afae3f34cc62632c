"""Import of files: over the bus, into the log and the lake, each sample once, and counted at the end."""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from ingest.importing.file_sending import CheckedFile, FileImport, FileSending, SendingGroup, counted
from ingest.run.pipeline import EmbeddedPipeline
from ingest.station.units_file import UnitEntry
from ingest.tables.sample_file import SampleFile, TableSummary
from storage.recording.client import HeldClaim, RecorderClient
from storage.recording.knowledge import CatalogKnowledge
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.delivery.publisher import DurablePublisher
from stream.errors import StoreError
from stream.identity import Place
from stream.transport.zenoh_bus import ZenohBus
from stream.worker.estimated_signals import EstimatedSignals

FileProgress = Callable[[Path, float], None]

# an import needs few intermediate estimates: 24 for a day of samples, and one at its end
_ESTIMATE_EVERY_S = 3600.0
_NOTHING: Mapping[str, str] = {}


def import_files(
    checked: Sequence[CheckedFile],
    folder: Path,
    place: Place,
    *,
    connect: str | None = None,
    listen: Sequence[str] = (),
    units: Sequence[UnitEntry] = (),
    about: Mapping[str, str] = _NOTHING,
    restates: bool = False,
    estimated: EstimatedSignals = EstimatedSignals(),  # noqa: B008  immutable
    progress: FileProgress | None = None,
) -> Iterator[FileImport]:
    """Import checked files into a store; yields their results in the same order.

    Files of different units or runs go through one recorder in this process, so that hundreds of small files cost
    little more than one large one. All of them are compared with the store before the first is sent.

    Parameters
    ----------
    folder: The store, unless `connect` is the endpoint of a recorder in another process.
    listen: Endpoints for subscribers (recorder in this process).
    units: Product, lot, fixture and so on of units.
    about: Details of the station, such as its latitude; also for runs that are stored already.
    restates: Whether these replace the stored ones.
    estimated: Signals that are estimated during the import (recorder in this process).
    progress: Called with the file and the fraction of it that is sent.

    Raises
    ------
    BadInput: If a file contradicts the store; nothing of its group is imported then.
    StoreError: If the lake does not hold what was sent.
    DeliveryError: If no recorder acknowledges it.
    """
    make = partial(FileSending, place=place, entries=units, about=about, restates=restates)
    for group in _groups(checked, make):
        if connect is not None:
            yield from _sent_to_recorder(group, folder, connect, progress)
            continue
        yield from _sent_embedded(group, folder, listen, estimated, progress)


def _groups(
    checked: Sequence[CheckedFile], make: Callable[[Path, SampleFile, TableSummary], FileSending]
) -> Iterator[list[tuple[CheckedFile, FileSending]]]:
    """Files in groups without two of one unit and run: the second must be compared with the first one stored."""
    group: list[tuple[CheckedFile, FileSending]] = []
    owners: set[tuple[str, str]] = set()
    shared = SendingGroup()
    for each in checked:
        sending = make(each.path, each.file, each.summary)
        if owners & sending.owners:
            yield group
            group, owners, shared = [], set(), SendingGroup()
        sending.join(shared)
        group.append((each, sending))
        owners |= sending.owners
    if group:
        yield group


def _sent_embedded(
    group: Sequence[tuple[CheckedFile, FileSending]],
    folder: Path,
    listen: Sequence[str],
    estimated: EstimatedSignals,
    progress: FileProgress | None,
) -> Iterator[FileImport]:
    began = time.monotonic()
    own_s = []
    with EmbeddedPipeline(
        folder, "gyrofleet import", listen=listen, estimate_every_s=_ESTIMATE_EVERY_S, estimated=estimated
    ) as pipeline:
        recovered = tuple(each.segment for each in pipeline.recovered)
        pipeline.recorder.wait_for_lake()
        with Catalog(pipeline.store) as catalog:
            for _, sending in group:
                sending.compare(CatalogKnowledge(catalog))
            for each, sending in group:
                sent_at = time.monotonic()
                sending.send(pipeline, None if progress is None else partial(progress, each.path))
                own_s.append(each.checking_s + time.monotonic() - sent_at)
        pipeline.finish()
    with Catalog(pipeline.store) as catalog:
        in_lake = counted(CatalogKnowledge(catalog), [sending for _, sending in group], str(pipeline.store.log))
    yield from _results(group, in_lake, own_s, began, recovered)


def _results(
    group: Sequence[tuple[CheckedFile, FileSending]],
    in_lake: Counter[tuple[str, str, str]],
    own_s: Sequence[float],
    began: float,
    recovered: tuple[str, ...] = (),
) -> Iterator[FileImport]:
    """Result of each file; the time that all took together is divided among them."""
    spent_s = sum(own_s) - sum(each.checking_s for each, _ in group)
    shared_s = (time.monotonic() - began - spent_s) / len(group)
    for number, (_, sending) in enumerate(group):
        yield sending.result(in_lake, own_s[number] + shared_s, recovered if number == 0 else ())


def _sent_to_recorder(
    group: Sequence[tuple[CheckedFile, FileSending]], folder: Path, connect: str, progress: FileProgress | None
) -> Iterator[FileImport]:
    """Send files to a recorder in another process, compared with its own store."""
    began = time.monotonic()
    own_s = []
    owners = {owner for _, sending in group for owner in sending.owners}
    names = ", ".join(each.path.name for each, _ in group[:3])
    with ZenohBus(connect=[connect]) as bus:
        client = RecorderClient(bus, wanted=_identity(folder))
        with (
            HeldClaim(client, owners, f"import of {names}") as claim,
            DurablePublisher(bus, only_store=client.store) as publisher,
        ):
            claim.on_loss = publisher.fail
            client.settle()
            for _, sending in group:
                sending.compare(client)
            for each, sending in group:
                sent_at = time.monotonic()
                sending.send(publisher, None if progress is None else partial(progress, each.path))
                own_s.append(each.checking_s + time.monotonic() - sent_at)
            publisher.drain()
            client.settle()
            in_lake = counted(client, [sending for _, sending in group], f"the log of the recorder at {connect}")
    yield from _results(group, in_lake, own_s, began)


def _identity(folder: Path) -> str | None:
    """Identity of the store in a folder; None if there is none."""
    try:
        return Store.open(folder).identity
    except StoreError:
        return None
