"""A short form of the trials of damage: `python tests/crash/damage.py --count 1000` is the long one."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.crash.damage import trials

SEED = 20261121


def test_damage_at_any_place_is_found_and_mended() -> None:
    """Once in each kind of file, in a store of two segments and in this process."""
    result = trials(6, SEED, segments=2)
    assert (result["trials"], result["wrong"]) == (6, [])
    assert len(result["by_kind"]) == 6


@pytest.mark.long
@pytest.mark.parametrize("count", [6, 60])
def test_damage_at_any_place_of_a_longer_store_is_found_and_mended(count: int) -> None:
    done = subprocess.run(
        [sys.executable, Path(__file__).with_name("damage.py"), "--count", str(count), "--seed", str(SEED), "--json"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["trials"], result["wrong"]) == (count, [])
    assert len(result["by_kind"]) == 6
