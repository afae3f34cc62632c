"""Who is at work, whatever clocks say: a clock that is set hides no dead role, and silences none that reports."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

import storage.recording.recorder as recording
from gyrofleet import main
from storage.log.event_log import EventLog
from storage.recording.recorder import Recorder
from storage.recording.status_board import FOLDER, StatusBoard
from storage.recording.store_status import store_status
from storage.segments.disk import Disk, OpenFile
from storage.store import Store
from stream.delivery.publisher import DurablePublisher
from stream.status.role_status import Role, RoleState, RoleStatus, RunProgress, decode_status, encode_status, new_status
from stream.transport.bus import LocalBus
from tests.storage.recorder_samples import KEY, batch

HOUR_NS = 3600 * 10**9


def dead_process() -> int:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    return ended.pid


def put(store: Store, status: RoleStatus, seconds_ago: float) -> None:
    """Keep a status as it would be after some seconds."""
    StatusBoard(store).put(status)
    path = store.folder / FOLDER / status.file_name
    kept = decode_status(path.read_bytes())
    path.write_bytes(encode_status(msgspec.structs.replace(kept, kept_ns=kept.kept_ns - round(seconds_ago * 1e9))))


@pytest.mark.parametrize("leap_ns", [HOUR_NS, -HOUR_NS, 0])
@pytest.mark.parametrize(
    ("seconds_ago", "is_dead", "condition"), [(11, True, "killed"), (11, False, "silent"), (1, False, "working")]
)
def test_a_clock_that_leaps_changes_nothing(
    tmp_path: Path, leap_ns: int, seconds_ago: float, is_dead: bool, condition: str
) -> None:
    """A role that was killed before the clock was set back by an hour was shown at work for an hour."""
    store = Store.create(tmp_path)
    status = new_status(Role.ESTIMATE, time.time_ns(), name="e")
    status = msgspec.structs.replace(
        status, at_ns=status.at_ns + leap_ns, pid=dead_process() if is_dead else os.getpid()
    )
    put(store, status, seconds_ago)
    put(store, new_status(Role.RECORD, time.time_ns()), 0)
    found = store_status(store)
    assert [each.condition for each in found.roles] == [condition, "working"]
    assert bool(found.troubles) == (condition != "working")


def test_without_a_recorder_nobody_knows_whether_a_run_is_at_work(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    progress = RunProgress(run="r1", procedure="static_bias", steps=1)
    put(store, new_status(Role.RUN, time.time_ns(), name="c", run=progress), 11)
    numbers = {"last_sample_seconds": 1_767_225_600.0}
    recorder = new_status(Role.RECORD, time.time_ns(), numbers=numbers)
    put(store, msgspec.structs.replace(recorder, state=RoleState.ENDED), 7_200)
    found = store_status(store)
    assert [each.condition for each in found.roles] == ["unknown"]
    assert found.last_sample_ns == 1_767_225_600 * 10**9
    (trouble,) = found.troubles
    assert "no recorder is at work, so it is not known whether `gyrofleet run` at c (run r1) is" in trouble
    assert "it reported last 11 s ago; the last sample was recorded at 2026-01-01 00:00:00 UTC, " in trouble
    done = CliRunner().invoke(main, ["status", "--store", str(tmp_path)])
    assert done.exit_code == 1
    assert "no recorder is at work" in done.stdout
    assert "silent" not in done.output
    put(store, recorder, 0)
    assert [each.condition for each in store_status(store).roles] == ["working", "silent"]


def test_what_a_killed_run_had_in_its_process_is_started_with_it(tmp_path: Path) -> None:
    store, pid = Store.create(tmp_path), dead_process()
    progress = RunProgress(run="r1", procedure="static_bias", steps=1)
    for role, run in ((Role.RECORD, None), (Role.ESTIMATE, None), (Role.RUN, progress)):
        put(store, msgspec.structs.replace(new_status(role, time.time_ns(), name="c", run=run), pid=pid), 11)
    (trouble,) = store_status(store).troubles
    assert "(run r1) was killed" in trouble
    other = new_status(Role.ESTIMATE, time.time_ns(), name="d")
    put(store, msgspec.structs.replace(other, pid=dead_process()), 11)
    assert len(store_status(store).troubles) == 2


def test_a_computer_whose_clock_is_wrong_is_heard(tmp_path: Path) -> None:
    """Its reports come over the bus each second, and were silent for whoever looked."""
    store = Store.create(tmp_path)
    bus = LocalBus()
    with Recorder(store, bus, EventLog(store), builds_lake=False, reports_status=False):
        status = RoleStatus(role=Role.ESTIMATE, name="far", host="far", at_ns=time.time_ns() - HOUR_NS, began_ns=0)
        bus.publish("gyrofleet/@status", encode_status(msgspec.structs.replace(status, kept_ns=2**62, kept_boot="x")))
        deadline = time.monotonic() + 20.0
        while not (found := store_status(store).roles):
            assert time.monotonic() < deadline
            time.sleep(0.02)
    assert found[0].condition == "working"
    assert 0.0 <= found[0].age_s < 10.0


class HangingDisk(Disk):
    """A disk that does not answer until it is let go."""

    def __init__(self) -> None:
        self.hangs, self.go = threading.Event(), threading.Event()

    def sync_data(self, file: OpenFile) -> None:
        if not self.go.is_set():
            self.hangs.set()
            self.go.wait(60.0)
        super().sync_data(file)


def test_a_recorder_whose_disk_hangs_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its status is reported by another thread, which knew of nothing."""
    monkeypatch.setattr(recording, "SILENT_AFTER_S", 0.3)
    store, bus, disk = Store.create(tmp_path), LocalBus(), HangingDisk()
    with (
        Recorder(store, bus, EventLog(store, disk=disk), sync_interval_s=0.01, builds_lake=False) as recorder,
        DurablePublisher(bus, timeout_s=20.0) as publisher,
    ):
        assert recorder.status().trouble == ""
        publisher.send_batch(KEY, batch(0))
        assert disk.hangs.wait(20.0)
        time.sleep(0.5)
        assert "the disk does not answer" in recorder.status().trouble
        assert recorder.status().state is RoleState.PAUSED
        disk.go.set()
        publisher.drain()
        deadline = time.monotonic() + 20.0
        while recorder.status().trouble:
            assert time.monotonic() < deadline
            time.sleep(0.02)
