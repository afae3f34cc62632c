"""Where a run takes commands from: the folder of its store, where that is on this computer."""

from collections.abc import Callable, Iterator

from ingest.run.run_path import Destination
from ingest.station.run_commands import Box
from storage.recording.command_box import BadCommand, CommandAnswer, CommandBox, RunCommand
from stream.errors import StoreError
from stream.events import NoteAdded


class NoBox:
    """Takes no commands."""

    def taken(self) -> Iterator[RunCommand | BadCommand]:
        """None."""
        return iter(())

    withdrawn = take = taken

    def notes(self) -> Iterator[NoteAdded]:
        """None."""
        return iter(())

    def answer(self, command_id: str, answer: CommandAnswer) -> None:
        """Nobody waits for it."""

    def forget(self, name: str) -> None:
        """There is none."""

    def close(self) -> None:
        """Nothing is open."""


def command_box(to: Destination, run: str, report: Callable[[str], None]) -> Box:
    """The commands of a run from its store; without them it goes on, and says why."""
    if not (to.folder / "store.json").exists():
        report("commands from pages are not taken: the store is not on this computer")
        return NoBox()
    try:
        return CommandBox(to.folder, run)
    except (StoreError, OSError) as error:
        report(f"warning: commands from pages are not taken: {error}")
        return NoBox()
