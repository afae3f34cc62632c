"""The state of a fleet store: of every plant how far its copy is behind, when it last answered, and what is wrong."""

import time

import msgspec

from storage.fleet_store import FleetStore, Replica
from storage.replication.progress import Lag, read_progress
from storage.replication.service import behind
from storage.segments.disk import DISK
from stream.duration import duration

_SILENT_S = 86_400.0


class PlantStatus(msgspec.Struct, frozen=True):
    """A plant's copy; ages are null if the plant has not answered yet."""

    plant: str
    store: str
    segments: int
    bytes: int
    segments_not_in_lake: int
    lag: Lag
    contact_age_s: float | None
    troubles: tuple[str, ...]


class FleetStatus(msgspec.Struct, frozen=True):
    """All plants of a fleet store; `troubles` are sentences, none where all is well."""

    store: str
    at_ns: int
    plants: tuple[PlantStatus, ...]
    free_bytes: int
    disk_bytes: int
    troubles: tuple[str, ...]


def fleet_status(fleet: FleetStore) -> FleetStatus:
    """Look at a fleet store."""
    plants = tuple(_status(replica) for replica in fleet.replicas())
    space = DISK.space(fleet.folder)
    return FleetStatus(
        str(fleet.folder), time.time_ns(), plants, space.free, space.total,
        tuple(f"{each.plant}: {trouble}" for each in plants for trouble in each.troubles),
    )  # fmt: skip


def _status(replica: Replica) -> PlantStatus:
    progress = read_progress(replica)
    age_s = (time.time_ns() - progress.contact_ns) / 1e9 if progress.contact_ns else None
    waiting = behind(replica)
    troubles = [f"refused {each.segment or each.kind}: {each.what}" for each in progress.refused]
    if progress.trouble:
        troubles.append(progress.trouble)
    if progress.lag.segments:
        troubles.append(f"{progress.lag.segments:,} segments, {progress.lag.bytes:,} bytes behind the plant")
    if age_s is not None and age_s > _SILENT_S:
        troubles.append(f"has not answered for {duration(age_s)}; is `gyrofleet replicate --watch` at work?")
    if waiting:
        troubles.append(f"{waiting:,} segments are not in its lake; the next pass of `gyrofleet replicate` builds it")
    return PlantStatus(
        replica.plant.name, replica.plant.store, progress.segments, progress.bytes, waiting, progress.lag, age_s,
        tuple(troubles),
    )  # fmt: skip
