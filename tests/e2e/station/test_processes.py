"""The parts as separate processes over loopback: recorder, estimator, source; stopped, killed, started again."""

import json
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from storage.segments.records import CHUNK_BYTES
from stream.estimators.base import default_estimators

Spawn = Callable[..., subprocess.Popen[str]]
TWO_CHUNKS_BYTES = 2 * CHUNK_BYTES  # of a log: a kill may cut the chunk that is being written, not the one before


def recorder(spawn: Spawn, endpoint: str, *more: str) -> subprocess.Popen[str]:
    process = spawn("record", "--listen", endpoint, "--json", *more)
    assert process.stdout is not None
    assert json.loads(process.stdout.readline())["event"] == "recording"
    return process


def stopped(process: subprocess.Popen[str]) -> tuple[str, str]:
    """End a service as an operator does, with Ctrl-C."""
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    return out, err


def table(path: Path, n: int) -> Path:
    rng = np.random.default_rng(5)
    i = np.arange(n)
    pl.DataFrame(
        {"time[s]": i * 0.01, **{f"rate_{axis}[deg/s]": rng.standard_normal(n) for axis in "xyz"}}
    ).write_parquet(path)
    return path


def until_chunks_are_written(log: Path) -> None:
    """Wait until the open segment of a log holds a whole chunk for certain."""
    deadline = time.monotonic() + 60
    while not any(path.stat().st_size > TWO_CHUNKS_BYTES for path in log.glob("*.open")):
        assert time.monotonic() < deadline, "nothing was recorded"
        time.sleep(0.005)


def assert_each_is_there_once(gyrofleet: Callable[..., Any], samples: int) -> None:
    ask = "select count(*) as n, count(distinct (signal, t_ns)) as moments from samples"
    assert gyrofleet("sql", ask, "--json").json == [{"n": samples, "moments": samples}]


def listening_addresses(pid: int) -> set[str]:
    """Addresses of the TCP sockets that a process listens on."""
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = str(descriptor.readlink())
        except FileNotFoundError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = set()
    for name in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:]:
            fields = line.split()
            is_open = fields[3] == "0A" or name.startswith("udp")
            if fields[9] in inodes and is_open:
                found.add(fields[1].split(":")[0])
    return found


