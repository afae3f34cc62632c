"""Giving a command to the station of a run, and waiting for its answer."""

import time
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import NamedTuple
from uuid import NAMESPACE_URL, uuid4, uuid5

from storage.recording.client import record_documents
from storage.recording.command_box import (
    ANSWER,
    FOLDER,
    GIVEN,
    NOTE,
    TAKEN,
    WITHDRAWN,
    BadCommand,
    CommandAnswer,
    CommandFolder,
    RunCommand,
)
from storage.recording.status_board import read_statuses
from storage.store import Store
from stream.errors import GyrofleetError
from stream.events import CommandOutcome, NoteAdded, RunAction, RunCommandAnswered, RunCommandGiven
from stream.identity import Place
from stream.status.role_status import boot, uptime_ns

PATIENCE_S = 5.0
PLACE = Place("local", "entered")
_LOOK_S = 0.05
_ENDS_S = 2.0  # how long after the time limit a station that has taken the command may still answer


class GivenCommand(NamedTuple):
    """A command and its answer so far; `is_logged` says whether the log has both."""

    command: RunCommand
    answer: CommandAnswer
    is_logged: bool


def give_command(
    store: Store, run: str, action: RunAction, *, by: str, reason: str, patience_s: float = PATIENCE_S,
    role: str = "gyrofleet control", ended_as: str | None = None, report: Callable[[str], None] | None = None,
) -> GivenCommand:  # fmt: skip
    """Command the station of a run; returns its answer: `accepted` if it is still at it after `patience_s`.

    A command that the station has not taken by then is withdrawn, and never carried out; one for a run that has ended,
    with the outcome `ended_as`, is refused. `role` is who writes the log where the station does not. `report` gets a
    sentence where a command with a longer patience is not answered within the usual one. Raises StoreError if the
    store's folder cannot be written, or is another user's.
    """
    now_ns = time.time_ns()
    command = RunCommand(
        id=uuid4().hex, run=run, action=action, by=by, reason=reason, given_ns=now_ns,
        expires_ns=now_ns + round(patience_s * 1e9), expires_uptime_ns=uptime_ns() + round(patience_s * 1e9),
        boot=boot(),
    )  # fmt: skip
    with closing(CommandFolder(store.folder, run)) as folder:
        if not folder.is_held:
            why = _nobody(store, run) if ended_as is None else _over(run, ended_as)
            return _not_taken(store, folder, command, why, role)
        folder.write(command.id, GIVEN, command)
        report_s, until_s = time.monotonic() + PATIENCE_S, time.monotonic() + patience_s
        while time.monotonic() < until_s and folder.is_held:
            answer = _answer(folder, command.id)
            if answer is not None and answer.is_final:
                folder.remove(command.id, ANSWER)
                return GivenCommand(command, answer, is_logged=True)
            time.sleep(_LOOK_S)
            if report is not None and time.monotonic() > report_s:
                waits = "the station has not taken the command yet, perhaps it waits for an instrument; the command "
                waits += f"stands for {patience_s:g} s; look at the station itself"
                report(waits if answer is None else f"the station is still at it: {answer.text}")
                report = None
        if folder.move(command.id, GIVEN, WITHDRAWN):
            why = _silent(run, patience_s) if folder.is_held else _nobody(store, run)
            return _not_taken(store, folder, command, why, role)
        return GivenCommand(command, _late(folder, command.id), is_logged=True)


def give_note(store: Store, note: NoteAdded) -> None:
    """Have the station of a run enter a note, which it does soon; StoreError if the folder cannot be written."""
    with closing(CommandFolder(store.folder, note.run)) as folder:
        folder.write(note.uid, NOTE, note)


def withdrawn_commands(store: Store, run: str) -> list[GivenCommand]:
    """Commands that the station has not taken, and that the log does not have yet."""
    try:
        folder = CommandFolder(store.folder, run, is_made=False)
    except GyrofleetError:
        return []
    with closing(folder):
        found = [folder.read(each, WITHDRAWN, RunCommand) for each in folder.names(WITHDRAWN)]
        return [GivenCommand(each, withdrawal(run), is_logged=False) for each in found if isinstance(each, RunCommand)]


def withdrawal(run: str) -> CommandAnswer:
    """The answer to a command that the station has not taken, once nobody knows more."""
    return CommandAnswer(
        outcome=CommandOutcome.UNANSWERED,
        text=f"the station of run {run} has not taken the command in time; it was withdrawn, nothing was done",
        text_zh=f"试验 {run} 的试验台未及时接收命令；命令已撤回，未执行",
    )


def command_documents(
    command: RunCommand, answer: CommandAnswer, t_ns: int
) -> tuple[RunCommandGiven, RunCommandAnswered]:
    """A command and its answer as documents of the log, at `t_ns` of the clock of who answers."""
    return given_document(command, t_ns), answered_document(command, answer, t_ns)


