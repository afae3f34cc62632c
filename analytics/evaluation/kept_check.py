"""What `gyrofleet verify` says of the metrics that a store keeps: each is what computing it anew gives."""

import tempfile
import time
from collections.abc import Collection
from pathlib import Path

import polars as pl
import pyarrow as pa

from analytics.evaluation import evaluation
from analytics.step_records import FOLDER, step_table
from analytics.step_records.kept_file import hash_path, read_kept
from storage.findings import KEPT_DAMAGED, Finding, Severity
from storage.sql.catalog import Catalog
from storage.store import Store

_ATTEMPTS = 3
_REMEDY = "move it to lake-aside; it is computed anew when it is first asked for"


def kept_findings(store: Store) -> list[Finding]:
    """What is wrong with them: damage, and values that do not follow from what the lake holds.

    What is not up to date is not wrong: it is computed when it is asked for.
    """
    paths = [store.folder / FOLDER / name for name in (step_table.FILE, evaluation.FILE)]
    found = [
        Finding(KEPT_DAMAGED, Severity.DAMAGE, str(path), "its content does not agree with its hash", _REMEDY)
        for path in paths
        if _is_damaged(path)
    ]
    steps, (metrics, prints) = step_table.kept_steps(store.folder), evaluation.kept_metrics(store.folder)
    if steps is None and not prints:
        return found
    with (
        tempfile.TemporaryDirectory(prefix="gyrofleet-verify-") as scratch,
        Catalog(store, kept=Path(scratch)) as catalog,
    ):
        metrics_now = evaluation.unit_metrics(catalog)
        steps_now = step_table.kept_steps(Path(scratch))
        _, prints_now = evaluation.kept_metrics(Path(scratch))
    if steps is not None and steps_now is not None:
        marks, marks_now = step_table.kept_prints(steps), step_table.kept_prints(steps_now)
        same = {run for run, mark in marks.items() if marks_now.get(run) == mark}
        found += _changed(paths[0], "run", _differing(steps, steps_now, "run", same))
    same = {unit for unit, mark in prints.items() if prints_now.get(unit) == mark}
    found += _changed(paths[1], "unit", _differing(metrics, metrics_now, "unit", same))
    return found


def _is_damaged(path: Path) -> bool:
    """Whether a file is not what was written; it may be written at this moment, with its hash to come."""
    for _ in range(_ATTEMPTS):
        if not path.exists() or not hash_path(path).exists() or read_kept(path) is not None:
            return False
        time.sleep(0.1)
    return True


def _differing(kept: pa.Table, now: pa.Table, key: str, same: Collection[str]) -> list[str]:
    """Runs or units whose rows should be the same, and are not."""
    one, other = (pl.DataFrame(table).partition_by(key, as_dict=True) for table in (kept, now))
    nothing = pl.DataFrame()
    return sorted(each for each in same if not one.get((each,), nothing).equals(other.get((each,), nothing)))


def _changed(path: Path, key: str, which: list[str]) -> list[Finding]:
    if not which:
        return []
    more = f" and {len(which) - 5} more" if len(which) > 5 else ""
    what = f"{key} {', '.join(which[:5])}{more}: what is kept is not what computing it anew gives"
    return [Finding(KEPT_DAMAGED, Severity.DAMAGE, str(path), what, _REMEDY)]
