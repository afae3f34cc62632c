"""Import of files: over the bus, into the log and the lake, each sample once, and counted at the end."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

from ingest.importing.file_sending import CheckedFile, FileImport, FileSending, SendingGroup, counted
from ingest.importing.repeated_files import repeated_files
from ingest.run.pipeline import EmbeddedPipeline
from ingest.station.units_file import UnitEntry
from storage.recording.client import HeldClaim, RecorderClient
from storage.recording.knowledge import AskedAhead, CatalogKnowledge, Knowledge, lake_knowledge
from storage.store import Store
from stream.delivery.publisher import DurablePublisher, Sender
from stream.errors import StoreError
from stream.identity import Place
from stream.security.actor import Actor
from stream.transport.zenoh_bus import ZenohBus
from stream.worker.estimated_signals import EstimatedSignals

FileProgress = Callable[[Path, float], None]

# an import needs few intermediate estimates: 24 for a day of samples, and one at its end
_ESTIMATE_EVERY_S = 3600.0


def import_files(
    checked: Sequence[CheckedFile], folder: Path, place: Place, *, connect: str | None = None,
    listen: Sequence[str] = (), units: Sequence[UnitEntry] = (), about: Mapping[str, str] = MappingProxyType({}),
    restates: bool = False, by: Actor | None = None, estimated: EstimatedSignals = EstimatedSignals(),
    progress: FileProgress | None = None,
) -> Iterator[FileImport]:  # fmt: skip
    """Import checked files into a store; yields their results in the same order.

    Files of different units or runs go through one recorder in this process, so that hundreds of small files cost
    little more than one large one; all of them are compared with the store before the first is sent. With `connect` a
    recorder in another process is used; that of this process lets subscribers connect at the endpoints `listen`, and
    estimates signals. `units` have product, lot, fixture and so on; `about` has details of the station, also for runs
    that are stored already, which it `restates`; `by` is who states them. `progress` gets the file and the fraction of
    it that is sent. Raises BadInput if a file contradicts the store; nothing of its group is imported then; StoreError
    if the lake does not hold what was sent; DeliveryError if no recorder acknowledges it.
    """
    make = partial(FileSending, place=place, entries=units, about=about, restates=restates, by=by)
    for group in _groups(map(make, checked)):
        if connect is not None:
            yield from _sent_to_recorder(group, folder, connect, progress)
        else:
            yield from _sent_embedded(group, folder, listen, estimated, progress)


def _groups(sendings: Iterable[FileSending]) -> Iterator[list[FileSending]]:
    """Files in groups without two of one unit and run: the second must be compared with the first one stored."""
    group: list[FileSending] = []
    owners: set[tuple[str, str]] = set()
    shared = SendingGroup()
    for sending in sendings:
        if not owners.isdisjoint(sending.owners):
            yield group
            group, owners, shared = [], set(), SendingGroup()
        sending.join(shared)
        group.append(sending)
        owners.update(sending.owners)
    if group:
        yield group


def _send(group: Sequence[FileSending], knowledge: Knowledge, sender: Sender, progress: FileProgress | None) -> None:
    asked = AskedAhead(knowledge, sorted({run for each in group for run in each.runs}))
    for each in group:
        each.compare(asked)
    for each in group:
        began = time.monotonic()
        each.send(sender, None if progress is None else partial(progress, each.path))
        each.spent_s += time.monotonic() - began


def _sent_embedded(
    group: Sequence[FileSending], folder: Path, listen: Sequence[str], estimated: EstimatedSignals,
    progress: FileProgress | None,
) -> Iterator[FileImport]:  # fmt: skip
    began = time.monotonic()
    with EmbeddedPipeline(
        folder, "gyrofleet import", listen=listen, estimate_every_s=_ESTIMATE_EVERY_S, estimated=estimated
    ) as pipeline:
        recovered = tuple(each.segment for each in pipeline.recovered)
        pipeline.recorder.wait_for_lake()
        with lake_knowledge(pipeline.store) as knowledge:
            _send(group, knowledge, pipeline, progress)
        pipeline.finish()
    from storage.sql.catalog import Catalog

    with Catalog(pipeline.store) as catalog:
        in_lake = counted(CatalogKnowledge(catalog), group, str(pipeline.store.log))
        sent = {each.path: content for each in group if (content := each.content) is not None}
        warnings = dict(zip(sent, repeated_files(catalog, list(sent.values())), strict=True))
    yield from _results(group, in_lake, began, recovered, warnings)


def _results(
    group: Sequence[FileSending], in_lake: Counter[tuple[str, str, str]], began: float, recovered: tuple[str, ...] = (),
    warnings: Mapping[Path, str | None] = MappingProxyType({}),
) -> Iterator[FileImport]:  # fmt: skip
    """Result of each file; the time that all took together is divided among them."""
    sent_s = sum(each.spent_s - each.checking_s for each in group)
    shared_s = (time.monotonic() - began - sent_s) / len(group)
    for number, sending in enumerate(group):
        own = () if (warning := warnings.get(sending.path)) is None else (warning,)
        yield sending.result(in_lake, sending.spent_s + shared_s, recovered if number == 0 else (), own)


def _sent_to_recorder(
    group: Sequence[FileSending], folder: Path, connect: str, progress: FileProgress | None
) -> Iterator[FileImport]:
    began = time.monotonic()
    identity: str | None = None
    owners = {owner for each in group for owner in each.owners}
    names = ", ".join(each.path.name for each in group[:3])
    with suppress(StoreError):  # there is no store here
        identity = Store.open(folder).identity
    with ZenohBus(connect=[connect]) as bus:
        client = RecorderClient(bus, wanted=identity)
        with (
            HeldClaim(client, owners, f"import of {names}", station=group[0].station) as claim,
            DurablePublisher(bus, only_store=client.store) as publisher,
        ):
            claim.on_loss = publisher.fail
            client.settle()
            _send(group, client, publisher, progress)
            publisher.drain()
            client.settle()
            in_lake = counted(client, group, f"the log of the recorder at {connect}")
    elsewhere = None if client.store == identity else client.store
    yield from (replace(each, recorder_store=elsewhere) for each in _results(group, in_lake, began))
