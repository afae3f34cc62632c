"""A standalone master of Spark and workers on loopback, each with one core; a worker can be killed."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self
from urllib.request import urlopen

from tests.free_ports import free_endpoint

_START_S = 120.0


class StandaloneCluster:
    """Processes of a master and its workers, as long as it is open.

    Parameters
    ----------
    folder : Path
        For what they write.
    workers : int
        How many, of one core each.
    """

    def __init__(self, folder: Path, workers: int) -> None:
        import pyspark

        self._home = Path(pyspark.__file__).parent
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        port, self._page = _free_port(), _free_port()
        self.engine = f"spark://127.0.0.1:{port}"
        self._master = self._started(
            "master", "org.apache.spark.deploy.master.Master",
            "--host", "127.0.0.1", "--port", port, "--webui-port", self._page,
        )  # fmt: skip
        self._wait_for(0)
        self._workers = [
            self._started(
                f"worker-{number}", "org.apache.spark.deploy.worker.Worker", "--host", "127.0.0.1", "--cores", 1,
                "--memory", "1500m", "--webui-port", _free_port(), "--work-dir", folder / f"work-{number}", self.engine,
            )
            for number in range(workers)
        ]  # fmt: skip
        self._wait_for(workers)

    def kill_worker(self) -> None:
        """Kill a worker with its executor, as a machine that fails."""
        worker = self._workers.pop()
        os.killpg(worker.pid, signal.SIGKILL)
        worker.wait()

    def processor_s(self) -> float:
        """Seconds of the processors that the workers, their executors and the tasks' Python have taken so far."""
        ticks, sessions = 0, {str(each.pid) for each in self._workers}
        for stat in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):  # it has ended meanwhile
                words = stat.read_text().rpartition(")")[2].split()
                if words[3] in sessions:  # its own, and of its children that have ended
                    ticks += sum(int(each) for each in words[11:15])
        return ticks / os.sysconf("SC_CLK_TCK")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for each in (*self._workers, self._master):
            os.killpg(each.pid, signal.SIGKILL)
            each.wait()

    def _started(self, name: str, *words: object) -> subprocess.Popen[bytes]:
        environment = os.environ | {
            "SPARK_HOME": str(self._home), "SPARK_LOCAL_IP": "127.0.0.1", "PYSPARK_PYTHON": sys.executable,
            "SPARK_DAEMON_JAVA_OPTS": "-XX:TieredStopAtLevel=1 -XX:+UseSerialGC", "SPARK_DAEMON_MEMORY": "256m",
        }  # fmt: skip
        with (self._folder / f"{name}.log").open("wb") as log:
            return subprocess.Popen(
                [self._home / "bin" / "spark-class", *map(str, words)],
                env=environment, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip

    def _wait_for(self, workers: int) -> None:
        until = time.monotonic() + _START_S
        while time.monotonic() < until:
            try:
                with urlopen(f"http://127.0.0.1:{self._page}/json/", timeout=10) as page:
                    if page.read().count(b'"ALIVE"') >= workers:
                        return
            except OSError:
                pass
            time.sleep(0.2)
        raise TimeoutError(f"master and {workers} workers are not up after {_START_S:.0f} s: see {self._folder}")


def _free_port() -> int:
    return int(free_endpoint().rpartition(":")[2])
