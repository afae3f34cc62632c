"""Verification of a fleet store: the copy of every plant, its list, and what plants state differently."""

import shlex
from collections.abc import Callable, Iterator
from functools import partial

import msgspec

from storage.check.verify import verify
from storage.findings import Finding, Severity, Verification
from storage.fleet_store import FleetStore, Replica
from storage.log.files import sealed_segments
from storage.manifests.log import read_log_manifest
from storage.replication.plant_list import PlantList
from storage.replication.progress import read_progress
from storage.replication.service import fleet_conflicts
from storage.store_marker import RECEIVED
from stream.errors import GyrofleetError, StoreError

_OF_SEGMENTS = {"segment_damaged", "segment_missing", "manifest_missing", "manifest_damaged", "log_missing"}


class FleetVerification(msgspec.Struct, frozen=True):
    """Result for every plant by name, and findings on the fleet store as a whole."""

    store: str
    plants: dict[str, Verification]
    findings: tuple[Finding, ...]

    @property
    def is_sound(self) -> bool:
        """Whether nothing needs to be repaired, fetched, or decided."""
        alone = all(finding.severity is Severity.NOTE for finding in self.findings)
        return alone and all(each.is_sound for each in self.plants.values())


def verify_fleet(fleet: FleetStore, progress: Callable[[float], None] = lambda _done: None) -> FleetVerification:
    """Verify the copies of all plants, one after the other, without changes."""
    replicas, to = fleet.replicas(), shlex.quote(str(fleet.folder))
    plants, findings = {}, []
    for number, replica in enumerate(replicas):
        found, _ = verify(replica.store, partial(_report, progress, number, len(replicas)))
        own = [*(_with_recall(finding, to) for finding in found.findings), *_of_replica(replica, to)]
        plants[replica.plant.name] = msgspec.structs.replace(found, findings=tuple(own))
    for plant, what in fleet.refusals():
        remedy = "if it is no other plant, look who took its place; delete refused.json to forget this"
        findings.append(Finding("plant_refused", Severity.NOTE, plant.name, what, remedy))
    try:
        findings += [
            Finding("identity_conflict", Severity.NOTE, each.unit, str(each)) for each in fleet_conflicts(fleet)
        ]
    except GyrofleetError as error:  # a damaged lake is reported above
        findings.append(
            Finding("check_failed", Severity.DAMAGE, str(fleet.folder), str(error), "repair the others first")
        )
    return FleetVerification(str(fleet.folder), plants, tuple(findings))


def _report(progress: Callable[[float], None], before: int, of: int, done: float) -> None:
    progress((before + done) / of)


def _with_recall(finding: Finding, to: str) -> Finding:
    if finding.kind not in _OF_SEGMENTS:
        return finding
    remedy = f"`gyrofleet replicate --recall --from PLANT --to {to}` fetches it from the plant"
    return msgspec.structs.replace(finding, remedy=remedy)


def _of_replica(replica: Replica, to: str) -> Iterator[Finding]:
    where = replica.folder / RECEIVED
    for refusal in read_progress(replica).refused:
        is_carried_file = "/" in refusal.segment  # a certificate, model or attestation, by its path in the store
        where_it_is = (replica.store.folder if is_carried_file else replica.store.log) / refusal.segment
        remedy = "repair it at the plant; what was received before stays"
        yield Finding(
            "replication_refused", Severity.UNFINISHED, str(where_it_is), f"{refusal.kind}: {refusal.what}", remedy
        )
    try:
        listed = PlantList(where)
    except StoreError as error:
        yield Finding("list_damaged", Severity.DAMAGE, str(where), str(error), "delete it, the next pass receives it")
        return
    held = read_log_manifest(replica.store).entries
    known = {(entry.segment, entry.sha256) for entry in (*listed.entries.values(), *listed.salvaged.values())}
    for name, entry in held.items():
        if (name, entry.sha256) not in known:
            what = f"segment {name} is in the copy, and the plant never listed it with this SHA-256"
            yield Finding(
                "segment_not_listed", Severity.DAMAGE, str(replica.store.log / name), what, "find out who put it there"
            )
    here = {path.name for path in sealed_segments(replica.store)}
    missing = sorted(listed.entries.keys() - here - held.keys() - listed.lost.keys())
    if missing:
        what = f"{len(missing)} segments of the plant's list have not arrived: {', '.join(missing[:5])}"
        remedy = f"`gyrofleet replicate --from PLANT --to {to}`"
        yield Finding("segments_not_arrived", Severity.UNFINISHED, str(replica.store.log), what, remedy)
