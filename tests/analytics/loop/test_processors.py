"""Work by several processes: in order, and ended with the process that asked for it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from analytics.loop.tracing.processors import by_processes

_ASKS = """
import time
from analytics.loop.tracing.processors import by_processes
if __name__ == "__main__":
    list(by_processes(time.sleep, [600.0] * 4, 2))
"""


def children(process: int) -> set[int]:
    """Processes below one, those of multiprocessing's tracker included."""
    return {int(each) for each in Path(f"/proc/{process}/task/{process}/children").read_text().split()}


def are_there(processes: set[int]) -> set[int]:
    """Those that run; one that has ended and waits to be asked for its exit code does not."""
    states = {each: Path(f"/proc/{each}/stat") for each in processes}
    return {
        each for each, stat in states.items() if stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"
    }


def test_results_come_in_order() -> None:
    assert list(by_processes(abs, [-3, 2, -1, 0], 2)) == [3, 2, 1, 0]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_processes_end_with_the_one_that_asked(tmp_path: Path, how: signal.Signals) -> None:
    program = tmp_path / "asks.py"
    program.write_text(_ASKS)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen([sys.executable, "-P", program], env=environment) as process:
        deadline = time.monotonic() + 60.0
        while len(below := children(process.pid)) < 3 and time.monotonic() < deadline:
            time.sleep(0.05)
        assert len(below) == 3, "two processes and the tracker of their resources"
        process.send_signal(how)
    deadline = time.monotonic() + 60.0
    while are_there(below) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not are_there(below)
