"""Processes kept for statements: none answers from before what the log has since."""

from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from analytics.serve import sql_pool
from analytics.serve.doors.roles import Person, Role
from analytics.serve.shared_lake import LakeState
from analytics.serve.sql_pool import SqlPool
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.segments.records import SAMPLES, LogRecord
from storage.store import Store, WriterLock, writer_is_active
from stream.batch import SampleBatch
from stream.identity import Place, sample_key
from stream.wire.batches import encode_batch

PERSON = Person(name="viewer", role=Role.VIEWER)


def written(log: EventLog, first: int) -> None:
    """Write a hundred samples."""
    t0_ns = (1_763_683_200 + first) * 10**9
    batch = SampleBatch("U1", "rate", "r1", UUID(int=1), first, t0_ns, 10**7, "deg/h", values=np.arange(100.0))
    key = sample_key(Place("plant", "bench"), "U1", "rate")
    record = LogRecord(key, SAMPLES, batch.last_ns + 1, t0_ns, encode_batch(batch))
    place = place_of(record)
    assert place is not None
    log.append(place, record)
    log.sync()


def test_what_a_recorder_wrote_before_it_was_killed_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sql_pool, "_FRESH_S", 0.0)
    store = Store.create(tmp_path / "S")

    def samples(log_version: int) -> int:
        state = LakeState("empty", 0, (), log_version=log_version)
        with pool.door(state, PERSON) as door:
            ((count,),) = (row.values() for row in door.ask("select count(*) from samples").read_all().to_pylist())
        return int(count)

    with SqlPool(store) as pool:
        with WriterLock(store, "test"):
            log = EventLog(store)
            written(log, 0)
            assert samples(1) == 100
            written(log, 100)
        assert not writer_is_active(store.folder)
        assert samples(2) == 200
        kept = set(pool._busy) | {each.door for each in pool._idle}
        assert samples(2) == 200
        assert {each.door for each in pool._idle} == kept