def given_document(command: RunCommand, t_ns: int) -> RunCommandGiven:
    """A command as a document; sent twice, it is the same."""
    return RunCommandGiven(
        run=command.run, t_ns=t_ns, uid=command.id, action=command.action, by=command.by, reason=command.reason,
        given_ns=command.given_ns,
    )  # fmt: skip


def answered_document(command: RunCommand, answer: CommandAnswer, t_ns: int) -> RunCommandAnswered:
    """An answer as a document; sent twice, it is the same."""
    uid = uuid5(NAMESPACE_URL, f"gyrofleet:command/{command.id}/{answer.outcome}").hex
    return RunCommandAnswered(
        run=command.run, t_ns=t_ns, uid=uid, command=command.id, outcome=answer.outcome, text=answer.text,
        text_zh=answer.text_zh,
    )  # fmt: skip


def is_at_work(store_folder: Path, run: str) -> bool:
    """Whether a station takes commands of a run from this store now."""
    if not (store_folder / FOLDER).is_dir():
        return False
    with suppress(GyrofleetError), closing(CommandFolder(store_folder, run, is_made=False)) as folder:
        return folder.is_held
    return False


def _answer(folder: CommandFolder, command_id: str) -> CommandAnswer | None:
    found = folder.read(command_id, ANSWER, CommandAnswer)
    return None if isinstance(found, BadCommand) else found


def _late(folder: CommandFolder, command_id: str) -> CommandAnswer:
    """The answer of a station that has taken the command, waiting a little longer."""
    until_s = time.monotonic() + _ENDS_S
    while True:
        answer = _answer(folder, command_id)
        if answer is not None and (answer.is_final or time.monotonic() > until_s):
            folder.remove(command_id, ANSWER)
            return answer
        if time.monotonic() > until_s:
            is_taken = command_id in folder.names(TAKEN)
            return CommandAnswer(
                outcome=CommandOutcome.ACCEPTED,
                text="the station has taken the command and has not answered yet; the course of the run will say"
                if is_taken
                else "the station has answered; the course of the run says what",
                text_zh="试验台已接收命令，尚未答复；结果见试验过程" if is_taken else "试验台已答复；结果见试验过程",
            )
        time.sleep(_LOOK_S)


def _not_taken(
    store: Store, folder: CommandFolder, command: RunCommand, answer: CommandAnswer, role: str
) -> GivenCommand:
    """Enter a command that no station took; where the log is being written by nobody who takes messages, wait there."""
    try:
        record_documents(
            store, command_documents(command, answer, time.time_ns()), role=role, place=PLACE, builds_lake=True
        )
    except GyrofleetError:
        folder.write(command.id, WITHDRAWN, command)
        return GivenCommand(command, answer, is_logged=False)
    folder.remove(command.id, WITHDRAWN)
    return GivenCommand(command, answer, is_logged=True)


def _nobody(store: Store, run: str) -> CommandAnswer:
    """The refusal where nobody looks for commands: the run is at work without that, or nobody works on it."""
    at_work = [
        each
        for each in read_statuses(store)
        if each.run is not None and each.run.run == run and each.condition in {"working", "paused"}
    ]
    if at_work:
        host = at_work[0].host
        return CommandAnswer(
            outcome=CommandOutcome.REFUSED,
            text=f"run {run} is at work on {host}, but takes no commands from this store: only `gyrofleet run` of a "
            "procedure does, on the computer of its store; `gyrofleet run-simulated` never does. Nothing was done, the "
            f"run goes on; go to its terminal on {host}",
            text_zh=f"试验 {run} 正在 {host} 上执行，但不从本存储接收命令：仅与存储同机的 gyrofleet run 试验规程接收，"
            f"run-simulated 不接收。未执行任何操作，试验继续；请到 {host} 的终端操作",
        )
    return CommandAnswer(
        outcome=CommandOutcome.REFUSED,
        text=f"no station is at work on run {run}: it was left to be resumed, or killed; nothing was done",
        text_zh=f"没有试验台在执行试验 {run}：试验已中断待续或被终止；未执行任何操作",
    )


def _over(run: str, outcome: str) -> CommandAnswer:
    return CommandAnswer(
        outcome=CommandOutcome.REFUSED, text=f"run {run} has ended ({outcome}); nothing was done",
        text_zh=f"试验 {run} 已结束（{outcome}）；未执行任何操作",
    )  # fmt: skip


def _silent(run: str, patience_s: float) -> CommandAnswer:
    return CommandAnswer(
        outcome=CommandOutcome.UNANSWERED,
        text=f"the station of run {run} has not taken the command within {patience_s:g} s; it was withdrawn, nothing "
        "was done. Look at the station itself",
        text_zh=f"试验 {run} 的试验台 {patience_s:g} s 内未接收命令；命令已撤回，未执行。请到试验台查看",
    )
