"""Structured logs of long-running roles on standard error: a line each, as text or JSON, from a level on.

Each line has its time, level, role, `event` in one word, `text` in a sentence, and numbers. What libraries log, and
errors that end a thread, come in the same form. Rotation is that of who keeps standard error: journald, or logrotate.
"""

import functools
import logging
import sys
import threading
from collections.abc import Callable, MutableMapping
from datetime import datetime
from types import TracebackType
from typing import Any, Literal, ParamSpec, TypeVar, get_args

import click

from stream.terminal.console import shown_text, structured_log
from stream.terminal.hints import completed
from stream.terminal.option_checks import warning_of_reach

P = ParamSpec("P")
R = TypeVar("R")
FORMATS = ("text", "json")
Level = Literal["debug", "info", "warning", "error"]
LEVELS: tuple[Level, ...] = get_args(Level)
_LOGGER = "gyrofleet"
_Fields = MutableMapping[str, Any]


class RoleLog:
    """The log of a role."""

    def __init__(self, role: str) -> None:
        import structlog

        self._log: structlog.stdlib.BoundLogger = structlog.stdlib.get_logger(_LOGGER).bind(role=role)

    def write(self, level: Level, event: str, text: str, **fields: object) -> None:
        """Write a line with further fields, such as numbers."""
        self._log.log(logging.getLevelNamesMapping()[level.upper()], event, text=completed(text), **fields)


def logged(role: str) -> Callable[[Callable[P, R]], Callable[..., R]]:
    """Give a command ``--log-format`` and ``--log-level``, and set up its log; it stands below `reporting`."""

    def decorate(command: Callable[P, R]) -> Callable[..., R]:
        @click.option(
            "--log-format", type=click.Choice(FORMATS), default="text", show_default=True,
            envvar="GYROFLEET_LOG_FORMAT", help="Form of the lines on standard error.",
        )  # fmt: skip
        @click.option(
            "--log-level", type=click.Choice(LEVELS), default="info", show_default=True,
            envvar="GYROFLEET_LOG_LEVEL", help="Leave out lines of lower levels.",
        )  # fmt: skip
        @functools.wraps(command)
        def run(*args: Any, log_format: str = "text", log_level: str = "info", **kwargs: Any) -> R:
            set_up(role, log_format, log_level)
            structured_log[:] = [functools.partial(_line, role)] if log_format == "json" else []
            if warning := warning_of_reach(kwargs.get("status_listen")):
                RoleLog(role).write("warning", "status_is_open", warning)
            return command(*args, **kwargs)

        return run

    return decorate


def set_up(role: str, log_format: str, log_level: str) -> None:
    """Have this process log in a form, from a level on."""
    import structlog

    shared: list[structlog.typing.Processor] = [
        structlog.stdlib.add_log_level, _stamped, structlog.processors.format_exc_info
    ]  # fmt: skip
    renderer = structlog.processors.JSONRenderer(ensure_ascii=False) if log_format == "json" else _as_text
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[*shared, functools.partial(_foreign, role)],
        processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, renderer],
    )
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level, *shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter
        ],
        logger_factory=structlog.stdlib.LoggerFactory(), wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=False,
    )  # fmt: skip
    handler = _StandardError()
    handler.setFormatter(formatter)
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(max(logging.WARNING, logging.getLevelNamesMapping()[log_level.upper()]))  # of libraries
    logging.getLogger(_LOGGER).setLevel(log_level.upper())
    threading.excepthook = functools.partial(_thread_failed, role)


def _line(role: str, level: Level, event: str, text: str) -> None:
    RoleLog(role).write(level, event, text)


class _StandardError(logging.StreamHandler[Any]):
    """Writes to what standard error is now."""

    def __init__(self) -> None:
        super().__init__(sys.stderr)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802  a name of the library
        """Ignore a closed standard error: nobody reads it any more."""
        if not isinstance(sys.exc_info()[1], BrokenPipeError):
            super().handleError(record)


def _stamped(_logger: object, _method: str, fields: _Fields) -> _Fields:
    fields["at"] = datetime.now().astimezone().isoformat(timespec="milliseconds")
    return fields


def _foreign(role: str, _logger: object, _method: str, fields: _Fields) -> _Fields:
    """A line of a library in our form."""
    return {**fields, "role": role, "text": fields["event"], "event": "library"}


def _as_text(_logger: object, _method: str, fields: _Fields) -> str:
    level = str(fields["level"])
    line = f"{str(fields['at'])[:19]} {'' if level == 'info' else f'{level}: '}{shown_text(str(fields['text']))}"
    trace = fields.get("exception")
    return line if trace is None else f"{line}\n{shown_text(str(trace))}"


def _thread_failed(role: str, failure: threading.ExceptHookArgs) -> None:
    error = failure.exc_value
    trace: TracebackType | None = failure.exc_traceback
    name = "" if failure.thread is None else failure.thread.name
    RoleLog(role).write(
        "error", "thread_failed", f"{type(error).__name__} in the thread {name}: {error}",
        exc_info=None if error is None else (type(error), error, trace),
    )  # fmt: skip
