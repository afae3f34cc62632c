"""Every gate, from nothing but Python 3.11: ``python3 tests/check.py``.

Makes ``.venv-check`` and installs there the wheel that it builds, as users do. Runs ruff, and pytest beside nothing of
the checkout but its tests and documents, so that only the wheel can be imported. Examples in docstrings come first;
mypy, import-linter and the build of the documentation run while tests wait. Files of tests are in memory where there
is room. With ``--all``, they are on the disk, the pages of the documentation are written and not only checked, the
long forms of the tests run as well, and some against the lowest versions of the libraries. The folders ``.venv-*`` may
be deleted.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parents[1]
# what touches each library, run against the lowest versions that pyproject.toml allows
LOWEST = (
    "tests/test_commands.py",
    "tests/e2e/test_api_store.py",
    "tests/e2e/test_spectrum.py",
    "tests/e2e/test_sql.py",
    "tests/ingest/can/test_can_bus.py",
    "tests/ingest/can/test_can_log.py",
    "tests/analytics/trends/test_trends_report.py",
)
# more than there are processors: many tests wait for processes of their own
PARALLEL = (
    "--numprocesses", str((os.cpu_count() or 1) + 2), "--dist", "loadfile", "--no-loadscope-reorder",
)  # fmt: skip
# of examples in docstrings; those of the kernels first, which are compiled then
PACKAGES = ("stream", "storage", "ingest", "analytics")
# the search for garbage, of which there is none, takes mypy a fifth of its time, and the examples a twelfth; mypy would
# take it up again by itself
UNSEARCHED = "import gc; gc.disable(); gc.enable = lambda: None; "
MYPY = UNSEARCHED + "from mypy.__main__ import console_entry; console_entry()"
EXAMPLES = UNSEARCHED + "from pytest import console_main; console_main()"

# tests make stores by the thousand, and what is recorded is synced
MEMORY = Path("/dev/shm")
ROOM_BYTES = 8 << 30

Command = Sequence[str | Path]


def run(*command: str | Path, cwd: Path = ROOT) -> None:
    print(f"\n$ {' '.join(str(part) for part in command)}", flush=True)
    if (code := exit_code(command, cwd=cwd)) != 0:
        sys.exit(f"failed with exit code {code}: {' '.join(str(part) for part in command)}")


def exit_code(
    command: Command, *, cwd: Path = ROOT, output: IO[str] | int | None = None, temporary: Path | None = None
) -> int:
    # tests start hundreds of processes, each of which would compile the project again
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    # more tests run than there are processors: threads of the linear algebra would only wait for each other
    for library in ("OPENBLAS", "OMP"):
        env.setdefault(f"{library}_NUM_THREADS", "1")
    if temporary is not None:
        env["TMPDIR"] = str(temporary)
    words = [str(part) for part in command]
    return subprocess.run(words, cwd=cwd, env=env, stdout=output, stderr=output, check=False).returncode


def environment(folder: Path) -> Path:
    """A virtual environment with uv and without the project; its folder of programs."""
    bin_ = folder / "bin"
    pip = (bin_ / "python", "-m", "pip")
    if not (bin_ / "uv").exists():
        print(f"making {folder}", flush=True)
        venv.create(folder, with_pip=True, clear=True)
        run(*pip, "install", "--quiet", "uv")
    if (bin_ / "gyrofleet").exists():
        run(*pip, "uninstall", "--quiet", "--yes", "gyrofleet")
    return bin_


def with_uv_or_pip(uv: Command, pip: Command) -> None:
    """Run a command of uv, which takes a sixth of pip's time; that of pip where only pip knows the registry."""
    print(f"\n$ {' '.join(map(str, uv))}", flush=True)
    if exit_code(uv) != 0:
        run(*pip)


def install(bin_: Path, *what: str | Path) -> None:
    """Install into an environment."""
    python = bin_ / "python"
    with_uv_or_pip(
        (bin_ / "uv", "pip", "install", "--quiet", "--python", python, *what),
        (python, "-m", "pip", "install", "--quiet", *what),
    )


def build_wheel(bin_: Path, folder: Path) -> Path:
    """The wheel of the checkout."""
    python = bin_ / "python"
    with_uv_or_pip(
        (bin_ / "uv", "build", "--quiet", "--wheel", "--python", python, "--out-dir", folder, ROOT),
        (python, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT),
    )
    (wheel,) = folder.glob("*.whl")
    return wheel


