"""A short form of the trials of damage: `python tests/crash/damage.py --count 1000` is the long one."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize("count", [6, pytest.param(60, marks=pytest.mark.long)])
def test_damage_at_any_place_is_found_and_mended(count: int) -> None:
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("damage.py"), "--count", str(count), "--seed", "20261121", "--json"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["trials"], result["wrong"]) == (count, [])
    assert len(result["by_kind"]) == 6
