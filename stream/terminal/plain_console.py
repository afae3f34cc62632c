"""Consoles for results and notes; rich is loaded for the first text that is printed."""

from typing import Any

from rich.console import Console
from rich.text import Text

from stream.terminal.console import shown_text
from stream.terminal.hints import completed


class PlainConsole(Console):
    """Console that prints text as it is: no markup (``rate[deg/s]``), no control characters; colour by `styled`."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, emoji=False, markup=False, **options)

    def on_broken_pipe(self) -> None:
        """Ignore a closed standard error; a closed standard output raises, and ends the command."""
        if not self.stderr:
            raise  # noqa: PLE0704  rich calls this while it handles the error

    def render_str(self, text: str, **options: Any) -> Text:
        """Text for the terminal."""
        return super().render_str(shown_text(text), **options)


class NotesConsole(PlainConsole):
    """Console whose hints can be run as they are printed; results stay as they are."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Text for the terminal."""
        return super().render_str(completed(text), **options)
