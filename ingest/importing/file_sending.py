"""Transfer of one file to a recorder: comparison with the store, sending, and the result."""

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from uuid import NAMESPACE_URL, UUID, uuid5

import msgspec
import numpy as np

from ingest.can.summary import CanCounts, CanSummary
from ingest.importing.stored import StoredSamples, check_steps
from ingest.station.units_file import UnitEntry, mounted_documents
from ingest.tables.rows import BadRow
from ingest.tables.sample_file import Progress, SampleFile, SignalSummary, TableSummary
from storage.recording.knowledge import Knowledge
from stream.batch import BoolArray, IntArray, SampleBatch
from stream.delivery.publisher import Sender
from stream.errors import BadInput, StoreError
from stream.events import NoteAdded, RunEnded, RunStarted, StationStated, StreamTotal, UnitMounted
from stream.identity import Place, event_key, sample_key

_Name = tuple[str, str, str]

_NAMESPACE = uuid5(NAMESPACE_URL, "gyrofleet/import")
_NOTHING: Mapping[str, str] = {}


@dataclass(frozen=True)
class SignalImport:
    """Result for one signal of a file; `in_lake` is None if the lake cannot be seen from here."""

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
    """Result for one file."""

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


class CheckedFile(NamedTuple):
    """A file that was read once; `checking_s` is what that took, seconds."""

    path: Path
    file: SampleFile
    summary: TableSummary
    checking_s: float


@dataclass
class SendingGroup:
    """State shared by files that are sent together.

    Attributes
    ----------
    runs: The first file of each run, and whether its date is known.
    begun, uids, stated: Runs and steps whose documents are sent, and runs whose station is corrected.
    """

    runs: dict[str, tuple[Path, bool]] = field(default_factory=dict)
    begun: set[str] = field(default_factory=set)
    uids: set[str] = field(default_factory=set)
    stated: set[str] = field(default_factory=set)


