"""The rows of `table`: what is measured, in which unit, and its bar. A row is added here."""

import atexit
import functools
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = str(Path(sys.executable).with_name("gyrofleet"))


class Measured(NamedTuple):
    """What a row found; `reason` where it could not be measured."""

    ours: float | None
    peer: float | None
    holds: bool | None
    reason: str = ""


class Row(NamedTuple):
    """A row of the table."""

    work: str
    unit: str
    bar: str
    measure: Callable[[], Measured]


ROWS: list[Row] = []


def row(work: str, unit: str, bar: str) -> Callable[[Callable[[], Measured]], Callable[[], Measured]]:
    """Add a row, measured by the function that follows."""

    def add(measure: Callable[[], Measured]) -> Callable[[], Measured]:
        ROWS.append(Row(work, unit, bar, measure))
        return measure

    return add


def machine() -> str:
    """The machine, and how busy it is."""
    return f"{platform.machine()}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}, Python {sys.version[:7]}"


@functools.cache
def installed() -> dict[str, str]:
    """The environment of commands as users start them: with bytecode from their first start on.

    Without bytecode (``PYTHONDONTWRITEBYTECODE``), compiling takes half of a command's start.
    """
    folder = tempfile.mkdtemp(prefix="gyrofleet-bytecode-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    kept = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPYCACHEPREFIX": folder}


@functools.cache
def bench(name: str, *arguments: str) -> Any:
    """What another benchmark prints as JSON, measured once for all rows that need it."""
    done = subprocess.run(
        [sys.executable, "-m", f"tests.bench.{name}", *arguments, "--json"],
        cwd=ROOT, capture_output=True, text=True, check=False, env=installed(),
    )  # fmt: skip
    if done.returncode != 0:
        raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr.strip() else f"exit {done.returncode}")
    return [json.loads(text) for text in done.stdout.splitlines() if text.startswith("{")]


def durable(*arguments: str) -> Any:
    """A run of `durable_rate`."""
    return bench("durable_rate", "--seconds", "8", *arguments)[0]


def clickhouse() -> dict[str, float]:
    """The peer that stores."""
    return dict(bench("clickhouse", "--samples", "2e7")[0])


@row("import of 200 files of 720 rows x 21 signals, one command", "s of CPU", "<= 10")
def _small_files() -> Measured:
    found = bench("small_files")[0]
    return Measured(found["cpu_s"], found["peer_cpu_s"], found["cpu_s"] <= 10.0)


@row("import of one large file, counted in the lake", "M samples/s", ">= 6, <= 4 times polars' time")
def _large_file() -> Measured:
    found = bench("import_rate", "--runs", "3")[0]
    ours, process = found["samples_per_s"], found["process_samples_per_s"]
    return Measured(ours, process * found["times_peer"], ours >= 6.0 and found["times_peer"] <= 4.0)


# what the process has taken when the first batch is handed on
_TO_FIRST_BATCH = """
import os, sys, time
import stream.delivery.publisher as publisher

def reached(*arguments, **named):
    print(time.process_time(), flush=True)
    os._exit(0)

publisher.DurablePublisher.send_batch = reached
import gyrofleet
sys.argv = ["gyrofleet", "import", sys.argv[1], "--unit", "U1", "--store", sys.argv[2]]
gyrofleet.front_door()
"""


@row("import: from its start to the first row", "s of CPU", "<= 0.4")
def _import_start() -> Measured:
    spent = []
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "one.csv"
        file.write_text("time[s],rate[deg/h]\n" + "".join(f"{1.79e9 + i},{i % 3}\n" for i in range(50)))
        for turn in range(5):
            command = [sys.executable, "-c", _TO_FIRST_BATCH, str(file), f"{folder}/store-{turn}"]
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, env=installed())
            spent.append(float(done.stdout.splitlines()[-1]))
    return Measured(min(spent), None, min(spent) <= 0.4)


@row("noise fit of one curve, median", "ms", "<= 10; worst <= 50")
def _noise_fit() -> Measured:
    found = bench("noise_fit_time")[0]
    return Measured(found["median_ms"], None, found["median_ms"] <= 10.0 and found["worst_ms"] <= 50.0)


@row("Allan, 24 octaves, 1000 a batch, through the API", "ns a sample", "<= 3")
def _allan() -> Measured:
    found = bench("estimators", "speed")[0]["speed"]
    return Measured(found["ns_per_sample"], found["allantools_oadev_ns_per_sample"], found["ns_per_sample"] <= 3.0)


@row("Allan, 24 octaves, 100 a batch, through the API", "ns a sample", "<= 10")
def _allan_100() -> Measured:
    found = bench("estimators", "speed", "--batch", "100")[0]["speed"]
    return Measured(found["ns_per_sample"], found["allantools_oadev_ns_per_sample"], found["ns_per_sample"] <= 10.0)


def worker(batch: int, *arguments: str) -> float:
    """Million samples a second through all estimators of 1000 signals."""
    return float(bench("worker_rate", "--batch", str(batch), *arguments)[0]["samples_per_s"]) / 1e6


