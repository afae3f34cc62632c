"""Verification of the log: its manifest, every byte of its segments, and the numbers of every stream."""

import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from uuid import UUID

from storage.attestation.verified_state import VerifiedState
from storage.check.ahead import ahead
from storage.check.continued_messages import ContinuedMessages
from storage.findings import Finding, Severity
from storage.log.files import sealed_segments, unknown_files
from storage.log.misplaced import misplaced_segments
from storage.log.recovery import left_open, reached_in
from storage.log.sequence import DOCUMENTS, LogPlace, LostStretch, SequenceCheck, place_of, raise_positions
from storage.log.store_documents import is_foreign
from storage.log.tail import open_records
from storage.manifests.entries import SegmentEntry
from storage.manifests.lake import read_manifest
from storage.manifests.log import manifest_path, read_log_manifest
from storage.segments.disk import HASHED_AT_ONCE, sha256_of
from storage.segments.reader import SegmentScan, read_chunks, spans_in
from storage.segments.records import EVENTS, LogRecord
from storage.store import Store, writer_is_active
from stream.errors import GyrofleetError, OutOfMemory, StoreError
from stream.events import RunEnded, StoreNoted, decode_event
from stream.identity import parse_key, sample_key
from stream.wire.acknowledgement import StreamId
from stream.wire.event_validation import invalid_reason

_SALVAGE = "salvage its readable part, keep the file in log/aside, and document the loss in the log"
_LOSSES = ("segment_salvaged", "segment_missing", "segment_recovered")
_LISTED_WITHIN_S = 2.0


@dataclass
class LogState:
    """Content of the log and what is wrong with it; segments by name.

    `entries` and `lost` are those of the manifest, `gone` are listed segments that do not exist. `samples` of each
    sealed segment and `messages` of all are those that can be read. `damaged` segments are not what was written;
    `before` are the positions of the streams before each of them. `undocumented` and `undocumented_salvage` are losses
    and salvaged segments without a document in the log, `declared` segments that documents declare damaged or missing,
    `documented` the lost stretches that have one. `misplaced` are files by their name that are, unchanged, the segment
    of another name, under which all else lists them. `uids` are those of the store's own documents, `totals` run and
    number of samples at the end of each stream. `compared` segments were not read, only their SHA-256 was compared.
    """

    store: str
    findings: list[Finding] = field(default_factory=list)
    entries: MutableMapping[str, SegmentEntry] = field(default_factory=dict)
    lost: dict[str, SegmentEntry] = field(default_factory=dict)
    gone: list[str] = field(default_factory=list)
    samples: dict[str, int] = field(default_factory=dict)
    messages: int = 0
    check: SequenceCheck = field(default_factory=SequenceCheck)
    damaged: list[Path] = field(default_factory=list)
    before: dict[str, dict[StreamId, int]] = field(default_factory=dict)
    undocumented: list[LostStretch] = field(default_factory=list)
    undocumented_salvage: list[str] = field(default_factory=list)
    declared: set[str] = field(default_factory=set)
    uids: set[str] = field(default_factory=set)
    documented: set[tuple[object, ...]] = field(default_factory=set)
    totals: dict[StreamId, tuple[str, int]] = field(default_factory=dict)
    compared: set[str] = field(default_factory=set)
    misplaced: dict[str, str] = field(default_factory=dict)

    def segment_of(self, path: Path) -> str:
        """Name of the segment that a file is."""
        return self.misplaced.get(path.name, path.name)

    def add(self, kind: str, severity: Severity, where: str, what: str, remedy: str = "") -> None:
        """Add a finding."""
        self.findings.append(Finding(kind, severity, where, what, remedy))


