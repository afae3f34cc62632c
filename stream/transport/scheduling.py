"""Threads that work when others have nothing to do."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress


def be_nicer(by: int) -> None:
    """Lower the priority of this thread alone by steps of nice; nothing where threads have none of their own."""
    if sys.platform == "linux":
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), os.getpriority(os.PRIO_PROCESS, 0) + by)


def wait_for_turn() -> None:
    """Let this thread, when it is woken, wait until the one at work has had its turn, a few milliseconds.

    Where all processors are busy, a thread that hands messages on then takes several at once, in place of two changes
    of threads for each (``SCHED_BATCH``, sched(7)). Nothing where a processor is idle, or there is no such policy.
    """
    if sys.platform == "linux":
        with suppress(OSError):  # where a sandbox refuses it
            if os.sched_getscheduler(0) == os.SCHED_OTHER:
                os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


@contextmanager
def threads_waiting_for_turn() -> Iterator[None]:
    """Threads that a library begins within wait for their turn; this one does as before."""
    before = _policy()
    wait_for_turn()
    try:
        yield
    finally:
        if sys.platform == "linux" and _policy() != before:
            with suppress(OSError):
                os.sched_setscheduler(0, before, os.sched_param(0))


def _policy() -> int:
    """Scheduling policy of this thread; 0, the usual one, where that is not known."""
    if sys.platform == "linux":
        with suppress(OSError):
            return os.sched_getscheduler(0)
    return 0