@row("all estimators of 1000 signals, 1000 a batch", "M samples/s", ">= 40")
def _worker_1000() -> Measured:
    return Measured(worker(1000), None, worker(1000) >= 40.0)


@row("all estimators of 1000 signals, 100 a batch", "M samples/s", ">= 15")
def _worker_100() -> Measured:
    return Measured(worker(100), None, worker(100) >= 15.0)


@row("share of the streaming spectrum in that work", "", "<= 0.1")
def _spectrum() -> Measured:
    share = 1.0 - worker(1000) / worker(1000, "--no-spectrum")
    return Measured(share, None, share <= 0.1)


@row("durable, acknowledged, beside ClickHouse", "M samples/s", ">= 2 times ClickHouse")
def _durable() -> Measured:
    ours = durable("--no-estimates")["gyrofleet"]["durable_samples_per_s"] / 1e6
    peer = clickhouse()["samples_per_s"] / 1e6
    return Measured(ours, peer, ours >= 2.0 * peer)


@row("durable, acknowledged, beside plain Zenoh + MCAP", "M samples/s", ">= 0.7 of the peer")
def _durable_plain() -> Measured:
    found = durable("--no-estimates")
    ours, peer = (found[who]["samples_per_s"] / 1e6 for who in ("gyrofleet", "peer"))
    return Measured(ours, peer, ours >= 0.7 * peer)


@row("durable with every estimate, beside acknowledged alone", "M samples/s", ">= 0.8, lag < 1 s")
def _durable_estimates() -> Measured:
    found, alone = durable("--no-peer")["gyrofleet"], durable("--no-estimates")["gyrofleet"]
    ours, peer = found["samples_per_s"] / 1e6, alone["durable_samples_per_s"] / 1e6
    return Measured(ours, peer, ours >= 0.8 * peer and found["behind_s"] < 1.0)


@row("durable, 100 samples a batch, every estimate", "M samples/s", ">= 6")
def _durable_100() -> Measured:
    ours = durable("--no-peer", "--batch", "100")["gyrofleet"]["samples_per_s"] / 1e6
    return Measured(ours, None, ours >= 6.0)


@row("log, counts of 0.96 bytes of entropy", "bytes/sample", "<= 1.10")
def _log_bytes() -> Measured:
    ours = durable("--no-estimates")["gyrofleet"]["bytes_per_sample"]
    return Measured(ours, clickhouse()["bytes_per_sample"], ours <= 1.10)


def lake() -> Any:
    """Questions to a lake of 1e8 rows."""
    return bench("lake_query", "query")[0]


@row("lake, the same counts, samples' file", "bytes/sample", "<= 1.00")
def _lake_bytes() -> Measured:
    ours = lake()["samples_file_bytes_a_sample"]
    return Measured(ours, clickhouse()["bytes_per_sample"], ours <= 1.0)


@row("1e8 rows: standard deviation of 10 s means, raw", "s", "ahead of ClickHouse")
def _raw_question() -> Measured:
    ours, peer = lake()["raw_s"], bench("clickhouse", "--samples", "1e8", "--units", "200")[0]["asked_s"]
    return Measured(ours, peer, ours < peer)


@row("the same from the rollup", "ms", "<= 10")
def _rollup_question() -> Measured:
    ours = lake()["rollup_s"] * 1e3
    return Measured(ours, None, ours <= 10.0)


@row("one metric, 1000 units x 30 days", "s", "<= 1")
def _one_metric() -> Measured:
    ours = bench("fleet_metrics", "fleet", "--tries", "1")[0]["one_metric_s"]
    return Measured(ours, None, ours <= 1.0)


@row("unit_metrics, 10,000 units x 30 days", "s", "<= 10, <= 1.5 GB")
def _fleet() -> Measured:
    found = bench("fleet_metrics", "fleet", "--units", "10000", "--tries", "1")[0]
    return Measured(found["every_metric_s"], None, found["every_metric_s"] <= 10.0 and found["peak_mb"] <= 1500.0)


def verified(name: str) -> Measured:
    """GB of the log a second; the lake is hashed as well."""
    found = bench("verify_rate")[0]
    return Measured(found[name], found["hashed_gb_per_s"], found[name] >= 2.0)


for _work, _name in (("everything read", "gb_per_s"), ("since an attestation", "since_gb_per_s")):
    row(f"verify of a log and its lake, {_work}", "GB/s of log", ">= 2; peer: SHA-256 alone")(
        functools.partial(verified, _name)
    )


@row("whole path: log, lake and every estimate", "M samples/s", ">= 15")
def _whole_path() -> Measured:
    ours = durable("--no-peer", "--with-lake")["gyrofleet"]["samples_per_s"] / 1e6
    return Measured(ours, None, ours >= 15.0)


def memory(role: str, most_mb: float) -> Measured:
    """Peak memory of a role while everything is estimated."""
    ours = durable("--no-peer")["gyrofleet"][f"{role}_mb"]
    return Measured(ours, None, ours <= most_mb)


for _role, _most in (("recorder", 150.0), ("source", 150.0), ("estimator", 300.0)):
    row(f"peak memory, {_role}", "MB", f"<= {_most:.0f}")(functools.partial(memory, _role, _most))
