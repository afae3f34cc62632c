"""The proof of the closed loop: campaigns with a known truth, traced and judged.

    python -m tests.bench.residual_tracing [--rows null,planted,...] [--count 10] [--first 0] [--sizes 6,10,20]
        [--peers] [--results FILE.jsonl] [--processes 2] [--minutes 30] [--only gravity_o,...] [--short] [--speed]

From the root of the checkout. Each campaign is one line of JSON in the file of results; those that are there already
are not run again. `--count` is the number of seeds: of the row ``null`` each of nine misspecifications, of ``excess``
two noises far from the declared one, of ``planted`` every effect at every size, of ``two`` three pairs a seed. The
noise is synthesised without the engine's noise model.
"""

import argparse
import json
import multiprocessing
import os
import resource
import sys
import time
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from analytics.loop.effects.registry import effects_for
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.diagnosis import FIRST_TIER, diagnose
from analytics.loop.tracing.search.screening import candidates_for, screen
from tests.bench.loop_campaign import Campaign
from tests.bench.tracing_cases import DECLARED, MODEL, ROWS, SIZES, Case, cases
from tests.bench.tracing_outcomes import traced
from tests.bench.tracing_tables import tables

SPEED_BLOCKS, SPEED_S = 30_000, 5.0
_SPEED_RUNS = 42


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", default=",".join(ROWS))
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="number of the first seed")
    parser.add_argument("--sizes", default=",".join(f"{z:g}" for z in SIZES))
    parser.add_argument("--only", default="")
    parser.add_argument("--peers", action="store_true")
    parser.add_argument("--results", type=Path, default=Path("residual_tracing.jsonl"))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=600.0)
    parser.add_argument("--short", action="store_true", help="one seed, every seventh campaign")
    parser.add_argument("--speed", action="store_true", help="only the speed")
    asked = parser.parse_args()
    if asked.speed:
        sys.exit(0 if _speed() else "the screening is too slow")
    rows = [row for row in asked.rows.split(",") if row]
    sizes = [float(z) for z in asked.sizes.split(",")]
    only = [name for name in asked.only.split(",") if name]
    count = 1 if asked.short else asked.count
    wanted = [case for row in rows for case in cases(row, count, sizes, only, first=asked.first)]
    lines = run(
        wanted[::7] if asked.short else wanted,
        asked.results,
        processes=asked.processes,
        minutes=asked.minutes,
        with_peers=asked.peers,
    )
    text, kept = tables(lines)
    print("\n".join(text))
    missing = len({case.key for case in wanted}) - len(lines)
    if missing and not asked.short:
        print(f"\n{missing} campaigns did not run")
    if not kept:
        sys.exit("a target is missed")


def run(
    wanted: Iterable[Case], results: Path, *, processes: int = 2, minutes: float = 600.0, with_peers: bool = False
) -> list[dict[str, Any]]:
    """Trace what has not been traced yet, append it to the results, and return the lines of all that was wanted."""
    cases_by_key = {case.key: case for case in wanted}
    done = {line["key"]: line for line in _read(results)}
    waiting = [case for key, case in cases_by_key.items() if key not in done]
    if not waiting:
        return [done[key] for key in cases_by_key]
    until = time.monotonic() + 60.0 * minutes
    with multiprocessing.get_context("spawn").Pool(processes) as pool, results.open("a") as file:
        work = partial(_in_time, until=until, with_peers=with_peers)
        for line in pool.imap_unordered(work, waiting, chunksize=4):
            if line is not None:
                file.write(json.dumps(line) + "\n")
                file.flush()
                done[line["key"]] = line
    return [done[key] for key in cases_by_key if key in done]


def _in_time(case: Case, *, until: float, with_peers: bool) -> dict[str, Any] | None:
    return traced(case, with_peers=with_peers) if time.monotonic() < until else None


def _read(results: Path) -> Iterator[dict[str, Any]]:
    if results.exists():
        with results.open() as file:
            yield from (json.loads(line) for line in file)


def _speed() -> bool:
    """Screen every effect on 30,000 blocks, then diagnose them; judged by the time of the processor."""
    campaign = Campaign(seed=7, runs=_SPEED_RUNS)
    runs = campaign.runs()
    case = case_of(runs, MODEL, DECLARED, ())
    best, wall = np.inf, np.inf
    for _ in range(3):
        started, start = time.process_time(), time.perf_counter()
        candidates = candidates_for([case.training], effects_for(case.stack.runs), MODEL.shaped(runs), FIRST_TIER, {})
        found = screen(candidates, [case.training.design], [DECLARED], np.random.default_rng(0))
        best, wall = min(best, time.process_time() - started), min(wall, time.perf_counter() - start)
    names = len({item.effect.name for item in candidates.items})
    print(f"{len(case.training)} blocks, {names} effects, {candidates.scale.size} columns, {found.tests:.0f} tests")
    print(f"columns and screening {best:.2f} s of processor, {wall:.2f} s by the clock (<= {SPEED_S:g} s)")
    started, start = time.process_time(), time.perf_counter()
    diagnose(runs, MODEL, declared_noise=DECLARED)
    took, by_clock = time.process_time() - started, time.perf_counter() - start
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"diagnose {took:.1f} s, {by_clock:.1f} s by the clock, {memory_mb:.0f} MB, load {os.getloadavg()[0]:.1f}")
    return bool(best <= SPEED_S * len(case.training) / SPEED_BLOCKS)


if __name__ == "__main__":
    main()