class FileSending:
    """Transfer of one file: joined to its group, compared with the store, sent, counted.

    Parameters
    ----------
    file, summary: Reader of the file, and the result of its first pass.
    entries: Product, lot, fixture and so on of units.
    about: Details of the station.
    restates: Whether these replace the stored ones.
    """

    def __init__(
        self,
        path: Path,
        file: SampleFile,
        summary: TableSummary,
        place: Place,
        entries: Sequence[UnitEntry] = (),
        about: Mapping[str, str] = _NOTHING,
        *,
        restates: bool = False,
    ) -> None:
        self._path = path
        self._file = file
        self._summary = summary
        self._place = place
        self._entries = {entry.serial: entry for entry in entries}
        self._about = dict(about)
        self._restates = restates
        self._stated: dict[str, dict[str, str]] = {}
        self._stored: StoredSamples | None = None
        self._common: Counter[_Name] = Counter()
        self._held: Counter[_Name] = Counter()
        self._known_uids: frozenset[str] = frozenset()
        self._last_mounted: dict[tuple[str, str], UnitMounted] = {}
        self._sent: Counter[_Name] = Counter()
        self._group = SendingGroup()

    @property
    def owners(self) -> set[tuple[str, str]]:
        """Units and runs that the file has samples of."""
        return {(signal.unit, signal.run) for signal in self._summary.signals}

    def join(self, group: "SendingGroup") -> None:
        """Join files of the same command; raises BadInput if only one of them has a date for the same run."""
        self._group = group
        for run in sorted({signal.run for signal in self._summary.signals}):
            path, is_dated = group.runs.setdefault(run, (self._path, self._summary.date_known))
            if is_dated != self._summary.date_known:
                dated, undated = (path, self._path) if is_dated else (self._path, path)
                raise BadInput(
                    f"{undated}: its times count from the start of run {run}, whose date {dated} gives; give --start, "
                    f"or import the files with another --run each"
                )

    @property
    def runs(self) -> list[str]:
        """Runs that the file has samples of."""
        return sorted({signal.run for signal in self._summary.signals})

    def compare(self, knowledge: Knowledge) -> None:
        """Compare the file with the store; raises BadInput if they contradict each other."""
        self._stored = StoredSamples(knowledge, self._path, self._summary)
        self._common = self._stored.check(self._file)
        self._held = _held(knowledge, self.runs)
        self._known_uids = frozenset(self._stored.known.uids)
        self._stated = {run: dict(details) for run, details in self._stored.known.stated.items()}
        check_steps(self._stored.known.steps, self._path, self._summary)
        if not self._restates:
            self._check_station()
        documents = [msgspec.json.decode(text, type=UnitMounted) for text in self._stored.known.mounted]
        self._last_mounted = {(each.run, each.unit): each for each in documents}

    def _check_station(self) -> None:
        """Refuse details of a station that differ from the stored ones: values would change silently."""
        for run in self.runs:
            stored = self._stated.get(run, {})
            for name, value in self._about.items():
                if stored.get(name, value) != value:
                    raise BadInput(
                        f"{self._path}: run {run} is stored with {name} {stored[name]}, now it is {value}; what is "
                        f"stored stays. To correct it, and all values that rest on it, give --restate"
                    )

    def send(self, sender: Sender, progress: Progress | None) -> None:
        """Publish what the store does not have: samples, steps, and the documents of their runs."""
        runs = dict.fromkeys(signal.run for signal in self._summary.signals)
        open_runs = set() if self._stored is None else self._stored.open_runs & set(runs)
        is_all_there = self._common.total() == sum(s.sampling.samples for s in self._summary.signals)
        if is_all_there and not self._summary.steps and not open_runs and not self._entries and not self._about:
            return
        content = _sha256(self._path)
        owners = dict.fromkeys((s.unit, s.run) for s in self._summary.signals)
        epochs = {owner: self._epoch(content, *owner) for owner in owners}
        for run in runs:
            if run not in self._group.begun and (self._stored is None or run not in self._stored.runs):
                self._group.begun.add(run)
                sender.send_event(event_key(self._place), self._started(run, content))
            elif run in self._stated and self._about.items() - self._stated[run].items():
                self._stated[run] |= self._about
                if run not in self._group.stated:
                    self._group.stated.add(run)
                    sender.send_event(event_key(self._place), self._station_stated(run))
            for mounted in self._mounted(run):
                sender.send_event(event_key(self._place), mounted)
        news = self._send_file(sender, epochs, progress)
        for run in runs:
            is_ours = self._started(run, content).uid in self._known_uids  # killed before it could end the run
            if is_ours if run in open_runs else news:
                sender.send_event(event_key(self._place), self._note(run, content))
                sender.send_event(event_key(self._place), self._ended(run, epochs))

    def _send_file(self, sender: Sender, epochs: dict[tuple[str, str], UUID], progress: Progress | None) -> int:
        """Send samples and steps that the store does not have; returns how many messages that were."""
        news = 0
        for item in self._file.batches(lambda unit, run: epochs[unit, run], self._keep, progress):
            if isinstance(item, SampleBatch):
                sender.send_batch(sample_key(self._place, item.unit, item.signal), item)
                self._sent[item.unit, item.run, item.signal] += len(item)
                news += 1
            elif item.uid not in self._known_uids and item.uid not in self._group.uids:
                self._group.uids.add(item.uid)
                sender.send_event(event_key(self._place), item)
                news += 1
        return news

    def missing(self, in_lake: Counter[_Name], where: str) -> str | None:
        """A sentence on samples that were sent and are not in the lake; None if all are there."""
        expected = {name: self._held[name] - self._common[name] + count for name, count in self._in_file().items()}
        wrong = [name for name in self._sent if in_lake[name] != expected[name]]
        if not wrong:
            return None
        unit, run, signal = name = wrong[0]
        return (
            f"{self._path}: unit {unit}, run {run}, signal {signal}: {self._sent[name]} samples were sent and "
            f"{expected[name]} are expected, but the lake holds {in_lake[name]}; the log has what was "
            f"acknowledged, look at {where}"
        )

    def result(self, in_lake: Counter[_Name] | None, seconds: float, recovered: tuple[str, ...] = ()) -> FileImport:
        """Result for the file."""
        summary = self._summary
        return FileImport(
            file=str(self._path),
            rows=summary.rows,
            bad_row_count=summary.bad_rows,
            bad_rows=summary.bad,
            steps=summary.steps,
            date_known=summary.date_known,
            seconds=seconds,
            signals=tuple(self._signal_result(signal, in_lake) for signal in summary.signals),
            recovered=recovered,
            counted=summary.counted,
            damage=summary.damage,
            remarks=summary.remarks,
            frames=summary.frames if isinstance(summary, CanSummary) else None,
        )

    def _signal_result(self, signal: SignalSummary, in_lake: Counter[_Name] | None) -> SignalImport:
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
        if self._stored is None:
            return np.ones(len(times_ns), np.bool_)
        return self._stored.new(unit, run, signal, times_ns)

    def _in_file(self) -> dict[_Name, int]:
        return {(s.unit, s.run, s.signal): s.sampling.samples for s in self._summary.signals}

    def _epoch(self, content: str, unit: str, run: str) -> UUID:
        """The same samples at the same times have the same epoch, so that a recorder recognises them."""
        sampled = [
            f"{s.signal} {s.sampling.samples} {s.sampling.t_first_ns} {s.sampling.t_last_ns}"
            for s in self._summary.signals
            if (s.unit, s.run) == (unit, run)
        ]
        return uuid5(_NAMESPACE, "\0".join([content, unit, run, str(self._common.total()), *sampled]))

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
            details=self._about,
        )

    def _station_stated(self, run: str) -> StationStated:
        """Details of the station, for a run that is stored without them or with others."""
        t_ns = min(signal.sampling.t_first_ns for signal in self._of(run))
        return StationStated(run=run, t_ns=t_ns, details=self._stated[run])

    def _mounted(self, run: str) -> list[UnitMounted]:
        """Documents on the units of the run, if the last stored ones differ."""
        units = dict.fromkeys(signal.unit for signal in self._of(run))
        entries = [self._entries[unit] for unit in units if unit in self._entries]
        begin_ns = min(signal.sampling.t_first_ns for signal in self._of(run))
        documents = mounted_documents(entries, run, begin_ns)
        later = [_following(each, self._last_mounted.get((run, each.unit))) for each in documents]
        return [each for each in later if each is not None]

    def _note(self, run: str, content: str) -> NoteAdded:
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


def _following(new: UnitMounted, last: UnitMounted | None) -> UnitMounted | None:
    """The document, dated after the `last` one; None if that has the same content."""
    if last is None:
        return new
    if msgspec.structs.replace(new, t_ns=last.t_ns, uid=last.uid) == last:
        return None
    return msgspec.structs.replace(new, t_ns=max(new.t_ns, last.t_ns), uid=_uid("mounted", new.uid, last.uid))


def counted(knowledge: Knowledge, sendings: Sequence[FileSending], where: str) -> Counter[_Name]:
    """Samples of each signal in the lake; raises StoreError if sent ones are missing (`where` is the log)."""
    in_lake = _held(knowledge, sorted({run for each in sendings for run in each.runs}))
    missing = next(filter(None, (each.missing(in_lake, where) for each in sendings)), None)
    if missing is not None:
        raise StoreError(missing)
    return in_lake


def _held(knowledge: Knowledge, runs: list[str]) -> Counter[_Name]:
    return Counter({(each.unit, each.run, each.signal): each.samples for each in knowledge.signals(runs)})


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _uid(*parts: str) -> str:
    return uuid5(_NAMESPACE, "\0".join(parts)).hex
