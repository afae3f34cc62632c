"""The estimators made ready before a command takes samples, and a word on why it takes some seconds."""

from collections.abc import Iterator
from contextlib import contextmanager

from stream.console import notes
from stream.estimators.warm_up import warm_up


def compile_kernels(*, quiet: bool) -> None:
    """Make the estimators' machine code ready; says so, for it takes some seconds the first time."""
    console = notes()
    with console.status("making the estimators ready (some seconds, the first time only)") if not quiet else _nothing():
        warm_up()


@contextmanager
def _nothing() -> Iterator[None]:
    yield
