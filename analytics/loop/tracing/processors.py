"""Work on many units on all processors; the results do not depend on how many there are."""

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from typing import Protocol, TypeVar

from threadpoolctl import threadpool_limits

T = TypeVar("T")
R = TypeVar("R")

_FEWEST_UNITS = 4  # fewer do not repay the start of processes
MOST_PROCESSES = 8  # each has the libraries and the data of a unit in memory
_LOOK_S = 0.5


class Spread(Protocol):
    """Work on many items, somewhere; the results are those of `map`."""

    def __call__(self, work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
        """Results of work, a function of a module, on each item, in their order."""


def processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0))


def single_blas() -> threadpool_limits:
    """Context in which BLAS uses one thread.

    Its own threads cost more than they save on these small matrices, and their number changes the last digits.
    """
    return threadpool_limits(1, "blas")


def by_processes(work: Callable[[T], R], items: Sequence[T], processes: int) -> Iterator[R]:
    """Results of work on each item, in their order; with one process, or few items, in this process.

    The processes end with this one, also where it is killed.
    """
    processes = min(processes, len(items) // 2, MOST_PROCESSES)
    if processes < 2 or len(items) < _FEWEST_UNITS:
        yield from map(work, items)
        return
    context = get_context("spawn")  # a fork would copy locks of threads
    with ProcessPoolExecutor(processes, context, _end_with, (os.getpid(),)) as pool:
        yield from pool.map(work, items)


def _end_with(parent: int) -> None:
    """End this process soon after its parent has ended: nobody would take the result of its work."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="parent").start()


def of_records(work: Callable[[int], R], records: int) -> list[R]:
    """Results of work on each record by its number, in their order.

    Threads suffice: BLAS and compiled kernels run outside of the interpreter's lock.
    """
    if records == 1:
        return [work(0)]
    with ThreadPoolExecutor(processors()) as pool:
        return list(pool.map(work, range(records)))
