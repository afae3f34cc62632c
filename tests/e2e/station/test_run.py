"""`gyrofleet run-simulated` as a process of its own: killed, stopped, and resumed, each sample once."""

import json
import random
import signal
import subprocess
import time
from collections.abc import Callable
from typing import Any

import pytest

Spawn = Callable[..., subprocess.Popen[str]]

RUN = ("run-simulated", "--run", "r1", "--simulate", 3, "--rate-hz", 1000, "--json")
COUNT = (
    "select signal, count(*) as n, count(distinct (unit, t_ns)) as moments, count(distinct run) as runs "
    "from samples group by signal order by signal"
)


def started(process: subprocess.Popen[str]) -> dict[str, Any]:
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line, process.communicate()[1]
    reported: dict[str, Any] = json.loads(line)
    assert reported["event"] in {"recording", "running"}
    return reported


def stopped(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err


def ended(process: subprocess.Popen[str], code: int = 0) -> dict[str, Any]:
    out, err = process.communicate(timeout=120)
    assert process.returncode == code, err
    reported: dict[str, Any] = json.loads(out.splitlines()[-1])
    return reported


@pytest.mark.long
def test_a_run_that_is_killed_again_and_again_is_recorded_once(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str
) -> None:
    record = spawn("record", "--listen", endpoint, "--json", "--rotate-mb", "4")
    started(record)
    command = (*RUN, "--hours", 1.0, "--speed", 0)
    rng = random.Random(3)
    for _ in range(4):
        source = spawn(*command)
        started(source)
        time.sleep(rng.uniform(0.02, 0.6))
        source.kill()
        source.wait()
    done = ended(spawn(*command))
    assert (done["event"], done["starts"], done["gap_s"], done["samples"]) == ("ended", 5, 0.0, 3 * 3_603_600)
    again = gyrofleet(*command)
    assert again.code == 0
    assert "nothing to do" in again.json["remark"]
    stopped(record)
    rows = gyrofleet("sql", COUNT, "--json").json
    assert rows == [
        {"signal": "rate", "n": 10_800_000, "moments": 10_800_000, "runs": 1},
        {"signal": "temperature", "n": 10_800, "moments": 10_800, "runs": 1},
    ]
    kinds = "select kind, count(*) as n from events where kind in ('RunStarted', 'RunResumed', 'PowerOn', 'RunEnded')"
    assert gyrofleet("sql", f"{kinds} group by kind order by kind", "--json").json == [
        {"kind": "PowerOn", "n": 3},
        {"kind": "RunEnded", "n": 1},
        {"kind": "RunResumed", "n": 4},
        {"kind": "RunStarted", "n": 1},
    ]


@pytest.mark.long
def test_a_run_goes_on_while_its_recorder_is_killed_and_stalled(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str
) -> None:
    record = spawn("record", "--listen", endpoint, "--json")
    started(record)
    source = spawn(*RUN, "--hours", 0.5, "--speed", 150)  # 12 s
    started(source)
    time.sleep(1.0)
    record.send_signal(signal.SIGSTOP)
    time.sleep(2.0)
    record.send_signal(signal.SIGCONT)
    time.sleep(1.0)
    record.kill()
    record.wait()
    time.sleep(2.0)
    assert source.poll() is None, "the source was to go on without a recorder"
    record = spawn("record", "--listen", endpoint, "--json")
    started(record)
    done = ended(source)
    assert (done["event"], done["starts"]) == ("ended", 1)
    stopped(record)
    rows = gyrofleet("sql", COUNT, "--json").json
    assert [(row["n"], row["moments"]) for row in rows] == [(5_400_000, 5_400_000), (5400, 5400)]


@pytest.mark.long
def test_a_paced_run_states_the_gap_and_goes_on_with_a_new_power_on(
    gyrofleet: Callable[..., Any], spawn: Spawn
) -> None:
    command = (*RUN, "--hours", 3, "--speed", 200)  # 54 s, recorded in the same process
    source = spawn(*command)
    started(source)
    time.sleep(3.0)
    source.kill()
    source.wait()
    time.sleep(1.0)
    source = spawn(*command)
    reported = started(source)
    assert reported["resumed"]
    assert reported["gap_s"] > 200.0
    time.sleep(1.0)
    source.send_signal(signal.SIGINT)
    assert ended(source, code=130)["event"] == "interrupted"
    refused = gyrofleet(*RUN, "--hours", 3, "--speed", 100)
    assert refused.code == 1
    assert "--speed was 200.0, now 100.0" in refused.json["error"]["message"]
    done = gyrofleet(*command, "--end")
    assert done.code == 0, done.err
    (row,) = gyrofleet(
        "sql", "select count(*) as n, count(distinct (unit, signal, t_ns)) as moments from samples", "--json"
    ).json
    assert row["n"] == row["moments"] > 0
    totals = gyrofleet("sql", "select document from events where kind = 'RunEnded'", "--json").json
    assert len(totals) == 1
    document = json.loads(totals[0]["document"])
    assert sum(total["samples"] for total in document["totals"]) == row["n"]
    assert len({total["epoch"] for total in document["totals"]}) == 6
    gaps = gyrofleet("sql", "select document->>'$.gap_ns' as gap from events where kind = 'RunResumed'", "--json").json
    assert [float(each["gap"]) / 1e9 for each in gaps] == [reported["gap_s"]]


@pytest.mark.long
def test_estimates_of_a_run_that_was_killed_are_those_of_one_that_was_not(
    gyrofleet: Callable[..., Any], spawn: Spawn
) -> None:
    def command(store: str) -> tuple[object, ...]:
        return ("run-simulated", "--run", "r1", "--simulate", 2, "--hours", 3, "--speed", 0, "--store", store, "--json")

    for delay_s in (0.1, 0.7):
        source = spawn(*command("killed"))
        started(source)
        time.sleep(delay_s)
        source.kill()
        source.wait()
    assert ended(spawn(*command("killed")))["starts"] == 3
    assert ended(spawn(*command("undisturbed")))["starts"] == 1
    ask = (
        "select unit, signal, estimator, t_ns - min(t_ns) over () as t_ns, final, tau_s, value, lo, hi, edf, n, "
        "samples, missing, reason from estimates order by all"
    )
    expected = gyrofleet("sql", ask, "--store", "undisturbed", "--json").json
    assert len(expected) > 500
    assert gyrofleet("sql", ask, "--store", "killed", "--json").json == expected
