"""Attestations that have arrived of a plant, compared with what has arrived beside them."""

from pathlib import Path
from typing import NamedTuple

from storage.attestation.attestation import kept_attestations, read_attestation
from storage.attestation.comparison import against
from storage.attestation.signing_key import fingerprint
from storage.findings import Severity
from storage.store import Store
from stream.errors import StoreError

KIND = "attestation_disagrees"


class Disagreement(NamedTuple):
    """A file that is not as it was attested, and what is wrong with it."""

    file: str
    what: str


class Checked(NamedTuple):
    """What disagrees with the newest attestation of a plant, and notes, which are no disagreement."""

    disagreements: tuple[Disagreement, ...] = ()
    notes: tuple[str, ...] = ()


class AttestationCheck:
    """Compares a copy with its newest attestation, again only when either has changed."""

    def __init__(self) -> None:
        self._of: tuple[str, int, int] = ("", 0, 0)
        self._found = Checked()

    def check(self, store: Store, segments: int, changed: bool) -> Checked:
        """Compare; the copy has so many `segments`, and has `changed` if anything has arrived since the last check."""
        kept = kept_attestations(store)
        if not kept:
            return Checked()
        newest = kept[-1]
        of = (newest.name, newest.stat().st_size, segments)
        if changed or of != self._of or self._found.disagreements:
            self._of, self._found = of, _compare(store, kept)
        return self._found


def _compare(store: Store, kept: list[Path]) -> Checked:
    newest = kept[-1]
    name = newest.relative_to(store.folder).as_posix()
    try:
        attestation, first = read_attestation(newest), read_attestation(kept[0])
        found = against(store, attestation, str(newest))
    except StoreError as error:
        return Checked((Disagreement(name, str(error)),))
    wrong = tuple(
        Disagreement(each.where.rpartition("/")[2], f"{name}: {each.what}")
        for each in found
        if each.severity is not Severity.NOTE
    )
    notes = [f"{name}: {each.what}" for each in found if each.severity is Severity.NOTE]
    if attestation.public != first.public:
        by, before = fingerprint(attestation.public), fingerprint(first.public)
        notes.append(f"{name} is signed by the key {by}, the plant's first one was by {before}: ask whose it is")
    return Checked(wrong, tuple(notes))
