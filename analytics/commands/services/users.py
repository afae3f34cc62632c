"""The commands `gyrofleet users`: who may log in to `gyrofleet serve`, and in which role."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from analytics.serve.doors.roles import ROLES, Role
from stream.errors import BadInput
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import notes, print_json, reporting, results
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from analytics.serve.doors.users_file import User

_users_option = click.option(
    "--users", "path", type=click.Path(path_type=Path, dir_okay=False), default="users.toml", show_default=True,
    help="File of users.",
)  # fmt: skip


@click.group("users", cls=CommandGroup)
def users() -> None:
    """Users of `gyrofleet serve`: people with passwords, programs with tokens, and their roles.

    A viewer reads and asks in SQL; an operator also enters notes and verifies the store; an engineer also diagnoses
    and puts error models to use; an approver also approves. A server reads the file again when it changes.
    """


@users.command("add")
@click.argument("name")
@click.option("--role", type=click.Choice(ROLES), required=True, help="What the user may do.")
@click.option("--program", is_flag=True, help="A program: a new token is printed, and stored nowhere.")
@click.option(
    "--certificate", metavar="SUBJECT", help="Subject of a client certificate, by which a proxy knows the user."
)
@click.option("--password-stdin", is_flag=True, help="Read the password from standard input instead of asking for it.")
@_users_option
@reporting
def add(
    name: str, role: str, certificate: str | None, path: Path, *, program: bool, password_stdin: bool, as_json: bool
) -> None:
    """Add a user, or give one another role and password, token or certificate: what the user had ends."""
    from analytics.serve.doors.users_file import add_certificate, add_person, add_program, read_users

    before = read_users(path).get(name) if path.exists() else None
    ended = _ended(before, certificate)
    found = {"user": name, "role": role, "users": str(path), "ended": ended}
    if certificate is not None:
        if program or password_stdin:
            raise BadInput("a user with --certificate has no password or token; leave --program, --password-stdin out")
        add_certificate(path, name, Role.named(role), certificate)
        print_json(found) if as_json else _print_added(name, role, path, ended)
        return
    if program:
        token = add_program(path, name, Role.named(role))
        if as_json:
            print_json(found | {"token": token})
        else:
            _print_ended(name, ended)
            notes().print(f"{name} is {role} in {path}; its token:")
            results().print(token, soft_wrap=True)
        return
    if password_stdin:
        password = sys.stdin.readline().rstrip("\r\n")
    else:
        password = click.prompt(f"password of {name}", hide_input=True, confirmation_prompt=True, err=True)
    add_person(path, name, Role.named(role), password)
    if as_json:
        print_json(found)
    else:
        _print_added(name, role, path, ended)


def _print_added(name: str, role: str, path: Path, ended: str) -> None:
    _print_ended(name, ended)
    results().print(f"{name} is {role} in {path}")


def _print_ended(name: str, ended: str) -> None:
    if ended:
        notes().print(f"{name} was there already: what opened the door before has ended ({ended})", soft_wrap=True)


def _ended(before: "User | None", certificate: str | None) -> str:
    """What a user had, and has no more with what is added now."""
    if before is None:
        return ""
    had = {
        "its password, with its sessions": before.password, "its token": before.token_sha256,
        "its certificate": "" if before.certificate == (certificate or "").strip() else before.certificate,
    }  # fmt: skip
    return "; ".join(what for what, each in had.items() if each)


@users.command("list")
@_users_option
@reporting
def list_users(path: Path, *, as_json: bool) -> None:
    """List the users and their roles."""
    from analytics.serve.doors.users_file import read_users
    from stream.errors import NotFound

    if not path.exists():
        raise NotFound(f"there is no file {path}; `gyrofleet users add NAME --role ROLE` writes it")
    rows = [{"user": name, "role": user.role, "kind": _kind(user)} for name, user in read_users(path).items()]
    if as_json:
        print_json(rows)
        return
    table = ResultTable("user", "role", "kind")
    for row in rows:
        table.add_row(*row.values())
    results().print(table)


def _kind(user: "User") -> str:
    if user.token_sha256:
        return "program"
    return "person" if user.password else "certificate"


@users.command("remove")
@click.argument("name")
@_users_option
@reporting
def remove(name: str, path: Path, *, as_json: bool) -> None:
    """Remove a user; its sessions end."""
    from analytics.serve.doors.users_file import remove_user

    remove_user(path, name)
    if as_json:
        print_json({"removed": name, "users": str(path)})
    else:
        results().print(f"{name} is removed from {path}")
