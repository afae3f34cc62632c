"""Where work on many units runs: in this process, on processors of this machine by Spark, or on a Spark cluster."""

import re
import shutil
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from os import environ
from pathlib import Path
from typing import Protocol, TypeVar

from stream.errors import BadInput, GyrofleetError

T = TypeVar("T")
R = TypeVar("R")

Done = Callable[[int, int], None]  # called with how many of how many units are done

_LOCAL = re.compile(r"local\[([1-9]\d*)\]")
_MASTER = re.compile(r"spark://[^\s:/,]+:\d+(,[^\s:/,]+:\d+)*")


class MissingSpark(GyrofleetError):
    """PySpark or Java is not installed."""


class Engine(Protocol):
    """Runs tasks; the results do not depend on how many there are, on where they run and in which order."""

    @property
    def slots(self) -> int:
        """How many tasks run at the same time."""

    def map(self, work: Callable[[T], R], tasks: Sequence[T], sizes: Sequence[int], on_done: Done) -> list[R]:
        """Results of `work`, a function of a module, on each task, in the order of the tasks.

        Parameters
        ----------
        sizes : Sequence[int]
            How many units each task has; `on_done` counts them.
        """


def check_engine(name: str) -> str:
    """The master's name as Spark takes it; BadInput if it is none, MissingSpark if Spark cannot be started here.

    >>> check_engine("yarn")
    Traceback (most recent call last):
    ...
    stream.errors.BadInput: --engine yarn: give local[N], as local[4], or a Spark master, as spark://host:7077
    """
    if _LOCAL.fullmatch(name) is None and _MASTER.fullmatch(name) is None:
        raise BadInput(f"--engine {name}: give local[N], as local[4], or a Spark master, as spark://host:7077")
    if find_spec("pyspark") is None:
        raise MissingSpark(f"--engine {name} needs PySpark, which is not installed: pip install 'gyrofleet[spark]'")
    home = environ.get("JAVA_HOME")
    java = shutil.which("java") if home is None else shutil.which("java", path=str(Path(home) / "bin"))
    if java is None:
        where = "the PATH" if home is None else f"JAVA_HOME ({home})"
        raise MissingSpark(
            f"--engine {name} needs Java 17 or later, and there is no java in {where}: install it, as by "
            "`apt install openjdk-17-jre-headless`, or leave out --engine, which needs none"
        )
    return name
