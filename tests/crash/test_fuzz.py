"""Short forms of the trials of malformed messages: `python -m tests.crash.fuzz --count 100000` is the long one."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("count", "how"),
    [(1000, ()), (500, ("--process",)), (5000, ()), (2000, ("--process",))],
    ids=["in this process", "over Zenoh", "more in this process", "more over Zenoh"],
)
@pytest.mark.in_gate("in this process")
def test_what_is_malformed_is_kept_aside_and_hinders_nobody(count: int, how: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "tests.crash.fuzz", "--count", str(count), "--oversize", "1", *how]
    done = subprocess.run(
        [*command, "--seed", "20261121", "--json"], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.stdout, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    assert result["wrong"] == []
    assert done.returncode == 0, done.stderr
    assert result["malformed"] > 0.75 * count
    assert len(result["by_kind"]) == 12
    assert result["good_samples"] > 4 * count
