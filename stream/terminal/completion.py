"""Completion of command lines in a shell."""

from collections.abc import Callable, Iterable

import click
from click.shell_completion import CompletionItem, get_completion_class

SHELLS = ("bash", "zsh", "fish")


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(ctx: click.Context, shell: str) -> None:
    """Print the script that completes commands, options, units, runs, metrics and procedures.

    For bash, put this line into ~/.bashrc: eval "$(gyrofleet completion bash)"
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(ctx.find_root().command, {}, "gyrofleet", "_GYROFLEET_COMPLETE").source())


class ListedName(click.ParamType[str]):
    """Text that the shell completes from the list that `names` gives when it asks."""

    name = "text"

    def __init__(self, names: Callable[[], Iterable[str]]) -> None:
        self._names = names

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Names that begin with what is typed."""
        return [CompletionItem(name) for name in self._names() if name.startswith(incomplete)]
