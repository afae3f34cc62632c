"""A short form of the trials of killed processes: `python tests/crash/kills.py --kills 200` is the long one."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(("kills", "samples"), [(5, 500_000), pytest.param(20, 3_000_000, marks=pytest.mark.long)])
def test_killed_at_any_moment_every_role_goes_on_and_nothing_is_lost_or_there_twice(kills: int, samples: int) -> None:
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("kills.py"), "--kills", str(kills), "--seed", "20261121", "--json"],
        capture_output=True,
        text=True,
        timeout=540,
    )
    assert done.stdout, done.stderr
    result = json.loads(done.stdout)
    assert result["wrong"] == []
    assert done.returncode == 0, done.stderr
    assert (result["kills"], len(result["by_role"])) == (kills, 5)
    assert result["rows"]["samples"] >= samples
    assert result["rows"]["estimates"] >= 10 * kills
