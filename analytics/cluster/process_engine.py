"""Tasks in processes of this machine, where no Spark is asked for."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

from analytics.cluster.engine import Done

T = TypeVar("T")
R = TypeVar("R")


class ProcessEngine:
    """Several processes of this machine, which end with each job; see `Engine`."""

    def __init__(self, processes: int) -> None:
        self.slots = processes

    def map(self, work: Callable[[T], R], tasks: Sequence[T], sizes: Sequence[int], on_done: Done) -> list[R]:
        """Results of `work` on each task, in their order; what a task raises is raised here, and the others end."""
        done, total = 0, sum(sizes)
        with ProcessPoolExecutor(self.slots, get_context("spawn")) as pool:  # a fork would copy locks of threads
            started: dict[Future[R], int] = {
                pool.submit(work, task): size for task, size in zip(tasks, sizes, strict=True)
            }
            try:
                for each in as_completed(started):
                    each.result()
                    done += started[each]
                    on_done(done, total)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
            return [each.result() for each in started]
