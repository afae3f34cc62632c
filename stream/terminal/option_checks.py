"""Checks of a command's options, before it does anything; `gyrofleet config check` has the same for its settings."""

import functools
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ParamSpec, TypeVar

import click

from stream.errors import BadInput, BusError, GyrofleetError
from stream.security.endpoint import parse_endpoint

P = ParamSpec("P")
R = TypeVar("R")
Check = Callable[[Mapping[str, Any]], object]
_MOST_PORT = 65535
WRONG_USE = 2  # exit code, as click's own
_CHECKS = "gyrofleet_checks"  # where a command keeps them


def options_checked(check: Check, *, exit_code: int = 1) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Have a command refuse its options, given by name, where `check` raises a GyrofleetError.

    It stands below `reporting`. With the exit code `WRONG_USE` nobody starts it again with the same options: for checks
    of what stays wrong until somebody corrects it.
    """

    def decorate(command: Callable[..., R]) -> Callable[..., R]:
        @functools.wraps(command)
        def run(*args: Any, **kwargs: Any) -> R:
            try:
                check(kwargs)
            except GyrofleetError as error:
                error.exit_code = max(error.exit_code, exit_code)
                raise
            return command(*args, **kwargs)

        keep_check(run, check)
        return run

    return decorate


def keep_check(command: Callable[..., Any], check: Check) -> None:
    """Say that a command makes this check itself."""
    setattr(command, _CHECKS, (check, *getattr(command, _CHECKS, ())))


def checks_of(command: click.Command) -> tuple[Check, ...]:
    """The checks that a command makes of its options, in their order."""
    found: tuple[Check, ...] = getattr(command.callback, _CHECKS, ())
    return found


@contextmanager
def about(option: str) -> Iterator[None]:
    """Errors within are about that option, by its parameter's name."""
    try:
        yield
    except GyrofleetError as error:
        error.option = error.option or option
        raise


def check_listen(options: Mapping[str, Any]) -> None:
    """BadInput if the option `status_listen` is no address."""
    if address := options.get("status_listen"):
        with about("status_listen"):
            parse_listen(address)


def warning_of_reach(address: str | None) -> str:
    """What to know of a status that is served beyond this computer; empty if it is not, or the address is none.

    >>> warning_of_reach("127.0.0.1:9464"), warning_of_reach("localhost:0"), warning_of_reach(None)
    ('', '', '')
    >>> warning_of_reach("0.0.0.0:9464")[:21]
    '--status-listen 0.0.0'
    """
    try:
        host, port = parse_listen(address or "")
        is_near = parse_endpoint(f"tcp/{host}:{port or 1}").is_loopback
    except (BadInput, BusError):
        return ""
    if is_near:
        return ""
    return (
        f"--status-listen {address}: anybody who reaches this computer can read the status there, without a login and "
        "without TLS; listen on 127.0.0.1 where only programs of this computer ask"
    )


def parse_listen(address: str) -> tuple[str, int]:
    """Host and port of ``HOST:PORT``; BadInput if it is none.

    >>> parse_listen("127.0.0.1:9464"), parse_listen(":0")
    (('127.0.0.1', 9464), ('127.0.0.1', 0))
    """
    host, _, port = address.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) <= len(str(_MOST_PORT)) and int(port) <= _MOST_PORT):
        raise BadInput(f"--status-listen {address}: this is no address; write it as 127.0.0.1:9464, a free port")
    return host or "127.0.0.1", int(port)
