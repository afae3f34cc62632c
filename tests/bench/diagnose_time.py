"""Seconds from the start of `gyrofleet diagnose` to its verdict: ``python -m tests.bench.diagnose_time --mean-s 10``.

Makes the campaign of `loop_files`, fifteen runs of six hours with a planted effect, imports it, and diagnoses the unit
several times, each by a process of its own. It prints the wall time of each, and its CPU time, which other work on the
machine changes less. A first diagnosis, which is not measured, compiles the kernels, and the modules to the bytecode
that `pip install` writes.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.bench.loop_campaign import DECLARED_MODEL, Campaign
from tests.bench.loop_files import written
from tests.bench.tracing_cases import built, cases

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-m", "gyrofleet"]


def made(folder: Path, effect: str, mean_s: float) -> Path:
    """A store with the campaign."""
    (case,) = [each for each in cases("planted", 1, [10.0], [effect], first=0) if each.name == effect][:1]
    campaign = Campaign(case.seed, block_s=10.0)
    runs = campaign.runs(built(case).planted, noise_seed=case.noise_seed)
    files = written(folder, campaign, runs, mean_s)
    store = folder / "store"
    command = [*COMMAND, "import", *map(str, files), "--unit", "FOG-0231", "--store", str(store)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return store


def timed(store: Path) -> tuple[float, float]:
    """Wall and CPU seconds of one diagnosis."""
    asked = ["diagnose", "--unit", "FOG-0231", "--model", f"rate = {DECLARED_MODEL}", "--store", str(store)]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([*COMMAND, *asked], cwd=ROOT, check=True, capture_output=True, env=environment)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--effect", default="temperature_rate")
    parser.add_argument("--mean-s", type=float, default=10.0)
    parser.add_argument("--times", type=int, default=5)
    parser.add_argument("--store", type=Path, help="a store that is there, of FOG-0231")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="gyrofleet-diagnose-") as name:
        store = asked.store or made(Path(name), asked.effect, asked.mean_s)
        timed(store)
        measured = [timed(store) for _ in range(asked.times)]
    for wall, cpu in measured:
        print(f"{wall:.2f} s, CPU {cpu:.2f} s")
    print(f"best {min(wall for wall, _ in measured):.2f} s, CPU {min(cpu for _, cpu in measured):.2f} s")


if __name__ == "__main__":
    main()
