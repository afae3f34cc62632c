"""What is at work on a store: asked from the command line and by Prometheus, while roles work, are killed and end."""

import json
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.free_ports import free_endpoint

Spawn = Callable[..., subprocess.Popen[str]]


def asked(url: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as refused:
        return refused.code, refused.read().decode()


def until(look: Callable[[], Any], is_so: Callable[[Any], bool], timeout_s: float = 60.0) -> Any:
    deadline = time.monotonic() + timeout_s
    while not is_so(found := look()):
        assert time.monotonic() < deadline, found
        time.sleep(0.2)
    return found


@pytest.mark.long
def test_status_follows_roles_from_work_to_death(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, tmp_path: Path
) -> None:
    metrics = free_endpoint().removeprefix("tcp/")
    record = spawn("record", "--listen", endpoint, "--status-listen", metrics, "--json")
    assert record.stdout is not None
    assert json.loads(record.stdout.readline())["event"] == "recording"
    run = spawn("run-simulated", "--run", "n-1", "--simulate", "2", "--hours", "1", "--connect", endpoint, "--json")

    def status() -> dict[str, Any]:
        done = gyrofleet("status", "--json")
        assert done.code == bool(done.json["troubles"])
        return dict(done.json)

    def conditions(found: dict[str, Any]) -> dict[str, str]:
        return {each["status"]["role"]: each["condition"] for each in found["roles"]}

    at_work = until(status, lambda found: conditions(found) == {"record": "working", "run": "working"})
    assert at_work["troubles"] == []
    assert at_work["verdicts"] == {"undecided": 2}
    (progress,) = (each["status"]["run"] for each in at_work["roles"] if each["status"]["role"] == "run")
    assert progress["run"] == "n-1"
    assert 3000 < progress["left_s"] <= 3600
    until(lambda: gyrofleet("status").out, lambda text: "n-1: step 1 of 1, sending, " in text)

    def scraped() -> dict[str, float]:
        code, text = asked(f"http://{metrics}/metrics")
        assert code == 200
        return {family.name: family.samples[0].value for family in text_string_to_metric_families(text)}

    numbers = until(scraped, lambda found: found["gyrofleet_record_samples_total"] > 0)
    assert numbers["gyrofleet_record_up"] == 1.0
    assert time.time() - numbers["gyrofleet_record_last_message_seconds"] < 60.0
    assert asked(f"http://{metrics}/health")[0] == 200
    assert asked(f"http://{metrics}/elsewhere")[0] == 404

    run.kill()
    run.communicate()
    killed = until(status, lambda found: conditions(found)["run"] == "killed")
    assert any("run n-1) was killed" in each and "start it again" in each for each in killed["troubles"])
    record.terminate()
    record.communicate(timeout=30)
    ended = until(status, lambda found: conditions(found)["record"] == "ended")
    assert len(ended["troubles"]) == 1  # of the run
    assert (tmp_path / "gyrofleet-data").is_dir()


@pytest.mark.long
def test_a_store_where_nothing_works_is_well(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time[s],rate[deg/h]\n0,1\n1,2\n2,1\n")
    assert gyrofleet("import", tmp_path / "a.csv", "--unit", "U", "--run", "r").code == 0
    found = gyrofleet("status", "--json")
    assert found.code == 0
    assert found.json["segments_not_in_lake"] == 0
    assert gyrofleet("verify").code == 0


def test_an_address_in_use_is_refused(gyrofleet: Callable[..., Any], endpoint: str) -> None:
    refused = gyrofleet("record", "--listen", endpoint, "--status-listen", "127.0.0.1:nine")
    assert refused.code == 1
    assert "write it as 127.0.0.1:9464" in refused.err
