"""Base class of documents: their run, their time, their identity."""

from enum import StrEnum
from typing import Annotated
from uuid import uuid4

import msgspec

Moment = Annotated[int, msgspec.Meta(ge=-(2**63) + 1, le=2**63 - 1)]


class Verdict(StrEnum):
    """Outcome of a check, a unit or a run."""

    PASS = "PASS"  # noqa: S105  not a password
    FAIL = "FAIL"
    MARGINAL = "MARGINAL"
    NO_DATA = "NO_DATA"
    ABORTED = "ABORTED"


def new_uid() -> str:
    """A new identity of a document."""
    return uuid4().hex


class Document(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", omit_defaults=True):
    """Base class of documents: their run, their time on the source's clock, and their identity."""

    run: str
    t_ns: Moment
    uid: str = msgspec.field(default_factory=new_uid)


class Act(Document, frozen=True, kw_only=True):
    """Base class of what people and programs do on record.

    `identity` is whom a certificate or a sign-in has proved, ``unauthenticated`` where nobody; empty in documents of
    before, and in those that a program makes by itself.
    """

    identity: str = ""


class ApprovedAct(Act, frozen=True, kw_only=True):
    """Base class of acts that two persons may be needed for.

    `proposal` is the uid of the `ActProposed` that it carries out, `proposed_by` the identity of who proposed it; empty
    where one person was enough.
    """

    proposal: str = ""
    proposed_by: str = ""
