"""What the commands of all packages share: options, output and how errors are told."""

import errno
import functools
import re
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, ParamSpec, TypeVar

import click
import msgspec
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text

from stream.errors import GyrofleetError

P = ParamSpec("P")
R = TypeVar("R")

_json = msgspec.json.Encoder(decimal_format="number")

DEFAULT_STORE = "gyrofleet-data"
_PATIENCE_S = 3.0
_TOLD_EVERY_S = 5.0
# C0 but tab and line feed, delete, C1, and Unicode's marks of direction
_CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
_DISK_REFUSES = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO}
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_INTERRUPTED = "interrupted; what is recorded is kept, and an import or a run goes on with the same command"

store_option = click.option(
    "--store",
    "folder",
    type=click.Path(path_type=Path),
    default=DEFAULT_STORE,
    show_default=True,
    help="Folder of the store.",
)

estimates_option = click.option(
    "--estimates",
    "estimated",
    metavar="SIGNAL",
    multiple=True,
    help="Estimate this signal as well while it flows, beside angular rates and signals with limits; 'all' for every "
    "signal. Any signal can be asked later: `gyrofleet allan` computes it from the samples.",
)


class PlainConsole(Console):
    """A console on which text stands as it is: no markup (``rate[deg/s]``), and nothing that commands the terminal.

    What is to be coloured is `styled`.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, emoji=False, markup=False, **options)

    def on_broken_pipe(self) -> None:
        """Ignore a closed standard error; a closed standard output raises, and ends the command."""
        if not self.stderr:
            raise  # noqa: PLE0704  rich calls this while it handles the error

    def render_str(self, text: str, **options: Any) -> Text:
        """Text for the terminal."""
        return super().render_str(shown_text(text), **options)


def shown_text(text: str) -> str:
    r"""Text in which control characters, and marks that turn the direction of writing, are visible.

    Examples
    --------
    >>> print(shown_text("FOG\x1b[31m-1"))
    FOG\x1b[31m-1
    """
    return _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def styled(text: str, style: str) -> Text:
    """Text in a colour, or bold, for a `PlainConsole`."""
    return Text(shown_text(text), style)


def csv_text(text: str) -> str:
    """Text that a spreadsheet takes for text: what it would take for a formula is led by an apostrophe.

    Examples
    --------
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


def notes() -> Console:
    """Console for progress and remarks (standard error)."""
    return PlainConsole(stderr=True)


def results() -> Console:
    """Console for results (standard output)."""
    console = PlainConsole()
    # a table that is piped into a file must not be cut to 80 columns
    return console if console.is_terminal else PlainConsole(width=200)


def json_text(value: Any) -> str:
    """A value as JSON; what JSON has no number for (NaN, infinity) is null."""
    return _json.encode(value).decode()


def counted(number: int, what: str) -> str:
    """A number of things in words.

    Examples
    --------
    >>> counted(1, "unit"), counted(2000, "unit")
    ('1 unit', '2,000 units')
    """
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def print_json(value: Any) -> None:
    """Print one JSON document on a line of its own."""
    click.echo(json_text(value))


def reporting(command: Callable[P, R]) -> Callable[..., R]:
    """Give a command ``--json`` and tell its errors in one line, with their exit code."""

    @click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> R:
        try:
            return command(*args, **kwargs)
        except GyrofleetError as error:
            kind = next(each.__name__ for each in type(error).__mro__ if not each.__name__.startswith("_"))
            _tell(kind, str(error), as_json=kwargs.get("as_json", False))
            sys.exit(error.exit_code)
        except OSError as error:
            if error.errno not in _DISK_REFUSES:
                raise
            where = f"{error.filename}: " if error.filename else ""
            text = f"{where}{error.strerror or error}; free the disk or mend it, and give the command again"
            _tell("DiskError", text, as_json=kwargs.get("as_json", False))
            sys.exit(1)
        except KeyboardInterrupt:
            _tell("Interrupted", _INTERRUPTED, as_json=kwargs.get("as_json", False))
            sys.exit(130)

    return run


def _tell(kind: str, message: str, *, as_json: bool) -> None:
    if as_json:
        print_json({"error": {"kind": kind, "message": message}})
    else:
        with suppress(BrokenPipeError):
            click.secho(f"error: {shown_text(message)}", err=True, fg="red")


def output_is_closed() -> bool:
    """Whether standard output is a pipe whose reader has gone, as after `| head`."""
    poll = select.poll()
    poll.register(1, 0)
    return any(events & select.POLLERR for _, events in poll.poll(0))


@contextmanager
def progress_bar(*, hidden: bool) -> Iterator[Progress]:
    """A progress bar on standard error; nothing where that is not a terminal or `hidden`."""
    console = notes()
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=hidden or not console.is_terminal, transient=True) as progress:
        yield progress


@contextmanager
def told_status() -> Iterator[Callable[[str], None]]:
    """A function that tells on standard error what is being done.

    At a terminal it is one line that changes; elsewhere, as in a log, it is a line every few seconds at most.
    """
    console = notes()
    if console.is_terminal:
        with console.status("starting") as status:
            yield lambda text: status.update(Text(shown_text(text)))
        return
    told_at = time.monotonic()

    def tell(text: str) -> None:
        nonlocal told_at
        if time.monotonic() - told_at >= _TOLD_EVERY_S:
            told_at = time.monotonic()
            console.print(text, markup=False, soft_wrap=True)

    yield tell


class Stop:
    """Whether the process was asked to stop.

    Not a `threading.Event`: a signal handler that sets one can come while the main thread holds its lock, and then
    waits for itself.
    """

    def __init__(self) -> None:
        self.asked_at: float | None = None

    def wait(self, seconds: float) -> bool:
        """Wait so long, or until asked; whether it was."""
        until = time.monotonic() + seconds
        while self.asked_at is None and (left_s := until - time.monotonic()) > 0.0:
            time.sleep(min(left_s, 0.05))
        return self.asked_at is not None


@contextmanager
def until_stopped() -> Iterator[Stop]:
    """Let SIGINT and SIGTERM ask a service to end in order; asked again some seconds later, it ends at once."""
    stop = Stop()

    def ask(number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if stop.asked_at is None:
            stop.asked_at = now
        elif now - stop.asked_at > _PATIENCE_S:
            # what is on disk is found again by the next process
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
