"""The operator of a run at a terminal: prompts, pause, stop and abort by a word and Enter."""

import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ingest.procedures.plan import PlannedStep
from ingest.station.run import RunStopped
from ingest.station.run_commands import RunCommands
from stream.terminal.console import Stop, structured_log

_REPORT_EVERY_S = 5.0
_WORDS = {"p": "pause", "pause": "pause", "c": "continue", "continue": "continue", "a": "abort", "abort": "abort"}
_HELP = "p Enter pauses, c Enter goes on, a Enter aborts; Ctrl-C stops, to resume later"


class ConsoleOperator:
    """Attends a run at a terminal, or, where there is none, reports its progress; `quiet`, it reports troubles only.

    `takes_s` is how long so many seconds at the station take for people, as `gyrofleet status` has it.
    """

    def __init__(
        self, console: Console, stop: Stop, *, says_yes: bool, quiet: bool, listens: bool,
        takes_s: Callable[[float], float] = float,
    ) -> None:  # fmt: skip
        self._console, self._stop, self._says_yes, self._quiet = console, stop, says_yes, quiet
        self._takes_s = takes_s
        self._words: SimpleQueue[str] = SimpleQueue()
        self._paused = self._aborted = False
        self._done = 0
        self.doing, self.left_s = "", 0.0  # what is being done, and how long the rest takes at the station
        self._asked: str | None = None
        self._reported_at = time.monotonic()
        self._progress = Progress(
            TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn(), console=console,
            disable=quiet or not console.is_terminal, transient=True,
        )  # fmt: skip
        self._task = self._progress.add_task("", total=1.0)
        self._total_s = 0.0
        self._look: Callable[[], None] | None = None
        self._commands: RunCommands | None = None
        self.may_end_early = False
        self._listens = listens
        if listens:
            signal.signal(signal.SIGTTIN, signal.SIG_IGN)  # in the background reading fails, and the run goes on
            threading.Thread(target=self._listen, name="gyrofleet-operator", daemon=True).start()

    def __enter__(self) -> "ConsoleOperator":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def watch(self, look: Callable[[], None]) -> None:
        """Have `look` called repeatedly, which reports other troubles."""
        self._look = look

    def attend(self, commands: RunCommands) -> None:
        """Take commands that people give elsewhere; a run that was killed while it was paused stays so."""
        self._commands, self._paused = commands, commands.is_paused
        if self._paused:
            self.report("the run was paused when its process ended, and stays so until it is told to go on")

    def report(self, text: str) -> None:
        """Print what has happened, or log it where the log is structured."""
        if structured_log:
            structured_log[-1]("info", "report", text)
            return
        self._console.print(text, soft_wrap=True, markup=False)

    def ready(self, prompt: str) -> bool:
        """Whether Enter was given since the prompt was first shown; raises RunStopped if nobody can give it."""
        if self._says_yes:
            return True
        if self._asked != prompt:
            self._asked = prompt
            self._done = 0
            self.report(f"{prompt}: then press Enter")
        self._read()
        if self._done:
            self._asked = None
            self._done = 0
            return True
        if not self._listens and self._words.empty():
            raise RunStopped(
                f"nobody can confirm {prompt!r}: standard input has ended; run it at a terminal, or say --yes"
            )
        return False

    @property
    def is_paused(self) -> bool:
        """Whether the run was asked to pause."""
        return self._paused

    def poll_request(self) -> str | None:
        """What was asked for by word or by signal."""
        self._read()
        if self._look is not None:
            self._look()
        if self._commands is not None:
            was_paused = self._commands.is_paused
            self._commands.look()
            if self._commands.is_paused is not was_paused:
                self._paused = self._commands.is_paused
            self._aborted = self._aborted or self._commands.is_aborted
        if self._aborted:
            return "abort"
        if self._stop.asked_at is not None:
            return "stop"
        return "pause" if self._paused else None

    def at(self, step: PlannedStep, doing: str, left_s: float) -> None:
        """Show the step, what is done, and the time left at the station."""
        self.doing, self.left_s = doing, left_s
        self._total_s = max(self._total_s, left_s)
        most = "at most " if self.may_end_early else ""
        left = _left(self._takes_s(left_s))
        text = f"step {step.number} {step.words.step or ''}: {doing}, {most}{left} left"
        self._progress.update(self._task, description=text, completed=1.0 - left_s / max(self._total_s, 1e-9))
        now = time.monotonic()
        if not self._quiet and not self._console.is_terminal and now - self._reported_at >= _REPORT_EVERY_S:
            self._reported_at = now
            self.report(text)

    def _listen(self) -> None:
        with suppress(OSError, ValueError):  # in the background, or what is typed is no text
            for line in sys.stdin:
                self._words.put(line.strip().lower())
        self._listens = False

    def _read(self) -> None:
        with suppress(Empty):
            while True:
                word = self._words.get_nowait()
                if word == "":
                    self._done += 1
                elif word not in _WORDS:
                    self._console.print(_HELP, markup=False)
                else:
                    self._aborted = self._aborted or _WORDS[word] == "abort"
                    self._paused = _WORDS[word] == "pause"


def _left(seconds: float) -> str:
    """Time that is left, as fine as it matters.

    >>> _left(7.6), _left(95.0), _left(5400.0)
    ('8 s', '2 min', '1 h 30 min')
    """
    minutes = round(seconds / 60.0)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60:02d} min"
    return f"{minutes} min" if seconds >= 60.0 else f"{seconds:.0f} s"
