"""`gyrofleet status` of a run at a station: units that fall silent, and a run that was left before its end."""

import os
import signal
import subprocess
import time
from collections.abc import Callable
from typing import Any

Bench = Any
Spawn = Callable[..., subprocess.Popen[str]]


def until_trouble(gyrofleet: Callable[..., Any], words: str) -> Any:
    deadline = time.monotonic() + 60
    while True:
        found = gyrofleet("status", "--store", "S", "--json")
        if any(words in each for each in found.json["troubles"]):
            assert found.code == 1
            return found.json
        assert time.monotonic() < deadline, found.json
        time.sleep(0.3)


def test_silent_units_and_an_interruption_are_in_the_status(
    gyrofleet: Callable[..., Any], spawn: Spawn, slow: Bench, state: Callable[..., dict[str, Any]]
) -> None:
    gyros = slow.role("gyros")
    process = spawn(*slow.run("static_bias", "--set", "bias_record_s=4000", "--set", "warm_up_s=0", "--run", "night"))
    state(lambda run: bool(run["open_steps"]))
    time.sleep(1.0)
    os.kill(gyros, signal.SIGSTOP)
    try:
        time.sleep(9.5)  # before 10 s nobody is silent: to ask meanwhile is only work for the machine
        until_trouble(gyrofleet, "from SIM-0001, SIM-0002")
        time.sleep(2.0)  # the run looks for silent units once a second: the status may be a second ahead of it
    finally:
        os.kill(gyros, signal.SIGCONT)
    deadline = time.monotonic() + 30
    while gyrofleet("status", "--store", "S").code:
        assert time.monotonic() < deadline
        time.sleep(0.3)
    time.sleep(2.0)  # the run's own look again; its status says at once that they are back
    process.send_signal(signal.SIGINT)
    reported, err = slow.ended(process, code=130)
    assert reported["event"] == "interrupted"
    assert "nothing has come for 1" in err
    assert "samples come again from SIM-0001, SIM-0002" in err
    found = until_trouble(gyrofleet, "(run night) was interrupted")
    (role,) = (each for each in found["roles"] if each["status"]["role"] == "run")
    assert role["condition"] == "interrupted"
    assert "the same command resumes it" in role["status"]["trouble"]
    assert found["verdicts"] == {}
    # ended as it is, it is no trouble any more
    slow.ended(spawn(*slow.run("static_bias", "--set", "bias_record_s=4000", "--set", "warm_up_s=0", "--end")))
    assert gyrofleet("status", "--store", "S").code == 0
