"""Every gate, from nothing but Python 3.11: ``python3 tests/check.py``.

Sets up ``.venv``, runs ruff, mypy, import-linter and pytest on the checkout, then builds the wheel and runs every
command's help and the demo against it, installed in a clean environment (``.venv-wheel``).
With ``--all``, the long forms of the tests run as well, and some against the lowest versions of the libraries.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DEMO = "tests/e2e/test_demo.py"
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
PARALLEL = ("--numprocesses", str((os.cpu_count() or 1) + 2), "--dist", "worksteal")


def run(*command: str | Path, cwd: Path = ROOT) -> None:
    print(f"\n$ {' '.join(str(part) for part in command)}", flush=True)
    # tests start hundreds of processes, each of which would compile the project anew
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    code = subprocess.run([str(part) for part in command], cwd=cwd, env=env, check=False).returncode
    if code != 0:
        sys.exit(f"failed with exit code {code}: {' '.join(str(part) for part in command)}")


def environment(folder: Path) -> Path:
    """A virtual environment; its folder of programs."""
    if not (folder / "bin" / "python").exists():
        print(f"making {folder}", flush=True)
        venv.create(folder, with_pip=True, clear=True)
    return folder / "bin"


def install(bin_: Path, *what: str | Path) -> None:
    """Install into an environment with uv, in a sixth of pip's time; with pip where only that knows the registry."""
    pip = (bin_ / "python", "-m", "pip", "install", "--quiet")
    run(*pip, "uv")
    with_uv = [bin_ / "uv", "pip", "install", "--quiet", "--python", bin_ / "python", *what]
    print(f"\n$ {' '.join(map(str, with_uv))}", flush=True)
    if subprocess.run(with_uv, cwd=ROOT, check=False).returncode != 0:
        run(*pip, *what)


def share_libraries(source: Path, target: Path) -> None:
    """Let one environment import the libraries of another, not what is installed editable there."""
    paths = [
        subprocess.check_output(
            [bin_ / "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], text=True
        ).strip()
        for bin_ in (source, target)
    ]
    # a .pth file adds a folder to the path; the .pth files in that folder are not read
    (Path(paths[1]) / "libraries.pth").write_text(f"{paths[0]}\n")


def development_requirements() -> list[str]:
    """The `dev` group; the pip that comes with Python 3.11 does not know groups."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        group: list[str] = tomllib.load(file)["dependency-groups"]["dev"]
    return [requirement for requirement in group if not requirement.startswith("gyrofleet")]


def main() -> None:
    parser = argparse.ArgumentParser(description="Every gate of gyrofleet, in virtual environments that it makes.")
    parser.add_argument("--all", action="store_true", help="Run the long forms of the tests as well.")
    everything = parser.parse_args().all
    chosen = ("-m", "") if everything else ()
    if sys.version_info < (3, 11):
        sys.exit(f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}")
    bin_ = environment(ROOT / ".venv")
    install(bin_, "--editable", ".[test]", *development_requirements())
    run(bin_ / "ruff", "check", ".")
    run(bin_ / "ruff", "format", "--check", ".")
    run(bin_ / "mypy")
    run(bin_ / "lint-imports")
    # runs the notebook; a warning, as of a link that leads nowhere, fails
    run(bin_ / "sphinx-build", "-q", "-W", "--keep-going", "docs", "docs/_build/html")
    # the demo runs against the wheel
    run(bin_ / "python", "-m", "pytest", *PARALLEL, *chosen, f"--ignore={DEMO}")

    with tempfile.TemporaryDirectory() as temporary:
        there = Path(temporary)
        run(bin_ / "python", "-m", "build", "--wheel", "--outdir", there / "dist", ".")
        (wheel,) = (there / "dist").glob("*.whl")
        shutil.rmtree(ROOT / ".venv-wheel", ignore_errors=True)
        clean = environment(ROOT / ".venv-wheel")
        install(clean, "--no-deps", wheel)
        share_libraries(bin_, clean)
        # beside nothing of the checkout but its tests, so that only the wheel can be imported
        shutil.copytree(ROOT / "tests", there / "project" / "tests", ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", there / "project")
        shared = ROOT.parent / "shared"
        if shared.exists():
            (there / "shared").symlink_to(shared)
        # files that are no Python, every command, and the whole path
        again = ("tests/test_house.py", "tests/test_commands.py", DEMO)
        run(clean / "python", "-m", "pytest", *PARALLEL, *again, cwd=there / "project")

    if everything:
        lowest = environment(ROOT / ".venv-lowest")
        install(lowest, "--resolution", "lowest-direct", "--editable", ".[test]")
        run(lowest / "python", "-m", "pytest", *PARALLEL, "-p", "no:cacheprovider", *LOWEST)


if __name__ == "__main__":
    main()