def verify_log(
    store: Store, progress: Callable[[float], None] | None = None, since: VerifiedState | None = None
) -> LogState:
    """Read all of a log; `progress` is called with the fraction that is read.

    Of segments that were verified `since`, only the SHA-256 is compared: what the log documents in them is not read.
    """
    state = LogState(store.identity)
    sealed = _verify_manifest(store, state, is_whole=since is None)
    done, size = 0, max(1, sum(path.stat().st_size for path in sealed))
    if since is not None:
        for path in _compared(sealed, state, since):
            done += path.stat().st_size
            if progress is not None:
                progress(done / size)
        sealed = [path for path in sealed if path.name not in state.compared]
    continued = ContinuedMessages(state.check)
    with ThreadPoolExecutor(1) as beside:  # hashes the next segment while one is read
        hashes = [beside.submit(sha256_of, path) for path in sealed[:1]]
        for number, path in enumerate(sealed):
            hashes += [beside.submit(sha256_of, each) for each in sealed[number + 1 : number + 2]]
            before = dict(state.check.next_seq)
            if not _verify_segment(path, state, hashes[number].result, continued):
                state.damaged.append(path)
                state.before[path.name] = before
            done += path.stat().st_size
            if progress is not None:
                progress(done / size)
    if writer_is_active(store.folder):
        for record in open_records(store):  # in which a recorder documents what it has recovered
            _read_document(record, state, is_reported=False)
    else:
        for path in left_open(store):
            what = "left open by a process that ended"
            remedy = "seal what it holds; the next `gyrofleet record` does so too"
            state.add("segment_unfinished", Severity.UNFINISHED, str(path), what, remedy)
    _verify_numbers(state)
    _verify_salvaged(store, state)
    return state


def _verify_manifest(store: Store, state: LogState, *, is_whole: bool) -> list[Path]:
    """Compare the manifest with the files; returns the sealed segments in their order."""
    if not store.log.is_dir():
        what = "the folder of the log is missing, with every segment"
        remedy = "restore it from a copy; else start it again, and document in it what is lost"
        state.add("log_missing", Severity.DAMAGE, str(store.log), what, remedy)
        return []
    until = time.monotonic() + _LISTED_WITHIN_S
    while True:
        # segments first: what is sealed later is not verified
        sealed = sealed_segments(store)
        manifest = read_log_manifest(store, whole=True)
        is_listed = all(path.name in manifest.entries for path in sealed)
        if is_listed or not writer_is_active(store.folder) or time.monotonic() >= until:
            break
        time.sleep(0.05)  # the line is written after the segment
    state.entries, state.lost = manifest.entries, manifest.lost
    for unknown in unknown_files(store):
        what = f"{unknown.why}; it is neither read nor brought to the lake"
        remedy = "move it to log/aside, with --quarantine"
        state.add("file_unknown", Severity.NOTE, str(unknown.path), what, remedy)
    where = str(manifest_path(store))
    remedy = "rebuild it from the segments, and keep the old one in log/aside"
    if not manifest_path(store).exists() and (len(sealed) > 1 or _has_parts(store)):
        state.add("manifest_missing", Severity.DAMAGE, where, "the manifest of the log is missing", remedy)
    for damage in manifest.damage:
        state.add("manifest_damaged", Severity.DAMAGE, where, f"line {damage.line}: {damage.reason}", remedy)
    sealed = _take_misplaced(store, state, sealed, misplaced_segments(store, manifest, with_equal_sizes=is_whole))
    there = {state.segment_of(path) for path in sealed}
    for name, entry in sorted(manifest.entries.items()):
        if name not in there and not (store.log / name).exists():
            state.gone.append(name)
            what = f"listed with {entry.samples:,} samples and {entry.size:,} bytes, but missing"
            remedy = "restore it from a copy; else document the loss in the log, and list it as lost"
            state.add("segment_missing", Severity.DAMAGE, str(store.log / name), what, remedy)
    return sealed


def _take_misplaced(store: Store, state: LogState, sealed: list[Path], misplaced: dict[str, str]) -> list[Path]:
    """Report segments under another name; returns the segments in their order, without what has the name of one."""
    state.misplaced = misplaced
    where_of = {own: name for name, own in misplaced.items()}
    for name, own in sorted(misplaced.items()):
        what = f"it is the segment {own}, by its SHA-256, under another name"
        state.add("segment_misplaced", Severity.DAMAGE, str(store.log / name), what, "give it its name again")
    for path in sealed:
        if path.name in where_of and path.name not in misplaced:
            what = f"it is not the segment of its name, which is {where_of[path.name]}; it was not read"
            state.add("segment_in_the_way", Severity.DAMAGE, str(path), what, "give it a free number, and read it")
    own_files = [path for path in sealed if path.name in misplaced or path.name not in where_of]
    return sorted(own_files, key=state.segment_of)


