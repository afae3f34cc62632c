"""Every gate, from nothing but Python 3.11: ``python3 tests/check.py``.

Makes ``.venv-check`` and installs there the wheel that it builds, as users do. Runs ruff, mypy and import-linter on the
checkout, builds the documentation, and runs pytest beside nothing of the checkout but its tests and documents, so that
only the wheel can be imported. With ``--all``, the long forms of the tests run as well, and some against the lowest
versions of the libraries. The folders ``.venv-*`` may be deleted.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

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
PARALLEL = ("--numprocesses", str((os.cpu_count() or 1) + 2), "--dist", "worksteal")


def run(*command: str | Path, cwd: Path = ROOT) -> None:
    print(f"\n$ {' '.join(str(part) for part in command)}", flush=True)
    # tests start hundreds of processes, each of which would compile the project anew
    env = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    # more tests run than there are processors: threads of the linear algebra would only wait for each other
    for library in ("OPENBLAS", "OMP"):
        env.setdefault(f"{library}_NUM_THREADS", "1")
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


def development_requirements() -> list[str]:
    """The `dev` group; the pip that comes with Python 3.11 does not know groups."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        group: list[str] = tomllib.load(file)["dependency-groups"]["dev"]
    return [requirement for requirement in group if not requirement.startswith("gyrofleet")]


def check_sources(bin_: Path, log: Path) -> int:
    """Everything that reads the checkout; its output goes to a file, since the documentation is built meanwhile."""
    with log.open("w") as file:
        for command in (("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy",), ("lint-imports",)):
            file.write(f"\n$ {' '.join(command)}\n")
            file.flush()
            words = [str(bin_ / command[0]), *command[1:]]
            if code := subprocess.run(words, cwd=ROOT, stdout=file, stderr=file, check=False).returncode:
                return code
    return 0


def beside_the_wheel(there: Path) -> Path:
    """A folder with the tests and documents of the checkout, and none of its packages."""
    project = there / "project"
    for name in ("tests", "docs"):
        shutil.copytree(
            ROOT / name, project / name, ignore=shutil.ignore_patterns("__pycache__", "_build", "_generated")
        )
    for name in ("README.md", "CHANGELOG.md", "pyproject.toml"):
        shutil.copy(ROOT / name, project)
    shared = ROOT.parent / "shared"
    if shared.exists():
        (there / "shared").symlink_to(shared)
    return project


def main() -> None:
    parser = argparse.ArgumentParser(description="Every gate of gyrofleet, in virtual environments that it makes.")
    parser.add_argument("--all", action="store_true", help="Run the long forms of the tests as well.")
    everything = parser.parse_args().all
    chosen = ("-m", "") if everything else ()
    if sys.version_info < (3, 11):
        sys.exit(f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}")
    bin_ = environment(ROOT / ".venv-check")
    with tempfile.TemporaryDirectory() as temporary:
        there = Path(temporary)
        install(bin_, "build")
        run(bin_ / "python", "-m", "build", "--wheel", "--outdir", there / "dist", ".")
        (wheel,) = (there / "dist").glob("*.whl")
        run(bin_ / "python", "-m", "pip", "uninstall", "--quiet", "--yes", "gyrofleet")
        install(bin_, f"{wheel}[test]", *development_requirements())
        with ThreadPoolExecutor() as pool:
            sources = pool.submit(check_sources, bin_, there / "sources.txt")
            # runs the notebook; a warning, as of a link that leads nowhere, fails
            run(bin_ / "sphinx-build", "-q", "-W", "--keep-going", "docs", "docs/_build/html")
            project = beside_the_wheel(there)
            # once, else each of the parallel processes would compile them
            run(bin_ / "python", "-c", "from stream.worker.compile_kernels import warm_up; warm_up()", cwd=project)
            code = sources.result()
        print((there / "sources.txt").read_text(), flush=True)
        if code != 0:
            sys.exit(f"failed with exit code {code}")
        packages = ("--pyargs", "stream", "storage", "ingest", "analytics")
        run(bin_ / "python", "-m", "pytest", *PARALLEL, *chosen, "tests", *packages, cwd=project)
    if everything:
        lowest = environment(ROOT / ".venv-lowest")
        install(lowest, "--resolution", "lowest-direct", "--editable", ".[test]")
        run(lowest / "python", "-m", "pytest", *PARALLEL, "-p", "no:cacheprovider", *LOWEST)


if __name__ == "__main__":
    main()
