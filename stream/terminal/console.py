"""Shared parts of all commands: options, output, error reports, signals."""

import errno
import functools
import os
import re
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

import click
import msgspec

from stream.errors import GyrofleetError
from stream.terminal.hints import completed, hinted

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID
    from rich.text import Text

P = ParamSpec("P")
R = TypeVar("R")

_json = msgspec.json.Encoder(decimal_format="number")

DEFAULT_STORE = "gyrofleet-data"
_PATIENCE_S = 3.0
_STATUS_EVERY_S = 5.0
# C0 but tab and line feed, delete, C1, and what Unicode has of marks of direction, separators and signs without width
_CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]")
_DISK_REFUSES = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO}
_PATH_REFUSES = {
    errno.EACCES, errno.EEXIST, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG, errno.ENOENT, errno.ENOTDIR,
    errno.ENOTEMPTY, errno.ENXIO, errno.EPERM,
}  # fmt: skip
_EXTRAS = {
    "asammdf": "mf4",
    "sklearn": "explain",
    **dict.fromkeys(("pyhanko", "pyhanko_certvalidator", "typst"), "certificate"),
    **dict.fromkeys(("py4j", "pyspark"), "spark"),
    **dict.fromkeys(("pyiceberg", "sqlalchemy"), "iceberg"),
    **dict.fromkeys(("cryptography", "rfc3161_client"), "attest"),
    **dict.fromkeys(("authlib", "joserfc", "requests"), "oidc"),
    **dict.fromkeys(("fsspec", "obstore"), "s3"),
    **dict.fromkeys(("starlette", "uvicorn"), "serve"),
    **dict.fromkeys(("can", "cantools", "msgpack", "pyvisa", "pyvisa_py", "serial"), "station"),
}
# what spreadsheets begin a formula with, also in the wide forms of Chinese and Japanese input
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
# variables by which rich takes other files for a terminal
_FORCED = {"FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"}
_INTERRUPTED = "interrupted; what is recorded is kept, and the same command resumes an import or a run"

store_option = click.option(
    "--store", "folder", type=click.Path(path_type=Path), default=DEFAULT_STORE, show_default=True,
    help="Folder of the store.",
)  # fmt: skip

status_listen_option = click.option(
    "--status-listen", metavar="HOST:PORT",
    help="Serve /metrics (Prometheus) and /health over HTTP, as at 127.0.0.1:9464; `gyrofleet status` needs it not.",
)  # fmt: skip

estimates_option = click.option(
    "--estimates",
    "estimated",
    metavar="SIGNAL",
    multiple=True,
    help="Estimate this signal as well while it flows, besides angular rates and signals with limits; 'all' for every "
    "signal. `gyrofleet allan` computes any signal later, from the samples.",
)


def shown_text(text: str) -> str:
    r"""Make control characters and marks of writing direction visible.

    >>> print(shown_text("FOG\x1b[31m-1"))
    FOG\x1b[31m-1
    """
    return _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def styled(text: str, style: str) -> "Text":
    """Text in a colour, or bold, for a `PlainConsole`."""
    from rich.text import Text

    return Text(shown_text(text), style)


def csv_text(text: str) -> str:
    """Put an apostrophe before text that a spreadsheet would take for a formula.

    >>> csv_text("=1+1"), csv_text("-0.5"), csv_text("rate")
    ("'=1+1", '-0.5', 'rate')
    """
    if not text.startswith(_FORMULA):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def notes() -> "Console":
    """Console for progress and remarks (standard error)."""
    from stream.terminal.plain_console import NotesConsole

    return NotesConsole(stderr=True)


def results() -> "Console":
    """Console for results (standard output)."""
    from stream.terminal.plain_console import PlainConsole

    console = PlainConsole()
    if console.is_terminal or "COLUMNS" in os.environ:
        return console
    return PlainConsole(width=200)  # a file is not 80 columns wide


def json_text(value: Any) -> str:
    """Encode a value as JSON; NaN and infinity become null."""
    return _json.encode(value).decode()


def counted(number: int, what: str) -> str:
    """Format a number with its noun.

    >>> counted(1, "unit"), counted(2000, "unit")
    ('1 unit', '2,000 units')
    """
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def print_json(value: Any) -> None:
    """Print one JSON document on a line of its own."""
    click.echo(json_text(value))


# writes a line (level, event, text) where a role logs as JSON: then nothing else is on standard error
structured_log: list[Callable[[str, str, str], None]] = []