def _has_parts(store: Store) -> bool:
    """Whether the lake has parts, which came from the log."""
    try:
        return bool(read_manifest(store).parts)
    except StoreError:
        return True


def _compared(sealed: list[Path], state: LogState, since: VerifiedState) -> Iterator[Path]:
    """Compare segments that were verified before, by their hashes; yields those that are unchanged."""
    known = [
        path
        for path in sealed
        if path.name not in state.misplaced and (entry := state.entries.get(path.name)) is not None and since.has(entry)
    ]
    with ThreadPoolExecutor(HASHED_AT_ONCE) as beside:
        for path, sha256 in zip(known, beside.map(sha256_of, known), strict=True):
            entry = state.entries[path.name]
            if sha256 != entry.sha256:
                continue  # it is read, and reported
            state.compared.add(path.name)
            state.samples[path.name] = entry.samples
            state.messages += entry.messages
            raise_positions(state.check.next_seq, reached_in(path))
            if entry.origin == "salvaged":
                state.declared.add(path.stem)
            yield path


def _verify_segment(path: Path, state: LogState, hashed: Callable[[], str], continued: ContinuedMessages) -> bool:
    name = state.segment_of(path)
    entry = state.entries.get(name)
    if entry is None:
        what = "sealed, but not in the manifest"
        state.add("segment_unlisted", Severity.UNFINISHED, str(path), what, "read it whole and list it")
    reasons = [] if entry is None else _differences(path, entry, hashed)
    counted = _Counted()
    try:
        if reasons:
            for record in SegmentScan(path, sealed=True):
                counted.add(_follow(record, state))
        else:
            _follow_segment(path, state, counted, continued)
    except OutOfMemory:
        raise  # nothing is known of the segment
    except GyrofleetError as error:
        if not isinstance(error, StoreError):
            reasons.append(f"it holds a message that cannot be read: {error}")
        elif not reasons:
            reasons.append(str(error))
    samples, messages = counted.samples, counted.messages
    # a salvaged segment has marks of what its streams had reached
    for stream, next_seq in reached_in(path).items():
        state.check.reach(stream, next_seq)
    state.samples[name] = samples
    state.messages += messages
    if entry is not None and not reasons and (samples, messages) != (entry.samples, entry.messages):
        listed = f"listed are {entry.samples:,} in {entry.messages:,}"
        reasons.append(f"{samples:,} samples in {messages:,} messages, {listed}")
    if reasons:
        lost = "" if entry is None else f"; {_unread(entry.samples, samples)}"
        state.add("segment_damaged", Severity.DAMAGE, str(path), "; ".join(reasons) + lost, _SALVAGE)
    return not reasons


def _unread(listed: int, read: int) -> str:
    if read > listed:
        return f"it holds {read:,} samples, listed are {listed:,}"
    return f"{listed - read:,} of {listed:,} samples cannot be read"


def _differences(path: Path, entry: SegmentEntry, hashed: Callable[[], str]) -> list[str]:
    """What of a segment differs from its entry, by its size or hash."""
    size = path.stat().st_size
    if size != entry.size:
        return [f"{size:,} bytes instead of {entry.size:,}"]
    return [] if hashed() == entry.sha256 else ["its SHA-256 is not that of the manifest"]


@dataclass
class _Counted:
    """What of a segment has been followed."""

    messages: int = 0
    samples: int = 0

    def add(self, samples: int) -> None:
        self.messages += 1
        self.samples += samples


