"""Group of commands whose help has sections and whole summaries."""

from itertools import groupby
from typing import Any

import click


class CommandGroup(click.Group):
    """Group whose help shows the first sentence of each command whole; click cuts it at the line's end."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._titles: dict[str, str] = {}

    def add_section(self, title: str, *commands: click.Command) -> None:
        """Add commands that stand under a title of their own in the help."""
        for command in commands:
            self.add_command(command)
            self._titles[str(command.name)] = title

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands and their summaries, section by section."""
        found = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        for title, section in groupby(found, key=lambda each: self._titles.get(each[0], "Commands")):
            rows = [(name, each.get_short_help_str(limit=1000)) for name, each in section if each and not each.hidden]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Commands in the order they were added, which is the order of use."""
        return list(self.commands)
