"""How long the metrics of a fleet take: ``python -m tests.bench.fleet_metrics [fleet|growth|raw]``.

`fleet` asks for the metrics of 1000 units with an hour a day over 30 days and a test at five temperatures, from the
kept records of their 35,000 steps: the bias family with temperature sensitivity and repeatability, and then every
metric there is, computed for the first time, and once more when nothing has changed. `growth` does so for 10 to 10,000
units. `raw` writes a day of 100 units at 100 Hz to the disk, 8.6e8 rows, and times the records of its steps: from the
lake's means of seconds, as a step of that length is reduced, and from means of seconds made from all raw rows.
"""

import argparse
import json
import os
import platform
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from analytics.evaluation.kept_metrics import unit_metrics
from analytics.metric_registry.registry import metrics
from analytics.step_records import reduction
from analytics.step_records.step_table import step_means
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.bench.fleet_lake import Fleet, write_raw_day

FAMILY = "bias"


def best_of(count: int, ask: Callable[[], Any]) -> tuple[float, float, Any]:
    """Seconds on the clock and of the processors in the fastest of some tries, and what came out."""
    tries, found = [], None
    for _ in range(count):
        begin, used = time.perf_counter(), time.process_time()
        found = ask()
        tries.append((time.perf_counter() - begin, time.process_time() - used))
    return min(tries)[0], min(each for _, each in tries), found


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def one(store: Store) -> int:
    """One metric from the kept records of the steps; how many rows."""
    (store.folder / "metrics" / "unit_metrics.parquet").unlink(missing_ok=True)
    with Catalog(store) as catalog, catalog.suspended_layers():
        unit_metrics(catalog, wanted=[FAMILY])
        return int(catalog.rows("select count(*) from unit_metrics")[0][0])


def family(store: Store) -> int:
    """The bias family from the kept records of the steps; how many rows."""
    (store.folder / "metrics" / "unit_metrics.parquet").unlink(missing_ok=True)
    with Catalog(store) as catalog, catalog.suspended_layers():
        unit_metrics(catalog, wanted=[name for name in metrics() if name.startswith(FAMILY)])
        return int(catalog.rows("select count(*) from unit_metrics")[0][0])


def every(store: Store, *, again: bool) -> int:
    """Every metric; how many rows."""
    if again:
        (store.folder / "metrics" / "unit_metrics.parquet").unlink(missing_ok=True)
    with Catalog(store) as catalog:
        return int(catalog.rows("select count(*) from unit_metrics")[0][0])


def fleet(folder: Path, units: int, days: int, tries: int) -> dict[str, Any]:
    made = Fleet(folder / f"store-{units}", units, days)
    begin = time.perf_counter()
    made.write()
    written_s = time.perf_counter() - begin
    store = made.store
    opened_s, _, _ = best_of(tries, lambda: Catalog(store).close())
    one_s, _, _ = best_of(tries, lambda: one(store))
    family_s, family_cpu_s, family_rows = best_of(tries, lambda: family(store))
    anew_s, anew_cpu_s, rows = best_of(tries, lambda: every(store, again=True))
    again_s, again_cpu_s, _ = best_of(tries, lambda: every(store, again=False))
    return {
        "units": units,
        "step_records": units * (days + 5) * 2,
        "written_s": written_s,
        "catalogue_opened_s": opened_s,
        "one_metric_s": one_s,
        "bias_family_s": family_s,
        "bias_family_cpu_s": family_cpu_s,
        "bias_family_rows": family_rows,
        "every_metric_s": anew_s,
        "every_metric_cpu_s": anew_cpu_s,
        "every_metric_rows": rows,
        "nothing_changed_s": again_s,
        "nothing_changed_cpu_s": again_cpu_s,
        "kept_mb": sum(each.stat().st_size for each in (store.folder / "metrics").iterdir()) / 1e6,
        "peak_mb": peak_mb(),
    }


# What the lake's means of seconds are made from, by SQL from the raw rows; the sums of squares in a second pass
FROM_RAW = """
select unit, signal, t_ns // 1000000000 * 1000000000 as t_ns, count(*) as n, avg(value) as mean,
  var_pop(value) * count(*) as m2, min(value) as lo, max(value) as hi
from samples
where run = $run and unit in (select unnest($units)) and signal in (select unnest($signals))
  and t_ns between $first and $last
group by unit, signal, t_ns // 1000000000 order by unit, signal, t_ns"""


def records(store: Store) -> Any:
    """The records of all steps, again."""
    shutil.rmtree(store.folder / "metrics", ignore_errors=True)
    with Catalog(store) as catalog:
        return step_means(catalog)


def raw(folder: Path, units: int) -> dict[str, Any]:
    begin = time.perf_counter()
    there = folder / "raw"
    store = Store.open(there) if there.exists() else write_raw_day(there, units, 100)
    written_s = time.perf_counter() - begin
    written_mb = peak_mb()
    rolled_s, rolled_cpu_s, rolled = best_of(2, lambda: records(store))
    rolled_mb = peak_mb()
    reduction._SECONDS = FROM_RAW
    raw_s, raw_cpu_s, found = best_of(1, lambda: records(store))
    for name in ("n", "mean", "sd", "standard_uncertainty", "sd_100s"):
        assert np.allclose(found[name].to_numpy(), rolled[name].to_numpy(), rtol=1e-9), name
    return {
        "units": units,
        "rows": sum(found["n"].to_pylist()),
        "disk_mb": sum(each.stat().st_size for each in store.lake.rglob("*.parquet")) / 1e6,
        "written_s": written_s,
        "written_peak_mb": written_mb,
        "records_from_seconds_s": rolled_s,
        "records_from_seconds_cpu_s": rolled_cpu_s,
        "records_from_seconds_peak_mb": rolled_mb,
        "records_from_raw_rows_s": raw_s,
        "records_from_raw_rows_cpu_s": raw_cpu_s,
        "peak_mb": peak_mb(),
    }


def machine() -> str:
    return f"{platform.machine()}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}, Python {sys.version[:6]}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mode", nargs="?", choices=("fleet", "growth", "raw"), default="fleet")
    parser.add_argument("--units", type=int, default=None, help="1000 for fleet, 100 for raw")
    parser.add_argument("--days", type=int, default=30)
    parser.add_argument("--tries", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="where to work; kept then")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gyrofleet-fleet-"))
    sizes = (10, 100, 1000, 10_000) if options.mode == "growth" else (options.units or 1000,)
    print(machine())
    try:
        if options.mode == "raw":
            show(raw(folder, options.units or 100), as_json=options.json)
        else:
            for units in sizes:
                show(fleet(folder, units, options.days, options.tries), as_json=options.json)
    finally:
        if options.folder is None:
            shutil.rmtree(folder)


def show(found: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(found), flush=True)
        return
    for name, value in found.items():
        print(f"{name:30} {value:,.4g}" if isinstance(value, float) else f"{name:30} {value:,}", flush=True)


if __name__ == "__main__":
    main()
