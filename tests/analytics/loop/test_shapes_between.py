"""Shapes between the tried ones: what a wrong width leaves is no further effect."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stream.batch import FloatArray

NOISE_DEG_PER_H, STRENGTH_DEG_PER_H_PER_K, PER_K = 1.0, 3.0, 0.8


def played(temperature: FloatArray, width: float) -> FloatArray:
    """Output of a play of that width."""
    found = np.empty_like(temperature)
    at = temperature[0]
    for number, each in enumerate(temperature):
        at = min(max(at, each - width / 2), each + width / 2)
        found[number] = at
    return found


def cycles(number: int) -> FloatArray:
    """Triangles about 20 degC, with turning points that differ, 10 s a sample, and dwells."""
    corners = {1: (-30, 70, -10, 50, 20), 2: (-30, 40, 0, 70, 20), 3: (70, -30, 45, 10, 20), 4: (50, -30, 70, -20, 20)}
    parts, last = [np.full(60, 20.0)], 20.0
    for corner in corners[number]:
        parts += [np.linspace(last, corner, round(abs(corner - last) * 6)), np.full(90, float(corner))]
        last = corner
    return np.concatenate(parts)


@pytest.mark.parametrize("width", [6.3, 8.0])
@pytest.mark.in_gate("8.0")
def test_a_loop_of_any_width_is_one_effect(run_command: Callable[..., Any], tmp_path: Path, width: float) -> None:
    """The tried widths are 4, 10, 18, 25 and 40 degC."""
    rng = np.random.default_rng(7)
    for number in (1, 2, 3, 4):
        temperature = cycles(number)
        rates = 5.0 + PER_K * (temperature - 25) - STRENGTH_DEG_PER_H_PER_K * (temperature - played(temperature, width))
        rates += rng.normal(0, NOISE_DEG_PER_H, rates.size)
        rows = "\n".join(
            f"{10 * at},{rate:.5f},{t:.3f}" for at, (rate, t) in enumerate(zip(rates, temperature, strict=True))
        )
        (tmp_path / f"r{number}.csv").write_text(f"time[s],rate[deg/h],temperature[degC]\n{rows}\n")
    files = [f"r{number}.csv" for number in (1, 2, 3, 4)]
    assert run_command("import", *files, "--unit", "U", "--store", "s", cwd=tmp_path).code == 0
    words = ("--unit", "U", "--signal", "rate", "--model", "rate = bias + temperature", "--store", "s", "--json")
    found = run_command("diagnose", *words, cwd=tmp_path).json
    (loop,) = found["effects"]
    assert loop["name"] == "thermal_hysteresis"
    # the last widths tried are 0.05 degC apart; noise adds 2 * 1 / (3 * sqrt(9000)) = 0.007 degC
    assert abs(loop["parameters"]["width"] - width) < 0.05 + 5 * 0.007
    assert abs(loop["coefficient"] - STRENGTH_DEG_PER_H_PER_K) < 0.1
