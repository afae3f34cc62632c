"""The guides to parts of one's own: the file that is shown, put where the guide says, works."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Outcome
from tests.sources import SOURCES

GUIDES = Path(__file__).parents[1] / "docs" / "how-to"

Ask = Callable[..., str]


def block(guide: str, language: str) -> str:
    """The first block of a guide in a language."""
    found = re.search(rf"```{language}\n(.*?)```", (GUIDES / guide).read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return found[1]


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the packages; compiled kernels are copied with them."""
    house = tmp_path_factory.mktemp("house")
    for package in ("stream", "storage", "ingest", "analytics"):
        shutil.copytree(SOURCES / package, house / package)
    shutil.copy2(SOURCES / "gyrofleet.py", house)
    return house


@pytest.fixture
def ask(house: Path, tmp_path: Path) -> Ask:
    def run(*words: str) -> str:
        command = [sys.executable, "-m", "gyrofleet", *words]
        environment = {**os.environ, "PYTHONPATH": str(house)}
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


def test_a_metric_of_ones_own(house: Path, tmp_path: Path, ask: Ask, gyrofleet: Callable[..., Outcome]) -> None:
    (house / "analytics" / "metrics" / "bias_magnitude.sql").write_text(block("own-metric.md", "sql"), encoding="utf-8")
    rng = np.random.default_rng(4)
    rows = "\n".join(f"{i},{x:.6f}" for i, x in enumerate(rng.normal(-3.0, 0.5, 3700)))
    (tmp_path / "still.csv").write_text(f"time[s],rate[deg/h]\n{rows}")
    assert gyrofleet("import", "still.csv", "--unit", "G-1", "--procedure", "static_bias", "--store", "S").code == 0
    (found,) = json.loads(ask("metrics", "--metric", "bias_magnitude", "--store", "S", "--json"))
    assert found["lo"] < 3.0 < found["hi"]
    assert found["clause"] == "5.12.1 (19)"


@pytest.mark.long
def test_an_effect_of_ones_own(house: Path, tmp_path: Path, ask: Ask) -> None:
    effects = house / "analytics" / "loop" / "effects"
    (effects / "ambient_pressure.py").write_text(block("own-effect.md", "python"), encoding="utf-8")
    rng = np.random.default_rng(6)
    t_s = np.arange(0.0, 7200.0, 10.0)
    for run in range(6):
        pressure = 1000.0 + 50.0 * np.sin(2 * np.pi * t_s / 3600 + run)
        rate = 1.0 + 0.02 * (pressure - 1000.0) + rng.normal(0.0, 0.3, t_s.size)
        rows = "\n".join(f"{a:g},{b:.5f},{c:.3f}" for a, b, c in zip(t_s, rate, pressure, strict=True))
        (tmp_path / f"p{run}.csv").write_text(f"time[s],rate[deg/h],pressure[hPa]\n{rows}")
    ask("import", *(f"p{run}.csv" for run in range(6)), "--unit", "G-2", "--store", "S")
    found = json.loads(ask("diagnose", "--unit", "G-2", "--model", "rate = bias", "--store", "S", "--json"))
    assert [each["name"] for each in found["effects"]] == ["ambient_pressure"]
    assert found["effects"][0]["coefficient"] == pytest.approx(0.02, rel=0.05)
