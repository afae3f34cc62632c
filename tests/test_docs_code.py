"""Code of the tutorials and guides, run from top to bottom in an empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
BLOCK = re.compile(r"^```(python|sh|text)\n(.*?)^```", re.DOTALL | re.MULTILINE)
RUN = ("tutorials/quality-manager.md", "tutorials/model-engineer.md", "tutorials/laboratory.md")


def run(kind: str, code: str, folder: Path) -> str:
    """Run a block; its output."""
    command = [sys.executable, "-c", code] if kind == "python" else ["bash", "-euo", "pipefail", "-c", code]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "COLUMNS": "160"}
    done = subprocess.run(
        command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300
    )
    assert done.returncode == 0, f"{code}\n{done.stdout}"
    assert "Traceback" not in done.stdout, done.stdout
    return done.stdout


@pytest.mark.parametrize("page", RUN)
def test_code_blocks_run_and_give_the_output_that_is_shown(page: str, tmp_path: Path) -> None:
    output = ""
    blocks = BLOCK.findall((DOCS / page).read_text(encoding="utf-8"))
    assert len(blocks) > 3
    for kind, code in blocks:
        if kind == "text":
            for line in filter(lambda line: line.strip(" ."), code.splitlines()):
                assert " ".join(line.split()) in " ".join(output.split()), f"not in the output:\n{line}\n{output}"
        else:
            output = run(kind, code, tmp_path)
            print(output)
