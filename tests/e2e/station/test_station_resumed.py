"""Procedures that are killed, or whose recorder is: nothing is there twice, and nothing is forgotten."""

import json
import random
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

Bench = Any
Kept = Any
Spawn = Callable[..., subprocess.Popen[str]]
Gyrofleet = Callable[..., Any]

CYCLES = ("--set", "repeats=4", "--set", "cool_down_s=5", "--set", "warm_up_s=0", "--set")


def is_running(pid: int) -> bool:
    """Whether a process is at work; one that has ended may wait for long to be taken note of."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.in_gate("2")
@pytest.mark.parametrize("kills", [2, 3])
def test_killed_at_any_moment_nothing_is_there_twice_and_nothing_is_forgotten(
    gyrofleet: Gyrofleet, kept: Kept, spawn: Spawn, bench: Bench, state: Callable[..., dict[str, Any]], kills: int
) -> None:
    command = bench.run("bias_repeatability", *CYCLES, "bias_record_s=100")
    rng = random.Random(11)
    moments: list[Callable[[dict[str, Any]], bool]] = [
        lambda run: True,  # right at the start
        lambda run: run["step"] >= 1 and not run["is_powered"],  # off between two records
        lambda run: run["step"] >= 2 and run["open_steps"],  # a second before the step's end
    ]
    for moment in moments[-kills:]:
        process = spawn(*command)
        state(moment)
        time.sleep(rng.uniform(0.0, 0.1))
        process.kill()
        process.wait()
    last = spawn(*command)
    assert last.stdout is not None
    reported = json.loads(last.stdout.readline())
    assert reported["resumed"]
    assert reported["gap_s"] > 0.0
    done, _ = bench.ended(last)
    assert done["run"].endswith("-bias_repeatability-A")
    kept.completed(steps=4)
    kept.sound()
    cut = kept.rows(
        "select repeat, outcome, count(distinct unit) as units from steps where outcome <> 'completed' "
        "group by all order by repeat desc"
    )
    assert {row["outcome"] for row in cut} == {"interrupted"}
    assert cut[0]["repeat"] >= reported["steps_done"] >= 2, "it goes on at the step that was cut"
    assert cut[0]["units"] == 2
    resumed = [
        json.loads(row["document"]) for row in kept.rows("select document from events where kind = 'RunResumed'")
    ]
    # a run that is killed before its start is recorded starts again
    assert len(resumed) in ({2} if kills == 2 else {2, 3})
    assert all(each["gap_ns"] > 0 for each in resumed)
    assert reported["gap_s"] in [each["gap_ns"] / 1e9 for each in resumed]
    (row,) = kept.rows("select count(*) as n from events where kind = 'RunStarted'")
    assert row["n"] == 1
    again = gyrofleet(*command, "--run", done["run"])
    assert again.code == 0
    assert "nothing to do" in again.json["remark"]


@pytest.mark.long
def test_a_recorder_elsewhere_may_be_killed_in_the_middle(
    gyrofleet: Gyrofleet, kept: Kept, spawn: Spawn, slow: Bench, endpoint: str, state: Callable[..., dict[str, Any]]
) -> None:
    def record() -> subprocess.Popen[str]:
        process = spawn("record", "--listen", endpoint, "--store", "S", "--json")
        assert process.stdout is not None
        process.stdout.readline()
        return process

    recorder = record()
    process = spawn(*slow.run("static_bias", "--set", "bias_record_s=160", "--set", "warm_up_s=0"))
    assert process.stdout is not None
    assert f"to the recorder at {endpoint}" in process.stdout.readline()
    state(lambda run: bool(run["open_steps"]))
    time.sleep(1.5)
    recorder.kill()
    recorder.wait()
    time.sleep(1.5)
    recorder = record()
    last, _ = slow.ended(process)
    assert (last["outcome"], last["short_records"]) == ("completed", 0)
    recorder.send_signal(signal.SIGINT)
    recorder.communicate(timeout=30)
    (row,) = kept.rows("select count(*) as n from samples")
    assert row["n"] == last["samples"]
    kept.sound()


@pytest.mark.long
def test_a_simulated_station_ends_as_a_whole_and_goes_on_with_its_clock(
    tmp_path: Path, simulated: Callable[..., Bench], command_line: Callable[..., list[str]]
) -> None:
    folder = tmp_path / "sim"
    found = simulated(folder, "--speed", 1000, "--rate-hz", 1)
    second = subprocess.run(command_line("simulate", folder), capture_output=True, text=True, timeout=30)
    assert second.returncode == 1
    assert "another gyrofleet simulate runs the station in" in second.stderr
    roles = [found.role("instruments"), found.role("gyros")]
    clock = (folder / "station.toml").read_bytes()
    found.process.kill()  # not asked: those that it started see it themselves
    found.process.communicate()
    again = simulated(folder)
    try:
        assert not any(map(is_running, roles))
        assert (folder / "station.toml").read_bytes() == clock
        deadline = time.monotonic() + 10
        reported: list[dict[str, Any]] = []
        while time.monotonic() < deadline and len(reported) < 4:
            lines = (folder / "truth.jsonl").read_bytes().splitlines()
            reported = [each for each in map(msgspec.json.decode, lines) if each["duration_s"] == 0.0]
            time.sleep(0.05)
        # a power-on more of each, not the first one once again
        assert sorted((each["unit"], each["power_on"]) for each in reported) == [
            ("SIM-0001", 1), ("SIM-0001", 2), ("SIM-0002", 1), ("SIM-0002", 2),
        ]  # fmt: skip
        roles = [again.role("instruments"), again.role("gyros")]
        again.process.send_signal(signal.SIGINT)
        _, err = again.process.communicate(timeout=20)
        assert again.process.returncode == 0, err
        assert "station ended" in err
        assert not any(map(is_running, roles))
    finally:
        again.process.kill()
