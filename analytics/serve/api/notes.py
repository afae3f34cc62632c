"""Notes that people add to runs."""

import time
import unicodedata
from typing import Annotated, Any

import msgspec

from analytics.serve.api.operation import Call, post
from analytics.serve.api.run.runs import check_in_run, run_row
from analytics.serve.api.unit.units import unit_row
from analytics.serve.doors.roles import Role
from ingest.importing.entered import enter
from storage.recording.run_command import give_note, is_at_work
from stream.errors import BadInput, StoreError
from stream.events import NoteAdded

_ROLE = "gyrofleet serve"


class NoteAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A note to a run, or to a unit in it."""

    run: Annotated[str, msgspec.Meta(min_length=1, max_length=128)]
    text: Annotated[str, msgspec.Meta(min_length=1, max_length=2000)]
    unit: Annotated[str, msgspec.Meta(max_length=128)] = ""


class Noted(msgspec.Struct, frozen=True, kw_only=True):
    """The note as it stands in the log; `is_visible` says whether SQL sees it already."""

    document: dict[str, Any]
    is_visible: bool


@post("/api/notes", role=Role.OPERATOR)
def add_note(call: Call, asked: NoteAsked) -> Noted:
    """Add a note to a run; the log has who wrote it and when."""
    text = asked.text.strip()
    if not text:
        raise BadInput("the note is empty; write what happened")
    if any(unicodedata.category(each) == "Cc" and each not in "\t\r\n" for each in text):
        raise BadInput("the note has control characters; write it as plain text")
    if asked.run not in call.service.live.floor.runs:
        run_row(call.fresh, asked.run)  # NotFound names similar ones
    if asked.unit:
        _check_unit(call, asked.run, asked.unit)
    by = call.person.actor
    note = NoteAdded(
        run=asked.run, t_ns=time.time_ns(), text=text, author=by.name, identity=by.identity,
        unit=asked.unit or None,
    )  # fmt: skip
    try:
        is_visible = enter(call.store.folder, [note], role=_ROLE)
    except StoreError:  # a run writes the log alone: its process enters the note
        if not is_at_work(call.store.folder, asked.run):
            raise
        give_note(call.store, note)
        is_visible = False
    call.service.live.course.add_own(note)
    return Noted(document=msgspec.to_builtins(note), is_visible=is_visible)


def _check_unit(call: Call, run: str, unit: str) -> None:
    """BadInput or NotFound if a unit is not in a run, on the floor or in the store."""
    now = call.service.live.floor.units.get(unit)
    if now is not None and now.run.run == run:
        return
    if now is None:
        unit_row(call, unit)  # NotFound names similar ones
    check_in_run(call, run, unit)
