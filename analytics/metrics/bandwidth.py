"""Bandwidth, from the gains on an angular-vibration table."""

import json
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from analytics.calibration.dynamics import Found, crossing, first_order_bandwidth
from analytics.calibration.frequency_response import Response
from analytics.calibration.vibration_records import (
    LEAST_RECORDS,
    Vibration,
    row_of,
    told,
    too_little_for,
    unmet,
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
        for standard, clause, method, gain_1, least_records, find in (
            ("GJB2426A", "5.13.4 (36)-(41)", "first_order", None, 1, first_order_bandwidth),
            ("GJB2426A", "5.13.4 (35)", "crossing", "lowest frequency", 1, partial(crossing, of_lowest=True)),
            (
                "JJF2014",
                "7.2.21.2 (40)-(43)",
                "crossing",
                "the curve's at zero frequency" if zero_gain is None else measured,
                LEAST_RECORDS,
                partial(crossing, zero_gain=zero_gain),
            ),
        ):
            found, reason = _found(vibration, find, least_records)
            parameters = {"method": method, "gain_1": gain_1} | told(vibration)
            if found is not None:
                parameters["misfit"] = float(f"{found.misfit:.3g}")
            yield row_of(vibration) | {
                "value": None if found is None or reason else found.value,
                "standard_uncertainty": None if found is None else found.standard_uncertainty,
                "freedom": None if found is None else found.freedom,
                "parameters": json.dumps(parameters, ensure_ascii=False),
                "standard": standard,
                "clause": clause,
                "reason": reason,
            }


def _found(
    vibration: Vibration, find: Callable[[Response], Found], least_records: int
) -> tuple[Found | None, str | None]:
    reason = unmet(vibration, least_records=least_records)
    if reason is not None:
        return None, reason
    assert vibration.response is not None
    try:
        found = find(vibration.response)
    except BadInput as error:
        return None, str(error)
    return found, too_little_for(found.value, vibration)
