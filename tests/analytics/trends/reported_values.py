"""Values of metrics in a store, and what a trend reports of them."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from analytics.trends.report import sentences
from analytics.trends.trend import Trend
from storage.sql.catalog import Catalog

HOUR_NS = 3600 * 10**9
START_NS = 1_767_225_600 * 10**9  # 2026-01-01 00:00 UTC
Reported = Callable[[Sequence[Mapping[str, Any]]], Catalog]


def one_each(values: np.ndarray, **words: Any) -> list[dict[str, Any]]:
    """One value of each unit."""
    return [{"unit": f"U{at:03}", "value": float(value), "station": "A", **words} for at, value in enumerate(values)]


def english(trend: Trend) -> str:
    """The report of a trend, which is whole in both languages."""
    found = sentences(trend)
    assert all(each.zh and not any("{" in text for text in each) for each in found)
    return "\n".join(each.en for each in found)