@pytest.mark.long
def test_an_import_to_a_recorder_of_another_store_names_that_store(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    recorder(spawn, endpoint, "--store", "remote")
    sent = gyrofleet("import", table(tmp_path / "a.parquet", 500), "--unit", "U1", "--connect", endpoint)
    assert sent.code == 0, sent.err
    identity = json.loads((tmp_path / "remote" / "store.json").read_text())["id"]
    said = " ".join(f"{sent.out} {sent.err}".split())
    assert f"1,500 more in the lake of the recorder's store {identity}, each once" in said
    assert f"--store STORE, STORE the folder of the recorder's store {identity}" in said
    assert "gyrofleet-data" not in said


@pytest.mark.long  # in the gate: `crash/test_kills.py`
def test_recorder_estimator_and_source_as_processes(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    record = recorder(spawn, endpoint)
    assert listening_addresses(record.pid) == {"0100007F"}  # 127.0.0.1, and nothing else
    estimate = spawn("estimate", "--every", "100", "--average", "5", "--json")  # finds the recorder by its store
    assert estimate.stderr is not None
    assert "estimating" in estimate.stderr.readline()
    second = gyrofleet("estimate")
    assert second.code == 1
    assert "another gyrofleet estimate is at work on this store" in second.err
    source = gyrofleet("import", table(tmp_path / "a.parquet", 50_000), "--unit", "U1", "--connect", endpoint, "--json")
    assert source.code == 0, source.err
    assert [signal["in_lake"] for signal in source.json["files"][0]["signals"]] == [50_000] * 3
    documents = [json.loads(line) for line in stopped(estimate)[0].splitlines()]
    assert {d["estimator"] for d in documents if d["kind"] == "EstimatePublished"} == {
        *default_estimators(), "bias_stability_5s",
    }  # fmt: skip
    for kind in ("NoiseFitted", "SpectralLinesFound"):
        assert sorted(d["signal"] for d in documents if d["kind"] == kind) == ["rate_x", "rate_y", "rate_z"]
    ended = json.loads(stopped(record)[0].splitlines()[-1])
    assert (ended["samples"], ended["rejected"]) == (150_000, 0)
    rows = gyrofleet(
        "sql",
        "select signal, count(*) as n, count(distinct t_ns) as moments, "
        "(select count(*) from estimates e where e.signal = s.signal and final "
        "and estimator = 'allan_deviation') as taus from samples s group by signal", "--json",
    ).json  # fmt: skip
    assert [(row["n"], row["moments"]) for row in rows] == [(50_000, 50_000)] * 3
    assert all(row["taus"] >= 14 for row in rows)
    again = gyrofleet("import", "a.parquet", "--unit", "U1")
    assert "Nothing to add" in again.out


@pytest.mark.long
def test_a_source_survives_the_recorder_being_killed(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    first = recorder(spawn, endpoint)
    source = spawn("import", table(tmp_path / "a.parquet", 1_000_000), "--unit", "U1", "--connect", endpoint, "--json")
    until_chunks_are_written(tmp_path / "gyrofleet-data" / "log")
    first.kill()
    first.wait()
    assert source.poll() is None, "the source was to be caught in the middle"
    second = recorder(spawn, endpoint)
    _, err = source.communicate(timeout=120)
    assert source.returncode == 0, err
    stopped(second)
    assert_each_is_there_once(gyrofleet, 3_000_000)
    reported = "select document->>'$.what' as what from events where kind = 'StoreNoted'"
    assert {"what": "segment_recovered"} in gyrofleet("sql", reported, "--json").json


@pytest.mark.long
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGINT])
def test_an_interrupted_import_is_completed_by_giving_it_again(
    gyrofleet: Callable[..., Any], spawn: Spawn, tmp_path: Path, fault: signal.Signals
) -> None:
    path = table(tmp_path / "a.parquet", 1_000_000)
    source = spawn("import", path, "--unit", "U1")
    until_chunks_are_written(tmp_path / "gyrofleet-data" / "log")
    source.send_signal(fault)
    source.communicate(timeout=60)
    assert source.returncode == (130 if fault == signal.SIGINT else -signal.SIGKILL)
    done = gyrofleet("import", path, "--unit", "U1", "--json")
    assert done.code == 0, done.err
    signals = done.json["files"][0]["signals"]
    assert 0 < sum(each["already_stored"] for each in signals) < 3_000_000
    assert [each["in_lake"] for each in signals] == [1_000_000] * 3
    assert_each_is_there_once(gyrofleet, 3_000_000)


@pytest.mark.long
def test_nobody_to_connect_to_and_an_address_in_use_are_said_so(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    path = table(tmp_path / "a.parquet", 100)
    refused = gyrofleet("import", path, "--unit", "U1", "--connect", endpoint)
    assert refused.code == 1
    assert f"cannot connect to {endpoint}" in refused.err
    for wrong in ("foo", "127.0.0.1:7447", "tcp/127.0.0.1"):
        for command in (
            ["record", "--listen"],
            ["import", path, "--unit", "U1", "--connect"],
            ["estimate", "--connect"],
        ):
            refused = gyrofleet(*command, wrong)
            assert refused.code == 1
            assert "write it as tcp/HOST:PORT" in refused.err
    nobody = gyrofleet("estimate")
    assert nobody.code == 1
    assert "no `gyrofleet record` writes gyrofleet-data" in nobody.err
    recorder(spawn, endpoint)
    taken = gyrofleet("record", "--listen", endpoint, "--store", "other")
    assert taken.code == 1
    assert f"cannot listen on {endpoint}" in taken.err
    locked = gyrofleet("import", path, "--unit", "U1")
    assert locked.code == 1
    assert f"--connect {endpoint}" in locked.err


@pytest.mark.long
def test_the_embedded_path_opens_no_port(spawn: Spawn, tmp_path: Path) -> None:
    source = spawn("import", table(tmp_path / "a.parquet", 2_000_000), "--unit", "U1")
    log = tmp_path / "gyrofleet-data" / "log"
    deadline = time.monotonic() + 30
    while not list(log.glob("*.open")) and time.monotonic() < deadline:
        time.sleep(0.005)
    assert listening_addresses(source.pid) == set()
    assert source.wait(timeout=60) == 0


@pytest.mark.long
def test_a_recorder_that_is_stopped_while_samples_come_ends_at_once_and_goes_on_where_it_was(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    first = recorder(spawn, endpoint)
    source = spawn("import", table(tmp_path / "a.parquet", 1_500_000), "--unit", "U1", "--connect", endpoint, "--json")
    until_chunks_are_written(tmp_path / "gyrofleet-data" / "log")
    began = time.monotonic()
    stopped(first)
    assert time.monotonic() - began < 10
    assert source.poll() is None, "the source was to be caught in the middle"
    second = recorder(spawn, endpoint)
    _, err = source.communicate(timeout=120)
    assert source.returncode == 0, err
    stopped(second)
    assert_each_is_there_once(gyrofleet, 4_500_000)


@pytest.mark.long
def test_a_source_killed_beside_a_running_recorder_is_completed_by_giving_it_again(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    record = recorder(spawn, endpoint, "--rotate-mb", "4")
    path = table(tmp_path / "a.parquet", 2_000_000)
    source = spawn("import", path, "--unit", "U1", "--connect", endpoint)
    log = tmp_path / "gyrofleet-data" / "log"
    deadline = time.monotonic() + 30
    while len(list(log.glob("*.mcap"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.005)
    source.kill()
    source.wait()
    again = gyrofleet("import", path, "--unit", "U1", "--connect", endpoint, "--json")
    assert again.code == 0, again.err
    assert [each["in_lake"] for each in again.json["files"][0]["signals"]] == [2_000_000] * 3
    stopped(record)
    assert_each_is_there_once(gyrofleet, 6_000_000)


@pytest.mark.long
def test_an_estimator_killed_again_and_again_gives_what_one_that_lived_gives(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    path = table(tmp_path / "a.parquet", 2_000_000)
    assert gyrofleet("import", path, "--unit", "U1", "--store", "undisturbed").code == 0
    record = recorder(spawn, endpoint, "--rotate-mb", "8")

    def start() -> subprocess.Popen[str]:
        process = spawn("estimate", "--every", "3600", "--checkpoint-every", "0.1", "--json")
        assert process.stderr is not None
        assert "estimating" in process.stderr.readline()
        return process

    estimate = start()
    source = spawn("import", path, "--unit", "U1", "--connect", endpoint)
    for delay_s in (0.3, 0.0, 1.0, 0.1):  # before and after checkpoints, while live and while catching up
        time.sleep(delay_s)
        estimate.kill()
        estimate.wait()
        estimate = start()
    assert source.wait(timeout=120) == 0
    lines = iter(estimate.stdout.readline, "") if estimate.stdout is not None else iter(())
    finals: set[tuple[str, str]] = set()
    for line in lines:
        document = json.loads(line)
        if document["kind"] == "SpectralLinesFound":
            finals.add((document["run"], document["signal"]))
        if len(finals) == 3:
            break
    stopped(estimate)
    stopped(record)
    ask = (
        "select signal, estimator, t_ns, final, tau_s, value, lo, hi, edf, n, samples, missing, reason "
        "from estimates order by all"
    )
    expected = gyrofleet("sql", ask, "--store", "undisturbed", "--json").json
    found = gyrofleet("sql", ask, "--json").json
    assert len(expected) > 400
    assert found == expected
    other = "select kind, uid, document from events where kind in ('NoiseFitted', 'SpectralLinesFound') order by all"
    assert gyrofleet("sql", other, "--json").json == gyrofleet("sql", other, "--store", "undisturbed", "--json").json
