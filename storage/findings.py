"""What `gyrofleet verify` has to say: where something is not as it should be, and what would be done about it."""

from enum import StrEnum

import msgspec

KEPT_DAMAGED = "kept_damaged"
"""Kind of a finding of a file that a layer keeps; `gyrofleet recover` moves it aside, since it is derived."""


class Severity(StrEnum):
    """How bad it is."""

    DAMAGE = "damage"
    """Something is not what was written, or is missing."""
    LOSS = "loss"
    """Samples or documents are not there, and nothing in the log says so."""
    UNFINISHED = "unfinished"
    """An interrupted process left something to do; nothing is lost."""
    NOTE = "note"
    """To know; the store is sound with it."""


class Finding(msgspec.Struct, frozen=True):
    """One thing that was found.

    Parameters
    ----------
    kind: What it is in one word, for programs.
    severity: How bad it is.
    where: File or stream.
    what: What it is, in a sentence.
    remedy: What `gyrofleet recover` would do, or a person should.
    """

    kind: str
    severity: Severity
    where: str
    what: str
    remedy: str = ""


class Verification(msgspec.Struct, frozen=True):
    """What a verification looked at and found."""

    store: str
    segments: int
    messages: int
    samples: int
    parts: int
    lake_samples: int
    findings: tuple[Finding, ...]
    seconds: float

    @property
    def is_sound(self) -> bool:
        """Whether nothing needs to be done."""
        return all(finding.severity is Severity.NOTE for finding in self.findings)
