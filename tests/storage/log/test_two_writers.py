"""Two processes at one store: the second is refused, and whatever happens no sealed segment is overwritten."""

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from storage.check.recover import recover
from storage.check.verify import verify
from storage.log.event_log import EventLog
from storage.segments.disk import DISK
from storage.segments.reader import read_segment
from storage.store import Store, WriterLock, writer_is_active
from stream.errors import StoreError
from stream.wire.batches import decode_batch
from tests.storage import log_records


def append(log: EventLog, unit: str, seq: int, n: int = 50) -> None:
    log_records.append(log, log_records.samples(unit, seq, n))


def recorded(store: Store) -> dict[str, list[int]]:
    """Numbers of the samples in the sealed segments, by unit."""
    found: dict[str, list[int]] = {}
    for segment in sorted(store.log.glob("*.mcap")):
        for record in read_segment(segment):
            batch = decode_batch(record.data)
            found.setdefault(batch.unit, []).extend(range(batch.seq, batch.next_seq))
    return found


def test_a_removed_lock_file_lets_no_second_writer_in(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    with WriterLock(store, "gyrofleet record"):
        (tmp_path / "writer.lock").unlink()
        assert writer_is_active(tmp_path)
        with pytest.raises(StoreError, match="is being written by"):
            WriterLock(store, "gyrofleet record")
    assert not writer_is_active(tmp_path)
    with WriterLock(store, "gyrofleet record"):
        pass


def test_sealing_keeps_the_segment_that_has_the_name(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    first, second = EventLog(store), EventLog(store)  # as two processes that no lock keeps apart
    append(first, "A", 0)
    first.sync()
    second._number = 5  # so that each begins its own file
    append(second, "B", 0)
    first.seal()
    assert second._segment is not None
    second._segment.path = store.log / "00000001.mcap"  # the number of the other
    sealed = second.seal()
    assert sealed is not None
    assert sealed.name == "00000007.mcap"
    assert "written by another process" in second.warnings[-1]
    append(second, "B", 50)
    assert second.seal() == store.log / "00000008.mcap"
    assert recorded(store) == {"A": list(range(50)), "B": list(range(100))}
    list(recover(store))
    assert verify(store)[0].is_sound


def test_an_open_segment_beside_another_of_its_number_is_sealed_under_a_new_one(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    log = EventLog(store)
    append(log, "A", 0)
    log.seal()
    log._number = 0
    append(log, "B", 0)
    log.sync()
    assert (store.log / "00000001.mcap.open").exists()
    del log
    again = EventLog(store)
    assert [each.records for each in again.recovered] == [1]
    assert recorded(store) == {"A": list(range(50)), "B": list(range(50))}
    list(recover(store))
    assert verify(store)[0].is_sound


def test_a_copy_that_was_sealed_already_is_moved_aside(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    log = EventLog(store)
    append(log, "A", 0)
    log.sync()
    left = (store.log / "00000001.mcap.open").read_bytes()
    append(log, "A", 50)
    log.seal()
    (store.log / "00000001.mcap.open").write_bytes(left)
    EventLog(store)
    assert recorded(store) == {"A": list(range(100))}
    assert len(list(store.aside.iterdir())) == 1


@pytest.mark.parametrize("has_flag", [True, False])
def test_a_name_that_is_taken_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_flag: bool) -> None:
    if not has_flag:
        monkeypatch.setattr("storage.segments.disk._library", object())
    a, b = tmp_path / "a", tmp_path / "b"
    a.write_text("a")
    b.write_text("b")
    with pytest.raises(FileExistsError):
        DISK.rename(a, b)
    assert (a.read_text(), b.read_text()) == ("a", "b")
    DISK.rename(a, tmp_path / "c")
    DISK.replace(tmp_path / "c", b)
    assert [path.name for path in tmp_path.iterdir()] == ["b"]
    assert b.read_text() == "a"


def test_who_enters_documents_waits_for_another_who_does(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    first = WriterLock(store, "gyrofleet check", is_brief=True)
    with ThreadPoolExecutor(1) as pool:
        second = pool.submit(WriterLock, store, "gyrofleet serve", is_brief=True, patience_s=20.0)
        with pytest.raises(TimeoutError):
            second.result(timeout=0.3)
        first.close()
        second.result(timeout=20.0).close()


def test_a_recorder_is_not_waited_for(tmp_path: Path) -> None:
    store = Store.create(tmp_path)
    with WriterLock(store, "gyrofleet record"):
        began = time.monotonic()
        with pytest.raises(StoreError, match="being written by gyrofleet record"):
            WriterLock(store, "gyrofleet serve", is_brief=True, patience_s=20.0)
        assert time.monotonic() - began < 10.0
