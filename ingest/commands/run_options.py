"""What the commands that send a run share: where it goes, its spool, and how the command ends."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click

from ingest.run.run_path import RunPath, TroubleWatch, check_spool_name, spools_of
from storage.store import writer_endpoint
from stream.console import Stop, store_option

INTERRUPTED = 130
PATIENCE_S = 5.0


class Destination(NamedTuple):
    """Where a run goes.

    Parameters
    ----------
    folder: The store.
    connect: Where the recorder listens; None where this process records.
    spools: Folder of the spools, or, where `is_given`, that of this run's.
    spool_bytes: How much may wait in the spool.
    """

    folder: Path
    connect: str | None
    spools: Path
    spool_bytes: int
    is_given: bool

    @classmethod
    def chosen(
        cls, run: str | None, folder: Path, connect: str | None, spool_folder: Path | None, spool_mb: int
    ) -> "Destination":
        """What the options say.

        Raises
        ------
        BadInput: If the run's name is too long for a folder.
        """
        connect = connect or writer_endpoint(folder)
        if spool_folder is None:
            check_spool_name(run or "")
        spools = spool_folder or spools_of(folder, is_remote=connect is not None)
        return cls(folder, connect, spools, spool_mb << 20, spool_folder is not None)


def destination_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of where a run goes, and `--end`."""
    for option in (
        click.option("--end", "is_ended", is_flag=True, help="End the run where it is, with outcome `stopped`."),
        click.option(
            "--spool-mb", type=click.IntRange(min=1), default=4096, show_default=True, help="Size of the spool."
        ),
        click.option(
            "--spool",
            "spool_folder",
            type=click.Path(path_type=Path),
            help="Folder of the spool; by default STORE/spool.",
        ),
        click.option("--connect", help="Where the recorder listens; by default the one that writes the store."),
        store_option,
    ):
        command = option(command)
    return command


def left_behind(path: RunPath, where: str, hint: str) -> str:
    """Wait a little for the recorder; what waits in the spool, and how to resume."""
    until = time.monotonic() + PATIENCE_S
    path.publisher.drain(lambda: time.monotonic() > until)
    left = path.publisher.outstanding
    if left:
        path.publisher.abandon()
    else:
        path.finish()
    kept = f"{left} messages wait in {where}; " if left else ""
    return f"{kept}give the same command {hint}, with --end to end it"


def drain(path: RunPath, trouble: TroubleWatch, stop: Stop) -> None:
    """Wait until all of it is recorded; after a request to stop, not for long."""

    def is_given_up() -> bool:
        trouble.look()
        return stop.asked_at is not None and time.monotonic() > stop.asked_at + PATIENCE_S

    path.publisher.drain(is_given_up)
