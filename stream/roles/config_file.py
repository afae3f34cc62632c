"""One TOML file for the long-running roles of a computer: a table each, whose keys are the options of the command.

store = "/var/lib/gyrofleet/night"      # of every role that has the option
[record]
listen = "tcp/0.0.0.0:7447"
security = "site/recorder/recorder"     # beside this file
[serve]
users = "users.toml"
"""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import click
import msgspec

from stream.errors import BadInput, BusError, GyrofleetError
from stream.files.toml_text import decode_toml
from stream.mistakes import collected, listed, near_name
from stream.security.endpoint import parse_endpoint
from stream.terminal.option_checks import checks_of

Command = TypeVar("Command", bound=Callable[..., Any])
TABLE = "gyrofleet_config"  # where a command keeps the name of its table
_NOT_IN_FILES = frozenset({"config", "help", "json"})
_ADDRESSES = frozenset({"listen", "connect"})


def configured(table: str) -> Callable[[Command], Command]:
    """Give a command ``--config FILE``, of which it takes a table; what the command line gives counts more."""

    def set_defaults(context: click.Context, _parameter: click.Parameter, path: Path | None) -> None:
        if path is not None:
            try:
                content = read_config(path)
                context.default_map = command_settings(path, content, table, context.command)
            except BadInput as error:
                raise click.UsageError(str(error), context) from error

    option = click.option(
        "--config", "config", type=click.Path(path_type=Path, dir_okay=False), is_eager=True, expose_value=False,
        callback=set_defaults, envvar="GYROFLEET_CONFIG", help=f"Take options from [{table}] of this TOML file.",
    )  # fmt: skip

    def decorate(command: Command) -> Command:
        setattr(command, TABLE, table)
        return option(command)

    return decorate


def read_config(path: Path) -> dict[str, Any]:
    """The tables of a file; BadInput if it cannot be read or is no TOML."""
    try:
        return decode_toml(path.read_bytes(), dict[str, Any])
    except OSError as error:
        raise BadInput(f"{path} cannot be read: {error.strerror or error}; give --config FILE") from error
    except msgspec.MsgspecError as error:
        raise BadInput(f"{path}: {error}") from error


def command_settings(path: Path, content: Mapping[str, Any], table: str, command: click.Command) -> dict[str, Any]:
    """Values of a command's parameters by their names; paths count from the file. BadInput names file and key."""
    options = dict(_options(command))
    found: dict[str, Any] = {}
    for key, value in content.items():
        if not isinstance(value, dict) and key in options:
            found[_name(options[key])] = _value(path, key, value, options[key])
    own = content.get(table, {})
    if not isinstance(own, dict):
        raise BadInput(f"{path}: {table} is a table: [{table}] with the options of `gyrofleet {table}` below it")
    for key, value in own.items():
        if key not in options:
            _unknown(path, f"{table}.{key}", key, options, f"an option of `gyrofleet {table}`")
        found[_name(options[key])] = _value(path, f"{table}.{key}", value, options[key])
    return found


def check_config(path: Path, commands: Mapping[str, click.Command]) -> list[str]:
    """The tables of a file; BadInput has each key that is wrong. `commands` are the roles by their tables."""
    content = read_config(path)
    common = {key: parameter for command in commands.values() for key, parameter in _options(command)}
    found: list[str] = []
    for key, value in content.items():
        with collected(found):
            if isinstance(value, dict):
                _check_table(path, content, key, commands)
            elif key not in common:
                _unknown(path, key, key, common, "an option of a role")
            else:
                _value(path, key, value, common[key])
    if found:
        raise BadInput(f"{path}: {listed(each.removeprefix(f'{path}: ') for each in dict.fromkeys(found))}")
    return [key for key in content if key in commands]


def _check_table(path: Path, content: Mapping[str, Any], table: str, commands: Mapping[str, click.Command]) -> None:
    if table not in commands:
        _unknown(path, table, table, commands, "a role")
    found: list[str] = []
    for key, value in content[table].items():
        with collected(found):
            command_settings(path, {table: {key: value}}, table, commands[table])
    if found:
        raise BadInput(*found)
    command_settings(path, content, table, commands[table])
    _check_as_role(path, content, table, commands[table])


def _check_as_role(path: Path, content: Mapping[str, Any], table: str, command: click.Command) -> None:
    """Parse the options as the role does that is started with the file, and make the checks that it makes of them."""
    options = dict(_options(command))
    try:
        given = command.make_context(table, ["--config", str(path)]).params
    except click.UsageError as error:
        raise BadInput(f"{path}: {table}: {error.format_message()}") from error
    for check in checks_of(command):
        try:
            check(given)
        except GyrofleetError as error:
            key = next((key for key, each in options.items() if each.name == error.option), "")
            is_common = key in content and key not in content[table]
            where = key if is_common else f"{table}.{key}" if key else table
            raise BadInput(f"{path}: {where}: {error}") from error
        except ModuleNotFoundError as error:
            raise BadInput(
                f"{path}: {table}: `gyrofleet {table}` needs {error.name}, which is not installed"
            ) from error


def _unknown(path: Path, where: str, key: str, known: Mapping[str, object], what: str) -> NoReturn:
    meant = near_name(key, known) or f"; there are {', '.join(known)}"
    raise BadInput(f"{path}: {where} is not {what}{meant}")


def _options(command: click.Command) -> Iterator[tuple[str, click.Option]]:
    """The options of a command by their keys: `rotate_mb` is ``--rotate-mb``."""
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            key = max(parameter.opts, key=len).removeprefix("--").replace("-", "_")
            if key not in _NOT_IN_FILES:
                yield key, parameter


def _name(option: click.Option) -> str:
    assert option.name is not None
    return option.name


def _value(path: Path, where: str, value: Any, option: click.Option) -> Any:
    """The value of an option; BadInput says what is expected."""
    if option.is_flag:
        if not isinstance(value, bool):
            raise BadInput(f"{path}: {where} is {value!r}; true or false is expected")
        return value
    if option.multiple:
        if not isinstance(value, list):
            raise BadInput(f"{path}: {where} is {value!r}; a list is expected, as [{value!r}]")
        return [_single(path, f"{where}[{at}]", each, option) for at, each in enumerate(value)]
    return _single(path, where, value, option)


def _single(path: Path, where: str, value: Any, option: click.Option) -> Any:
    kind = option.type
    is_whole = isinstance(kind, click.types.IntParamType)
    is_number = is_whole or isinstance(kind, click.types.FloatParamType)
    fits = isinstance(value, (int if is_whole else (int, float)) if is_number else str) and not isinstance(value, bool)
    if not fits:
        what = "a whole number" if is_whole else "a number" if is_number else "a text"
        raise BadInput(f"{path}: {where} is {value!r}; {what} is expected{_range(kind)}")
    if isinstance(kind, click.Path) and isinstance(value, str):
        value = str(path.parent / value)
    try:
        kind.convert(value, option, None)
        if option.name in _ADDRESSES:
            parse_endpoint(str(value))
    except click.BadParameter as error:
        raise BadInput(f"{path}: {where}: {error.message.rstrip('.')}{_range(kind)}") from error
    except (BusError, OSError, OverflowError, ValueError) as error:  # a path with a null, a number beyond all
        raise BadInput(f"{path}: {where}: {error}") from error
    return value


def _range(kind: "click.ParamType[Any]") -> str:
    """The numbers that an option takes, as the end of a sentence."""
    if not isinstance(kind, click.IntRange | click.FloatRange):
        return ""
    least = "" if kind.min is None else f", {kind.min:g} or more"
    return least if kind.max is None else f"{least}, at most {kind.max:g}"
