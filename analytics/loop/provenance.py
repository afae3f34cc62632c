"""Provenance of a diagnosis: who asked, when, with which version, of which data."""

import getpass
import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version

import msgspec

from analytics.loop.blocks.run_blocks import RunBlocks


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """Who asked, when, the version of gyrofleet, and the SHA-256 of the reduced data of each run."""

    by: str
    at: str
    version: str
    sha256: dict[str, str]


def provenance(runs: Sequence[RunBlocks]) -> Provenance:
    """Provenance of a diagnosis that is made now."""
    try:
        by = getpass.getuser()
    except (KeyError, OSError):  # no name for this user, as in a container
        by = ""
    return Provenance(
        by=by,
        at=datetime.now(UTC).isoformat(timespec="seconds"),
        version=version("gyrofleet"),
        sha256={run.run: _sha256(run) for run in runs},
    )


def _sha256(run: RunBlocks) -> str:
    """Of the block means of the signal and of the channels, with their times."""
    found = hashlib.sha256(f"{run.unit}/{run.signal}/{run.run}/{run.t0_ns}/{run.block_s:g}".encode())
    for array in (run.slot, run.value):
        found.update(array.tobytes())
    for name in sorted(run.channels):
        found.update(name.encode())
        found.update(run.mean(name).tobytes())
    return found.hexdigest()
