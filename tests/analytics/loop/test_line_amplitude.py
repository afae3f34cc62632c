"""The amplitude of a periodic line is that of the rate, not that of the blocks that were fitted."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

AMPLITUDE_DEG_PER_H, FREQUENCY_HZ = 14.4, 0.013  # blocks of 30 s leave sin(pi f T)/(pi f T) = 0.77 of it


@pytest.mark.parametrize("block", ["30s", "10s"])
@pytest.mark.in_gate("30s")
def test_the_amplitude_does_not_depend_on_the_blocks(
    run_command: Callable[..., Any], tmp_path: Path, block: str
) -> None:
    rng = np.random.default_rng(21)
    for number in (1, 2, 3):
        at = np.arange(7200.0)
        line = AMPLITUDE_DEG_PER_H * np.sin(2 * np.pi * FREQUENCY_HZ * at + number)
        rates = 5.0 + line + rng.normal(0, 20.0, at.size)
        rows = "\n".join(f"{second:.0f},{rate:.5f}" for second, rate in zip(at, rates, strict=True))
        (tmp_path / f"r{number}.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
    files = [f"r{number}.csv" for number in (1, 2, 3)]
    assert run_command("import", *files, "--unit", "U", "--store", "s", cwd=tmp_path).code == 0
    words = ("--unit", "U", "--signal", "rate", "--model", "rate = bias", "--block", block, "--store", "s", "--json")
    found = run_command("diagnose", *words, cwd=tmp_path).json
    (line,) = found["effects"]  # and no second one beside it, of what a frequency of a grid leaves
    assert line["name"] == "periodic_line"
    # bounds by Cramer and Rao, five deviations: 20 deg/h in 3 runs of 7200 s
    assert abs(line["parameters"]["frequency_hz"] - FREQUENCY_HZ) < 5e-6
    assert abs(line["coefficient"] - AMPLITUDE_DEG_PER_H) < 5 * 20.0 * np.sqrt(2 / (3 * 7200)) / 0.77
    assert line["lo"] < AMPLITUDE_DEG_PER_H < line["hi"]
