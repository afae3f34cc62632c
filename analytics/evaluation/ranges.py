"""Ranges of units, whose metrics are computed one range after the other, and the order of their rows."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from analytics.evaluation import evaluation
from analytics.evaluation.evaluation import COLUMNS, choose_records, choose_steps, define_scripts, of_units
from analytics.metric_registry.registry import metrics
from storage.sql.catalog import Catalog
from storage.sql.parquet_content import ParquetContent
from stream.batch import IntArray

# Step records in one range.
RANGE_RECORDS = 50_000
# A total order, so that kept and recomputed rows make the same table.
_CODED, _TEXTS = ("unit", "metric", "signal", "run"), ("parameters", "standard", "clause")
_TIED = """
select place from given_rows
order by unit, metric, signal nulls first, run nulls first, parameters nulls first, standard, clause, steps, runs,
  reason
"""
_KEPT = """
select * from internal.kept_metrics where unit between $first and $last
  and not (unit in (select unnest($stale)) and metric in (select unnest($replaced)))
  -- a unit of which nothing is left, as one whose only run is excluded, may stand between the others
  and unit in (select unnest($current))
"""


class Update(NamedTuple):
    """What of the kept values is to be replaced."""

    kept: ParquetContent | None
    stale: Collection[str]  # units whose needed metrics are computed
    needed: Collection[str]
    current: Collection[str]  # units of which kept values count


def ranges_of(catalog: Catalog, units: Iterable[str]) -> list[list[str]]:
    """All units in their order, in ranges with a bounded number of records."""
    records = dict(catalog.rows("select unit, count(*) from internal.step_records group by unit"))
    return in_ranges({unit: records.get(unit, 0) for unit in units}, RANGE_RECORDS)


def in_ranges(rows: Mapping[str, int], most: int) -> list[list[str]]:
    """Units in their order, in ranges of at most so many rows, or of one unit.

    >>> in_ranges({"A": 2, "B": 1, "C": 9, "D": 3}, most=4)
    [['A', 'B'], ['C'], ['D']]
    """
    found: list[list[str]] = []
    count = 0
    for unit in sorted(rows):
        count += rows[unit]
        if not found or count > most:
            found.append([])
            count = rows[unit]
        found[-1].append(unit)
    return found


def updated(
    catalog: Catalog, steps: ParquetContent, ranges: list[list[str]], update: Update, computed: pa.Table | None
) -> Iterator[tuple[pa.Table, bool]]:
    """Rows of each range of units, and whether they are in their order already.

    They are the kept ones, and the needed metrics of stale units, which are computed here if they are not `computed`.
    """
    if update.kept is not None:
        catalog.put_content("kept_metrics", update.kept)
    chosen = [metrics()[name] for name in sorted(update.needed)]
    for units, records in zip(ranges, steps.up_to("unit", (units[-1] for units in ranges)), strict=True):
        of_range = [unit for unit in units if unit in update.stale]
        rows = _kept_rows(catalog, units, of_range, update)
        if not of_range:
            yield rows, True
            continue
        if computed is None:
            choose_records(catalog, records if len(of_range) == len(units) else of_units(records, of_range))
            del records
            # a metric may also look at documents, which are those of all units
            found = of_units(evaluation.evaluate(catalog, chosen), of_range)
        else:
            found = of_units(computed, of_range)
        yield pa.concat_tables([rows, found]), False
    catalog.put_content("kept_metrics", ParquetContent.of(COLUMNS.empty_table()))
    if computed is None and update.stale:
        catalog.put("chosen_records", steps.schema.empty_table())
        choose_steps(catalog)
        define_scripts(catalog, "views")  # whose tables are of a range


def _kept_rows(catalog: Catalog, units: list[str], stale: list[str], update: Update) -> pa.Table:
    if update.kept is None:
        return COLUMNS.empty_table()
    current = [unit for unit in units if unit in update.current]
    given = {"first": units[0], "last": units[-1], "stale": stale, "replaced": sorted(update.needed)}
    return catalog.reader(_KEPT, given | {"current": current}).read_all().cast(COLUMNS)


def in_order(catalog: Catalog, rows: pa.Table) -> pa.Table:
    """The rows sorted; the statement of all keys sorts only those that are equal in the first ones."""
    import polars as pl  # kept rows are in order, and need none of it

    place = np.zeros(rows.num_rows, np.int64)
    for name in _CODED:
        codes, count = _codes(rows[name])
        place = place * count + codes
    keys = pl.DataFrame({"place": place, **{name: pl.Series(rows[name]) for name in _TEXTS}}).with_row_index("at")
    by = ["place", *_TEXTS]
    keys = keys.sort(by, nulls_last=[False, False, True, True])
    is_tied = keys.select(pl.all_horizontal(pl.col(each).eq_missing(pl.col(each).shift()) for each in by)).to_series()
    at = keys["at"].to_numpy().astype(np.int64)
    same = is_tied.to_numpy().copy()
    same[:1] = False
    tied = np.flatnonzero(same | np.append(same[1:], False))
    if tied.size:
        given = rows.take(at[tied]).append_column("place", pa.array(np.arange(tied.size)))
        at[tied] = at[tied][catalog.table(_TIED, given)["place"].to_numpy()]
    return rows.take(at).combine_chunks()


def _codes(column: pa.ChunkedArray) -> tuple[IntArray, int]:
    """Numbers in the order of texts, from 1 on, 0 for null, and how many numbers there are."""
    encoded = column.combine_chunks().dictionary_encode()
    ranks = np.empty(len(encoded.dictionary), np.int64)
    ranks[pc.array_sort_indices(encoded.dictionary).to_numpy()] = np.arange(1, len(ranks) + 1)
    ranks = np.append(ranks, 0)
    return ranks[encoded.indices.fill_null(len(ranks) - 1).to_numpy()], len(ranks)
