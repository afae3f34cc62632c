"""Work on many units on all processors; the results do not depend on how many there are."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from typing import Protocol, TypeVar

from threadpoolctl import threadpool_limits

T = TypeVar("T")
R = TypeVar("R")

_FEWEST_UNITS = 4  # fewer do not repay the start of processes
MOST_PROCESSES = 8  # each has the libraries and the data of a unit in memory


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
    """Results of work on each item, in their order; with one process, or few items, in this process."""
    processes = min(processes, len(items) // 2, MOST_PROCESSES)
    if processes < 2 or len(items) < _FEWEST_UNITS:
        yield from map(work, items)
        return
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:  # a fork would copy locks of threads
        yield from pool.map(work, items)


def of_records(work: Callable[[int], R], records: int) -> list[R]:
    """Results of work on each record by its number, in their order.

    Threads suffice: BLAS and compiled kernels run outside of the interpreter's lock.
    """
    if records == 1:
        return [work(0)]
    with ThreadPoolExecutor(processors()) as pool:
        return list(pool.map(work, range(records)))
