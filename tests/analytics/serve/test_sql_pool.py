"""Processes kept for statements: none answers from before what the log has since."""

from pathlib import Path

import numpy as np
import pytest

from analytics.serve import sql_pool
from analytics.serve.doors.roles import Person, Role
from analytics.serve.shared_lake import LakeState
from analytics.serve.sql_pool import SqlPool
from storage.log.event_log import EventLog
from storage.store import Store, WriterLock, writer_is_active
from tests.analytics.serve.open_log import write_samples

PERSON = Person(name="viewer", role=Role.VIEWER)


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
            write_samples(log, np.arange(100.0))
            assert samples(1) == 100
            write_samples(log, np.arange(100.0), first=100)
        assert not writer_is_active(store.folder)
        assert samples(2) == 200
        kept = {each.door for each in pool._idle}
        assert samples(2) == 200
        assert {each.door for each in pool._idle} == kept
