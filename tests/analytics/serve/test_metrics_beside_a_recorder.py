"""Beside a recorder metrics lag behind the lake, and follow it as long as somebody looks."""

import asyncio
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from analytics.serve import warming
from analytics.serve.app import application
from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.doors.roles import Role
from analytics.serve.live.follower import FloorFollower
from analytics.serve.service import Service
from analytics.serve.shared_lake import SharedLake
from analytics.serve.sql_pool import SqlPool
from storage.store import Store

PATIENCE_S = 60.0
Import = Callable[[str], None]


@pytest.fixture
def take(tmp_path: Path, run_command: Callable[..., Any]) -> Import:
    """Import a run at rest."""
    lines = ["time[s],unit,rate[deg/h]", *(f"{at / 10},FOG-1,{at % 7}" for at in range(600))]
    (tmp_path / "rest.csv").write_text("\n".join(lines))

    def take(run: str) -> None:
        words = (
            "import",
            "rest.csv",
            "--run",
            run,
            "--procedure",
            "static_bias",
            "--start",
            f"2026-11-2{run[1]}T10:00:00Z",
        )
        done = run_command(*words, "--store", "S", cwd=tmp_path)
        assert done.code == 0, done.err

    return take


@pytest.fixture
def service(tmp_path: Path, take: Import, monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    """A server of a store with a run, which takes it that a recorder is at work and looks for changes at once."""
    monkeypatch.setattr(warming, "writer_is_active", lambda _folder: True)
    for name, seconds in (("_METRICS_LOOK_S", 0.05), ("_METRICS_NEXT_S", 0.1), ("_METRICS_PAUSES", 0.0)):
        monkeypatch.setattr(warming, name, seconds)
    take("r1")
    store = Store.open(tmp_path / "S")
    live = FloorFollower(store)
    door = Doorkeeper(token="T", token_role=Role.VIEWER, users=None, cookie="c", is_secure=False)
    service = Service(store, door, SharedLake(store, live.entered), SqlPool(store), live, is_on_loopback=True)
    live.start(service.lake, lambda *_: None)
    service.warming.start()
    yield service
    service.close()


@pytest.mark.long
def test_metrics_of_a_unit_that_is_looked_at_follow_the_lake(service: Service, take: Import) -> None:
    async def run() -> None:
        transport = httpx.ASGITransport(application(service, ("here",)))
        headers = {"Authorization": "Bearer T"}
        async with httpx.AsyncClient(
            transport=transport, base_url="http://here", timeout=60.0, headers=headers
        ) as viewer:

            async def runs() -> set[str]:
                answer = await viewer.get("/api/units/FOG-1")
                assert answer.status_code == 200, answer.text
                return {each["run"] for each in answer.json()["metrics"] if each["run"]}

            assert await runs() == {"r1"}
            for number in (2, 3):
                await asyncio.to_thread(take, f"r{number}")
                expected, until_s = {f"r{each}" for each in range(1, number + 1)}, time.monotonic() + PATIENCE_S
                while await runs() != expected:
                    assert time.monotonic() < until_s, f"the metrics do not have r{number}"
                    await asyncio.sleep(0.2)

    asyncio.run(run())
