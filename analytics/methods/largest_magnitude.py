"""The largest in magnitude of several measured differences, with bounds that hold for a maximum.

The largest of several noisy magnitudes is biased upwards, the more so the more there are: value -+ t * u would be too
narrow. Here every difference has bounds that hold for all together (Bonferroni); the largest true magnitude lies
between the largest of their lower and of their upper bounds.
"""

import math
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
    tests = [list(group) for _, group in groupby(catalog.table(sql).to_pylist(), itemgetter("test"))]
    halves = iter(_half_widths(tests))
    for members in tests:
        half = [next(halves) for _ in members]
        row = members[0] | {"freedom": None}
        row["reason"] = next((each["reason"] for each in members if each["reason"] is not None), None)
        if row["reason"] is None and all(each["difference"] is not None for each in members):
            row |= _largest(members, half)
            if len(members) > 1:
                row["parameters"] |= max(members, key=lambda each: abs(each["difference"]))["of_largest"]
        yield row


def _half_widths(tests: Sequence[Sequence[Mapping[str, Any]]]) -> list[float]:
    """Half widths of the bounds that hold for all differences of each test together; NaN where u is not known."""
    members = [(len(test), each["u"], each["freedom"]) for test in tests for each in test]
    count, u, freedom = np.array(members, np.float64).reshape(-1, 3).T
    found: list[float] = joint_half_widths(u, freedom, count).tolist()
    return found


def _largest(members: Sequence[Mapping[str, Any]], half: Sequence[float]) -> dict[str, float | None]:
    """The largest, with its uncertainty and its bounds.

    >>> both = [{"difference": d, "u": 0.1, "freedom": 1e6, "is_signed": False} for d in (1.0, -2.0)]
    >>> _largest(both, [0.25, 0.25])
    {'value': 2.0, 'lo': 1.75, 'hi': 2.25, 'standard_uncertainty': 0.1, 'freedom': 1000000.0}
    """
    size = [abs(each["difference"]) for each in members]
    at = size.index(max(size))
    value, lo, hi = size[at], math.nan, math.nan
    if not any(map(math.isnan, half)):
        lo = max(max(each - off, 0.0) for each, off in zip(size, half, strict=True))
        hi = max(each + off for each, off in zip(size, half, strict=True))
    if members[0]["is_signed"] and len(members) == 1:
        value = members[0]["difference"]
        lo, hi = value - half[0], value + half[0]
    own = {"standard_uncertainty": members[at]["u"], "freedom": members[at]["freedom"]}
    return {"value": value, "lo": lo, "hi": hi, **own}
