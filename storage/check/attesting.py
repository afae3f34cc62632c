"""The role that attests a store again and again: a store that is not sound, or a disk that refuses, ends no role."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

from storage.attestation.attestation import Attested, attest
from storage.attestation.signing_key import SigningKey, fingerprint
from storage.attestation.verified_state import newest_verified_state
from storage.findings import Severity
from storage.store import Store
from stream.errors import GyrofleetError, StoreError
from stream.files.atomic_file import write_durably
from stream.status.role_status import Role, RoleStatus, new_status

if TYPE_CHECKING:
    from collections.abc import Mapping

    from storage.manifests.entries import SegmentEntry


class AttestService:
    """Attests a store, with `verifies` only a sound one, and copies each attestation to `out`."""

    def __init__(
        self, store: Store, key: SigningKey, *, out: Path | None = None, timestamp_url: str = "", verifies: bool = False
    ) -> None:
        self._store, self._key, self._out = store, key, out
        self._timestamp_url, self._verifies = timestamp_url, verifies
        self._began_ns = time.time_ns()
        self._attested, self._last_ns, self._trouble = 0, 0, ""

    def status(self) -> RoleStatus:
        """How often it attested, when last, and why the newest attempt failed."""
        numbers = {"attestations_total": float(self._attested)}
        if self._last_ns:
            numbers["last_attestation_seconds"] = self._last_ns / 1e9
        return new_status(Role.ATTEST, self._began_ns, trouble=self._trouble[:4000], numbers=numbers)

    def round(self) -> Attested:
        """Attest once; StoreError if nothing was signed, or it cannot be written."""
        try:
            found = self._round()
        except (GyrofleetError, OSError) as error:
            self._trouble = str(error)
            if isinstance(error, OSError):
                raise StoreError(f"{self._store.folder} cannot be attested: {error}") from error
            raise
        self._trouble = f"attested without a time stamp: {found.unstamped}" if found.unstamped else ""
        return found

    def _round(self) -> Attested:
        verified = self._verified() if self._verifies else None
        found = attest(self._store, self._key, timestamp_url=self._timestamp_url, verified=verified)
        self._attested, self._last_ns = self._attested + 1, time.time_ns()
        if self._out is not None:
            try:
                write_durably(self._out, found.path.read_bytes())
            except OSError as error:
                raise StoreError(
                    f"{self._out} cannot be written: {error}; the attestation is kept as {found.path}"
                ) from error
        return found

    def _verified(self) -> "Mapping[str, SegmentEntry]":
        """Entries of the segments of the store; StoreError if it is not sound."""
        from storage.check.verify import verify

        found, state = verify(self._store, since=newest_verified_state(self._store, fingerprint(self._key.public)))
        if not found.is_sound:
            wrong = [each for each in found.findings if each.severity is not Severity.NOTE]
            more = f"; and {len(wrong) - 1} more" if len(wrong) > 1 else ""
            raise StoreError(
                f"{self._store.folder} is not sound, nothing is signed: {wrong[0].where}: {wrong[0].what}{more}. "
                "`gyrofleet verify` lists all"
            )
        return {name: entry for name, entry in state.entries.items() if name in state.samples}
