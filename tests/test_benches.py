"""Every benchmark can be started: its modules are there, and the files of the project that it names."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
NAMES = sorted(path.stem for path in (ROOT / "tests/bench").glob("*.py"))
# of the extra `bench`, or of measured data that stand outside
APART = {"chdb", "pyspark", "moto"}


@pytest.mark.parametrize("name", NAMES)
def test_a_benchmark_finds_its_modules_and_files(name: str) -> None:
    try:
        module = importlib.import_module(f"tests.bench.{name}")
    except ModuleNotFoundError as error:
        if error.name in APART:
            pytest.skip(f"{error.name} is not installed")
        raise
    named = {key: value for key, value in vars(module).items() if isinstance(value, Path)}
    lost = [f"{key} = {value}" for key, value in named.items() if value.is_relative_to(ROOT) and not value.exists()]
    assert lost == []


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_benchmark_explains_itself(name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", f"tests.bench.{name}", "--help"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0 or "not installed" in done.stderr, done.stderr[-1000:]
