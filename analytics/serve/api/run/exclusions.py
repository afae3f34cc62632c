"""Exclusion of runs from evaluation, and their inclusion."""

from typing import Annotated, Any

import msgspec

from analytics.serve.api.operation import Call, post
from analytics.serve.doors.roles import Role
from storage.recording import exclusions
from stream.events import ExclusionAction

_Name = Annotated[str, msgspec.Meta(min_length=1, max_length=128)]


class ExclusionAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A run, some units of it, or a check by its uid, and why it is excluded, or included again."""

    action: ExclusionAction
    reason: Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]
    run: _Name | None = None
    units: tuple[_Name, ...] = ()
    check: _Name | None = None


class Excluded(msgspec.Struct, frozen=True, kw_only=True):
    """Units that were changed, and those that were so already; `is_visible` says whether evaluations follow it yet."""

    units: list[str]
    already: list[str]
    documents: list[dict[str, Any]]
    is_visible: bool


@post("/api/exclusions", role=Role.APPROVER)
def enter_exclusion(call: Call, asked: ExclusionAsked) -> Excluded:
    """Exclude a run from every evaluation, or include it again; the log has who did it, when and why."""
    done = exclusions.enter_exclusion(
        call.store, asked.action, asked.reason, call.person.actor, role="gyrofleet serve", run=asked.run,
        units=asked.units, check=asked.check,
    )  # fmt: skip
    documents = [msgspec.to_builtins(each) for each in done.documents]
    return Excluded(units=done.changed, already=done.others, documents=documents, is_visible=done.is_in_lake)