def _follow_segment(path: Path, state: LogState, counted: _Counted, continued: ContinuedMessages) -> None:
    """Follow the messages of an undamaged segment; those that continue their streams in the bytes of its chunks."""
    channels: dict[int, tuple[str, str]] = {}
    continued.drop_stale()
    follow = continued.follow
    messages = samples = 0
    try:
        for content in ahead(read_chunks(path)):
            for topic, schema, arrival_ns, publish_ns, begin, end, _ in spans_in(path, content, channels):
                found = follow(topic, content, begin, end)
                if not found:
                    continued.settle(topic)
                    record = LogRecord(topic, schema, arrival_ns, publish_ns, content[begin:end])
                    place = place_of(record)
                    if place is not None:
                        found = _follow_at(record, place, state)
                        continued.expect(record, place)
                samples += found
                messages += 1
    finally:
        continued.settle_all()
        counted.messages, counted.samples = messages, samples


def _follow(record: LogRecord, state: LogState) -> int:
    """Add a message; returns its number of samples."""
    place = place_of(record)
    return 0 if place is None else _follow_at(record, place, state)


def _follow_at(record: LogRecord, place: LogPlace, state: LogState) -> int:
    state.check.follow(place)
    _read_document(record, state)
    return place.samples


def _read_document(record: LogRecord, state: LogState, *, is_reported: bool = True) -> None:
    """Take what a document of the store or the end of a run says; an invalid one is ignored, and reported."""
    if record.schema != EVENTS or "/estimate/" in record.topic:
        return
    document = decode_event(record.data).document
    if (reason := invalid_reason(document)) is not None:
        if is_reported:
            where = f"{record.topic} {document.uid}"
            state.add("document_odd", Severity.NOTE, where, f"{type(document).__name__}, ignored: {reason}")
    elif isinstance(document, StoreNoted):
        _add_document(document, state)
    elif isinstance(document, RunEnded) and is_reported:
        station = parse_key(record.topic).place
        for total in document.totals:
            stream = StreamId(sample_key(station, total.unit, total.signal), UUID(total.epoch).hex)
            state.totals[stream] = (document.run, total.samples)


def _add_document(document: StoreNoted, state: LogState) -> None:
    if is_foreign(document, state.store):
        return
    state.uids.add(document.uid)
    state.documented |= {stretch_id(lost) for lost in document.details.get("lost") or []}
    segment = document.details.get("segment")
    if document.what in _LOSSES and isinstance(segment, str):
        state.declared.add(segment.partition(".")[0])


def stretch_id(lost: Mapping[str, object]) -> tuple[object, ...]:
    """Identity of a lost stretch."""
    return lost.get("key"), lost.get("epoch"), lost.get("first_seq"), lost.get("last_seq")


def _verify_salvaged(store: Store, state: LogState) -> None:
    for name, entry in state.entries.items():
        if entry.origin == "salvaged" and name not in state.gone and name.removesuffix(".mcap") not in state.declared:
            state.undocumented_salvage.append(name)
            what = "it is the readable part of a damaged segment, without a document in the log"
            state.add("salvage_undocumented", Severity.LOSS, str(store.log / name), what, "document it in the log")


def _verify_numbers(state: LogState) -> None:
    for stream, (run, samples) in state.totals.items():
        if state.check.next_seq.get(stream, 0) < samples:
            state.check.reach(stream, samples)
            what = f"run {run} ended with {samples:,} samples, not all of them are stored"
            state.add("run_incomplete", Severity.NOTE, f"{stream.key} {stream.epoch}", what)
    # samples first, then documents
    for lost in sorted(state.check.lost, key=lambda lost: lost.signal == DOCUMENTS):
        where = f"{lost.key} {lost.epoch}"
        if stretch_id(vars(lost)) in state.documented:
            state.add("loss_documented", Severity.NOTE, where, f"lost, and documented in the log: {lost}")
        else:
            state.undocumented.append(lost)
            state.add("numbers_missing", Severity.LOSS, where, str(lost), "document in the log that they are lost")
    for place in state.check.repeated:
        what = f"numbers {place.seq} to {place.next_seq - 1} are stored twice"
        where = f"{place.stream.key} {place.stream.epoch}"
        state.add("numbers_repeated", Severity.DAMAGE, where, what, "report this: a disk fault cannot cause it")
