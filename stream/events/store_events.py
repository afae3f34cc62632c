"""Documents of a store as a whole: what it is judged by, what it certifies, what it notes, what it alerts to."""

from enum import StrEnum
from typing import Any

import msgspec

from stream.events.document import Act, ApprovedAct, Document

RAW_ROWS_DROPPED = "raw_rows_dropped"  # `what` of a StoreNoted: raw rows that the lake no longer has
RAW_ROWS_RESTORED = "raw_rows_restored"  # and: raw rows that were restored, with the documents that this cancels


class SpecificationAction(StrEnum):
    """Change that a document makes to the product specifications of a store."""

    ADDED = "added"
    REVISED = "revised"
    WITHDRAWN = "withdrawn"
    SETTLED = "settled"  # a person accepts that documents before it are lost


class SpecificationEntered(ApprovedAct, frozen=True, kw_only=True, tag=True):
    """A revision of a product specification is added or withdrawn, or a loss accepted; `run` is empty.

    `content` is the TOML, empty where it is withdrawn. `previous` is the SHA-256 of the specification document before
    it in the store, empty in the first. `rejudges` says whether earlier records are judged again; `settles` are hashes
    of documents at which the chain is broken, which a person accepts. Recorders of several stores may share one bus:
    `store` is the identity of its store, `seal` the seal.
    """

    action: SpecificationAction
    name: str
    revision: str
    content: str = ""
    by: str
    reason: str = ""
    previous: str = ""
    rejudges: bool = False
    settles: tuple[str, ...] = ()
    store: str = ""
    seal: str = ""


class CertificateIssued(ApprovedAct, frozen=True, kw_only=True, tag=True):
    """A calibration certificate of a unit is issued; `run` is empty.

    `sha256` is that of the PDF, `digital_sha256` that of the XML in it, `data_sha256` that of the results, which are in
    `results` as JSON; `specification` that of the last specification of the store then. `valid_until` is the last day
    of its validity (ISO), empty where no interval was agreed. A new certificate names the one that it `supersedes`,
    and the `reason`. `store` is the identity of its store, `seal` the seal.
    """

    number: str
    unit: str
    standard: str
    language: str
    sha256: str
    digital_sha256: str
    data_sha256: str
    results: str
    runs: tuple[str, ...]
    valid_until: str
    by: str
    software: str
    specification: str = ""
    supersedes: str = ""
    reason: str = ""
    store: str = ""
    seal: str = ""


class ActProposed(Act, frozen=True, kw_only=True):
    """An act that two persons are needed for: nothing of it is active before another one approves it; `run` is empty.

    `subject` is ``models``, ``specifications`` or ``certificates``, `title` the act in words, `content` its document as
    JSON. `store` is the identity of its store, `seal` the seal.
    """

    subject: str
    title: str
    content: str
    by: str
    reason: str = ""
    unit: str | None = None
    store: str = ""
    seal: str = ""


class ProposalRejected(Act, frozen=True, kw_only=True):
    """The `ActProposed` with the uid `proposal` is rejected, or withdrawn by who proposed it; `run` is empty."""

    proposal: str
    by: str
    reason: str
    unit: str | None = None
    store: str = ""
    seal: str = ""


class StoreNoted(Document, frozen=True, kw_only=True, tag=True):
    """An event of a store, in one word, in a sentence, and in numbers.

    `run` is empty. The details name the store, since recorders of several may share one bus.
    """

    what: str
    text: str
    details: dict[str, Any] = msgspec.field(default_factory=dict)


class AlertRaised(Document, frozen=True, kw_only=True, tag=True):
    """A condition that is reported to people; its `uid` names the alert."""

    rule: str
    severity: str
    subject: str
    text: str
    text_zh: str = ""
    unit: str | None = None


class AlertCleared(Document, frozen=True, kw_only=True, tag=True):
    """The condition of an alert has passed; with a `text`, it ended without passing, as a run with a silent unit."""

    alert: str
    text: str = ""
    text_zh: str = ""
    unit: str | None = None


class AlertSent(Document, frozen=True, kw_only=True, tag=True):
    """A target has taken the message of an alert."""

    alert: str
    target: str
    attempts: int = 1


class AlertAcknowledged(Act, frozen=True, kw_only=True, tag=True):
    """A person has taken note of an alert."""

    alert: str
    by: str
    note: str = ""
