"""Every role of a station killed again and again: is each sample recorded once, and is every estimate the same.

``python -m tests.crash.kills --kills 200``. Router, recorder, builder of the lake, estimator and source run as
processes of their own. One or another of them is killed with SIGKILL at random moments, and started again with the same
command. Runs follow each other until the kills are done and the last run has ended. Then the store must be sound, and
equal to one that the same runs were recorded to undisturbed, in one process: samples, documents and estimates.
"""

import argparse
import json
import random
import sys
import tempfile
import time
from collections import Counter
from itertools import chain, count, islice
from pathlib import Path
from typing import Any

import duckdb

from storage.sql.catalog import Catalog
from storage.store import Store
from stream.worker.compile_kernels import compile_kernels
from tests.crash.killed_station import (
    READY,
    ROLES,
    UNITS,
    Shape,
    Start,
    Station,
    Wrong,
    run_options,
    run_to_end,
    start_program,
)  # fmt: skip

_MOST_FAILURES = 5

SAMPLE_COLUMNS = "unit, signal, run, epoch, seq, t_ns, counts, value, unit_of_measure, flags"
DOCUMENTS = (  # what a restart adds is not in an undisturbed store
    "select kind, run, unit, signal, document, site, station, t_ns, uid from events "
    "where kind not in ('RunResumed', 'StoreNoted')"
)


def disturb(station: Station, shape: Shape, kills: int, rng: random.Random) -> None:
    """Run a station under so many kills."""
    for role in ROLES:
        station.start(role)
        if role in READY:  # an estimator that never was takes no run that has ended
            station.wait_until_ready(role)
    # at random, and all of them equally often in the long run
    victims = chain.from_iterable(rng.sample(ROLES, len(ROLES)) for _ in count())
    for role in islice(victims, kills):
        station.wait_for_samples()
        station.pass_time(rng.uniform(0.05, shape.kill_s))
        station.kill(role)
        time.sleep(rng.uniform(0.0, shape.kill_s / 3))
        station.start(role)
    station.finish()


def compare(killed: Catalog, whole: Catalog, runs: int) -> tuple[dict[str, int], list[str]]:
    """How many rows there are, and which are in one of two stores only."""
    wrong: list[str] = []
    rows: Counter[str] = Counter()

    def same(what: str, sql: str) -> None:
        with duckdb.connect() as connection:
            connection.register("a", killed.reader(sql).read_all())
            connection.register("b", whole.reader(sql).read_all())
            for here, there, where in (("a", "b", "killed"), ("b", "a", "undisturbed")):
                only = connection.execute(f"select * from {here} except all select * from {there}").fetchmany(3)
                if only:
                    wrong.append(f"{what}: only in the {where} store: {only}")
            ((count,),) = connection.execute("select count(*) from a").fetchall()
            rows[what.split()[0]] += count

    for number in range(1, runs + 1):
        for unit in range(1, UNITS + 1):
            name = f"run = 'run-{number}' and unit = 'SIM-{unit:04d}'"
            same(f"samples of {name}", f"select {SAMPLE_COLUMNS} from samples where {name}")
    same("estimates", "select * from estimates")
    same("documents", DOCUMENTS)
    for view, name in (("events", "uid"), ("estimates", "uid, tau_s, estimator")):
        again = killed.rows(f"select {name}, count(*) from {view} group by all having count(*) > 1")
        if again:
            wrong.append(f"{view} that are there twice: {again[:3]}")
    return dict(rows), wrong


def trial(folder: Path, kills: int, seed: int, shape: Shape, start: Start) -> dict[str, Any]:
    """Kill so often, and hold what came of it against what would have been."""
    rng = random.Random(seed)
    began = time.monotonic()
    station = Station(folder, shape, start)
    compile_kernels(quiet=True)  # else no estimator lives long enough to have them
    try:
        disturb(station, shape, kills, rng)
    finally:
        station.close()
    disturbed_s = time.monotonic() - began
    wrong = station.failures if len(station.failures) > _MOST_FAILURES else []
    runs = len(station.finished)
    for number in range(1, runs + 1):
        run_to_end(start, folder, "run-simulated", *run_options(number, shape), "--store", folder / "whole")
    for store in (station.store, folder / "whole"):
        run_to_end(start, folder, "verify", "--store", store)
    with Catalog(Store.open(station.store)) as killed, Catalog(Store.open(folder / "whole")) as whole:
        rows, different = compare(killed, whole, runs)
        ((recovered,),) = killed.rows("select count(*) from events where document->>'$.what' = 'segment_recovered'")
        ((twice,),) = killed.rows("select count(*) - count(distinct uid) from internal.lake_events")
    wrong += different
    if rows.get("samples") != runs * shape.samples:
        wrong.append(f"{rows.get('samples')} samples, {runs} runs have {runs * shape.samples}")
    wrong += [f"{role} was killed {station.kills[role]} times" for role in ROLES if 10 * station.kills[role] < kills]
    return {
        "kills": sum(station.kills.values()),
        "by_role": dict(station.kills),
        "starts": dict(station.starts),
        "ended_by_themselves": station.failures,
        "runs": runs,
        "rows": rows,
        "resent": sum(each["resent"] for each in station.finished),
        "recovered_segments": recovered,
        "documents_sent_twice": twice,
        "seconds": round(time.monotonic() - began),
        "seconds_disturbed": round(disturbed_s),
        "wrong": wrong,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="Folder for the stores and what the processes said, to look at.")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        try:
            result = trial(folder.resolve(), arguments.kills, arguments.seed, Shape(), start_program)
        except Wrong as error:
            result = {"wrong": [str(error)]}
    if arguments.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name}: {value}")
    sys.exit(1 if result["wrong"] else 0)


if __name__ == "__main__":
    main()
