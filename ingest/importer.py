"""Importing a file: over the bus, into the log and the lake, each sample once, and counted at the end."""

import hashlib
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from uuid import NAMESPACE_URL, UUID, uuid5

import msgspec
import numpy as np

from ingest.instruments.can_samples import CanCounts
from ingest.instruments.can_summary import CanSummary
from ingest.instruments.table_rows import BadRow
from ingest.instruments.table_summary import SignalSummary, TableSummary
from ingest.pipeline import EmbeddedPipeline
from ingest.sample_file import Progress, SampleFile
from ingest.stored import StoredSamples
from ingest.units_file import UnitEntry, mounted_documents
from storage.catalog import Catalog
from storage.store import Store, writer_endpoint
from stream.batch import BoolArray, IntArray, SampleBatch
from stream.delivery import DurablePublisher, Sender
from stream.errors import BadInput, StoreError
from stream.events import NoteAdded, RunEnded, RunStarted, StreamTotal, UnitMounted
from stream.identity import Place, event_key, sample_key
from stream.zenoh_bus import ZenohBus

_Name = tuple[str, str, str]

_NAMESPACE = uuid5(NAMESPACE_URL, "gyrofleet/import")
_LAKE_PATIENCE_S = 60.0


@dataclass(frozen=True)
class SignalImport:
    """What became of one signal of a file; `in_lake` is None where the lake cannot be seen from here."""

    unit: str
    run: str
    signal: str
    unit_of_measure: str
    in_file: int
    added: int
    already_stored: int
    in_lake: int | None
    sample_interval_s: float
    irregular: bool


@dataclass(frozen=True)
class FileImport:
    """What became of one file."""

    file: str
    rows: int
    bad_row_count: int
    bad_rows: tuple[BadRow, ...]
    steps: int
    date_known: bool
    seconds: float
    signals: tuple[SignalImport, ...]
    recovered: tuple[str, ...] = ()
    counted: str = "rows"
    damage: str = ""
    remarks: tuple[str, ...] = ()
    frames: CanCounts | None = None

    @property
    def added(self) -> int:
        """Samples that the store did not have."""
        return sum(signal.added for signal in self.signals)


