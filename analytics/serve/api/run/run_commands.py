"""Commands of people to the station of a run: pause, resume, abort; its answer, and what nobody has answered."""

import time
from typing import Annotated

import msgspec

from analytics.serve.api.operation import Call, Nothing, get, link, post
from analytics.serve.api.run.run_course import CommandRow, run_course
from analytics.serve.api.run.runs import run_row
from analytics.serve.doors.roles import Role
from analytics.serve.problems import Conflict, TooMany
from storage.recording.run_command import PATIENCE_S, command_documents, give_command, is_at_work
from stream.errors import BadInput, NotFound
from stream.events import CommandOutcome, RunAction

_ROLE = "gyrofleet serve"


class CommandAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the station is to do, and why."""

    action: RunAction
    reason: Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]


class CommandGiven(msgspec.Struct, frozen=True, kw_only=True):
    """The station's answer: `outcome` is ``done``, or ``accepted`` where that is not confirmed yet (202)."""

    run: str
    command: str
    action: RunAction
    outcome: CommandOutcome
    text: str
    text_zh: str


class RunCommands(msgspec.Struct, frozen=True, kw_only=True):
    """The commands of a run, the newest first."""

    commands: list[CommandRow]


@post(
    "/api/runs/{run}/commands", role=Role.OPERATOR,
    is_unfinished=lambda given: given.outcome is CommandOutcome.ACCEPTED,
)  # fmt: skip
def command_run(call: Call, asked: CommandAsked) -> CommandGiven:
    """Command the station of a run to pause, resume or abort it, and wait some seconds for its answer.

    202 if the station has taken the command and does not confirm within 5 s that it is carried out: the commands of the
    run have ``done`` once it is.
    409 if it refuses, if the run has ended, or if it has not taken the command in time: then the command is withdrawn.
    """
    run = call.path["run"]
    reason = asked.reason.strip()
    if not reason:
        raise BadInput("the reason is empty; say why")
    if (wait_s := call.service.command_tries.wait_s(call.person.name)) > 0.0:
        raise TooMany(f"{call.person.name} has given too many commands", wait_s)
    ended_as = None if is_at_work(call.store.folder, run) else _outcome(call, run)
    given = give_command(
        call.store, run, asked.action, by=call.person.name, reason=reason, role=_ROLE, ended_as=ended_as
    )
    answer = given.answer
    for document in command_documents(given.command, answer, time.time_ns()):
        call.service.live.course.add_own(document)
    if answer.outcome in {CommandOutcome.REFUSED, CommandOutcome.UNANSWERED}:
        raise Conflict(f"{asked.action} {answer.outcome}: {answer.text}")
    more = more_zh = ""
    if answer.outcome is CommandOutcome.ACCEPTED:
        see = link("api", "runs", run, "commands")
        more = f"; not confirmed within {PATIENCE_S:g} s: {see} and the page of the run say when it is done"
        more_zh = f"；{PATIENCE_S:g} s 内未确认完成：完成后见 {see} 及试验页面"
    return CommandGiven(
        run=run, command=given.command.id, action=asked.action, outcome=answer.outcome, text=answer.text + more,
        text_zh=answer.text_zh + more_zh,
    )  # fmt: skip


@get("/api/runs/{run}/commands", is_kept=False, table="commands")
def list_run_commands(call: Call, asked: Nothing) -> RunCommands:
    """The commands that were given to the station of a run: by whom, when and why, and what came of each."""
    return RunCommands(commands=run_course(call, asked).commands)


def _outcome(call: Call, run: str) -> str | None:
    """How a run has ended; None if it has not. NotFound if there is none."""
    try:
        return None if (found := run_course(call, Nothing()).outcome) == "open" else found
    except NotFound:
        run_row(call.views, run)  # NotFound names similar ones
        raise
