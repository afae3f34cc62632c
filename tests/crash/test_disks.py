"""Disks that are full and disks that fail, under real processes: nothing acknowledged is lost, and it goes on."""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from analytics.alerts.kept_alerts import AlertFile
from storage.recording.status_board import StatusBoard, read_statuses
from storage.store import Store
from stream.errors import StoreError
from stream.status.role_status import Role, RoleState, new_status
from tests.small_disk import small_disk_at

Start = Callable[..., Any]
SAMPLES = 300_000


def table(path: Path, n: int = SAMPLES) -> Path:
    values = np.random.default_rng(5).standard_normal(n)
    pl.DataFrame({"time[s]": np.arange(n) * 0.01, "rate[deg/s]": values}).write_parquet(path)
    return path


def check(gyrofleet: Callable[..., Any], store: Path) -> None:
    (row,) = gyrofleet(
        "sql", "select count(*) as n, count(distinct t_ns) as moments, count(distinct seq) as numbers from samples",
        "--json", "--store", store,
    ).json  # fmt: skip
    assert row == {"n": SAMPLES, "moments": SAMPLES, "numbers": SAMPLES}
    verified = gyrofleet("verify", "--json", "--store", store)
    assert verified.code == 0, verified.out


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 8 MB."""
    with small_disk_at(tmp_path / "disk", 8) as folder:
        yield folder


@pytest.mark.long  # in the gate: `test_recorder_disk.py`
def test_a_full_disk_stops_recording_and_room_lets_it_go_on(
    gyrofleet: Callable[..., Any], start: Start, endpoint: str, small_disk: Path, tmp_path: Path
) -> None:
    store = small_disk / "store"
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(6_500_000))
    record = start("record", "--listen", endpoint, "--store", store, "--rotate-mb", "1", "--json")
    record.until(lambda line: line["event"] == "recording")
    source = start(
        "import", table(tmp_path / "a.parquet"), "--unit", "U1", "--connect", endpoint, "--store", store, "--json"
    )
    paused = record.until(lambda line: line["event"] == "warning" and "recording is paused" in line["text"])
    assert "kept in reserve" in paused["text"] or "No space left" in paused["text"]
    time.sleep(5.0)
    assert source.process.poll() is None, "the source was to wait"
    ballast.unlink()
    assert source.process.wait(timeout=90) == 0, source.errors
    assert any("resumes after a pause" in line["text"] for line in record.lines if line["event"] == "warning")
    record.stop()
    assert record.process.returncode == 0, record.errors
    check(gyrofleet, store)


def filled(disk: Path) -> None:
    """Leave no block of a disk free."""
    with suppress(OSError), (disk / "ballast").open("ab", buffering=0) as file:
        while file.write(bytes(4096)):
            pass


def test_on_a_full_disk_a_role_says_why_it_waits_and_alerts_go_on(small_disk: Path) -> None:
    store = Store.create(small_disk / "store")
    board = StatusBoard(store)
    with AlertFile(store) as file:
        file.write({}, {}, "00000007")
    board.put(new_status(Role.RECORD, 1))
    filled(small_disk)
    board.put(new_status(Role.RECORD, 1, state=RoleState.PAUSED, trouble="the disk is full"))
    (status,) = read_statuses(store)
    assert (status.state, status.trouble) == (RoleState.PAUSED, "the disk is full")
    with AlertFile(store) as file:
        assert file.kept.segment == "00000007"
    (store.folder / "alerts" / "alerts.db").unlink()
    filled(small_disk)
    with pytest.raises(StoreError, match="free or repair the disk"):
        AlertFile(store)


def test_a_lake_is_rebuilt_when_a_full_disk_has_room_again(
    gyrofleet: Callable[..., Any], small_disk: Path, tmp_path: Path
) -> None:
    store = small_disk / "store"
    done = gyrofleet("import", table(tmp_path / "a.parquet"), "--unit", "U1", "--store", store)
    assert done.code == 0, done.err
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(shutil.disk_usage(small_disk).free - 200_000))
    done = gyrofleet("rebuild", "--store", store)
    assert done.code == 1
    assert "the old one stays in force" in done.err
    check(gyrofleet, store)
    ballast.unlink()
    assert gyrofleet("rebuild", "--store", store).code == 0
    check(gyrofleet, store)


@pytest.mark.long
@pytest.mark.parametrize(
    ("calls", "when", "files"),
    [
        ("fdatasync", "1", 1),
        ("fdatasync", "2+2", 2),
        ("write", "4", 1),
        ("write", "5+3", 2),
        ("rename,renameat,renameat2", "1", 1),
        ("fsync", "1", 1),
    ],
)
def test_errors_of_the_disk_cost_a_segment_and_no_sample(
    gyrofleet: Callable[..., Any],
    command_line: Callable[..., list[str]],
    start_program: Start,
    endpoint: str,
    tmp_path: Path,
    calls: str,
    when: str,
    files: int,
) -> None:
    if shutil.which("strace") is None:
        pytest.skip("strace is not installed")
    store = tmp_path / "store"
    paths = [argument for i in range(files) for argument in ("-P", str(store / "log" / f"{i + 1:08d}.mcap.open"))]
    trace = tmp_path / "trace"
    record = start_program(
        "strace", "-f", "-qq", "-o", str(trace), *paths, "-e", f"inject={calls}:error=EIO:when={when}",
        *command_line("record", "--listen", endpoint, "--store", store, "--rotate-mb", "1", "--json"),
    )  # fmt: skip
    record.until(lambda line: line["event"] == "recording")
    source = gyrofleet(
        "import", table(tmp_path / "a.parquet"), "--unit", "U1", "--connect", endpoint, "--store", store, "--json"
    )
    assert source.code == 0, source.err
    record.stop()
    assert "INJECTED" in trace.read_text(), "the fault was never reached"
    assert any("the segment is abandoned" in line.get("text", "") for line in record.lines)
    ended = next(line for line in record.lines if line["event"] == "ended")
    assert (ended["samples"], ended["interruptions"] >= 1) == (SAMPLES, True)
    check(gyrofleet, store)
