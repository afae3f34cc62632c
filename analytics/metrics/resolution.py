"""Resolution: the smallest change of a rate that the output follows."""

from collections.abc import Iterator, Mapping
from typing import Any

from analytics.methods.half_error import within_half_both_ways
from storage.sql.catalog import Catalog

# Clause, and the base rate over the expected threshold: from, to, in the words of the clause.
_BASES = {
    "GJB2426A": ("5.11 (18)", 100.0, float("inf"), "more than 100 times"),
    "JJF2014": ("7.2.10 (18)", 20.0, 50.0, "20 to 50 times"),
}


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric, one for each standard: they differ in the base rate, checked where the threshold is known."""
    for row in catalog.reader(sql).read_all().to_pylist():
        found = {} if row["reason"] else within_half_both_ways(row["compared"], "increment")
        for standard, (clause, *_) in _BASES.items():
            yield row | {"standard": standard, "clause": clause} | (_unsuitable(row, standard) or found)


def _unsuitable(row: Mapping[str, Any], standard: str) -> dict[str, Any] | None:
    """Why the base rate is not what the standard asks for."""
    if row["expected_threshold"] is None:
        return None
    _, least, most, words = _BASES[standard]
    ratio = row["base_rate"] / row["expected_threshold"]
    if least * (1 - 1e-3) <= ratio <= most * (1 + 1e-3):
        return None
    threshold = f"the expected threshold of {row['expected_threshold']:g} deg/h"
    return {"reason": f"the base rate is {ratio:.3g} times {threshold}, the clause asks for {words}"}