class _Sending:
    """One file on its way to a recorder."""

    def __init__(
        self, path: Path, file: SampleFile, summary: TableSummary, place: Place, entries: Sequence[UnitEntry] = ()
    ) -> None:
        self._path = path
        self._file = file
        self._summary = summary
        self._place = place
        self._entries = {entry.serial: entry for entry in entries}
        self._stored: StoredSamples | None = None
        self._common: Counter[_Name] = Counter()
        self._sends_all = False
        self._held: Counter[_Name] = Counter()
        self._known_uids: frozenset[str] = frozenset()
        self._last_mounted: dict[tuple[str, str], UnitMounted] = {}
        self._sent: Counter[_Name] = Counter()

    def compare(self, store: Store) -> None:
        """Find out what the store has of the file; raises BadInput where the two contradict each other."""
        catalog = Catalog(store)
        self._stored = StoredSamples(catalog, self._path, self._summary)
        self._common = self._stored.check(self._file)
        self._held = _held(catalog)
        runs = sorted({signal.run for signal in self._summary.signals})
        known = catalog.rows(
            "select uid from events where (kind like 'Step%' or kind = 'RunStarted') and run in (select unnest($runs))",
            {"runs": runs},
        )
        self._known_uids = frozenset(str(uid) for (uid,) in known)
        if not self._entries:
            return
        mounted = catalog.rows(
            "select document from events join units using (run, unit, uid) where run in (select unnest($runs))",
            {"runs": runs},
        )
        documents = [msgspec.json.decode(text, type=UnitMounted) for (text,) in mounted]
        self._last_mounted = {(each.run, each.unit): each for each in documents}

    def send_all(self) -> None:
        """Send everything under the file's own name, and leave it to the recorder to know again what it has.

        What a recorder that is running has in its open segment is not in the lake, so that the lake cannot tell
        what is missing; its numbers can.

        Raises
        ------
        BadInput
            If the store has a part of the file under another name.
        """
        self._sends_all = True
        for name, count in self._common.items():
            unit, run, signal = name
            mine = str(self._epoch(_sha256(self._path), unit, run))
            if count and self._stored is not None and self._stored.epochs(name) != {mine}:
                raise BadInput(
                    f"{self._path}: a part of unit {unit}, signal {signal}, run {run} came to the store by another "
                    f"import; complete it without --connect, once the recorder has ended"
                )

    def send(self, sender: Sender, progress: Progress | None) -> None:
        """Publish what the store does not have: samples, steps, and the documents of the runs they belong to."""
        runs = dict.fromkeys(signal.run for signal in self._summary.signals)
        open_runs = set() if self._stored is None else self._stored.open_runs & set(runs)
        is_all_there = self._common.total() == sum(s.sampling.samples for s in self._summary.signals)
        if is_all_there and not self._summary.steps and not open_runs and not self._entries:
            return
        content = _sha256(self._path)
        owners = dict.fromkeys((s.unit, s.run) for s in self._summary.signals)
        epochs = {owner: self._epoch(content, *owner) for owner in owners}
        for run in runs:
            if self._stored is None or run not in self._stored.runs:
                sender.send_event(event_key(self._place), self._started(run, content))
            for mounted in self._mounted(run):
                sender.send_event(event_key(self._place), mounted)
        news = self._send_file(sender, epochs, progress)
        for run in runs:
            is_ours = self._started(run, content).uid in self._known_uids  # killed before it could end the run
            if is_ours if run in open_runs else news:
                sender.send_event(event_key(self._place), self._noted(run, content))
                sender.send_event(event_key(self._place), self._ended(run, epochs))

    def _send_file(self, sender: Sender, epochs: dict[tuple[str, str], UUID], progress: Progress | None) -> int:
        """Send samples and steps that the store does not have; returns how many messages that were."""
        news = 0
        for item in self._file.batches(lambda unit, run: epochs[unit, run], self._keep, progress):
            if isinstance(item, SampleBatch):
                sender.send_batch(sample_key(self._place, item.unit, item.signal), item)
                self._sent[item.unit, item.run, item.signal] += len(item)
                news += 1
            elif item.uid not in self._known_uids:
                sender.send_event(event_key(self._place), item)
                news += 1
        return news

    def await_lake(self, store: Store, *, patience_s: float) -> Counter[_Name]:
        """Samples of each signal in the lake, once all that was sent is there."""
        deadline = time.monotonic() + patience_s
        while True:
            with Catalog(store) as catalog:
                in_lake = _held(catalog)
            expected = {name: self._held[name] - self._common[name] + count for name, count in self._in_file().items()}
            wrong = [name for name in self._sent if in_lake[name] != expected[name]]
            if not wrong:
                return in_lake
            if time.monotonic() >= deadline:
                unit, run, signal = name = wrong[0]
                raise StoreError(
                    f"{self._path}: unit {unit}, run {run}, signal {signal}: {self._sent[name]} samples were sent and "
                    f"{expected[name]} are expected, but the lake holds {in_lake[name]}; the log has what was "
                    f"acknowledged, look at {store.log}"
                )
            time.sleep(0.2)

    def result(self, signal: SignalSummary, in_lake: Counter[_Name] | None) -> SignalImport:
        """What became of one signal."""
        name = (signal.unit, signal.run, signal.signal)
        return SignalImport(
            *name,
            unit_of_measure=signal.unit_of_measure,
            in_file=signal.sampling.samples,
            added=signal.sampling.samples - self._common[name],
            already_stored=self._common[name],
            in_lake=None if in_lake is None else in_lake[name],
            sample_interval_s=signal.sampling.dt_ns / 1e9,
            irregular=signal.sampling.irregular,
        )

    def _keep(self, unit: str, run: str, signal: str, times_ns: IntArray) -> BoolArray:
        if self._stored is None or self._sends_all:
            return np.ones(len(times_ns), np.bool_)
        return self._stored.new(unit, run, signal, times_ns)

    def _in_file(self) -> dict[_Name, int]:
        return {(s.unit, s.run, s.signal): s.sampling.samples for s in self._summary.signals}

    def _epoch(self, content: str, unit: str, run: str) -> UUID:
        """The same samples at the same times carry the same name, so that a recorder knows them again."""
        sampled = [
            f"{s.signal} {s.sampling.samples} {s.sampling.t_first_ns} {s.sampling.t_last_ns}"
            for s in self._summary.signals
            if (s.unit, s.run) == (unit, run)
        ]
        common = 0 if self._sends_all else self._common.total()
        return uuid5(_NAMESPACE, "\0".join([content, unit, run, str(common), *sampled]))

    def _of(self, run: str) -> list[SignalSummary]:
        return [signal for signal in self._summary.signals if signal.run == run]

    def _started(self, run: str, content: str) -> RunStarted:
        return RunStarted(
            run=run,
            t_ns=min(signal.sampling.t_first_ns for signal in self._of(run)),
            uid=_uid("started", run, content),
            date_known=self._summary.date_known,
            source=f"file {self._path.name}",
            units=tuple(dict.fromkeys(signal.unit for signal in self._of(run))),
        )

    def _mounted(self, run: str) -> list[UnitMounted]:
        """What the list of units says of those in the run, where the store's last word of them is another."""
        units = dict.fromkeys(signal.unit for signal in self._of(run))
        entries = [self._entries[unit] for unit in units if unit in self._entries]
        begin_ns = min(signal.sampling.t_first_ns for signal in self._of(run))
        documents = mounted_documents(entries, run, begin_ns)
        later = [_said_after(each, self._last_mounted.get((run, each.unit))) for each in documents]
        return [each for each in later if each is not None]

    def _noted(self, run: str, content: str) -> NoteAdded:
        added = sum(self._sent[s.unit, s.run, s.signal] for s in self._of(run))
        text = f"imported {self._path.name} (sha256 {content}): {added} samples"
        if self._summary.bad_rows:
            text += f"; {self._summary.bad_rows} of {self._summary.rows} rows left out as bad"
        for remark in filter(None, (self._summary.damage, *self._summary.remarks)):
            text += f"; {remark}"
        return NoteAdded(
            run=run,
            t_ns=self._last_ns(run),
            uid=_uid("noted", run, content, str(self._common.total()), str(self._last_ns(run))),
            text=text,
            author="import",
        )

    def _ended(self, run: str, epochs: dict[tuple[str, str], UUID]) -> RunEnded:
        totals = tuple(
            StreamTotal(
                unit=s.unit,
                signal=s.signal,
                epoch=str(epochs[s.unit, s.run]),
                samples=self._sent[s.unit, s.run, s.signal],
            )
            for s in self._of(run)
        )
        uid = _uid("ended", run, *(str(epoch) for epoch in epochs.values()))
        return RunEnded(run=run, t_ns=self._last_ns(run), uid=uid, totals=totals)

    def _last_ns(self, run: str) -> int:
        return max(signal.sampling.t_last_ns for signal in self._of(run))


