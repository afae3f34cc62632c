"""The floor and its changes over HTTP, beside a recorder at work."""

import json
import subprocess
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from storage.log.follower import LogFollower
from storage.log.tail import documents_beyond
from storage.store import Store
from stream.events import Document, EstimatePublished, RunStarted
from stream.wire.batches import RawBatch
from tests.analytics.serve.conftest import TOKEN, Served, start
from tests.forked_commands import CommandServer


class Stream:
    """Server-sent events as they come."""

    def __init__(self, answer: httpx.Response) -> None:
        self._lines = answer.iter_lines()

    def event(self) -> dict[str, Any]:
        """The next event that is no heartbeat."""
        found: dict[str, Any] = {}
        for line in self._lines:
            name, _, value = line.partition(": ")
            if line == "" and "data" in found:
                return found | {"data": json.loads(found["data"])}
            if name in ("id", "event", "data"):
                found[name] = value
        raise AssertionError("the stream has ended")


@pytest.fixture
def beside(tmp_path: Path, command_server: CommandServer, run_command: Callable[..., Any]) -> Iterator[Served]:
    """A server of its own, over a store that is written while it runs."""
    words = ("run-simulated", "--run", "before", "--simulate", 1, "--hours", 0.001, "--speed", 0, "--store", "S")
    done = run_command(*words, cwd=tmp_path)
    assert done.code == 0, done.err
    process, ready = start(command_server, "--store", "S", "--port", 0, "--token", TOKEN, cwd=tmp_path)
    yield Served(ready["url"], tmp_path, {})
    process.terminate()
    _, err = process.communicate(timeout=20)
    assert process.returncode == 0, err
    assert "Traceback" not in err, err


