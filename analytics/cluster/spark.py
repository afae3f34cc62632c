"""Tasks on Apache Spark: a session, a job of many tasks, and what went wrong on which executor."""

import os
import platform
import re
import socket
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast
from warnings import catch_warnings, filterwarnings

from analytics.cluster.engine import Done, check_engine
from stream.closing import Closing
from stream.errors import GyrofleetError

# PySpark is imported where it is used: this module is read where it is not installed as well
if TYPE_CHECKING:
    from py4j.java_gateway import JavaGateway
    from pyspark import AccumulatorParam, SparkConf, SparkContext

T = TypeVar("T")
R = TypeVar("R")

_ATTEMPTS = 4  # of a task, the first one included
_FIRST_TASK_S = 120.0  # in which an executor has taken a task, or there is none
_POLL_S = 0.1
_HOST = "host"
_LOOPBACK = re.compile(r"spark://(127\.[\d.]+|localhost):")
# that decide the last digits of a result
_PACKAGES = ("gyrofleet", "duckdb", "numpy", "scipy", "numba", "pyarrow", "polars")
# of Java, which only plans and passes bytes on: to start soon is worth more than to run fast
_QUICK = "-XX:TieredStopAtLevel=1 -XX:+UseSerialGC"
_JAVA = {
    "spark.driver.extraJavaOptions": _QUICK,
    "spark.driver.memory": "2g",  # holds the results of a job
}
_SETTINGS = {
    "spark.app.name": "gyrofleet",
    "spark.executor.extraJavaOptions": _QUICK,
    "spark.ui.enabled": "false",
    "spark.ui.showConsoleProgress": "false",
    "spark.driver.maxResultSize": "0",
    "spark.locality.wait": "0",  # the store is as near to each executor
    "spark.task.maxFailures": str(_ATTEMPTS),
    # one thread a task: sums of several threads differ in their last digits
    **{
        f"spark.executorEnv.{name}": "1"
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "POLARS_MAX_THREADS")
    },
    # bytes: memory that one task has freed stays with the process, for the next one
    "spark.executorEnv.MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    "spark.executorEnv.MALLOC_TRIM_THRESHOLD_": str(256 << 20),
}


class ClusterError(GyrofleetError):
    """Spark cannot be started, or a task failed on it."""


class _Failure(NamedTuple):
    """Why a task has failed for good, and on which host."""

    host: str
    what: str


class _Failures:
    """Adds up failures on their way to the driver, as Spark's `AccumulatorParam`."""

    def zero(self, _value: tuple[_Failure, ...]) -> tuple[_Failure, ...]:
        return ()

    def addInPlace(  # noqa: N802  the name that Spark calls
        self, one: tuple[_Failure, ...], other: tuple[_Failure, ...]
    ) -> tuple[_Failure, ...]:
        return one + other


class SparkEngine(Closing):
    """A Spark session, on ``local[N]`` or ``spark://host:port``; see `Engine`.

    A task that fails is tried four times; tasks of an executor that is lost run on others. On an executor the same
    versions of the packages that compute must be installed, for the same Python.
    """

    def __init__(self, name: str) -> None:
        master = check_engine(name)
        from pyspark import SparkConf

        self._name = name
        if found := re.fullmatch(r"local\[(\d+)\]", master):  # which else tries a task once
            master = f"local[{found[1]},{_ATTEMPTS}]"
        conf = SparkConf(loadDefaults=False).setMaster(master).setAll(list(_SETTINGS.items()))
        os.environ.setdefault("PYSPARK_PYTHON", sys.executable)
        if not master.startswith("spark:") or _LOOPBACK.match(master):
            conf.set("spark.driver.bindAddress", "127.0.0.1").set("spark.driver.host", "127.0.0.1")
        self._context = _started(name, conf)
        try:
            self._check_executors()
        except BaseException:
            self.close()
            raise
        self.slots = max(1, self._context.defaultParallelism)

    def map(self, work: Callable[[T], R], tasks: Sequence[T], sizes: Sequence[int], on_done: Done) -> list[R]:
        """Results of `work`, a function of a module, on each task, in their order; `sizes` are counted in `on_done`."""
        if not tasks:
            return []
        return self._run(work, tasks, sizes, on_done, patience_s=None)

    def close(self) -> None:
        """End the session."""
        self._context.stop()

    def _check_executors(self) -> None:
        """Wait for an executor; ClusterError if there is none, or it has other versions than this machine."""
        (there,) = self._run(_versions, [None], [1], lambda _done, _total: None, patience_s=_FIRST_TASK_S)
        here = _versions(None)
        if unlike := [name for name in here if name != _HOST and here[name] != there.get(name)]:
            other, own = (", ".join(f"{name} {each.get(name)}" for name in unlike) for each in (there, here))
            raise ClusterError(
                f"--engine {self._name}: an executor on {there[_HOST]} has {other}, this machine {own}; results would "
                "differ in their last digits: install the same there"
            )

    def _run(
        self, work: Callable[[T], R], tasks: Sequence[T], sizes: Sequence[int], on_done: Done, patience_s: float | None
    ) -> list[R]:
        from py4j.protocol import Py4JError
        from pyspark.errors import PySparkException

        context = self._context
        counted = context.accumulator(0)
        failures = context.accumulator((), cast("AccumulatorParam[tuple[_Failure, ...]]", _Failures()))
        attempted = _Attempted(work, counted, failures)
        pairs = list(zip(tasks, sizes, strict=True))
        # one partition a task; `repartition` would put all on one executor
        tried = context.parallelize(pairs, len(pairs)).map(attempted)
        answer: Future[list[R]] = Future()
        group = f"gyrofleet-job-{id(answer):x}"

        def run() -> None:
            try:
                context.setJobGroup(group, "gyrofleet", interruptOnCancel=True)
                answer.set_result(tried.collect())
            except BaseException as error:  # noqa: BLE001  raised again where the result is asked for
                answer.set_exception(error)

        thread = threading.Thread(target=run, name=group, daemon=True)
        thread.start()
        total, waited_s = sum(sizes), 0.0
        try:
            while thread.is_alive() and not failures.value:
                thread.join(_POLL_S)
                waited_s += _POLL_S
                on_done(min(counted.value, total), total)
                if patience_s is not None and waited_s > patience_s:
                    raise ClusterError(
                        f"--engine {self._name}: no executor has taken a task in {patience_s:.0f} s; are workers up, "
                        "with a free core and 1 GB of memory, and can they reach this machine?"
                    )
        except BaseException:
            context.cancelJobGroup(group)
            raise
        if failures.value:
            context.cancelJobGroup(group)
            first = failures.value[0]
            raise ClusterError(f"--engine {self._name}: a task failed on {first.host}: {first.what}")
        try:
            found = answer.result()
        except (Py4JError, PySparkException) as error:
            raise ClusterError(f"--engine {self._name}: the job has failed: {_short(error)}") from error
        on_done(total, total)
        return found


