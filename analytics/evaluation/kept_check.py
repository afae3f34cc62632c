"""Check of the kept metrics for `gyrofleet verify`: recomputing gives the same."""

import tempfile
import time
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import polars as pl

from analytics.evaluation import kept_metrics
from analytics.evaluation.ranges import in_ranges
from analytics.step_records import FOLDER, step_table
from analytics.step_records.step_table import hash_path, open_kept
from storage.findings import KEPT_DAMAGED, Finding, Severity
from storage.sql.catalog import Catalog
from storage.sql.parquet_content import ROW_GROUP, ParquetContent
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
    with tempfile.TemporaryDirectory(prefix="gyrofleet-verify-") as scratch:
        with Catalog(store, kept=Path(scratch)) as catalog:
            kept_metrics.unit_metrics(catalog)
        steps_now = step_table.kept_steps(Path(scratch))
        metrics_now, prints_now = kept_metrics.kept_metrics(Path(scratch))
    if steps is not None and steps_now is not None:
        marks, marks_now = step_table.kept_prints(steps), step_table.kept_prints(steps_now)
        same = {run for run, mark in marks.items() if marks_now.get(run) == mark}
        found += _changed(paths[0], "run", steps, steps_now, dict.fromkeys(same))
    if metrics is not None and metrics_now is not None:
        parts = {unit: mark.partition(":") for unit, mark in prints.items()}
        of_units = {
            unit: names.split(",") if colon else None  # some metrics only
            for unit, (mark, colon, names) in parts.items()
            if prints_now.get(unit) == mark
        }
        found += _changed(paths[1], "unit", metrics, metrics_now, of_units)
    return found


def _is_damaged(path: Path) -> bool:
    """Whether a file disagrees with its hash; one that is being written has its hash a moment later."""
    for _ in range(_ATTEMPTS):
        if not path.exists() or not hash_path(path).exists() or open_kept(path) is not None:
            return False
        time.sleep(0.1)
    return True


def _changed(
    path: Path, key: str, kept: ParquetContent, now: ParquetContent, same: Mapping[str, Collection[str] | None]
) -> list[Finding]:
    """A finding where the rows of runs or units should be the same, or of some of their metrics, and are not."""
    which: set[str] = set()
    for one, other in _in_ranges(kept, now, key):
        for name in (one.keys() | other.keys()) & same.keys() - which:
            then, again = one.get(name), other.get(name)
            if again is not None and (metrics := same[name]) is not None:
                again = again.filter(pl.col("metric").is_in(metrics))
            if then is None or again is None:
                is_same = then is None and (again is None or again.is_empty())
            else:
                is_same = then.equals(again)
            if not is_same:
                which.add(name)
    if not which:
        return []
    more = f" and {len(which) - 5} more" if len(which) > 5 else ""
    what = f"{key} {', '.join(sorted(which)[:5])}{more}: the kept rows are not what recomputing gives"
    return [_finding(path, what)]


def _in_ranges(
    kept: ParquetContent, now: ParquetContent, key: str
) -> Iterator[tuple[dict[str, pl.DataFrame], dict[str, pl.DataFrame]]]:
    """Rows of both in ranges of units, by runs or units: all of a fleet take several GB."""
    counts: Counter[str] = Counter()
    for each in (kept, now):
        for batch in each.file.iter_batches(ROW_GROUP, columns=["unit"]):
            counts.update({pair["values"]: pair["counts"] for pair in batch["unit"].value_counts().to_pylist()})
    lasts = [units[-1] for units in in_ranges(counts, 4 * ROW_GROUP)]
    for tables in zip(kept.up_to("unit", lasts), now.up_to("unit", lasts), strict=True):
        one, other = (pl.DataFrame(table).partition_by(key, as_dict=True) for table in tables)
        yield {name: rows for (name,), rows in one.items()}, {name: rows for (name,), rows in other.items()}


def _finding(path: Path, what: str) -> Finding:
    return Finding(KEPT_DAMAGED, Severity.DAMAGE, str(path), what, _REMEDY)
