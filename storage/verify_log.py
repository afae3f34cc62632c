"""Is the log what was written: its manifest, every byte of its segments, and the numbers of every stream."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from uuid import UUID

from storage.findings import Finding, Severity
from storage.log_manifest import SegmentEntry, manifest_path, read_log_manifest
from storage.mcap_records import EVENTS, LogRecord
from storage.recovery import left_open
from storage.segment_reader import SegmentScan, read_segment
from storage.sequence import DOCUMENTS, LostStretch, SequenceCheck, place_of
from storage.store import Store, writer_is_active
from stream.delivery import StreamId
from stream.errors import GyrofleetError, StoreError
from stream.events import RunEnded, StoreNoted, decode_event
from stream.identity import parse_key, sample_key

_SALVAGE = "save what it still holds, keep the file itself in log/aside, and say in the log what is lost"


@dataclass
class LogState:
    """What the log holds and what is wrong with it.

    Parameters
    ----------
    findings : list of Finding
        In the order of the log.
    entries : dict of str to SegmentEntry
        Of the manifest.
    samples : dict of str to int
        Samples of each sealed segment, by name, as far as it can be read.
    messages : int
        Messages of all of them.
    check : SequenceCheck
        How far the streams have come, and what is missing in them.
    damaged : list of Path
        Sealed segments that are not what was written.
    before : dict of str to dict
        How far the streams had come before each of those.
    undocumented : list of LostStretch
        What is missing without a document in the log that says so.
    noted : set of str
        What the store has said of itself, in one word each.
    """

    findings: list[Finding] = field(default_factory=list)
    entries: dict[str, SegmentEntry] = field(default_factory=dict)
    samples: dict[str, int] = field(default_factory=dict)
    messages: int = 0
    check: SequenceCheck = field(default_factory=SequenceCheck)
    damaged: list[Path] = field(default_factory=list)
    before: dict[str, dict[StreamId, int]] = field(default_factory=dict)
    undocumented: list[LostStretch] = field(default_factory=list)
    noted: set[str] = field(default_factory=set)

    def add(self, kind: str, severity: Severity, where: str, what: str, remedy: str = "") -> None:
        """Note a finding."""
        self.findings.append(Finding(kind, severity, where, what, remedy))


def verify_log(store: Store, progress: Callable[[float], None] | None = None) -> LogState:
    """Read all of a log.

    Parameters
    ----------
    store : Store
        Whose.
    progress : callable, optional
        Called with the fraction that is read.
    """
    state = LogState()
    documented: list[dict[str, object]] = []
    totals: dict[StreamId, tuple[str, int]] = {}
    manifest = read_log_manifest(store)
    state.entries = manifest.entries
    sealed = sorted(store.log.glob("*.mcap"))
    where = str(manifest_path(store))
    for damage in manifest.damage:
        state.add(
            "manifest_damaged", Severity.DAMAGE, where, f"line {damage.line}: {damage.reason}",
            "write it anew from the segments, and keep what is there in log/aside",
        )  # fmt: skip
    for name in manifest.entries.keys() - {path.name for path in sealed}:
        entry = manifest.entries[name]
        state.add(
            "segment_missing", Severity.DAMAGE, str(store.log / name),
            f"listed with {entry.samples:,} samples and {entry.size:,} bytes, and not there",
            "restore it from a copy; else take it off the manifest and say in the log what is lost",
        )  # fmt: skip
    done, size = 0, max(1, sum(path.stat().st_size for path in sealed))
    for path in sealed:
        before = dict(state.check.next_seq)
        if not _verify_segment(path, state, documented, totals):
            state.damaged.append(path)
            state.before[path.name] = before
        done += path.stat().st_size
        if progress is not None:
            progress(done / size)
    _verify_numbers(state, documented, totals)
    if not writer_is_active(store.folder):
        for path in left_open(store):
            state.add(
                "segment_unfinished", Severity.UNFINISHED, str(path), "left open by a process that ended",
                "seal what it holds; the next `gyrofleet record` does so too",
            )  # fmt: skip
    return state


def _verify_segment(
    path: Path, state: LogState, documented: list[dict[str, object]], totals: dict[StreamId, tuple[str, int]]
) -> bool:
    entry = state.entries.get(path.name)
    reasons = []
    if entry is None:
        what = "sealed, but not in the manifest"
        state.add("segment_unlisted", Severity.UNFINISHED, str(path), what, "read it whole and list it")
    elif path.stat().st_size != entry.size:
        reasons.append(f"{path.stat().st_size:,} bytes instead of {entry.size:,}")
    elif _sha256(path) != entry.sha256:
        reasons.append("its SHA-256 is not that of the manifest")
    samples = messages = 0
    try:
        for record in read_segment(path) if not reasons else SegmentScan(path, sealed=True):
            samples += _follow(record, state, documented, totals)
            messages += 1
    except StoreError as error:
        if not reasons:
            reasons.append(str(error))
    except GyrofleetError as error:
        reasons.append(f"it holds a message that cannot be read: {error}")
    state.samples[path.name] = samples
    state.messages += messages
    if entry is not None and not reasons and (samples, messages) != (entry.samples, entry.messages):
        listed = f"listed are {entry.samples:,} in {entry.messages:,}"
        reasons.append(f"{samples:,} samples in {messages:,} messages, {listed}")
    if reasons:
        lost = "" if entry is None else f"; {entry.samples - samples:,} of {entry.samples:,} samples cannot be read"
        state.add("segment_damaged", Severity.DAMAGE, str(path), "; ".join(reasons) + lost, _SALVAGE)
    return not reasons


def _follow(
    record: LogRecord,
    state: LogState,
    documented: list[dict[str, object]],
    totals: dict[StreamId, tuple[str, int]],
) -> int:
    """Take a message; how many samples it has."""
    place = place_of(record)
    if place is None:
        return 0
    state.check.follow(place)
    if record.schema == EVENTS and "/estimate/" not in record.topic:
        document = decode_event(record.data).document
        if isinstance(document, StoreNoted):
            state.noted.add(document.what)
            documented += document.details.get("lost") or []
        elif isinstance(document, RunEnded):
            station = parse_key(record.topic).place
            for total in document.totals:
                stream = StreamId(sample_key(station, total.unit, total.signal), UUID(total.epoch).hex)
                totals[stream] = (document.run, total.samples)
    return place.samples


def _verify_numbers(
    state: LogState, documented: list[dict[str, object]], totals: dict[StreamId, tuple[str, int]]
) -> None:
    for stream, (run, samples) in totals.items():
        if state.check.next_seq.get(stream, 0) < samples:
            state.check.reach(stream, samples)
            what = f"run {run} ended with {samples:,} samples, not all of them are there"
            state.add("run_incomplete", Severity.NOTE, f"{stream.key} {stream.epoch}", what)
    known = {(each.get("key"), each.get("epoch"), each.get("first_seq"), each.get("last_seq")) for each in documented}
    # samples first, then documents
    for lost in sorted(state.check.lost, key=lambda lost: lost.signal == DOCUMENTS):
        where = f"{lost.key} {lost.epoch}"
        if (lost.key, lost.epoch, lost.first_seq, lost.last_seq) in known:
            state.add("loss_documented", Severity.NOTE, where, f"lost, and said so in the log: {lost}")
        else:
            state.undocumented.append(lost)
            state.add("numbers_missing", Severity.LOSS, where, str(lost), "say in the log that they are lost")
    for place in state.check.repeated:
        what = f"numbers {place.seq} to {place.next_seq - 1} are there twice"
        where = f"{place.stream.key} {place.stream.epoch}"
        state.add("numbers_repeated", Severity.DAMAGE, where, what, "report this: no fault of a disk does it")


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
