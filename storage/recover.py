"""What `gyrofleet recover` does: put a store right again, destroy nothing, and say in the log what is lost."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from storage.event_log import EventLog
from storage.findings import Finding
from storage.lake import Lake, build_missing, builder_lock
from storage.lake_check import mend
from storage.log_manifest import SegmentEntry, rewrite_manifest
from storage.mcap_records import EVENTS, LogRecord
from storage.recovery import Recovery, salvage_segment, take_in
from storage.sequence import LostStretch
from storage.sequence import Place as Position
from storage.store import Store, WriterLock
from storage.verify import checkpoint_findings, lake_findings
from storage.verify_log import LogState, verify_log
from stream.checkpoint import keep_aside
from stream.delivery import StreamId
from stream.errors import StoreError
from stream.events import StoreNoted, encode_event, new_uid
from stream.identity import Place, event_key

_NOTES_KEY = event_key(Place("store", "recover"))


class Action(msgspec.Struct, frozen=True):
    """Something that was done."""

    what: str
    where: str
    text: str


def recover(store: Store) -> Iterator[Action]:
    """Put right what `verify` finds; every step is yielded when it is done, and can be done again.

    Raises
    ------
    StoreError
        If another process writes the store, or the disk refuses.
    """
    with WriterLock(store, "gyrofleet recover"), builder_lock(store):
        try:
            state = verify_log(store)
            yield from _mend_log(store, state)
            yield from _mend_lake(store)
            yield from _mend_checkpoints(checkpoint_findings(store, verify_log(store)))
        except OSError as error:
            raise StoreError(f"{store.folder} cannot be put right: {error}; mend the disk and give it again") from error


def _mend_log(store: Store, state: LogState) -> Iterator[Action]:
    documents: list[StoreNoted] = []
    entries = dict(state.entries)
    for path in state.damaged:
        recovery = salvage_segment(store, path, state.before[path.name])
        details = {"lost": [vars(each) for each in recovery.lost]}
        documents.append(_document("segment_salvaged", _told(recovery), details))
        if recovery.entry is None:
            entries.pop(path.name, None)
        else:
            entries[path.name] = recovery.entry
        yield Action("segment_salvaged", str(path), _told(recovery))
    gone = [name for name in entries if not (store.log / name).exists()]
    for name in gone:
        entry = entries.pop(name)
        text = f"segment {name} with {entry.samples:,} samples is not there any more"
        documents.append(_document("segment_missing", text, {"entry": msgspec.to_builtins(entry)}))
        yield Action("segment_missing", str(store.log / name), f"taken off the manifest: {text}")
    if documents or any(each.kind == "manifest_damaged" for each in state.findings):
        aside = rewrite_manifest(store, _listed(store, entries))
        kept = "" if aside is None else f"; as it was: {aside}"
        yield Action("manifest_written", str(store.log), f"{len(entries)} segments listed{kept}")
    log = EventLog(store)
    for recovery in log.recovered:
        yield Action("segment_sealed", str(store.log / recovery.segment), _told(recovery))
        if recovery.lost:
            details = {"lost": [vars(each) for each in recovery.lost]}
            documents.append(_document("segment_recovered", _told(recovery), details))
    said = [lost for document in documents for lost in document.details.get("lost", [])]
    for lost in state.undocumented:
        if vars(lost) not in said:
            documents.append(_document("numbers_missing", str(lost), {"lost": [vars(lost)]}))
            yield Action("loss_documented", f"{lost.key} {lost.epoch}", str(lost))
    _append(log, documents)


def _listed(store: Store, entries: dict[str, SegmentEntry]) -> list[SegmentEntry]:
    """Every sealed segment; one whose line was lost is read whole."""
    sealed = sorted(store.log.glob("*.mcap"))
    return [entries[path.name] if path.name in entries else take_in(path)[0] for path in sealed]


def _append(log: EventLog, documents: list[StoreNoted]) -> None:
    stream = StreamId(_NOTES_KEY, new_uid())
    for seq, document in enumerate(documents):
        payload = encode_event(document, stream.epoch, seq)
        record = LogRecord(_NOTES_KEY, EVENTS, document.t_ns, document.t_ns, payload)
        log.append(Position(stream, seq, seq + 1, document.t_ns, document.t_ns, ""), record)
    log.seal()


def _mend_checkpoints(findings: list[Finding]) -> Iterator[Action]:
    for finding in findings:
        if finding.kind == "checkpoint_damaged":
            aside = keep_aside(Path(finding.where))
            yield Action("checkpoint_set_aside", finding.where, f"kept as {aside}")


def _mend_lake(store: Store) -> Iterator[Action]:
    for problem in mend(store):
        yield Action("lake_mended", str(store.lake / problem.part / problem.file), problem.remedy)
    for name in build_missing(store):
        yield Action("lake_built", str(store.lake / name), "brought from the log to the lake")
    lake = Lake(store)
    for finding in lake_findings(store, verify_log(store)):
        if finding.kind == "lake_disagrees":
            lake.remake(Path(finding.where).name, aside=True)
            yield Action("lake_mended", finding.where, finding.remedy)


def _document(what: str, text: str, details: dict[str, Any]) -> StoreNoted:
    return StoreNoted(run="", t_ns=time.time_ns(), what=what, text=text, details=details)


def _told(recovery: Recovery) -> str:
    text = f"{recovery.records:,} messages saved of {recovery.segment}"
    if recovery.damaged_chunks:
        text += f", {recovery.damaged_bytes:,} bytes in {recovery.damaged_chunks} pieces could not be read"
    lost = _told_lost(recovery.lost)
    if lost:
        text += f"; lost: {lost}"
    if recovery.kept_aside is not None:
        text += f"; as it was: {recovery.kept_aside}"
    return text


def _told_lost(lost: tuple[LostStretch, ...]) -> str:
    more = f" and {len(lost) - 5} more" if len(lost) > 5 else ""
    return "; ".join(str(each) for each in lost[:5]) + more
