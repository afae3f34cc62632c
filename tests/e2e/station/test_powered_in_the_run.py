"""Units that are off when the run begins, and send as soon as a step powers them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.e2e.conftest import finish


@pytest.mark.parametrize("rate_hz", [100])
def test_the_first_samples_after_power_on_are_numbered_once(
    gyrofleet: Callable[..., Any], tmp_path: Path, simulated: Callable[..., Any], rate_hz: int
) -> None:
    """The bus of a unit that is off had given its first sample a number which the sources after power-on gave again."""
    bench = simulated(tmp_path / "sim", "--speed", 4, "--rate-hz", rate_hz, "--units", 1)
    try:
        done = gyrofleet(*bench.run("power_consumption", "--set", "warm_up_s=4", "--set", "power_record_s=20"))
    finally:
        finish(bench)
    assert done.code == 0, done.err
    assert "no recorder has acknowledged" not in done.err
    query = "select samples from signals where unit = 'SIM-0001' and signal = 'rate'"
    ((samples,),) = (tuple(row.values()) for row in json.loads(gyrofleet("sql", query, "--store", "S", "--json").out))
    assert 0.9 * 24 * rate_hz < samples < 1.3 * 24 * rate_hz
