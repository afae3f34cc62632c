"""A run that was estimated live, by processes over a real bus, and is replayed: by the command line."""

import json
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

Spawn = Callable[..., subprocess.Popen[str]]
ASK = (
    "select signal, estimator, t_ns, final, tau_s, value, lo, hi, edf, n, samples, missing, reason, uid "
    "from estimates order by all"
)


def recorder(spawn: Spawn, *arguments: object) -> subprocess.Popen[str]:
    process = spawn("record", *arguments, "--json")
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["event"] == "recording"
    return process


def estimator(spawn: Spawn, *arguments: object) -> subprocess.Popen[str]:
    process = spawn("estimate", *arguments, "--json")
    assert process.stderr is not None
    assert "estimating" in process.stderr.readline()
    return process


def wait_for_last(process: subprocess.Popen[str], signals: int) -> None:
    """Wait until the last of what is said of a run has been said of so many signals."""
    assert process.stdout is not None
    seen = 0
    while seen < signals:
        seen += json.loads(process.stdout.readline())["kind"] == "SpectralLinesFound"


def stop(*processes: subprocess.Popen[str]) -> None:
    for process in processes:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err


@pytest.mark.long
def test_estimates_of_a_replay_equal_the_live_ones_bit_for_bit(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    n = 300_000
    rng = np.random.default_rng(6)
    table = {"time[s]": np.arange(n) * 0.01, **{f"rate_{axis}[deg/s]": rng.standard_normal(n) for axis in "xy"}}
    pl.DataFrame(table).write_parquet(tmp_path / "a.parquet")
    record = recorder(spawn, "--listen", endpoint)
    estimate = estimator(spawn, "--every", "300", "--average", "5", "--checkpoint-every", "0.2")
    source = spawn("import", "a.parquet", "--unit", "U1", "--connect", endpoint)
    estimate.kill()  # in its beginnings, and another takes over in mid-run
    estimate.wait()
    estimate = estimator(spawn, "--every", "300", "--average", "5")
    assert source.wait(timeout=120) == 0
    wait_for_last(estimate, 2)
    stop(estimate, record)

    found = gyrofleet("replay", "a", "--json")
    assert found.code == 0, found.out
    estimates = found.json["estimates"]
    assert (found.json["every_s"], found.json["samples"]) == (300.0, 2 * n)
    assert estimates["equal"] == estimates["stored"] == estimates["made"] > 100
    reported = gyrofleet("replay", "a")
    assert f"{estimates['equal']} of {estimates['equal']} estimates equal bit for bit" in reported.out
    other = gyrofleet("replay", "a", "--every", "200")
    assert other.code == 1
    assert "made, but not stored" in other.out

    second = recorder(spawn, "--listen", endpoint, "--store", "second")
    worker = estimator(spawn, "--every", "300", "--average", "5", "--store", "second")
    sent = gyrofleet("replay", "a", "--connect", endpoint, "--json")
    assert sent.code == 0, sent.err
    assert (sent.json["samples"], sent.json["estimates"]) == (2 * n, None)
    wait_for_last(worker, 2)
    stop(worker, second)
    live = gyrofleet("sql", ASK, "--json").json
    assert len(live) > 300
    assert gyrofleet("sql", ASK, "--store", "second", "--json").json == live
    into = gyrofleet("replay", "a", "--into", "third", "--store", "second", "--json")
    assert into.code == 0, into.err
    ask = "select signal, seq, t_ns, value from samples order by all"
    whole = "select count(*) as n, sum(hash(s)) as h from (" + ask + ") s"
    rows = [gyrofleet("sql", whole, "--store", store, "--json").json for store in ("gyrofleet-data", "second", "third")]
    assert rows[0][0]["n"] == 2 * n
    assert rows[1] == rows[0]
    assert rows[2] == rows[0]


@pytest.mark.long
def test_a_replay_of_what_is_not_there_is_refused(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    pl.DataFrame({"time[s]": np.arange(100.0), "rate[deg/s]": np.arange(100.0)}).write_parquet(tmp_path / "a.parquet")
    assert gyrofleet("import", "a.parquet", "--unit", "U1").code == 0
    refused = gyrofleet("replay", "b")
    assert refused.code == 1
    assert "holds no run 'b'" in refused.err
    itself = gyrofleet("replay", "a", "--into", "gyrofleet-data")
    assert itself.code == 1
    assert "give another one" in itself.err
