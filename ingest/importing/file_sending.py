"""Transfer of one file to a recorder: comparison with the store, sending, and the result."""

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from uuid import NAMESPACE_URL, UUID, uuid5

import msgspec

from ingest.importing.repeated_files import ImportedFile, note_of_import
from ingest.importing.shared_runs import (
    Span,
    are_apart,
    other_tests,
    refuse_shared,
    warning_of_excluded,
    warning_of_shared,
)
from ingest.importing.station_details import Restated, check_details, restated
from ingest.importing.stored import StoredSamples
from ingest.importing.stored_steps import StoredSteps
from ingest.importing.tested_units import no_output_warnings, tested_units
from ingest.station.units_file import UnitEntry, mounted_documents
from ingest.tables.rows import BadRow
from ingest.tables.sample_file import Progress, SampleFile, SignalSummary, TableSummary
from storage.recording.knowledge import Knowledge
from stream.batch import SampleBatch
from stream.decoding import decode_json
from stream.defects.rate_changes import RateChange
from stream.delivery.publisher import Sender
from stream.errors import BadInput, StoreError
from stream.events import NoteAdded, RunEnded, RunStarted, StationStated, StepStarted, StreamTotal, UnitMounted
from stream.identity import Place, event_key, sample_key
from stream.security.actor import Actor

if TYPE_CHECKING:
    from ingest.can.summary import CanCounts

_Name = tuple[str, str, str]

_NAMESPACE = uuid5(NAMESPACE_URL, "gyrofleet/import")


class CheckedFile(NamedTuple):
    """A file that was read once; `checking_s` is what that took, seconds."""

    path: Path
    file: SampleFile
    summary: TableSummary
    checking_s: float


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
    rate_changes: tuple[RateChange, ...] = ()


@dataclass(frozen=True)
class FileImport:
    """Result for one file."""

    file: str
    rows: int
    bad_row_count: int
    bad_rows: tuple[BadRow, ...]
    steps: int
    steps_added: int  # new ones, and stored ones of which the file has more
    date_known: bool
    seconds: float
    signals: tuple[SignalImport, ...]
    recovered: tuple[str, ...] = ()
    counted: str = "rows"
    damage: str = ""
    remarks: tuple[str, ...] = ()
    frames: "CanCounts | None" = None
    restated: tuple[Restated, ...] = ()  # stored runs whose station this file states
    recorder_store: str | None = None  # identity of the recorder's store, where that is not the one of this command

    @property
    def added(self) -> int:
        """Samples that the store did not have."""
        return sum(signal.added for signal in self.signals)


@dataclass
class SendingGroup:
    """State shared by files that are sent together."""

    runs: dict[str, tuple[Path, bool]] = field(default_factory=dict)  # first file of each, and whether it is dated
    spans: dict[str, Span] = field(default_factory=dict)  # first and last sample of each run, nanoseconds
    begun: set[str] = field(default_factory=set)  # runs whose documents are sent
    named: set[tuple[str, str]] = field(default_factory=set)  # runs, and units that documents which are sent name
    stated: set[str] = field(default_factory=set)  # runs whose station is corrected


