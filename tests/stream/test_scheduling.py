"""Threads that give way to others: those that build the lake and open metrics, and those that hand messages on."""

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from storage.recording.lake_builder import LakeBuilder
from storage.store import Store
from stream.transport.scheduling import be_nicer

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="threads have no priority of their own")


def niceness(thread: threading.Thread) -> int:
    assert thread.native_id is not None
    return os.getpriority(os.PRIO_PROCESS, thread.native_id)


def test_one_thread_alone_becomes_nicer() -> None:
    before = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    found: list[int] = []

    def work() -> None:
        be_nicer(3)
        found.append(niceness(threading.current_thread()))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [min(before + 3, 19)]
    assert os.getpriority(os.PRIO_PROCESS, threading.get_native_id()) == before


def test_the_lake_is_built_by_a_nicer_thread(tmp_path: Path) -> None:
    own = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    others = set(threading.enumerate())  # of other tests in this process
    builder = LakeBuilder(Store.create(tmp_path), pytest.fail)
    (thread,) = (each for each in threading.enumerate() if each.name == "gyrofleet-lake" and each not in others)
    until = time.monotonic() + 10.0
    while niceness(thread) == own and time.monotonic() < until:
        time.sleep(0.01)
    assert niceness(thread) == min(own + 5, 19)
    builder.close()


def policies(pid: int) -> list[tuple[str, int]]:
    """Names of the threads of a process, and their scheduling policies."""
    found = []
    for folder in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):
            found.append(((folder / "comm").read_text().strip(), os.sched_getscheduler(int(folder.name))))
    return found


def test_threads_of_the_bus_wait_for_their_turn() -> None:
    own = os.sched_getscheduler(0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    program = """
import sys, time
from stream.transport.zenoh_bus import ZenohBus
with ZenohBus(listen=[sys.argv[1]]) as bus, ZenohBus(connect=[sys.argv[1]]) as other:
    seen = []
    bus.subscribe("a", lambda key, payload: seen.append(payload))
    while not seen:
        other.publish("a", b"b")
        time.sleep(0.02)
    print("ready", flush=True)
    sys.stdin.read()
"""
    with subprocess.Popen(
        [sys.executable, "-c", program, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        found = policies(process.pid)
        process.communicate("")
    assert {policy for name, policy in found if name.startswith(("rx-", "tx-"))} == {os.SCHED_BATCH}
    assert os.SCHED_OTHER in {policy for _, policy in found}, "who sends does not wait"
    assert os.sched_getscheduler(0) == own