def development_requirements() -> list[str]:
    """The `dev` group; the pip that comes with Python 3.11 does not know groups."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        group: list[str] = tomllib.load(file)["dependency-groups"]["dev"]
    return [requirement for requirement in group if not requirement.startswith("gyrofleet")]


def check_meanwhile(log: Path, *commands: Command, cwd: Path = ROOT, niceness: int = 10) -> int:
    """Run commands one after the other, by default in the time that others leave; their output goes to a file."""
    with log.open("w") as file:
        for command in commands:
            file.write(f"\n$ {' '.join(map(str, command))}\n")
            file.flush()
            if code := exit_code(("nice", "-n", str(niceness), *command), cwd=cwd, output=file):
                file.write(f"failed with exit code {code}\n")
                return code
    return 0


def beside_the_wheel(there: Path) -> Path:
    """A folder with tests, documents and files of deployment of the checkout, and none of its packages."""
    project = there / "project"
    for name in ("tests", "docs", "deploy"):
        shutil.copytree(
            ROOT / name, project / name, ignore=shutil.ignore_patterns("__pycache__", "_build", "_generated")
        )
    for name in ("README.md", "CHANGELOG.md", "pyproject.toml"):
        shutil.copy(ROOT / name, project)
    shared = ROOT.parent / "shared"
    if shared.exists():
        (there / "shared").symlink_to(shared)
    return project


def folder_in_memory() -> Path | None:
    """A folder in memory, where there is one with room for the files of all tests."""
    has_room = os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free >= ROOM_BYTES
    return MEMORY if has_room else None


def main() -> None:
    parser = argparse.ArgumentParser(description="Every gate of gyrofleet, in virtual environments that it makes.")
    parser.add_argument("--all", action="store_true", help="Run the long forms of the tests as well.")
    everything = parser.parse_args().all
    chosen = ("-m", "") if everything else ()
    if sys.version_info < (3, 11):
        sys.exit(f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}")
    bin_ = environment(ROOT / ".venv-check")
    folder = None if everything else folder_in_memory()
    with tempfile.TemporaryDirectory(dir=folder) as temporary, ThreadPoolExecutor() as pool:
        there = Path(temporary)
        wheel = build_wheel(bin_, there / "dist")
        extras = "spark,test" if everything else "test"  # Spark is half a gigabyte
        install(bin_, f"{wheel}[{extras}]", *development_requirements())
        run(bin_ / "ruff", "check", ".")
        run(bin_ / "ruff", "format", "--check", ".")
        logs = [there / f"{name}.txt" for name in ("sources", "documents", "examples")]
        meanwhile = [pool.submit(check_meanwhile, logs[0], (bin_ / "python", "-c", MYPY), (bin_ / "lint-imports",))]
        project = beside_the_wheel(there)
        pytest = (bin_ / "python", "-m", "pytest")
        # once, else each of the parallel processes would compile the tests, and the machine code that they call
        collecting = (*pytest, "--collect-only", "tests")
        before = [pool.submit(exit_code, collecting, cwd=project, output=subprocess.DEVNULL)]
        # all in one process, which imports all modules once; that of `warm_up` compiles all kernels of estimators
        examples = (bin_ / "python", "-c", EXAMPLES, "-q", "--pyargs", *PACKAGES)
        before.append(pool.submit(check_meanwhile, logs[2], examples, cwd=project, niceness=0))
        _, of_examples = (each.result() for each in before)
        # runs the notebook; a warning, as of a link that leads nowhere, fails, also where no pages are written
        builder = "html" if everything else "dummy"
        sphinx = (bin_ / "sphinx-build", "-b", builder, "-q", "-W", "--keep-going", "docs", f"docs/_build/{builder}")
        meanwhile.append(pool.submit(check_meanwhile, logs[1], sphinx))
        testing = (*pytest, *PARALLEL, *chosen, "tests")
        print(f"\n$ {' '.join(map(str, testing))}", flush=True)
        codes = [exit_code(testing, cwd=project, temporary=there), of_examples, *(each.result() for each in meanwhile)]
        for log in logs:
            print(log.read_text(), flush=True)
        if any(codes):
            sys.exit("failed: see above")
    if everything:
        lowest = environment(ROOT / ".venv-lowest")
        install(lowest, "--resolution", "lowest-direct", "--editable", ".[test]")
        run(lowest / "python", "-m", "pytest", *PARALLEL, "-p", "no:cacheprovider", *LOWEST)


if __name__ == "__main__":
    main()