class FileSending:
    """Transfer of one file: joined to its group, compared with the store, sent, counted; see `import_files`."""

    def __init__(
        self, checked: CheckedFile, place: Place, entries: Sequence[UnitEntry], about: Mapping[str, str],
        restates: bool, by: Actor | None = None,
    ) -> None:  # fmt: skip
        self.path, self._file, self._summary, self.checking_s = checked
        self._place, self._about, self._restates = place, dict(about), restates
        self._by = {} if by is None else {"by": by.name, "identity": by.identity}
        self.station = place.station
        self._entries = {entry.serial: entry for entry in entries}
        self.spent_s = self.checking_s
        self.owners = list(dict.fromkeys((signal.unit, signal.run) for signal in self._summary.signals))
        self._of: dict[str, list[SignalSummary]] = {}  # signals by run
        for signal in self._summary.signals:
            self._of.setdefault(signal.run, []).append(signal)
        self.runs = sorted(self._of)  # that it has samples of
        self._sent: Counter[_Name] = Counter()
        self._is_sent = False
        self._restated: list[Restated] = []
        self._warnings: list[str] = []

    def join(self, group: SendingGroup) -> None:
        """Join files of the same command; raises BadInput if only one of them has a date for the same run."""
        self._group = group
        for run in self.runs:
            path, is_dated = group.runs.setdefault(run, (self.path, self._summary.date_known))
            if is_dated != self._summary.date_known:
                dated, undated = (path, self.path) if is_dated else (self.path, path)
                raise BadInput(
                    f"{undated}: its times count from the start of run {run}, whose date {dated} gives; give --start, "
                    f"or import the files with another --run each"
                )
            span = self._first_ns(run), self._last_ns(run)
            before = group.spans.setdefault(run, span)
            if is_dated and self._summary.is_run_by_name and are_apart(before, span):
                raise refuse_shared(self.path, run, f"the samples of {path} too")
            group.spans[run] = min(before[0], span[0]), max(before[1], span[1])

    def compare(self, knowledge: Knowledge) -> None:
        """Compare the file with the store; raises BadInput if they contradict each other."""
        self._stored = StoredSamples(knowledge, self.path, self._summary)
        self._common = self._stored.check(self._file)
        self._other_names = self._stored.under_other_names(self._file)
        self._held = _held(knowledge, self.runs)
        self._known_uids = frozenset(self._stored.known.uids)
        self._check_moved()
        self._stated = {run: dict(details) for run, details in self._stored.known.stated.items()}
        self._steps = StoredSteps(self._stored.known, self.path, self._summary, self._stored.moment)
        self._check_shared()
        documents = [decode_json(text, UnitMounted) for text in self._stored.known.mounted]
        self._last_mounted = {(each.run, each.unit): each for each in documents}

    def _check_shared(self) -> None:
        """Refuse a run that the file's name gives to another day; warn of one that it gives to other units."""
        signals = self._stored.known_signals
        for run, own in self._of.items():
            stored = [each for each in signals if each.run == run]
            others = other_tests(stored, own, is_dated=self._summary.date_known)
            zone = self._stated.get(run, {}).get("time_zone") or self._about.get("time_zone")
            if self._summary.is_run_by_name and others.are_apart:
                raise refuse_shared(self.path, run, others.text(zone))
            if not self._restates:
                check_details(self.path, run, self._stated.get(run, {}), self._about, others)
            warning = warning_of_shared(run, others, self._summary, zone)
            both = {each.unit for each in stored} & set(self._units_of(run))
            if warning is not None and (not both or both & others.spans.keys()):
                self._warnings.append(warning)
            excluded = {
                unit: why for of, unit, why in self._stored.known.excluded if of == run and unit in self._units_of(run)
            }
            if excluded:
                self._warnings.append(warning_of_excluded(run, excluded))

    def _check_moved(self) -> None:
        """Refuse a file whose samples a run has at other times: each would be there twice."""
        for run, signals in self._of.items():
            names = [(each.unit, run, each.signal) for each in signals]
            if any(self._common[name] for name in names):
                continue
            if all(self._held[name] for name in names) and self._started(run, self._content).uid in self._known_uids:
                raise self._moved(run, "this very file at other times")
            for unit in dict.fromkeys(each.unit for each in signals):
                if (shift := self._stored.shifted(self._file, (unit, run))) is not None:
                    raise self._moved(run, f"of unit {unit} {shift}")

    def _moved(self, run: str, what: str) -> BadInput:
        return BadInput(
            f"{self.path}: run {run} has {what}; what is stored stays, and its rows would be there twice. With another "
            "--start or --time-zone, import it as another run: --run NAME; if the stored one is wrong, leave that run "
            f"out (`gyrofleet runs exclude {run} --reason ...`)"
        )

    @property
    def content(self) -> ImportedFile | None:
        """Its content and names; None if nothing of it was sent."""
        if not self._is_sent:
            return None
        return ImportedFile(self._content, {run: self._units_of(run) for run in self.runs})

    @cached_property
    def _content(self) -> str:
        """SHA-256 of the file."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def send(self, sender: Sender, progress: Progress | None) -> None:
        """Publish what the store does not have: samples, steps, and the documents of their runs."""
        open_runs = self._stored.open_runs & self._of.keys()
        is_all_there = self._common.total() == sum(s.sampling.samples for s in self._summary.signals)
        if is_all_there and not self._summary.steps and not open_runs and not self._entries and not self._about:
            return
        content, self._is_sent = self._content, True
        epochs = {owner: self._epoch(content, *owner) for owner in self.owners}
        send = partial(sender.send_event, event_key(self._place))
        for run in self._of:
            if run not in self._group.begun and run not in self._stored.runs:
                self._group.begun.add(run)
                started = self._started(run, content)
                self._group.named |= {(run, unit) for unit in started.units}
                send(started)
            elif run in self._stated and self._about.items() - self._stated[run].items():
                before, self._stated[run] = self._stated[run], self._stated[run] | self._about
                if run not in self._group.stated:
                    self._group.stated.add(run)
                    units = sorted({unit for unit, of, _ in self._held if of == run})
                    self._restated.append(restated(run, units, before, self._about))
                    send(StationStated(run=run, t_ns=self._first_ns(run), details=self._stated[run], **self._by))
            for mounted in self._mounted(run):
                self._group.named.add((run, mounted.unit))
                send(mounted)
        news = self._send_file(sender, epochs, progress)
        for run in self._of:
            is_ours = self._started(run, content).uid in self._known_uids  # killed before it could end the run
            if is_ours if run in open_runs else news:
                send(self._note(run, content))
                send(self._ended(run, epochs))

    def _send_file(self, sender: Sender, epochs: dict[tuple[str, str], UUID], progress: Progress | None) -> int:
        """Send samples and steps that the store does not have; returns how many messages that were."""
        news = 0
        for item in self._file.batches(lambda unit, run: epochs[unit, run], self._stored.new, progress):
            if isinstance(item, SampleBatch):
                sender.send_batch(sample_key(self._place, item.unit, item.signal), item)
                self._sent[item.unit, item.run, item.signal] += len(item)
                news += 1
                continue
            document = self._steps.at_start(item) if isinstance(item, StepStarted) else self._steps.at_end(item)
            if document is not None:
                sender.send_event(event_key(self._place), document)
                news += 1
        return news

    def missing(self, in_lake: Counter[_Name], where: str) -> str | None:
        """A sentence on samples that were sent and are not in the lake; None if all are there."""
        in_file = {(s.unit, s.run, s.signal): s.sampling.samples for s in self._summary.signals}
        expected = {name: self._held[name] - self._common[name] + count for name, count in in_file.items()}
        wrong = [name for name in self._sent if in_lake[name] != expected[name]]
        if not wrong:
            return None
        unit, run, signal = name = wrong[0]
        return (
            f"{self.path}: unit {unit}, run {run}, signal {signal}: {self._sent[name]} samples were sent and "
            f"{expected[name]} are expected, but the lake holds {in_lake[name]}; the log has what was "
            f"acknowledged, look at {where}"
        )

    def result(
        self, in_lake: Counter[_Name] | None, seconds: float, recovered: tuple[str, ...] = (),
        warnings: tuple[str, ...] = (),
    ) -> FileImport:  # fmt: skip
        """Result for the file."""
        summary = self._summary
        return FileImport(
            file=str(self.path), rows=summary.rows, bad_row_count=summary.bad_rows, bad_rows=summary.bad,
            steps=len(summary.steps), steps_added=self._steps.added, date_known=summary.date_known, seconds=seconds,
            signals=tuple(self._signal_result(signal, in_lake) for signal in summary.signals), recovered=recovered,
            counted=summary.counted, damage=summary.damage,
            remarks=(
                *warnings, *no_output_warnings(summary.signals), *self._warnings, *self._other_names, *summary.remarks
            ),
            frames=getattr(summary, "frames", None), restated=tuple(self._restated),
        )  # fmt: skip

    def _signal_result(self, signal: SignalSummary, in_lake: Counter[_Name] | None) -> SignalImport:
        name = (signal.unit, signal.run, signal.signal)
        return SignalImport(
            *name, unit_of_measure=signal.unit_of_measure, in_file=signal.sampling.samples,
            added=signal.sampling.samples - self._common[name], already_stored=self._common[name],
            in_lake=None if in_lake is None else in_lake[name], sample_interval_s=signal.sampling.dt_ns / 1e9,
            irregular=signal.sampling.irregular, rate_changes=signal.sampling.rate_changes,
        )  # fmt: skip

    def _epoch(self, content: str, unit: str, run: str) -> UUID:
        """The same samples at the same times have the same epoch, so that a recorder recognises them."""
        mine = [(s.signal, s.sampling) for s in self._of[run] if s.unit == unit]
        sampled = [f"{signal} {each.samples} {each.t_first_ns} {each.t_last_ns}" for signal, each in mine]
        return uuid5(_NAMESPACE, "\0".join([content, unit, run, str(self._common.total()), *sampled]))

    def _started(self, run: str, content: str) -> RunStarted:
        return RunStarted(
            run=run, t_ns=self._first_ns(run), uid=_uid("started", run, content), date_known=self._summary.date_known,
            source=f"file {self.path.name}", units=tuple(dict.fromkeys(signal.unit for signal in self._of[run])),
            details=self._about, procedure=self._procedure(),
            lot=self._lot(run),
        )  # fmt: skip

    def _procedure(self) -> str | None:
        """The procedure of all steps; None if they are of several."""
        own = self._summary.procedures
        if self._summary.words is not None:
            own |= {self._summary.words.procedure}
        return next(iter(own)) if len(own) == 1 else None

    def _lot(self, run: str) -> str | None:
        """The lot of all units of a run; None if they are of several."""
        units = {signal.unit for signal in self._of[run]}
        lots = {self._entries[unit].lot if unit in self._entries else None for unit in units}
        return lots.pop() if len(lots) == 1 else None

    def _mounted(self, run: str) -> list[UnitMounted]:
        """Documents on the units of the run, if the last stored ones differ."""
        units = dict.fromkeys(signal.unit for signal in self._of[run])
        new = self._new_units(run)
        entries = [
            self._entries.get(unit, UnitEntry(serial=unit)) for unit in units if unit in self._entries or unit in new
        ]
        documents = mounted_documents(entries, run, self._first_ns(run))
        later = [_following(each, self._last_mounted.get((run, each.unit))) for each in documents]
        found = [each for each in later if each is not None]
        return [msgspec.structs.replace(each, **self._by) if each.unit in self._entries else each for each in found]

    def _new_units(self, run: str) -> set[str]:
        """Tested units that the run gets from this file, and that nothing names."""
        stored = {unit for unit, of, _ in self._held if of == run}
        return {
            unit for unit in tested_units(self._of[run])
            if unit not in stored and (run, unit) not in self._group.named and (run, unit) not in self._last_mounted
        }  # fmt: skip

    def _units_of(self, run: str) -> list[str]:
        return sorted({signal.unit for signal in self._of[run]})

    def _note(self, run: str, content: str) -> NoteAdded:
        added = sum(self._sent[s.unit, s.run, s.signal] for s in self._of[run])
        units = self._units_of(run)
        text = note_of_import(self.path.name, content, units, added)
        if self._summary.bad_rows:
            text += f"; {self._summary.bad_rows} of {self._summary.rows} rows left out as bad"
        for remark in filter(None, (self._summary.damage, *self._other_names, *self._summary.remarks)):
            text += f"; {remark}"
        t_ns = self._last_ns(run)
        uid = _uid("noted", run, content, str(self._common.total()), str(t_ns), *units)
        return NoteAdded(run=run, t_ns=t_ns, uid=uid, text=text, author="import")

    def _ended(self, run: str, epochs: dict[tuple[str, str], UUID]) -> RunEnded:
        totals = []
        for s in self._of[run]:
            epoch, samples = str(epochs[s.unit, run]), self._sent[s.unit, run, s.signal]
            totals.append(StreamTotal(unit=s.unit, signal=s.signal, epoch=epoch, samples=samples))
        uid = _uid("ended", run, *(str(epoch) for epoch in epochs.values()))
        return RunEnded(run=run, t_ns=self._last_ns(run), uid=uid, totals=tuple(totals))

    def _first_ns(self, run: str) -> int:
        return min(signal.sampling.t_first_ns for signal in self._of[run])

    def _last_ns(self, run: str) -> int:
        return max(signal.sampling.t_last_ns for signal in self._of[run])


def _following(new: UnitMounted, last: UnitMounted | None) -> UnitMounted | None:
    """The document, dated after the `last` one; None if that has the same content."""
    if last is None:
        return new
    if msgspec.structs.replace(new, t_ns=last.t_ns, uid=last.uid, by=last.by, identity=last.identity) == last:
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


def _uid(*parts: str) -> str:
    return uuid5(_NAMESPACE, "\0".join(parts)).hex