def reporting(command: Callable[P, R]) -> Callable[..., R]:
    """Give a command ``--json`` and report its errors in one line, with their exit code."""

    @click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> R:
        try:
            return command(*args, **kwargs)
        except GyrofleetError as error:
            kind = next(each.__name__ for each in type(error).__mro__ if not each.__name__.startswith("_"))
            message, code = str(error), error.exit_code
        except OSError as error:
            where = f"{error.filename}: " if error.filename else ""
            if error.errno in _DISK_REFUSES:
                message = f"{where}{error.strerror or error}; free or repair the disk, then repeat the command"
                kind, code = "DiskError", 1
            elif error.errno in _PATH_REFUSES and where:
                message = f"{where}{error.strerror}; give another path, or correct what is there"
                kind, code = "PathError", 1
            else:
                raise
        except ModuleNotFoundError as error:
            extra = _EXTRAS.get((error.name or "").split(".")[0])
            if extra is None:
                raise
            message = f"this needs {error.name}, which is not installed: pip install 'gyrofleet[{extra}]'"
            kind, code = "MissingExtra", 1
        except KeyboardInterrupt:
            kind, message, code = "Interrupted", _INTERRUPTED, 130
        message = completed(message)
        if kwargs.get("as_json", False):
            print_json({"error": {"kind": kind, "message": message}})
        if structured_log:
            structured_log[-1]("error", "failed", message)
        elif not kwargs.get("as_json", False):
            with suppress(BrokenPipeError):
                click.secho(f"error: {shown_text(message)}", err=True, fg="red")
        sys.exit(code)

    return hinted(run)


def output_is_closed() -> bool:
    """Whether standard output is a pipe whose reader has gone, as after `| head`."""
    poll = select.poll()
    poll.register(1, 0)
    return any(events & select.POLLERR for _, events in poll.poll(0))


class NoProgress:
    """A progress bar that is not shown."""

    def add_task(self, _description: str, **_: Any) -> "TaskID":
        """Begin a task."""
        return cast("TaskID", 0)

    def update(self, _task: "TaskID", **_: Any) -> None:
        """Take progress of a task."""

    def advance(self, _task: "TaskID", _advance: float = 1) -> None:
        """Likewise."""


@contextmanager
def progress_bar(*, hidden: bool) -> Iterator["Progress | NoProgress"]:
    """A progress bar on standard error; nothing where that is not a terminal or `hidden`."""
    if hidden or not (sys.stderr.isatty() or os.environ.keys() & _FORCED):
        yield NoProgress()
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    console = notes()
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as progress:
        yield progress


@contextmanager
def status_line() -> Iterator[Callable[[str], None]]:
    """Give a function that shows the activity on standard error: one changing line, in a log one every few seconds."""
    console = notes()
    if console.is_terminal:
        from rich.text import Text

        with console.status("starting") as status:
            yield lambda text: status.update(Text(shown_text(text)))
        return
    shown_at = time.monotonic()

    def show(text: str) -> None:
        nonlocal shown_at
        if time.monotonic() - shown_at >= _STATUS_EVERY_S:
            shown_at = time.monotonic()
            console.print(text, markup=False, soft_wrap=True)

    yield show


class Stop:
    """Whether the process was asked to stop.

    Not a `threading.Event`: a signal handler that sets one while the main thread holds its lock deadlocks.
    """

    def __init__(self) -> None:
        self.asked_at: float | None = None

    def wait(self, seconds: float) -> bool:
        """Wait until asked, at most so long; return whether it was asked."""
        until = time.monotonic() + seconds
        while self.asked_at is None and (left_s := until - time.monotonic()) > 0.0:
            time.sleep(min(left_s, 0.05))
        return self.asked_at is not None


_stops: list[Stop] = []  # of the roles within `until_stopped`: one in a process


def seconds_since_stop() -> float | None:
    """How long ago this process was asked to end, in `until_stopped`; None if it was not."""
    asked_at = _stops[-1].asked_at if _stops else None
    return None if asked_at is None else time.monotonic() - asked_at


@contextmanager
def interrupted_by_term() -> Iterator[None]:
    """Have SIGTERM end a command as Ctrl-C does: what it holds is closed, and its exit code is 130."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def until_stopped() -> Iterator[Stop]:
    """Turn SIGINT and SIGTERM into a request to stop; a second signal some seconds later ends the process."""
    stop = Stop()

    def ask(number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if stop.asked_at is None:
            stop.asked_at = now
        elif now - stop.asked_at > _PATIENCE_S:
            # the next process recovers from what is on disk
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    _stops.append(stop)
    try:
        yield stop
    finally:
        _stops.remove(stop)
        for number, handler in before.items():
            signal.signal(number, handler)
