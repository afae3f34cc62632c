"""The commands `gyrofleet config` and `gyrofleet supervise`."""

import sys
from pathlib import Path

import click
from click.core import ParameterSource

from stream.errors import BadInput
from stream.roles.config_file import TABLE, check_config
from stream.roles.role_log import RoleLog, logged
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import notes, print_json, reporting, results, until_stopped

_FILE = click.Path(path_type=Path, dir_okay=False)
# sources end before what they send to
_ORDER = ("router", "record", "lake", "estimate", "compensate", "serve", "alert", "attest", "replicate")
_LOOK_S = 0.2


def roles() -> dict[str, tuple[tuple[str, ...], click.Command]]:
    """The commands that take a table of a file of settings, with their words, by the name of the table."""
    found: dict[str, tuple[tuple[str, ...], click.Command]] = {}
    waiting: list[tuple[tuple[str, ...], click.Command]] = [((), click.get_current_context().find_root().command)]
    while waiting:
        words, command = waiting.pop()
        if isinstance(command, click.Group):
            context = click.Context(command)
            each_name = command.list_commands(context)
            waiting += [((*words, name), each) for name in each_name if (each := command.get_command(context, name))]
        elif table := getattr(command.callback, TABLE, ""):
            found[table] = words, command
    return {name: found[name] for name in sorted(found, key=_ORDER.index)}


def _commands() -> dict[str, click.Command]:
    return {name: command for name, (_, command) in roles().items()}


@click.group("config", cls=CommandGroup)
def config() -> None:
    """Check files before anything relies on them."""


@config.command("check")
@click.argument("files", nargs=-1, required=True, type=_FILE)
@click.option("--as", "kind", metavar="KIND", help="What the files are, where their content does not say.")
@reporting
def check(files: tuple[Path, ...], kind: str | None, *, as_json: bool) -> None:
    """Check FILES of any kind that gyrofleet reads, and name file, key and what is expected.

    Stations, lists of units, specifications, rules of alerts, procedures, simulated fleets, CAN mappings, serial
    frames, orders of certificates, users, logins, a site's rules and access list, and settings of roles (--config).
    """
    from analytics.config_kinds import KINDS, checked, checked_together

    if kind is not None and kind not in KINDS:
        raise BadInput(f"--as {kind}: there is no such kind; there are {', '.join(KINDS)}")
    commands = _commands()
    found = checked_together([checked(path, kind, commands) for path in files])
    if as_json:
        print_json({"is_well": all(not each.problem for each in found), "files": found})
    else:
        for each in found:
            if each.problem:
                notes().print(f"error: {each.problem}", soft_wrap=True)
            else:
                results().print(f"{each.file}: {each.kind}, {each.text}", soft_wrap=True)
    sys.exit(1 if any(each.problem for each in found) else 0)


@click.command("supervise")
@click.argument("path", metavar="FILE", type=_FILE)
@click.option(
    "--patience-s", type=click.FloatRange(min=1.0), default=60.0, show_default=True,
    help="How long roles may take to end, when this command is ended.",
)  # fmt: skip
@reporting
@logged("supervise")
def supervise(path: Path, patience_s: float, *, as_json: bool) -> None:
    """Keep the roles of a FILE of settings at work: one process for each of its tables, until stopped.

    A role that dies is reported with its reason, and started again after 1 s, then 2 s, up to 60 s; one whose options
    are wrong is not. A --log-format that is given is that of the roles as well. Where there is systemd, its units do
    the same.
    """
    from stream.roles.supervision import Role, Supervisor

    context = click.get_current_context()
    is_given = context.get_parameter_source("log_format") is ParameterSource.COMMANDLINE
    form = ("--log-format", context.params["log_format"]) if is_given else ()
    known = roles()
    names = check_config(path, _commands())
    if not names:
        raise BadInput(f"{path} has no table of a role, as [record]; there are {', '.join(known)}")
    log = RoleLog("supervise")
    command = [sys.executable, "-c", "from gyrofleet import front_door; front_door()"]
    wanted = [Role(name, (*known[name][0], "--config", str(path), *form)) for name in sorted(names, key=_ORDER.index)]
    supervisor = Supervisor(wanted, command, log.write)
    with until_stopped() as stopped:
        while supervisor.look() and not stopped.wait(_LOOK_S):
            pass
        is_well = supervisor.stop(patience_s)
    if as_json:
        print_json({"event": "ended", "starts": {role.name: role.starts for role in wanted}})
    sys.exit(0 if is_well and not any(role.gave_up for role in wanted) else 1)
