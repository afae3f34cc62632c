"""Notes on isolated outliers that raise the noise of diagnosed runs."""

from collections.abc import Mapping

from analytics.curves.isolated_outliers import IsolatedOutliers, isolated_outliers
from analytics.loop.blocks.checks import Note, in_runs
from analytics.loop.blocks.records import Record, is_rolled_up
from storage.sql.catalog import Catalog
from storage.sql.reading import find_signal


def outlier_notes(catalog: Catalog, unit: str, signal: str, records: Mapping[str, Record]) -> list[Note]:
    """Notes on single far samples that raise the noise; of signals so slow that a sample weighs in its block."""
    found: dict[str, IsolatedOutliers] = {}
    for run, record in records.items():
        if is_rolled_up(record.interval_s, record.samples, record.kept_raw) or record.kept_raw < record.samples:
            continue
        outliers = isolated_outliers(catalog, find_signal(catalog, unit, signal, run))
        if outliers.is_worth_a_word:
            found[run] = outliers
    if not found:
        return []
    count, largest = sum(each.count for each in found.values()), max(each.largest for each in found.values())
    raised = max(each.raise_n_by for each in found.values())
    text = (
        f"{count:,} samples of {signal} are isolated outliers {in_runs(list(found), len(records))}, up to "
        f"{largest:.3g} times the noise: they raise N by up to {raised:.0%}"
    )
    return [Note("outliers", text, signal, tuple(found), is_limit=True)]
