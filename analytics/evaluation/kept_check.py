"""Check of the kept metrics for `gyrofleet verify`: recomputing gives the same."""

import tempfile
import time
from collections.abc import Collection
from pathlib import Path

import polars as pl
import pyarrow as pa

from analytics.evaluation import kept_metrics
from analytics.step_records import FOLDER, step_table
from analytics.step_records.step_table import hash_path, open_kept
from storage.findings import KEPT_DAMAGED, Finding, Severity
from storage.sql.catalog import Catalog
from storage.store import Store

_ATTEMPTS = 3
_REMEDY = "move it to lake-aside; it is recomputed when it is next needed"


def kept_findings(store: Store) -> list[Finding]:
    """Damage of the kept files, and values that do not follow from the lake; outdated ones are no finding."""
    paths = [store.folder / FOLDER / name for name in (step_table.FILE, kept_metrics.FILE)]
    damaged = "its content does not agree with its hash"
    found = [_finding(path, damaged) for path in paths if _is_damaged(path)]
    steps, (metrics, prints) = step_table.kept_steps(store.folder), kept_metrics.kept_metrics(store.folder)
    if steps is None and not prints:
        return found
    with (
        tempfile.TemporaryDirectory(prefix="gyrofleet-verify-") as scratch,
        Catalog(store, kept=Path(scratch)) as catalog,
    ):
        kept_metrics.unit_metrics(catalog)
        with catalog.suspended_layers():
            metrics_now = pl.DataFrame(catalog.table("from unit_metrics"))
        steps_now = step_table.kept_steps(Path(scratch))
        _, prints_now = kept_metrics.kept_metrics(Path(scratch))
    if steps is not None and steps_now is not None:
        marks, marks_now = step_table.kept_prints(steps), step_table.kept_prints(steps_now)
        same = {run for run, mark in marks.items() if marks_now.get(run) == mark}
        found += _changed(paths[0], "run", steps, steps_now, same)
    parts = {unit: mark.partition(":") for unit, mark in prints.items()}
    same = {unit for unit, (mark, _, _) in parts.items() if prints_now.get(unit) == mark}
    for unit, (_, colon, names) in parts.items():
        if colon:  # some metrics only
            metrics_now = metrics_now.filter((pl.col("unit") != unit) | pl.col("metric").is_in(names.split(",")))
    if metrics is not None:
        found += _changed(paths[1], "unit", metrics.read(), metrics_now, same)
    return found


def _is_damaged(path: Path) -> bool:
    """Whether a file disagrees with its hash; one that is being written has its hash a moment later."""
    for _ in range(_ATTEMPTS):
        if not path.exists() or not hash_path(path).exists() or open_kept(path) is not None:
            return False
        time.sleep(0.1)
    return True


def _changed(
    path: Path, key: str, kept: pa.Table, now: pa.Table | pl.DataFrame, same: Collection[str]
) -> list[Finding]:
    """A finding where the rows of runs or units should be the same, and are not."""
    one, other = (pl.DataFrame(table).partition_by(key, as_dict=True) for table in (kept, now))
    nothing = pl.DataFrame()
    which = sorted(each for each in same if not one.get((each,), nothing).equals(other.get((each,), nothing)))
    if not which:
        return []
    more = f" and {len(which) - 5} more" if len(which) > 5 else ""
    what = f"{key} {', '.join(which[:5])}{more}: the kept rows are not what recomputing gives"
    return [_finding(path, what)]


def _finding(path: Path, what: str) -> Finding:
    return Finding(KEPT_DAMAGED, Severity.DAMAGE, str(path), what, _REMEDY)
