"""Fixtures for all tests: the measured recordings, and the command line as a user runs it."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def measured() -> Path:
    """Folder of the measured recordings; the test is skipped where it is absent."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(f"the measured recordings are not in {folder}")
    return folder


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


@pytest.fixture(scope="session")
def command_line() -> Callable[..., list[str]]:
    """The installed console script with arguments, for a process that a test starts itself."""
    program = str(Path(sys.executable).with_name("gyrofleet"))
    return lambda *arguments: [program, *(str(argument) for argument in arguments)]


@pytest.fixture
def gyrofleet(tmp_path: Path, command_line: Callable[..., list[str]]) -> Callable[..., Outcome]:
    """Run a command in a process of its own, in an empty folder."""

    def run(*arguments: object, timeout_s: float = 120.0) -> Outcome:
        done = subprocess.run(
            command_line(*arguments),
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            env={**os.environ, "PYTHONWARNINGS": "error", "COLUMNS": "200"},
        )
        assert "Traceback" not in done.stderr, done.stderr
        return Outcome(done.returncode, done.stdout, done.stderr)

    return run
