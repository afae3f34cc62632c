"""Commands that messages propose, as "see `gyrofleet verify`": completed by what the user's own command was given.

A message is made where the command line is not known. So it is completed where it is shown: with ``--store`` of another
store than the default, and with ``--security`` where the proposed command takes a certificate of the same role.
"""

import functools
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import click

P = ParamSpec("P")
R = TypeVar("R")
_HINT = re.compile(r"`gyrofleet ([^`]+)`")
_ROLES = "gyrofleet_roles"  # where a command keeps those whose certificates it takes
_current: list[click.Context] = []  # of the process: logs are written by any thread


def hinted(command: Callable[P, R]) -> Callable[P, R]:
    """Complete hints by the options of a command while it runs."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        context = click.get_current_context(silent=True)
        if context is None:
            return command(*args, **kwargs)
        _current.append(context)
        try:
            return command(*args, **kwargs)
        finally:
            _current.remove(context)

    return run


def keep_roles(command: Any, roles: tuple[str, ...]) -> None:
    """Say whose certificates a command takes."""
    setattr(command, _ROLES, roles)


def keep_certificate(role: str, folder: Path) -> None:
    """Say whose certificate the present command was given."""
    if _current:
        _current[-1].meta[_ROLES] = role, folder


def completed(text: str) -> str:
    """A message whose hints can be run as they are printed."""
    return _HINT.sub(_completed, text) if _current and "`gyrofleet " in text else text


def _completed(hint: re.Match[str]) -> str:
    context = _current[-1]
    command = _command(context.find_root().command, hint[1].split())
    if command is None:
        return hint[0]
    more = ""
    options = {name: each for each in command.params if isinstance(each, click.Option) for name in each.opts}
    given = next((each.name for each in context.command.params if "--store" in each.opts), None)
    folder, store = context.params.get(given or ""), options.get("--store")
    # a command whose --store has no default takes it for something else
    if isinstance(folder, Path) and store is not None and isinstance(store.default, str) and "--store" not in hint[1]:
        more += "" if str(folder) == store.default else f" --store {shlex.quote(str(folder))}"
    role, certificate = context.meta.get(_ROLES, ("", None))
    if role in getattr(command.callback, _ROLES, ()) and "--security" not in hint[1]:
        more += f" --security {shlex.quote(str(certificate))}"
    return f"`gyrofleet {hint[1]}{more}`"


def _command(command: click.Command, words: list[str]) -> click.Command | None:
    """The command that words name; None if they name none."""
    for word in words:
        if not isinstance(command, click.Group):
            break
        found = command.get_command(click.Context(command), word)
        if found is None:
            return None
        command = found
    return None if isinstance(command, click.Group) else command
