"""Repair of a store: destroys nothing, and documents losses in the log."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from uuid import NAMESPACE_OID, uuid5

import msgspec

from storage.check.verify import checkpoint_findings, kept_findings, lake_findings, only_in_lake
from storage.check.verify_lake import repair_lake
from storage.check.verify_log import LogState, stretch_id, verify_log
from storage.findings import KEPT_DAMAGED
from storage.lake.builder import build_missing, builder_lock
from storage.lake.lake import Lake
from storage.lake.lake import quarantine as quarantine_file
from storage.log.event_log import EventLog
from storage.log.files import quarantine_unknown, sealed_segments
from storage.log.misplaced import put_back
from storage.log.recovery import Recovery, examine_segment, salvage_segment, unlisted_entry
from storage.log.sequence import LostStretch
from storage.log.store_documents import append_document, store_document
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import LOST, ManifestWriter, manifest_path, read_log_manifest, rewrite_manifest
from storage.specifications.copies import mend_copies
from storage.store import Store, WriterLock
from storage.store_marker import MARKER, copy_fault, is_replica, write_markers
from stream.errors import StoreError
from stream.events import StoreNoted, new_uid
from stream.identity import Place, event_key
from stream.wire.acknowledgement import StreamId
from stream.worker.checkpoint import quarantine as quarantine_checkpoint

_NOTES_KEY = event_key(Place("store", "recover"))
_SALVAGED = "it is the readable part of a damaged segment"


class Action(msgspec.Struct, frozen=True):
    """A completed step."""

    what: str
    where: str
    text: str


def recover(store: Store, *, quarantine: bool = False) -> Iterator[Action]:
    """Repair what `verify` finds, step by step, all repeatable; with `quarantine` foreign files go to ``log/aside``."""
    try:
        with WriterLock(store, "gyrofleet recover"), builder_lock(store):
            for folder in (store.log, store.tmp):
                folder.mkdir(exist_ok=True)
            if quarantine:
                for unknown, target in quarantine_unknown(store):
                    yield Action("file_quarantined", str(unknown.path), f"{unknown.why}; kept as {target}")
            if (fault := copy_fault(store.folder)) is not None:
                write_markers(store.folder, store.identity)
                yield Action("marker_copied", str(store.log / MARKER), f"written again, {fault}")
            yield from _repair_log(store)
            yield from _repair_lake(store)
            for finding in checkpoint_findings(store, verify_log(store)):
                if finding.kind == "checkpoint_damaged":
                    aside = quarantine_checkpoint(Path(finding.where))
                    yield Action("checkpoint_set_aside", finding.where, f"kept as {aside}")
            for aside in mend_copies(store):
                yield Action("specification_copied", str(aside.parent), f"written from the log; the old file: {aside}")
            for finding in kept_findings(store):
                # derived, and computed again on demand
                if finding.kind == KEPT_DAMAGED and Path(finding.where).exists():
                    kept = quarantine_file(store, Path(finding.where))
                    yield Action("kept_set_aside", finding.where, f"kept as {kept}")
    except OSError as error:
        raise StoreError(f"{store.folder} cannot be repaired: {error}; repair the disk and run it again") from error


def _repair_log(store: Store) -> Iterator[Action]:
    """Repair the log; losses are documented, durably, before anything is replaced, so that a kill loses nothing."""
    yield from _repair_manifest(store)
    renamed: set[str] = set()
    for path, own in put_back(store):
        renamed.add(path.stem)
        yield Action(
            "segment_renamed", str(path), f"it is the segment {own.name}, by its SHA-256, and has its name again"
        )
    if renamed:
        for name in Lake(store).drop_of_segments(renamed):
            yield Action("lake_mended", str(store.lake / name), "made of a segment under another name; taken out")
    yield from _list_in_place(store)
    log = EventLog(store)
    for entry in log.listed:
        yield _listed(store, entry)
    for recovery in log.recovered:
        yield Action("segment_sealed", str(store.log / recovery.segment), _describe(recovery))
    state = verify_log(store)
    only = only_in_lake(store, state)
    documents = [*_of_damage(store, state, only), *_of_recovered(store, log, state)]
    documented = {stretch_id(lost) for document in documents for lost in document.details.get("lost", [])}
    undocumented = [lost for lost in state.undocumented if stretch_id(vars(lost)) not in documented]
    documents += [_document(store, "numbers_missing", str(lost), "", (lost,)) for lost in undocumented]
    stream = StreamId(_NOTES_KEY, new_uid())
    for document in documents:
        if document.uid not in state.uids:
            append_document(log, stream, document)
    log.seal()
    for lost in undocumented:
        yield Action("loss_documented", f"{lost.key} {lost.epoch}", str(lost))
    for name in state.undocumented_salvage:
        yield Action("loss_documented", str(store.log / name), _SALVAGED)
    manifest = ManifestWriter(store)
    for path in state.damaged:
        recovery = salvage_segment(store, path, state.before[path.name])
        manifest.add(recovery.entry or _lost(path.name, manifest.found.entries.get(path.name)))
        yield Action("segment_salvaged", str(path), _describe(recovery))
    for name in (*state.gone, *(f"{segment}.mcap" for segment in only)):
        manifest.add(_lost(name, state.entries.get(name)))
        yield Action("segment_missing", str(store.log / name), "listed as lost")


def _repair_manifest(store: Store) -> Iterator[Action]:
    """Rewrite a damaged manifest with its valid entries; `EventLog` adds the segments that it lacks."""
    found = read_log_manifest(store, whole=True)
    is_missing = not manifest_path(store).exists() and any(store.log.glob("*.mcap"))
    if found.damage or is_missing:
        entries = list(found.entries.values())
        if not is_replica(store.folder):  # a recorder may have listed them last since
            own = [entry for entry in entries if entry.origin != "found"]
            entries = _in_place(own, [entry for entry in entries if entry.origin == "found"])
        aside = rewrite_manifest(store, [*entries, *found.lost.values()])
        kept = "" if aside is None else f"; the old file: {aside}"
        yield Action("manifest_written", str(store.log), f"its valid entries are kept{kept}")


def _list_in_place(store: Store) -> Iterator[Action]:
    """List sealed segments without a line before later ones, where an attestation has them; `EventLog` adds newer ones.

    The manifest of a replica is in the order of arrival.
    """
    found = read_log_manifest(store, whole=True)
    newest = max(found.entries, default="")
    fresh = []
    for path in sealed_segments(store):
        if path.name < newest and path.name not in found.entries:
            with suppress(StoreError):  # a damaged one is salvaged later
                fresh.append(unlisted_entry(store, path)[0])
    if not fresh or is_replica(store.folder):
        return
    listed = _in_place(list(found.entries.values()), fresh)
    lost = found.lost.keys() - {each.segment for each in fresh}
    rewrite_manifest(store, [*listed, *(found.lost[name] for name in sorted(lost))])
    for entry in fresh:
        yield _listed(store, entry)


def _in_place(listed: list[SegmentEntry], fresh: list[SegmentEntry]) -> list[SegmentEntry]:
    """Entries with those of segments that were found without a line, each before the first later segment."""
    whole = list(listed)
    for entry in fresh:
        place = next((at for at, other in enumerate(whole) if other.segment > entry.segment), len(whole))
        whole.insert(place, entry)
    return whole


def _listed(store: Store, entry: SegmentEntry) -> Action:
    text = f"read, {entry.samples:,} samples; it was sealed"
    return Action("segment_listed", str(store.log / entry.segment), text)


def _of_damage(store: Store, state: LogState, only: list[str]) -> Iterator[StoreNoted]:
    for path in state.damaged:
        found = examine_segment(path, state.before[path.name])
        yield _document(store, "segment_salvaged", _describe(found), path.name, found.lost)
    for name in state.gone:
        entry = state.entries[name]
        text = f"segment {name} with {entry.samples:,} samples is missing"
        yield _document(store, "segment_missing", text, name, (), entry=msgspec.to_builtins(entry))
    for segment in only:
        text = f"segment {segment}.mcap is missing; its content is in the lake"
        yield _document(store, "segment_missing", text, f"{segment}.mcap", ())


def _of_recovered(store: Store, log: EventLog, state: LogState) -> Iterator[StoreNoted]:
    reported = set()
    for recovery in log.recovered:
        if recovery.lost or recovery.damaged_chunks:
            reported.add(recovery.segment.partition(".")[0])
            yield _document(store, "segment_recovered", _describe(recovery), recovery.segment, recovery.lost)
    for name in state.undocumented_salvage:
        if name.partition(".")[0] not in reported:
            yield _document(store, "segment_recovered", f"{name}: {_SALVAGED}", name, ())


def _lost(name: str, entry: SegmentEntry | None) -> SegmentEntry:
    """Entry of a missing segment; its number is not reused."""
    return msgspec.structs.replace(entry or SegmentEntry(name, 0, "", 0, 0, 0, 0), origin=LOST)


def _document(
    store: Store, what: str, text: str, segment: str, lost: tuple[LostStretch, ...], **more: object
) -> StoreNoted:
    """A document whose identity depends on its content, so that a finding is documented once."""
    details = {"segment": segment, "lost": [vars(each) for each in lost], **more}
    parts = [store.identity, what, segment, *(str(part) for each in lost for part in stretch_id(vars(each)))]
    uid = uuid5(NAMESPACE_OID, "\0".join(parts)).hex
    return msgspec.structs.replace(store_document(store.identity, what, text, details), uid=uid)


def _repair_lake(store: Store) -> Iterator[Action]:
    for problem in repair_lake(store):
        yield Action("lake_mended", str(store.lake / problem.part / problem.file), problem.remedy)
    for name in build_missing(store):
        yield Action("lake_built", str(store.lake / name), "built from the log")
    lake = Lake(store)
    for finding in lake_findings(store, verify_log(store)):
        if finding.kind == "lake_disagrees":
            lake.rebuild_part(Path(finding.where).name, aside=True)
            yield Action("lake_mended", finding.where, finding.remedy)


def _describe(recovery: Recovery) -> str:
    return f"{recovery}" + ("" if recovery.kept_aside is None else f"; the original: {recovery.kept_aside}")
