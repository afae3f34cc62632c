"""Plants, fleet stores, and sources that misbehave, for the tests of replication."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

import msgspec

from storage.check.verify_fleet import FleetVerification, verify_fleet
from storage.fleet_store import FleetStore
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import FIRST, manifest_path, read_log_manifest
from storage.replication.progress import Progress
from storage.replication.receiver import Receiver
from storage.replication.service import Pass, Replication
from storage.replication.sources.folder_source import FolderSource
from storage.replication.sources.source import SegmentSource, SourceGone
from storage.store import Store
from tests.storage.verified_store import filled


def plant(folder: Path, segments: int = 4) -> Store:
    """The store of a plant with so many segments, each of two batches."""
    return filled(folder, *(range(2 * number, 2 * number + 2) for number in range(segments)))


def received(source: SegmentSource, fleet: FleetStore) -> Progress:
    """One pass for one source, without lakes."""
    return Receiver(source, fleet).run()


def replicated(fleet: FleetStore, *stores: Store) -> Pass:
    """One pass over plants named by their folders, with lakes."""
    return Replication(fleet).run([FolderSource(store.folder) for store in stores])


def segments_of(store: Store) -> dict[str, bytes]:
    """The sealed segments of a store by name."""
    return {path.name: path.read_bytes() for path in sorted(store.log.glob("*.mcap"))}


def kinds(verification: FleetVerification) -> list[str]:
    found = [*verification.findings, *(each for of in verification.plants.values() for each in of.findings)]
    return sorted(finding.kind for finding in found)


def verified(fleet: FleetStore) -> FleetVerification:
    return verify_fleet(fleet)


def rechained(store: Store, **changes: SegmentEntry) -> None:
    """Write a plant's list again, validly chained, with other entries for some segments."""
    last, lines = FIRST, []
    for name, entry in read_log_manifest(store).entries.items():
        text = msgspec.json.encode(changes.get(name.removesuffix(".mcap"), entry))
        last = hashlib.sha256(last.encode() + text).hexdigest()
        lines.append(text + b"\t" + last.encode() + b"\n")
    manifest_path(store).write_bytes(b"".join(lines))


class CutOff(FolderSource):
    """A source whose link is cut after so many bytes."""

    def __init__(self, folder: Path, after_bytes: int) -> None:
        super().__init__(folder)
        self.left = after_bytes

    def read(self, name: str, offset: int, length: int) -> bytes:
        piece = super().read(name, offset, min(length, 10_000))
        self.left -= len(piece)
        if self.left < 0:
            raise SourceGone("the link is cut")
        return piece


class Talker(FolderSource):
    """A source that returns more than it is asked for."""

    def read(self, name: str, offset: int, length: int) -> bytes:
        return super().read(name, offset, length) + b"more"


class Endless(FolderSource):
    """A source whose list never ends: validly chained, of segments that nobody can deliver."""

    def segments(self, after: int) -> Iterator[bytes]:
        last, count = FIRST, 0
        for raw in super().segments(0):
            count, last = count + 1, raw.rpartition(b"\t")[2].decode()
            if count > after:
                yield raw
        while True:
            count += 1
            text = msgspec.json.encode(SegmentEntry(f"{count:08d}.mcap", 10, "ab" * 32, 1, 1, 0, 0))
            last = hashlib.sha256(last.encode() + text).hexdigest()
            if count > after:
                yield text + b"\t" + last.encode()
