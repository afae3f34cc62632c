"""Threshold by the three methods: on the rate table, on the indexing head, and in one slow turn."""

from collections.abc import Iterator
from typing import Any

from analytics.methods.half_error import of_slow_turn, within_half_both_ways
from storage.sql.catalog import Catalog


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric.

    ``parameters.method`` is ``rate_table`` (GJB method 1, JJF 2014), ``indexing_head`` (2) or ``slow_turn`` (3).

    Erratum: GJB (15) divides by the output F; meant is the theoretical output K Omega, as JJF 2014 (17) has it: else an
    output of 0 would be no error at all.
    """
    for row in catalog.reader(sql).read_all().to_pylist():
        if row["reason"] is not None:
            yield row
        elif row["parameters"]["method"] == "slow_turn":
            yield row | of_slow_turn(catalog, row)
        else:
            yield row | within_half_both_ways(row["compared"] or [], "rate")
