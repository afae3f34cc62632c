"""Pages whose metrics are still being computed: what is known is shown at once, the rest when it is there."""

import asyncio
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from analytics.serve.app import application
from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.doors.roles import Role
from analytics.serve.live.follower import FloorFollower
from analytics.serve.service import Service
from analytics.serve.shared_lake import SharedLake
from analytics.serve.sql_pool import SqlPool
from storage.store import Store

LATER = 'id="rest-of-page"'
WINDOW = {"Sec-Fetch-Dest": "document", "Authorization": "Bearer T"}


@pytest.fixture
def service(tmp_path: Path, run_command: Callable[..., Any]) -> Iterator[Service]:
    """A server that has not begun to compute metrics: nothing warms its catalogues."""
    lines = ["time[s],unit,rate[deg/h]", *(f"{at / 10},FOG-1,{at % 7}" for at in range(600))]
    (tmp_path / "rest.csv").write_text("\n".join(lines))
    words = ("import", "rest.csv", "--run", "r1", "--procedure", "static_bias", "--start", "2026-11-21T10:00:00Z")
    done = run_command(*words, "--store", "S", cwd=tmp_path)
    assert done.code == 0, done.err
    store = Store.open(tmp_path / "S")
    live = FloorFollower(store)
    door = Doorkeeper(token="T", token_role=Role.VIEWER, users=None, cookie="c", is_secure=False)
    service = Service(store, door, SharedLake(store, live.entered), SqlPool(store), live, is_on_loopback=True)
    live.start(service.lake, lambda *_: None)
    yield service
    service.close()


async def seen(service: Service, path: str, headers: dict[str, str], status: int = 200) -> str:
    transport = httpx.ASGITransport(application(service, ("here",)))
    async with httpx.AsyncClient(transport=transport, base_url="http://here", timeout=60.0) as client:
        answer = await client.get(path, headers=headers)
        while answer.status_code == 202:  # a busy machine: the page that asks again
            answer = await client.get(path, headers=headers)
    assert answer.status_code == status
    return answer.text


async def rest_of(service: Service, path: str, headers: dict[str, str]) -> None:
    """Ask until the page is whole, as its script does: an answer that others got is given for two seconds."""
    until_s = time.monotonic() + 30.0
    while LATER in await seen(service, path, headers):
        assert time.monotonic() < until_s
        await asyncio.sleep(0.1)


def test_a_window_shows_what_is_known_and_then_the_rest(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    async def run() -> None:
        # a window asks for metrics, which a fast machine has before the second one is seen
        monkeypatch.setattr(service.warming, "want_metrics", lambda: None)
        unit = await seen(service, "/units/FOG-1", WINDOW)
        assert LATER in unit
        assert 'href="/runs/r1"' in unit
        assert "600" in unit  # its samples
        assert "Being computed." in unit
        trends = await seen(service, "/trends", WINDOW)
        assert LATER in trends
        assert "Bias stability" in trends
        monkeypatch.undo()
        program = {"Authorization": "Bearer T"}
        whole = await seen(service, "/units/FOG-1", program)  # waits for all of it
        assert LATER not in whole
        assert 'id="unit-metrics"' in whole
        # what the script of the page looks for
        await rest_of(service, "/units/FOG-1", program | {"X-Partial": "1"})
        await rest_of(service, "/trends", WINDOW)

    asyncio.run(run())


@pytest.mark.long
def test_a_unit_that_is_not_there_is_reported_before_metrics_are(service: Service) -> None:
    assert "FOG-1" in asyncio.run(seen(service, "/units/FOG-9", WINDOW, status=404))
