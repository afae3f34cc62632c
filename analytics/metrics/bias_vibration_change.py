"""Change of the bias by vibration, along each axis and the largest."""

from collections.abc import Iterator
from typing import Any

from analytics.metrics.axis_changes import largest_changes
from storage.sql.catalog import Catalog

HEADER = """\
-- id:        bias_vibration_change
-- en:        Bias change by vibration
-- zh:        零偏振动前后变化量
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, axis
-- parameters: axis, repeat, scale_factor, axis_of_largest
-- source:    JJF 2014-2022 7.2.19 (33)
-- needs:     procedure bias_vibration: static steps before and after a vibration along X, Y and Z
-- limits:    given
-- equation:  abs(B_after - B_before) along each axis; of the unit the largest
"""


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric."""
    yield from largest_changes(catalog, "select * from internal.bias_changes where cause = 'vibration'")
