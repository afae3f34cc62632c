"""The threads that build the lake and open metrics give way to those who wait."""

import os
import sys
import threading
import time
from pathlib import Path

import pytest

from storage.recording.lake_builder import LakeBuilder
from storage.store import Store
from stream.roles.niceness import be_nicer

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
