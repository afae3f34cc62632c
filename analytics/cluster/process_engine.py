"""Tasks in processes of this machine, where no Spark is asked for."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from analytics.cluster.engine import Done
from analytics.loop.tracing.processors import by_processes

T = TypeVar("T")
R = TypeVar("R")


class ProcessEngine:
    """Several processes of this machine, which end with each job; see `Engine`."""

    def __init__(self, processes: int) -> None:
        self.slots = processes

    def map(self, work: Callable[[T], R], tasks: Sequence[T], sizes: Sequence[int], on_done: Done) -> list[R]:
        """Results of `work` on each task, in their order; what a task raises is raised here."""
        found, done = [], 0
        for result, size in zip(by_processes(work, tasks, self.slots), sizes, strict=True):
            found.append(result)
            done += size
            on_done(done, sum(sizes))
        return found
