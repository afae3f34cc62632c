"""Stopping a service: in order at first, at once when asked again later, and never stuck in a signal handler."""

import subprocess
import sys
import time

import pytest

STORM = """
import os, signal, threading, time
from stream.terminal.console import until_stopped

with until_stopped() as stop:
    sender = threading.Thread(target=lambda: [os.kill(os.getpid(), signal.SIGINT) for _ in range(20_000)])
    sender.start()
    while sender.is_alive():
        stop.wait(0.0001)
    print(stop.wait(60.0))
"""
STUCK = """
import time
from stream.terminal.console import until_stopped

with until_stopped() as stop:
    print("ready", flush=True)
    while True:  # deaf to the first request
        stop.wait(0.01)
        time.sleep(0.01)
"""


def test_a_storm_of_signals_asks_once_and_locks_nothing_up() -> None:
    done = subprocess.run([sys.executable, "-c", STORM], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "True\n"


@pytest.mark.long
@pytest.mark.parametrize("number", [2, 15])
def test_a_service_that_does_not_end_is_ended_by_asking_again(number: int) -> None:
    with subprocess.Popen([sys.executable, "-c", STUCK], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        process.send_signal(number)
        time.sleep(0.5)
        assert process.poll() is None
        time.sleep(3.0)
        process.send_signal(number)
        assert process.wait(timeout=10) == -number