class _Attempted:
    """Calls `work`; a failure of the last attempt is counted instead of raised, so that its words reach the driver."""

    def __init__(self, work: Callable[[Any], Any], counted: Any, failures: Any) -> None:
        self._work, self._counted, self._failures = work, counted, failures

    def __call__(self, pair: tuple[Any, int]) -> Any:
        from pyspark import TaskContext

        task, size = pair
        try:
            found = self._work(task)
        except Exception as error:  # whatever it is, another executor may succeed
            attempt = TaskContext.get()
            if attempt is not None and attempt.attemptNumber() < _ATTEMPTS - 1:
                raise
            self._failures.add((_Failure(socket.gethostname(), _what(error)),))
            return None
        self._counted.add(size)
        return found


def _what(error: Exception) -> str:
    if isinstance(error, GyrofleetError):
        return str(error)
    at = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({at.filename}:{at.lineno})"


def _versions(_: None) -> dict[str, str]:
    """Versions of all that decides the last digits."""
    found = {name: version(name) for name in _PACKAGES}
    return found | {"Python": ".".join(platform.python_version_tuple()[:2]), _HOST: socket.gethostname()}


def _started(name: str, conf: "SparkConf") -> "SparkContext":
    """A session; what Java writes goes to a file, whose end is in the message if it does not start."""
    from py4j.protocol import Py4JError
    from pyspark import SparkContext
    from pyspark.errors import PySparkException

    log = _log()
    try:
        with catch_warnings():  # of what is not used here
            filterwarnings("ignore", "PySpark does not yet fully support pandas", FutureWarning)
            context = SparkContext(conf=conf, gateway=_gateway())
    except (Py4JError, PySparkException, OSError) as error:
        why = f"{_short(error)}; {log} has what it wrote"
        raise ClusterError(f"--engine {name}: Spark does not start: {why}") from error
    context.setLogLevel("OFF")
    return context


@cache
def _log() -> Path:
    with tempfile.NamedTemporaryFile(prefix="gyrofleet-spark-", suffix=".log", delete=False) as file:
        return Path(file.name)


@cache
def _gateway() -> "JavaGateway":
    """The Java process, one for all sessions of this one."""
    from pyspark import SparkConf
    from pyspark.java_gateway import launch_gateway

    options = SparkConf(loadDefaults=False).setAll(list(_JAVA.items()))
    with _log().open("wb") as file:
        found: JavaGateway = launch_gateway(options, {"stdout": file, "stderr": file})
    return found


def _short(error: Exception) -> str:
    if lacking := re.search(r"No module named '(\w+)'", str(error)):
        python = ".".join(platform.python_version_tuple()[:2])
        return (
            f"an executor has no module {lacking[1]}: install gyrofleet there, for Python {python} at {sys.executable}"
        )
    lines = [line for line in str(error).splitlines() if line.strip() and not line.lstrip().startswith("at ")]
    return " ".join(line.strip() for line in lines[:4])[:600]
