"""The options ``--security`` and ``--insecure`` of the commands that use the bus."""

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import click

from stream.errors import BadInput, BusError
from stream.security.credentials import VARIABLE, BusSecurity, Credentials, load_credentials, secured_process
from stream.security.endpoint import check_plain_endpoint, secured_endpoint
from stream.security.rights import Role
from stream.terminal.console import structured_log
from stream.terminal.hints import keep_certificate, keep_roles
from stream.terminal.option_checks import about, keep_check

P = ParamSpec("P")
R = TypeVar("R")
_UNPROTECTED = "the bus has no security: it reaches this computer only; `gyrofleet site init` makes certificates"


def check_one_address(options: Mapping[str, Any]) -> None:
    """BadInput if a role is to listen and to connect."""
    if options.get("listen") and options.get("connect"):
        with about("connect"):
            raise BadInput("give --listen or --connect, not both: with --connect it is the router that listens")


def secured(
    *roles: Role, listens: bool = False, default: Callable[[dict[str, Any]], Path | None] = lambda _: None,
    is_group: bool = False,
) -> Callable[[Callable[P, R]], Callable[..., R]]:  # fmt: skip
    """Give a command the options, and its buses the protection that they ask for; it stands below `reporting`.

    The certificate is of one of `roles`. Addresses among the command's arguments are checked before it begins, and are
    of TLS with security. `listens`: it listens where it is given no address, and reports that the bus has no security.
    `default` finds the folder of the certificate in its other arguments. A group (`is_group`) with a subcommand called
    needs none.
    """

    def checked(options: Mapping[str, Any]) -> Credentials | None:
        return _credentials(options, roles or tuple(Role))

    def decorate(command: Callable[P, R]) -> Callable[..., R]:
        @click.option(
            "--security", "security", type=click.Path(path_type=Path, exists=True), envvar=VARIABLE,
            help=f"Folder of this side's certificate, from `gyrofleet site`.  [variable: {VARIABLE}]",
        )  # fmt: skip
        @click.option(
            "--insecure", "is_insecure", is_flag=True, help="Let the bus reach beyond this computer without security."
        )
        @functools.wraps(command)
        def run(*args: Any, security: Path | None = None, is_insecure: bool = False, **kwargs: Any) -> R:
            if is_group and click.get_current_context().invoked_subcommand is not None:
                return command(*args, **kwargs)
            if security is None and not is_insecure:
                security = default(kwargs)
            credentials = checked(kwargs | {"security": security, "is_insecure": is_insecure})
            for name in ("listen", "connect"):
                if kwargs.get(name) and credentials is not None:
                    kwargs[name] = secured_endpoint(kwargs[name])
            does_listen = kwargs.get("listen") or (listens and not kwargs.get("connect"))
            if credentials is None and does_listen:
                text = "the bus has no security, and reaches the network" if is_insecure else _UNPROTECTED
                if structured_log:
                    structured_log[-1]("warning", "no_security", text)
                else:
                    click.echo(f"note: {text}", err=True)
            if credentials is not None:
                keep_certificate(credentials.principal.role, credentials.folder)
            with secured_process(BusSecurity(credentials, is_insecure)):
                return command(*args, **kwargs)

        keep_check(run, checked)
        keep_roles(run, roles)
        return run

    return decorate


def _credentials(options: Mapping[str, Any], roles: tuple[Role, ...]) -> Credentials | None:
    """The credentials that options name, None without security; a GyrofleetError if the addresses do not go with it."""
    security, is_insecure = options.get("security"), bool(options.get("is_insecure"))
    if security is not None and is_insecure:
        with about("is_insecure"):
            raise BadInput("give --security or --insecure, not both")
    with about("security"):
        credentials = None if security is None else load_credentials(security, roles)
    for name in ("listen", "connect"):
        given = options.get(name)
        if not given:
            continue
        with about(name):
            if credentials is None:
                check_plain_endpoint(given, is_listening=name == "listen", is_insecure=is_insecure)
                continue
            if name == "listen" and not credentials.principal.role.listens:
                raise BusError(
                    f"{credentials.principal} may not listen: others would not connect to it; --listen needs the "
                    f"certificate of a recorder or router"
                )
            secured_endpoint(given)
    return credentials
