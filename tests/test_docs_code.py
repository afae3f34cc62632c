"""Code of the tutorials and guides, run from top to bottom in an empty folder."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
BLOCK = re.compile(r"^```(python|sh|text)\n(.*?)^```", re.DOTALL | re.MULTILINE)
RUN = (
    "tutorials/laboratory.md",
    pytest.param("tutorials/test-engineer.md", marks=pytest.mark.long),
    pytest.param("tutorials/quality-manager.md", marks=pytest.mark.long),
    pytest.param("tutorials/model-engineer.md", marks=pytest.mark.long),
)


def environment() -> dict[str, str]:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "COLUMNS": "160"}


def run(kind: str, code: str, folder: Path) -> str:
    """Run a block; its output."""
    command = [sys.executable, "-c", code] if kind == "python" else ["bash", "-euo", "pipefail", "-c", code]
    done = subprocess.run(
        command, cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300
    )
    assert done.returncode == 0, f"{code}\n{done.stdout}"
    assert "Traceback" not in done.stdout, done.stdout
    return done.stdout


@contextmanager
def running(code: str, folder: Path) -> Iterator[None]:
    """Run a service beside the blocks that follow; it has to end in order when it is interrupted."""
    with (folder / "service.log").open("w") as log:
        service = subprocess.Popen(
            ["bash", "-c", f"exec {code.splitlines()[1]}"], cwd=folder, env=environment(), stdout=log, stderr=log
        )
        try:
            yield
            service.send_signal(signal.SIGINT)
            assert service.wait(60) == 0, (folder / "service.log").read_text()
        finally:
            service.kill()
            service.wait()


@pytest.fixture
def beside() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.mark.long
@pytest.mark.parametrize("page", RUN)
def test_code_blocks_run_and_give_the_output_that_is_shown(page: str, tmp_path: Path, beside: ExitStack) -> None:
    output = ""
    blocks = BLOCK.findall((DOCS / page).read_text(encoding="utf-8"))
    assert len(blocks) > 3
    for kind, code in blocks:
        if code.startswith("# in a terminal of its own\n"):
            beside.enter_context(running(code, tmp_path))
        elif kind == "text":
            for line in filter(lambda line: line.strip(" ."), code.splitlines()):
                assert " ".join(line.split()) in " ".join(output.split()), f"not in the output:\n{line}\n{output}"
        else:
            output = run(kind, code, tmp_path)
            print(output)
