"""Alerts through restarts with segments that were sealed meanwhile, rules that are edited, and a second process."""

import json
import subprocess
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.e2e.station.test_alerts import Spawn, hook, until, watching

__all__ = ["hook"]

RULES = """
[targets.line]
kind = "webhook"
url = "http://127.0.0.1:{port}/alerts"
[[rules]]
kind = "unit_silent"
silent_s = 2
clear_after_s = 1
"""


def events(posted: list[dict[str, Any]]) -> Counter[tuple[str, str]]:
    return Counter((each["rule"], each["event"]) for each in posted)


def killed(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate()


@pytest.mark.long
def test_what_lasts_is_told_once_through_restarts_rules_and_seals(
    gyrofleet: Callable[..., Any], spawn: Spawn, endpoint: str, hook: tuple[int, list[dict[str, Any]]], tmp_path: Path
) -> None:
    """The unit's last sample is in a segment that was sealed before the restart: it was reported as well again."""
    port, posted = hook
    path = tmp_path / "alerts.toml"
    path.write_text(RULES.format(port=port))
    record = spawn("record", "--listen", endpoint, "--rotate-s", "1", "--json")
    assert record.stdout is not None
    record.stdout.readline()
    watch = watching(spawn, path)
    source = spawn("run-simulated", "--run", "n-1", "--simulate", "2", "--hours", "1", "--json")
    until(lambda: gyrofleet("status", "--json").json["segments"] >= 2)
    killed(source)
    until(lambda: len(posted) == 2)
    other = spawn("run-simulated", "--run", "n-2", "--station", "other", "--simulate", "1", "--hours", "1", "--json")
    silent = {("unit_silent", "raised"): 2, ("unit_silent", "ended"): 1}  # SIM-0001 is measured there now
    until(lambda: events(posted) == silent)
    before = gyrofleet("status", "--json").json["segments"]
    until(lambda: gyrofleet("status", "--json").json["segments"] >= before + 3)
    for _ in range(2):
        killed(watch)
        watch = watching(spawn, path)
        time.sleep(5.0)
    refused = gyrofleet("alert", "run", "--rules", path)
    assert refused.code == 1
    assert "another gyrofleet alert run is at work on this store" in refused.err
    assert events(posted) == silent

    assert watch.stdout is not None
    path.write_text(RULES.format(port=port) + '[[rules]]\nkind = "disk"\nfree_gb = "lots"\n')
    assert "Expected `float`" in json.loads(watch.stdout.readline())["text"]
    path.write_text(RULES.format(port=port) + '[[rules]]\nkind = "disk"\nfree_gb = 1e9\n')
    assert "read again" in json.loads(watch.stdout.readline())["text"]
    until(lambda: events(posted) == silent | {("disk", "raised"): 1})
    found = {each["status"]["role"]: each["condition"] for each in gyrofleet("status", "--json").json["roles"]}
    assert found["alert"] == "working"
    killed(watch)
    killed(other)
    record.terminate()
    record.communicate(timeout=60)