def _said_after(new: UnitMounted, last: UnitMounted | None) -> UnitMounted | None:
    """Return the document as what is said after another; None where that says the same already."""
    if last is None:
        return new
    if msgspec.structs.replace(new, t_ns=last.t_ns, uid=last.uid) == last:
        return None
    return msgspec.structs.replace(new, t_ns=max(new.t_ns, last.t_ns), uid=_uid("mounted", new.uid, last.uid))


def import_file(
    path: Path,
    file: SampleFile,
    summary: TableSummary,
    folder: Path,
    place: Place,
    *,
    connect: str | None = None,
    listen: Sequence[str] = (),
    units: Sequence[UnitEntry] = (),
    progress: Progress | None = None,
    checking_s: float = 0.0,
) -> FileImport:
    """Bring a checked file into a store.

    Parameters
    ----------
    path, file, summary
        The file and what its first pass found.
    folder : Path
        The store, for the embedded path; with `connect` it is looked at only if the recorder there writes it.
    place : Place
        Site and station that the samples are said to come from.
    connect : str, optional
        Endpoint of a recorder in another process.
    listen : sequence of str
        Endpoints on which others may listen in (embedded path).
    units : sequence of UnitEntry
        Product, lot, fixture and so on of units; of each that the file has samples of.
    progress : callable, optional
        Called with the fraction that is sent.
    checking_s : float
        What the first pass took, seconds; part of the time that is reported.

    Raises
    ------
    BadInput
        If the file contradicts what the store has; the store is then as it was.
    StoreError
        If the lake does not hold what was sent.
    DeliveryError
        If no recorder acknowledges it.
    """
    began = time.monotonic()
    sending = _Sending(path, file, summary, place, units)
    recovered: tuple[str, ...] = ()
    if connect is None:
        with EmbeddedPipeline(folder, "gyrofleet import", listen=listen) as pipeline:
            recovered = tuple(each.segment for each in pipeline.recovered)
            pipeline.recorder.wait_for_lake()
            sending.compare(pipeline.store)
            sending.send(pipeline, progress)
            pipeline.finish()
        store: Store | None = pipeline.store
    else:
        store = Store.open(folder) if writer_endpoint(folder) == connect else None
        if store is not None:
            sending.compare(store)
            sending.send_all()
        with ZenohBus(connect=[connect]) as bus, DurablePublisher(bus) as publisher:
            sending.send(publisher, progress)
            publisher.drain()
    in_lake = None if store is None else sending.await_lake(store, patience_s=_LAKE_PATIENCE_S if connect else 0.0)
    return FileImport(
        file=str(path),
        rows=summary.rows,
        bad_row_count=summary.bad_rows,
        bad_rows=summary.bad,
        steps=summary.steps,
        date_known=summary.date_known,
        seconds=checking_s + time.monotonic() - began,
        signals=tuple(sending.result(signal, in_lake) for signal in summary.signals),
        recovered=recovered,
        counted=summary.counted,
        damage=summary.damage,
        remarks=summary.remarks,
        frames=summary.frames if isinstance(summary, CanSummary) else None,
    )


def _held(catalog: Catalog) -> Counter[_Name]:
    rows = catalog.rows("select unit, run, signal, samples from signals")
    return Counter({(unit, run, signal): samples for unit, run, signal, samples in rows})


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _uid(*parts: str) -> str:
    return uuid5(_NAMESPACE, "\0".join(parts)).hex
