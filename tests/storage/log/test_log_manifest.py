"""The manifest of the log lists every segment, and no byte of it changes unseen."""

import json
from pathlib import Path

from storage.log.event_log import EventLog
from storage.log.recovery import unlisted_entry
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import FIRST, ManifestWriter, manifest_path, read_log_manifest, rewrite_manifest
from storage.segments.records import EVENTS, LogRecord
from storage.store import Store
from stream.events import RunEnded, encode_event
from stream.identity import event_key
from tests.storage.log_records import PLACE, append, samples, written


def test_the_manifest_lists_every_segment_with_its_hash(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    log = EventLog(store, rotate_bytes=1)
    for i in range(3):
        append(log, samples("U1", 100 * i))
        assert log.due
        log.seal()
    end = encode_event(RunEnded(run="r1", t_ns=7), "e", 0)
    append(log, LogRecord(event_key(PLACE), EVENTS, 10**18, 7, end))
    log.seal()
    entries = read_log_manifest(store).entries
    assert [entry.segment for entry in entries.values()] == [f"0000000{i}.mcap" for i in (1, 2, 3, 4)]
    assert [(entry.samples, entry.messages) for entry in entries.values()] == [(100, 1)] * 3 + [(0, 1)]
    assert [entry.ended for entry in entries.values()] == [(), (), (), ("r1",)]
    for entry in entries.values():
        found, _ = unlisted_entry(store, store.log / entry.segment)
        assert (found.sha256, found.size, found.samples) == (entry.sha256, entry.size, entry.samples)


def test_a_segment_without_its_line_is_taken_in(tmp_path: Path) -> None:
    store, _ = written(tmp_path)
    before = manifest_path(store).read_text()
    manifest_path(store).unlink()
    EventLog(store)
    (entry,) = read_log_manifest(store).entries.values()
    assert entry.origin == "found"
    assert entry.sha256 == json.loads(before.split("\t")[0])["sha256"]


def test_no_byte_of_the_manifest_changes_unseen(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    writer = ManifestWriter(store)
    entries = [SegmentEntry(f"{i:08d}.mcap", i, "0" * 64, 1, 1, 1, 1, ("r1",)) for i in range(20)]
    for entry in entries:
        writer.add(entry)
    content = manifest_path(store).read_bytes()
    assert list(read_log_manifest(store).entries.values()) == entries
    for at in range(0, len(content), 7):
        manifest_path(store).write_bytes(content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :])
        found = read_log_manifest(store)
        assert found.damage or len(found.entries) < 20
        assert len(found.entries) >= 17
    lines = content.splitlines(keepends=True)
    manifest_path(store).write_bytes(b"".join(lines[:5] + lines[6:]))
    assert [each.line for each in read_log_manifest(store).damage] == [6]
    store.tmp.rmdir()
    aside = rewrite_manifest(store, entries)
    assert aside is not None
    assert aside.read_bytes() == b"".join(lines[:5] + lines[6:])
    assert read_log_manifest(store).damage == []


def test_a_line_that_was_not_finished_is_cut_off(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    entries = [SegmentEntry(f"{i:08d}.mcap", i, "0" * 64, 1, 1, 1, 1) for i in range(3)]
    ManifestWriter(store).add(entries[0])
    with manifest_path(store).open("ab") as file:
        file.write(b'{"segment": "0000')
    writer = ManifestWriter(store)
    assert writer.found.last != FIRST
    writer.add(entries[1])
    assert list(read_log_manifest(store).entries.values()) == entries[:2]
