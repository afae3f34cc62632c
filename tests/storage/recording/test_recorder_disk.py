"""The recorder on a disk that is full or fails, clock steps, and messages after the end of their run."""

import errno
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from storage.lake.builder import build_missing
from storage.log.event_log import EventLog
from storage.recording import lake_builder
from storage.recording.recorder import Recorder
from storage.segments.disk import Disk, OpenFile, Space
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.delivery.publisher import DurablePublisher
from stream.events import RunEnded, RunStarted
from stream.identity import ACKNOWLEDGEMENT_KEY, event_key
from stream.status.role_status import RoleState
from stream.transport.bus import LocalBus
from stream.wire.acknowledgement import decode_acknowledgement
from tests.storage.recorder_samples import KEY, PLACE, batch, lake_values


class FullDisk(Disk):
    """A disk that can be filled and emptied, and that refuses on demand."""

    def __init__(self) -> None:
        self.free = 10 << 30
        self.refused = 0

    def space(self, folder: Path) -> Space:
        return Space(self.free, 100 << 30)

    def write(self, file: OpenFile, content: bytes) -> None:
        if self.refused > 0:
            self.refused -= 1
            raise OSError(28, "No space left on device")
        super().write(file, content)


def until(condition: Callable[[], bool], patience_s: float = 20.0) -> None:
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, "it did not come to it"
        time.sleep(0.01)


def noted(store: Store) -> list[str]:
    with Catalog(store) as catalog:
        rows = catalog.rows("select document->>'$.what' from events where kind = 'StoreNoted' order by time")
    return [str(what) for (what,) in rows]


def test_a_full_disk_pauses_recording_and_room_lets_it_go_on(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    disk = FullDisk()
    warnings: list[str] = []
    recorder = Recorder(
        store, bus, EventLog(store, disk=disk), sync_interval_s=0.01, on_warning=warnings.append, disk=disk
    )
    paused: list[str] = []
    bus.subscribe(ACKNOWLEDGEMENT_KEY, lambda _, payload: paused.append(decode_acknowledgement(payload).paused))
    with recorder, DurablePublisher(bus, resend_after_s=0.1, timeout_s=2.0) as publisher:
        publisher.send_batch(KEY, batch(0))
        publisher.drain()
        disk.free = 2 << 30
        until(lambda: any("is running full" in warning for warning in warnings))
        disk.free = 1 << 20
        until(lambda: recorder.paused is not None)
        for i in range(1, 40):
            publisher.send_batch(KEY, batch(i))
        time.sleep(3.0)  # longer than the source would wait for a recorder that is silent
        assert publisher.outstanding == 39
        assert "kept in reserve" in str(recorder.paused)
        assert any("kept in reserve" in each for each in paused)
        disk.free = 10 << 30
        publisher.drain()
    assert lake_values(store) == list(range(4000))
    assert noted(store) == ["disk_low", "recording_paused"]


@pytest.mark.parametrize("errors", [pytest.param(1, marks=pytest.mark.long), 3])
def test_a_write_error_costs_a_segment_and_nothing_else(tmp_path: Path, errors: int) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    disk = FullDisk()
    recorder = Recorder(store, bus, EventLog(store, disk=disk), sync_interval_s=0.01, disk=disk)
    with recorder, DurablePublisher(bus, resend_after_s=0.1) as publisher:
        for i in range(20):
            publisher.send_batch(KEY, batch(i))
            if i == 10:
                publisher.drain()
                disk.refused = errors
        publisher.drain()
    assert recorder.counts.interruptions == errors
    assert recorder.counts.samples == 2000
    assert len(list(store.log.glob("*.mcap"))) == 2
    assert lake_values(store) == list(range(2000))
    assert "disk_error" in noted(store) or "recording_paused" in noted(store)
    assert EventLog(store).recovered == []


def test_a_step_back_of_a_source_clock_is_noted(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    with Recorder(store, bus, EventLog(store)) as recorder, DurablePublisher(bus) as publisher:
        publisher.send_batch(KEY, batch(0))
        publisher.send_batch(KEY, replace(batch(1), t0_ns=50 * 10**6))
        publisher.drain()
        assert recorder.counts.backwards == 1
        until(lambda: recorder.counts.messages >= 2 and not recorder._intake.clock_steps)
    with Catalog(store) as catalog:
        ((text,),) = catalog.rows("select document->>'$.text' from events where kind = 'StoreNoted'")
    assert "the source's clock went back by 0.049 s at sample 100" in text


@pytest.mark.long
def test_samples_that_come_behind_the_end_of_their_run_are_in_the_lake_soon(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    with Recorder(store, bus, EventLog(store), sync_interval_s=0.01) as recorder, DurablePublisher(bus) as publisher:
        publisher.send_event(event_key(PLACE), RunStarted(run="r1", t_ns=0))
        publisher.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=10**9))
        publisher.drain()
        until(lambda: recorder.counts.segments == 1)
        publisher.send_batch(KEY, batch(0))  # sent again after an error of the disk, its end has come before it
        publisher.drain()
        until(lambda: recorder.counts.segments == 2)
        until(lambda: len(lake_values(store)) == 100)


@pytest.mark.long
def test_a_run_that_is_added_to_behind_its_end_is_not_cut_into_seconds(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    bus = LocalBus()
    with Recorder(store, bus, EventLog(store), sync_interval_s=0.01) as recorder, DurablePublisher(bus) as publisher:
        publisher.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=0))
        publisher.drain()
        until(lambda: recorder.counts.segments == 1)
        for i in range(40):  # 4 s, as another file of the same run
            publisher.send_batch(KEY, batch(i))
            time.sleep(0.1)
        during = recorder.counts.segments
        until(lambda: recorder.counts.segments == 2)
    assert during == 1


class FailsOnce(Disk):
    """A disk whose next fdatasync fails."""

    is_due = True

    def sync_data(self, file: OpenFile) -> None:
        if self.is_due:
            self.is_due = False
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        super().sync_data(file)


@pytest.mark.long
def test_what_came_when_the_disk_failed_does_not_keep_others_from_settling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("storage.recording.recorder._SETTLE_S", 10.0)
    store, bus, disk = Store.create(tmp_path), LocalBus(), FailsOnce()
    with (
        Recorder(store, bus, EventLog(store, disk=disk), sync_interval_s=0.01, disk=disk) as recorder,
        DurablePublisher(bus, resend_after_s=0.05) as publisher,
    ):
        time.sleep(0.05)  # so that the message is taken and synced in one pass
        publisher.send_batch(KEY, batch(0))
        publisher.drain()
        recorder.settle()
    assert not disk.is_due


def test_a_lake_that_cannot_be_written_is_a_trouble_until_it_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, bus, disk = Store.create(tmp_path), LocalBus(), FullDisk()
    warnings: list[str] = []
    is_full = True

    def build(of: Store) -> Iterator[str]:
        if is_full:
            raise OSError(errno.ENOSPC, "No space left on device")
        yield from build_missing(of)

    monkeypatch.setattr(lake_builder, "build_missing", build)
    monkeypatch.setattr(lake_builder, "_RETRY_S", 0.05)
    recorder = Recorder(store, bus, EventLog(store, disk=disk), disk=disk, on_warning=warnings.append)
    with recorder:
        until(lambda: "lake" in recorder.status().trouble)
        status = recorder.status()
        assert (status.state, "No space left on device" in status.trouble) == (RoleState.WORKING, True)
        until(lambda: len(warnings) == 1)
        is_full = False
        until(lambda: recorder.status().trouble == "")
    assert len(warnings) == 1
