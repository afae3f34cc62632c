"""Pages that take long: a word at once, made once however often the window asks, and no two readers' pages mixed."""

import asyncio
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from analytics.serve.doors.doorkeeper import Doorkeeper
from analytics.serve.doors.roles import Role
from analytics.serve.live.follower import FloorFollower
from analytics.serve.pages.frame.problem_page import problem_response
from analytics.serve.pages.frame.waiting import Waiting
from analytics.serve.problems import Stopping, TooMany
from analytics.serve.service import Service
from analytics.serve.shared_lake import SharedLake
from analytics.serve.sql_pool import SqlPool
from storage.store import Store
from stream.errors import NotFound, StoreError


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    store = Store.create(tmp_path / "S")
    live = FloorFollower(store)
    door = Doorkeeper(token="T", token_role=Role.VIEWER, users=None, cookie="c", is_secure=False)
    service = Service(store, door, SharedLake(store, live.entered), SqlPool(store), live, is_on_loopback=True)
    yield service
    service.close()


def window(cookie: str = "c=1", dest: str = "document") -> Request:
    headers = [(b"cookie", cookie.encode()), (b"sec-fetch-dest", dest.encode()), (b"host", b"here")]
    scope = {"type": "http", "method": "GET", "path": "/units/U", "query_string": b"", "headers": headers}
    return Request(scope | {"server": ("here", 80), "scheme": "http"})


class Slow:
    """A page that takes so long; `made` counts how often it was begun."""

    def __init__(self, seconds: float) -> None:
        self.made, self._seconds = 0, seconds

    async def __call__(self) -> Response:
        self.made += 1
        mine = self.made
        await asyncio.sleep(self._seconds)
        return HTMLResponse(f"page {mine}")


def test_a_window_is_told_at_once_and_gets_the_page_made_once(service: Service) -> None:
    async def run() -> None:
        waiting, slow = Waiting(), Slow(1.2)
        began_s = time.monotonic()
        answer = await waiting.answer(window(), service, slow)
        assert time.monotonic() - began_s < 1.0
        assert (answer.status_code, answer.headers["refresh"]) == (202, "0")
        assert "being computed" in bytes(answer.body).decode()
        answer = await waiting.answer(window(), service, slow)  # held until it is made
        assert (bytes(answer.body), slow.made) == (b"page 1", 1)
        assert time.monotonic() - began_s >= 1.2
        await waiting.answer(window(), service, slow)
        assert slow.made == 2  # a page is not kept longer than it is waited for

    asyncio.run(run())


@pytest.mark.long
def test_readers_and_programs_do_not_get_the_pages_of_others(service: Service) -> None:
    async def run() -> None:
        waiting, slow = Waiting(), Slow(0.7)
        await waiting.answer(window("c=1"), service, slow)
        await waiting.answer(window("c=2"), service, slow)
        assert bytes((await waiting.answer(window("c=2"), service, slow)).body) == b"page 2"
        assert bytes((await waiting.answer(window("c=1"), service, slow)).body) == b"page 1"
        assert bytes((await waiting.answer(window(dest="empty"), service, slow)).body) == b"page 3"

    asyncio.run(run())


def test_an_error_is_told_to_who_waits(service: Service) -> None:
    async def run() -> None:
        waiting = Waiting()

        async def fail() -> Response:
            await asyncio.sleep(0.7)
            raise ValueError("no such unit")

        assert (await waiting.answer(window(), service, fail)).status_code == 202
        with pytest.raises(ValueError, match="no such unit"):
            await waiting.answer(window(), service, fail)

    asyncio.run(run())


def test_a_problem_that_passes_is_a_page_that_asks_again() -> None:
    scope = dict(window().scope) | {"headers": [(b"accept", b"text/html"), (b"host", b"here")]}
    for problem, status, after in ((TooMany("too many statements", 7.0), 429, "7"), (StoreError("a disk"), 503, "5")):
        answer = problem_response(Request(scope), problem)
        assert (answer.status_code, answer.headers["refresh"]) == (status, after)
        assert str(problem) in bytes(answer.body).decode()
        sent = problem_response(Request(scope | {"method": "POST"}), problem)  # a form is not sent again
        assert "refresh" not in sent.headers
    assert "refresh" not in problem_response(Request(scope), NotFound("no unit U")).headers


def test_a_server_that_stops_says_so(service: Service) -> None:
    async def run() -> None:
        service.stopping.set()
        with pytest.raises(Stopping):
            await Waiting().answer(window(), service, Slow(5.0))

    asyncio.run(run())
