"""The largest in magnitude of several measured differences, with bounds that hold for a maximum.

The largest of several noisy magnitudes is biased upwards, the more so the more there are: value -+ t * u would be too
narrow. Here every difference has bounds that hold for all together (Bonferroni); the largest true magnitude lies
between the largest of their lower and of their upper bounds.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from analytics.methods.confidence_bounds import joint_half_widths
from storage.sql.catalog import Catalog


def largest_magnitudes(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """One row of a metric for each `test`, in whose order the differences stand.

    The statement gives `difference`, `u` and `freedom`, and the columns of a metric's row. A test with any `reason` has
    no value. The struct `of_largest` goes into the parameters of a test of several differences; where `is_signed`, a
    single one keeps its sign.
    """
    for _, group in groupby(catalog.table(sql).to_pylist(), itemgetter("test")):
        members = list(group)
        row = members[0] | {"freedom": None}
        row["reason"] = next((each["reason"] for each in members if each["reason"] is not None), None)
        if row["reason"] is None and all(each["difference"] is not None for each in members):
            row |= _largest(members)
            if len(members) > 1:
                row["parameters"] |= max(members, key=lambda each: abs(each["difference"]))["of_largest"]
        yield row


def _largest(members: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The largest, with its uncertainty and its bounds.

    >>> both = [{"difference": d, "u": 0.1, "freedom": 1e6, "is_signed": False} for d in (1.0, -2.0)]
    >>> {name: round(each, 3) for name, each in _largest(both).items() if name != "freedom"}
    {'value': 2.0, 'lo': 1.776, 'hi': 2.224, 'standard_uncertainty': 0.1}
    """
    difference, u, freedom = (
        np.array([each[name] for each in members], np.float64) for name in ("difference", "u", "freedom")
    )
    half = joint_half_widths(u, freedom)
    size = np.abs(difference)
    at = int(np.argmax(size))
    value, lo, hi = size[at], np.max(np.maximum(size - half, 0.0)), np.max(size + half)
    if members[0]["is_signed"] and len(members) == 1:
        value, lo, hi = difference[0], difference[0] - half[0], difference[0] + half[0]
    found = {"value": value, "lo": lo, "hi": hi, "standard_uncertainty": u[at], "freedom": freedom[at]}
    return {name: float(each) for name, each in found.items()}