def test_a_run_is_on_the_floor_within_two_seconds(beside: Served, command_server: CommandServer) -> None:
    with beside.program() as client, client.stream("GET", "/api/live") as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        stream = Stream(answer)
        first = stream.event()
        assert first["event"] == "floor"
        assert [run["run"] for run in first["data"]["runs"]] == ["before"]
        words = ["run-simulated", "--run", "now", "--simulate", "3", "--hours", "0.01", "--speed", "4", "--store", "S"]
        process = command_server.start(words, cwd=beside.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        change = stream.event()
        while not any(row[2] == "now" for row in change["data"]["units"]):
            change = stream.event()
        assert change["event"] == "change"
        assert change["data"]["time_ns"] - arrival_ns(beside.store) < 2 * 10**9
        assert first["data"]["units"][0][0] in change["data"]["gone"]  # the station has a new run
        # who comes back gets what it has missed
        number = change["id"].rpartition("-")[2]
        headers = {"Last-Event-ID": change["id"]}
        with client.stream("GET", "/api/live", headers=headers) as again:
            later = Stream(again).event()
        assert later["event"] == "change"
        assert int(later["id"].rpartition("-")[2]) > int(number)
        process.kill()
        process.communicate()
    with beside.program() as client:
        floor = client.get("/api/floor").json()
    assert {row[1] for row in floor["units"]} == {"SIM-0001", "SIM-0002", "SIM-0003"}


def arrival_ns(store: Path) -> int:
    """When the recorder had the start of the run."""
    documents = documents_beyond(Store.open(store), set())
    return next(at_ns for document, at_ns in documents if isinstance(document, RunStarted) and document.run == "now")


@pytest.mark.long
def test_a_sample_is_seen_once_and_soon_after_its_acknowledgement(
    beside: Served, command_server: CommandServer
) -> None:
    """While a run goes on, and through the moment in which its segment comes to the lake."""
    words = ["run-simulated", "--run", "now", "--simulate", "1", "--hours", "0.02", "--speed", "6", "--rate-hz", "100"]
    process = command_server.start(
        [*words, "--store", "S"], cwd=beside.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    name = ("SIM-0001", "now", "rate")
    store = Store.open(beside.folder / "S")
    with beside.program() as client, LogFollower(store) as log:
        in_log, seen = 0, []
        while process.poll() is None:
            of_log = [each.content for each in log.poll() if isinstance(each.content, RawBatch)]
            heads = [raw.message for raw in of_log]
            in_log += sum(head.samples for head in heads if (head.unit, head.run, head.signal) == name)
            time.sleep(2.0)  # what the log has now is seen by then
            answer = client.get("/api/signals/SIM-0001/now/rate", params={"points": 10_000})
            if in_log or answer.status_code == 200:
                assert answer.status_code == 200, answer.text
                seen.append(sum(answer.json()["n"]))
                assert seen[-1] >= in_log
        _, err = process.communicate()
        assert process.returncode == 0, err
        assert sorted(seen) == seen
        assert len(set(seen)) >= 3
        whole = client.get("/api/signals/SIM-0001/now/rate", params={"points": 10_000}).json()
        assert sum(whole["n"]) == 7200  # each once
        assert client.get("/api/allan/SIM-0001/now/rate").json()["tau_s"]


@pytest.mark.long
def test_a_run_is_answered_before_the_lake_has_it(beside: Served, command_server: CommandServer) -> None:
    """Documents, units and counts of samples are there soon and once, also while segments come to the lake."""
    words = ["run-simulated", "--run", "now", "--simulate", "2", "--hours", "0.04", "--speed", "3", "--rate-hz", "100"]
    process = command_server.start(
        [*words, "--store", "S"], cwd=beside.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    store = Store.open(beside.folder / "S")
    counted: list[int] = []
    with beside.program() as client, LogFollower(store) as log:
        due: deque[tuple[float, set[str], int]] = deque()  # what is to be seen, and from when on
        uids, samples, was_open, audited, known_s = set[str](), 0, False, set[str](), 0.0
        while process.poll() is None:
            for message in log.poll():
                if isinstance(message.content, RawBatch):
                    samples += message.content.message.samples if message.content.message.run == "now" else 0
                elif isinstance(message.content, Document) and not isinstance(message.content, EstimatePublished):
                    uids |= {message.content.uid} if message.content.run == "now" else set()
            due.append((time.monotonic() + 2.0, set(uids), samples))
            asked_s = time.monotonic()
            answer = client.get("/api/runs/now")
            events = client.get("/api/events", params={"run": "now", "limit": 10_000}).json()["events"]
            audited |= {each["run"] for each in client.get("/api/units/SIM-0001/audit").json()["events"]}
            while due and due[0][0] <= asked_s:
                _, known, least = due.popleft()
                seen = [each["uid"] for each in events]
                assert len(seen) == len(set(seen))
                assert known <= set(seen)
                if known:
                    assert answer.status_code == 200, answer.text
                    assert answer.json()["run"]["samples"] >= least
            if len(set(counted)) > 8:
                time.sleep(0.5)  # the run is long for busy machines, others have seen enough
            if answer.status_code == 200:
                was_open |= answer.json()["run"]["outcome"] == "open"
                counted.append(answer.json()["run"]["samples"])
                assert sum(each["kind"] == "RunStarted" for each in answer.json()["documents"]) == 1
                # by the time of measurement: what is simulated faster than the clock began earlier
                assert [run["run"] for run in client.get("/api/runs").json()["runs"]] == ["before", "now"]
                if not any(each["unit"] == "SIM-0002" for each in answer.json()["units"]):
                    continue  # the run has begun, and nothing of this unit is in the log yet
                known_s = known_s or time.monotonic()
                of_unit = client.get("/api/units/SIM-0002")
                if of_unit.status_code != 200:  # a page of its own, which may be a moment behind
                    assert time.monotonic() < known_s + 2.0, of_unit.text
                    continue
                (outcome,) = (run["outcome"] for run in of_unit.json()["runs"] if run["run"] == "now")
                assert outcome in ("open", "completed")
                assert "now" in audited or time.monotonic() < known_s + 2.0
                (row,) = client.get("/api/units", params={"search": "SIM-0002"}).json()["units"]
                assert row["last_run"] == "now"
        _, err = process.communicate()
        assert process.returncode == 0, err
        assert was_open
        assert sorted(counted) == counted
        assert len(set(counted)) >= 4
        deadline_s = time.monotonic() + 5.0  # two seconds, and the lake's version
        while (found := client.get("/api/runs/now").json())["run"]["outcome"] != "completed":
            assert time.monotonic() < deadline_s
        assert (
            found["run"]["samples"]
            == sum(unit["samples"] for unit in found["units"])
            == client.post("/api/sql", json={"sql": "select sum(samples) as n from signals where run = 'now'"}).json()[
                "rows"
            ][0]["n"]
        )
        assert counted[-1] <= found["run"]["samples"]
        assert client.get("/api/runs/nowhere").status_code == 404
    with beside.browser() as browser:
        for page in ("/runs/now", "/units/SIM-0002", "/runs", "/units"):
            assert "now" in browser.get(page).text
