"""Bandwidth, from the gains on an angular-vibration table."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from analytics.methods.dynamics import DynamicResult, crossing, first_order_bandwidth
from analytics.methods.frequency_response import Response
from analytics.methods.vibration_records import (
    LEAST_RECORDS,
    Vibration,
    too_little_for,
    unmet,
    vibration_row,
    vibrations,
)
from storage.sql.catalog import Catalog
from stream.errors import BadInput

HEADER = """\
-- id:        bandwidth
-- en:        Bandwidth
-- zh:        频带宽度
-- unit:      Hz
-- better:    higher
-- grain:     unit, signal, run
-- parameters: method, gain_1, misfit, position, axis, reference, frequencies, records, sample_rate_hz
-- source:    GJB 2426A-2004 5.13 (35)-(41); JJF 2014-2022 7.2.21 (40)-(43)
-- needs:     procedure bandwidth: 10 frequencies in equal ratios from 10 Hz to 2 bandwidths, sampled above 20 of them
-- limits:    t
-- equation:  G^2 = K_D^2 - T^2 omega^2 G^2, Bw = 1/(2 pi T); or where the gain is 0.707
"""


def compute(catalog: Catalog) -> Iterator[dict[str, Any]]:
    """Rows of the metric: of GJB by the first-order lag and by the crossing of 0.707, of JJF by the crossing."""
    for vibration in vibrations(catalog):
        zero_gain, measured = vibration.scale_factor, f"scale factor measured in run {vibration.scale_run}"
        gain_1 = "the curve's at zero frequency" if zero_gain is None else measured
        lowest, zero = partial(crossing, of_lowest=True), partial(crossing, zero_gain=zero_gain)
        for source, method, gain, least_records, find in (
            (("GJB2426A", "5.13.4 (36)-(41)"), "first_order", None, 1, first_order_bandwidth),
            (("GJB2426A", "5.13.4 (35)"), "crossing", "lowest frequency", 1, lowest),
            (("JJF2014", "7.2.21.2 (40)-(43)"), "crossing", gain_1, LEAST_RECORDS, zero),
        ):
            found, reason = _found(vibration, find, least_records)
            parameters: dict[str, Any] = {"method": method, "gain_1": gain}
            if found is not None:
                parameters["misfit"] = float(f"{found.misfit:.3g}")
            yield vibration_row(vibration, source, parameters, found, reason)


def _found(
    vibration: Vibration, find: Callable[[Response], DynamicResult], least_records: int
) -> tuple[DynamicResult | None, str | None]:
    if (reason := unmet(vibration, least_records=least_records)) is not None:
        return None, reason
    assert vibration.response is not None
    try:
        found = find(vibration.response)
    except BadInput as error:
        return None, str(error)
    return found, too_little_for(found.value, vibration)
