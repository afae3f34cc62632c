"""Findings of `gyrofleet verify`."""

from enum import StrEnum

import msgspec

KEPT_DAMAGED = "kept_damaged"
"""Kind of a damaged file that a catalogue layer keeps; derived, so that `gyrofleet recover` quarantines it."""


class Severity(StrEnum):
    """How severe a finding is."""

    DAMAGE = "damage"  # something differs from what was written, or is missing
    LOSS = "loss"  # samples or documents are missing, and the log does not document it
    UNFINISHED = "unfinished"  # an interrupted process left work to finish; nothing is lost
    NOTE = "note"  # for information; the store is sound


class Finding(msgspec.Struct, frozen=True):
    """One finding: `kind` for programs, in one word; `where`, a file or stream; `what`, a sentence for people.

    `remedy` is what `gyrofleet recover` would do, or a person should.
    """

    kind: str
    severity: Severity
    where: str
    what: str
    remedy: str = ""


class Verification(msgspec.Struct, frozen=True):
    """Result of a verification.

    `compared` segments were verified before and are compared by SHA-256 alone: those of the attestation `since`.
    `has_values` says whether the values of the lake were compared with the log, and not only its files hashed.
    """

    store: str
    segments: int
    messages: int
    samples: int
    parts: int
    lake_samples: int
    findings: tuple[Finding, ...]
    seconds: float
    compared: int = 0
    since: str = ""
    has_values: bool = False

    @property
    def is_sound(self) -> bool:
        """Whether nothing needs to be repaired."""
        return all(finding.severity is Severity.NOTE for finding in self.findings)
