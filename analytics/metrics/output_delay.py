"""Output delay, from the phases on an angular-vibration table."""

from collections.abc import Iterator
from typing import Any

from analytics.methods.dynamics import first_order_bandwidth, output_delay
from analytics.methods.vibration_records import LEAST_RECORDS, too_little_for, unmet, vibration_row, vibrations
from storage.sql.catalog import Catalog
from stream.errors import BadInput

HEADER = """\
-- id:        output_delay
-- en:        Output delay time
-- zh:        输出延迟时间
-- unit:      ms
-- better:    lower
-- grain:     unit, signal, run
-- parameters: bandwidth_hz, misfit_rad, position, axis, reference, frequencies, records, sample_rate_hz
-- source:    GJB 2426A-2004 5.14 (42)-(46); JJF 2014-2022 7.2.22 (44)-(50)
-- needs:     procedure bandwidth, with the table's rate or angle recorded as fast as the units
-- limits:    t
-- equation:  -P_i - atan(omega_i T) = omega_i T_d
"""
_MS = 1e3


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric: the standards differ in how many records they ask for."""
    for vibration in vibrations(catalog):
        for source, least_records in (
            (("GJB2426A", "5.14.4 (42)-(46)"), 1),
            (("JJF2014", "7.2.22.2 (44)-(50)"), LEAST_RECORDS),
        ):
            parameters: dict[str, Any] = {}
            found, reason = None, unmet(vibration, least_records=least_records)
            if reason is None:
                assert vibration.response is not None
                try:
                    found = output_delay(vibration.response)
                    bandwidth_hz = first_order_bandwidth(vibration.response).value
                except BadInput as error:
                    found, reason = None, str(error)
                else:
                    reason = too_little_for(bandwidth_hz, vibration)
                    parameters = {"bandwidth_hz": float(f"{bandwidth_hz:.6g}")}
                    parameters["misfit_rad"] = float(f"{found.misfit:.3g}")
            yield vibration_row(vibration, source, parameters, found, reason, scale=_MS)
