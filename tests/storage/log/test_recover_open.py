"""A segment that was left open and then damaged: all but the damaged chunk is saved, whatever byte was hit."""

import shutil
from pathlib import Path

import pytest

from storage.log.event_log import EventLog
from storage.log.recovery import left_open, recover_segment
from storage.segments.reader import read_segment
from storage.store import Store
from tests.storage.recording.test_disk_faults import append, samples

SYNCS = 5


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A log whose process was killed: one open segment of five chunks with two messages each."""
    store = Store.create(tmp_path_factory.mktemp("left") / "S")
    log = EventLog(store)
    for number in range(SYNCS):
        for unit in ("U1", "U2"):
            append(log, samples(unit, 2 * number, 2))
        log.sync()
    return store


# steps that are prime to the sizes of the records: every kind of record is hit at every place
@pytest.mark.long
@pytest.mark.parametrize("step", [149, pytest.param(37, marks=pytest.mark.long)])
def test_a_flipped_byte_costs_one_chunk_at_most(left: Store, tmp_path: Path, step: int) -> None:
    """A byte of an index between two chunks cost all chunks after it, and nothing said so."""
    content = left_open(left)[0].read_bytes()
    short: dict[int, int] = {}
    for position in range(8, len(content), step):
        shutil.rmtree(tmp_path / "T", ignore_errors=True)
        shutil.copytree(left.folder, tmp_path / "T")
        store = Store.open(tmp_path / "T")
        damaged = bytearray(content)
        damaged[position] ^= 0xFF
        path = left_open(store)[0]
        path.write_bytes(damaged)
        recovery = recover_segment(store, path, {})
        saved = sum(1 for segment in store.log.glob("*.mcap") for _ in read_segment(segment))
        assert saved == recovery.records
        if saved < 2 * SYNCS - 2:
            short[position] = saved
        assert saved == 2 * SYNCS or recovery.lost or recovery.kept_aside is not None
    assert short == {}
