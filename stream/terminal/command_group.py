"""Group of commands whose help has sections and whole summaries, and which loads a command when it is asked for."""

import importlib
from collections.abc import Mapping
from itertools import groupby
from typing import Any

import click


class CommandGroup(click.Group):
    """Group whose help shows the first sentence of each command whole; click cuts it at the line's end."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._titles: dict[str, str] = {}
        self._places: dict[str, str] = {}

    def add_section(self, title: str, places: Mapping[str, str]) -> None:
        """Add commands that stand under a title of their own in the help, each with its place: ``module:name``."""
        for name, place in places.items():
            self._titles[name], self._places[name] = title, place

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """A command, loaded at the first time."""
        if (place := self._places.get(cmd_name)) is not None and cmd_name not in self.commands:
            module, _, name = place.partition(":")
            self.add_command(getattr(importlib.import_module(module), name), cmd_name)
        return super().get_command(ctx, cmd_name)

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
        return [*self._titles, *(each for each in self.commands if each not in self._titles)]
