"""Signals that only the log has so far: what is known of them is as in the lake."""

import asyncio
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from analytics.serve.app import application
from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.doors.roles import Role
from analytics.serve.live.follower import FloorFollower
from analytics.serve.service import Service
from analytics.serve.shared_lake import SharedLake
from analytics.serve.sql_pool import SqlPool
from storage.log.event_log import EventLog
from storage.recording.client import record_documents
from storage.store import Store, WriterLock
from stream.events import RunStarted
from tests.analytics.serve.open_log import write_samples


def answers(store: Store, *paths: str) -> list[dict[str, Any]]:
    """Answers of a server over a store."""
    live = FloorFollower(store)
    door = Doorkeeper(token="T", token_role=Role.VIEWER, users=None, cookie="c", is_secure=False)
    service = Service(store, door, SharedLake(store, live.entered), SqlPool(store), live, is_on_loopback=True)
    live.start(service.lake, lambda *_: None)

    async def asked() -> list[dict[str, Any]]:
        transport = httpx.ASGITransport(application(service, ("here",)))
        headers = {"Authorization": "Bearer T"}
        async with httpx.AsyncClient(
            transport=transport, base_url="http://here", timeout=60.0, headers=headers
        ) as viewer:
            live.wait()
            found = [await viewer.get(path) for path in paths]
        assert [each.status_code for each in found] == [200] * len(paths), [each.text for each in found]
        return [each.json() for each in found]

    try:
        return asyncio.run(asked())
    finally:
        service.close()


def test_a_dead_sensor_and_a_run_without_date(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "S")
    record_documents(store, [RunStarted(run="r1", t_ns=1, units=("U1",), date_known=False)], role="test")
    with WriterLock(store, "test"):
        log = EventLog(store)
        write_samples(log, np.full(100, np.nan))
        write_samples(log, np.array([1.0, np.nan, 3.0]), signal="other", run="r2")
    dead, other = answers(store, "/api/signals/U1/r1/rate", "/api/signals/U1/r2/other")
    assert dead["samples"] == 0
    assert dead["t_ns"] == []
    assert dead["last_ns"] - dead["first_ns"] == 99 * 10**7
    assert not dead["date_known"]
    assert other["date_known"]
    assert (other["samples"], max(other["max"])) == (2, 3.0)
