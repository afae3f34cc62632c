"""How often U holds the truth: ``python -m tests.bench.budget_coverage [--calibrations 500]``.

Each calibration draws the errors of its instruments from their stated uncertainties (`calibrations.py`); the truth is
to lie within U in 93 to 98 % of them. Where a sensitivity is a bound, as of a flip whose axis may lie in any direction,
only 93 % is asked. A figure is OUTSIDE where the one-sided 99.9 % binomial bound, corrected for the number of figures,
excludes that; the command fails then.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from scipy import stats

from analytics.evaluation.evaluation import define_views, evaluate
from analytics.metric_registry.registry import metrics
from analytics.step_records.step_table import step_means
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.bench.calibrations import EXPECTED, calibration, stated_standards
from tests.bench.metric_steps import START_NS

LEAST, MOST = 0.93, 0.98
# A flip may lie in any direction; errors from rate to rate are also in the scatter about the line.
CONSERVATIVE = {"bias_acceleration_sensitivity", "scale_factor_asymmetry", "fitted_zero"}


class Covered(NamedTuple):
    """How often U held the truth of one figure."""

    metric: str
    of: str
    rows: int
    held: int
    held_by_type_a: int  # by k times type A alone
    mean_k: float
    is_outside: bool


def uncertain_rows(store: Store, records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the metrics that are compared, of records whose runs all have the same standards."""
    with Catalog(store) as catalog:
        catalog._unfilled.clear()  # else it would fill itself with what the store holds
        define_views(catalog, pa.Table.from_pylist(list(records), schema=step_means(catalog).schema))
        runs = sorted({record["run"] for record in records})
        of_runs = {"standards": stated_standards(), "time_zone": "UTC", "t_ns": START_NS, "recorded_ns": START_NS}
        catalog.put("run_standards", pa.Table.from_pylist([{"run": run} | of_runs for run in runs]))
        names = dict.fromkeys(metric for metric, _, _ in EXPECTED)
        table = evaluate(catalog, [metrics()[name] for name in names])
    return [json.loads(row["parameters"] or "{}") | row for row in table.to_pylist()]


def covered(store: Store, calibrations: int, seed: int) -> list[Covered]:
    """Coverage of each figure over so many calibrations."""
    rng = np.random.default_rng(seed)
    records = [record for at in range(calibrations) for record in calibration(f"C{at:04d}", rng)]
    rows = uncertain_rows(store, records)
    return [_covered(metric, where, truth, rows) for metric, where, truth in EXPECTED]


def _covered(metric: str, where: dict[str, Any], truth: float, rows: Sequence[dict[str, Any]]) -> Covered:
    mine = [
        row
        for row in rows
        if row["metric"] == metric
        and row["run"].endswith(_run_of(metric))
        and all(row[name] == value for name, value in where.items())
    ]
    lacking = [row for row in mine if row["U"] is None]
    if lacking:
        raise SystemExit(f"{metric}: {lacking[0]['reason'] or lacking[0]['uncertainty_reason']}")
    held = sum(abs(row["value"] - truth) <= row["U"] for row in mine)
    by_a = sum(abs(row["value"] - truth) <= row["k"] * row["u_type_a"] for row in mine)
    tail = 0.001 / (2 * len(EXPECTED))
    too_few = not mine or stats.binom.cdf(held, len(mine), LEAST) < tail
    too_many = metric not in CONSERVATIVE and stats.binom.sf(held - 1, len(mine), MOST) < tail
    mean_k = float(np.mean([row["k"] for row in mine])) if mine else float("nan")
    return Covered(metric, " ".join(map(str, where.values())), len(mine), held, by_a, mean_k, bool(too_few or too_many))


def _run_of(metric: str) -> str:
    return {"bias": "-static_bias", "scale_factor_asymmetry": "-scale_factor", "fitted_zero": "-scale_factor"}.get(
        metric, f"-{metric}"
    )


def line_of(row: Covered) -> str:
    share, by_a = (100 * each / max(row.rows, 1) for each in (row.held, row.held_by_type_a))
    mark = "  OUTSIDE" if row.is_outside else ""
    figures = f"{share:6.1f} % of {row.rows}, type A alone {by_a:5.1f} %, k {row.mean_k:.2f}"
    return f"{row.metric:38} {row.of:18} {figures}{mark}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calibrations", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="gyrofleet-budget-") as folder:
        found = covered(Store.create(Path(folder) / "store"), options.calibrations, options.seed)
    for row in found:
        print(json.dumps(row._asdict()) if options.json else line_of(row), flush=True)
    sys.exit(any(row.is_outside for row in found))


if __name__ == "__main__":
    main()
