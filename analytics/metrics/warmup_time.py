"""Warm-up time of units with temperature control, measured like the start-up time."""

from collections.abc import Iterator
from typing import Any

from analytics.metrics.settling_time import settling_times
from storage.sql.catalog import Catalog

HEADER = """\
-- id:        warmup_time
-- en:        Warm-up time
-- zh:        预热时间
-- unit:      s
-- better:    lower
-- grain:     unit, signal, run, test
-- parameters: test, tests, band_deg_per_h, reference, counted_from
-- source:    GJB 2426A-2004 5.6
-- needs:     procedure warmup_time: power-on at several rates and positions; startup_band_deg_per_h of the product
-- limits:    given
-- equation:  max(t_r1, ..., t_rm, t_p1, ..., t_pn)
"""


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric."""
    yield from settling_times(catalog, "^warm_?up_time|预热时间")
