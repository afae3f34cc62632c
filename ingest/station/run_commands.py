"""Commands that people give to a run from elsewhere: taken, decided, kept in its state, logged and answered."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Protocol

from ingest.station.checks.rest import by_hand
from ingest.station.run_log import RunLog
from storage.recording.command_box import BadCommand, CommandAnswer, RunCommand
from storage.recording.run_command import withdrawal
from stream.closing import Closing
from stream.errors import StoreError
from stream.events import CommandOutcome, NoteAdded, RunAction


class Box(Protocol):
    """Where commands come from, and answers go to."""

    def taken(self) -> Iterator[RunCommand | BadCommand]:
        """Commands that were taken, but not answered, by a process before this one."""

    def withdrawn(self) -> Iterator[RunCommand | BadCommand]:
        """Commands that were withdrawn, and that the log does not have."""

    def take(self) -> Iterator[RunCommand | BadCommand]:
        """Take the commands that wait."""

    def answer(self, command_id: str, answer: CommandAnswer) -> None:
        """Answer a command."""

    def notes(self) -> Iterator[NoteAdded]:
        """Notes that wait."""

    def forget(self, name: str) -> None:
        """Forget a withdrawn command, or a note, which is in the log."""

    def close(self) -> None:
        """Take no more."""


class RunCommands(Closing):
    """Carries out the commands of a run, each once: what is decided is in the run's state before it is acted on.

    `now_ns` is the computer's clock, by which commands expire; `report` tells the operator at the station.
    """

    def __init__(self, box: Box, log: RunLog, now_ns: Callable[[], int], report: Callable[[str], None]) -> None:
        self._box, self._log, self._now_ns, self._report = box, log, now_ns, report
        self._is_open = True

    @property
    def is_paused(self) -> bool:
        """Whether the run is paused, by whomever."""
        return self._log.state.is_paused

    @property
    def is_aborted(self) -> bool:
        """Whether a command aborts the run."""
        return self._log.state.aborted_by is not None

    def begin(self) -> None:
        """Answer what a process before this one has left; once the run's documents can be sent."""
        for command in self._good(self._box.taken()):
            known = self._log.command_answer(command.id)
            if known is None:
                lost = _refused(
                    "the station's process ended before it carried out the command; give it again",
                    "试验台进程在执行命令前终止；请重新下达命令",
                )
                self._log.decide_command(command, lost)
                known = lost
            self._answer(command.id, known)

    def look(self) -> None:
        """Take what waits, and decide it: the run's state then says whether it is paused or to be aborted."""
        if not self._is_open:
            return
        for command in self._good(self._box.withdrawn()):
            self._log.decide_command(command, withdrawal(command.run))
            self._box.forget(command.id)
        for note in self._box.notes():
            self._log.enter_note(note)
            self._report(f"note by {note.author}: {note.text}")
            self._box.forget(note.uid)
        for command in self._good(self._box.take()):
            answer = self._log.command_answer(command.id)
            if answer is None:
                answer = self._decision(command)
                self._log.decide_command(command, answer)
                self._report(f"{command.action} by {command.by} ({command.reason}): {answer.text}")
            self._answer(command.id, answer)

    def finish_abort(self, unsafe: Mapping[str, str]) -> None:
        """Answer the command that has aborted the run; `unsafe` has why instruments could not be made safe."""
        if (command_id := self._log.state.aborted_by) is not None:
            text, text_zh = "the run is aborted, the station was made safe", "试验已中止，试验台已置于安全状态"
            if unsafe:
                text = f"the run is aborted; {'; '.join(by_hand(unsafe))}"
                troubles = "；".join(f"{name}（{trouble}）" for name, trouble in unsafe.items())
                text_zh = f"试验已中止；请手动使以下设备处于安全状态：{troubles}"
            answer = CommandAnswer(outcome=CommandOutcome.DONE, text=text, text_zh=text_zh, unsafe=tuple(unsafe))
            self._log.complete_command(command_id, answer)
            self._answer(command_id, answer)

    def end(self) -> None:
        """Refuse what still waits, and take no more; before the run's end is sent."""
        if self._is_open:
            over = _refused("the run is ending: nothing is left to do", "试验即将结束：没有剩余步骤")
            for command in self._good(self._box.take()):
                self._log.decide_command(command, over)
                self._answer(command.id, over)
        self.close()

    def close(self) -> None:
        """Take no more commands; whoever has given one that was not taken withdraws it."""
        if self._is_open:
            self._is_open = False
            self._box.close()

    def _decision(self, command: RunCommand) -> CommandAnswer:
        state = self._log.state
        at, at_zh = f"at step {state.step + 1}", f"第 {state.step + 1} 步"
        if command.is_over or self._now_ns() > command.expires_ns:
            return _refused("it came too late; give it again if it is still wanted", "命令已过期；如仍需要请重新下达")
        if state.aborted_by is not None:
            return _refused("the run is being aborted", "试验正在中止")
        match command.action:
            case RunAction.PAUSE if state.is_paused:
                return _refused(f"it is paused already, {at}", f"试验已暂停于{at_zh}")
            case RunAction.PAUSE:
                recording = "; the record goes on, nothing new is commanded" if state.open_steps else ""
                recording_zh = "；记录继续，不再下发新指令" if state.open_steps else ""
                return _done(f"paused {at}{recording}", f"已暂停于{at_zh}{recording_zh}")
            case RunAction.RESUME if not state.is_paused:
                return _refused("it is not paused", "试验未处于暂停状态")
            case RunAction.RESUME:
                return _done(f"goes on {at}", f"从{at_zh}继续")
            case RunAction.ABORT:
                return CommandAnswer(
                    outcome=CommandOutcome.ACCEPTED, text=f"is aborted {at}; the station is being made safe",
                    text_zh=f"在{at_zh}中止；正在使试验台处于安全状态",
                )  # fmt: skip

    def _answer(self, command_id: str, answer: CommandAnswer) -> None:
        with suppress(StoreError):  # the log has it
            self._box.answer(command_id, answer)

    def _good(self, found: Iterator[RunCommand | BadCommand]) -> Iterator[RunCommand]:
        for each in found:
            if isinstance(each, BadCommand):
                text = f"warning: a command was not carried out: {each.name} {each.why}"
                self._log.note(text)
                self._report(text)
            else:
                yield each


def _done(text: str, text_zh: str) -> CommandAnswer:
    return CommandAnswer(outcome=CommandOutcome.DONE, text=text, text_zh=text_zh)


def _refused(text: str, text_zh: str) -> CommandAnswer:
    return CommandAnswer(outcome=CommandOutcome.REFUSED, text=text, text_zh=text_zh)
