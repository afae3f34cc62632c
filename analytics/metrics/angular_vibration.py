"""Bandwidth and output delay, from the gains and phases on an angular-vibration table."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from analytics.methods.dynamics import DynamicResult, crossing, first_order_bandwidth, output_delay
from analytics.methods.frequency_response import Response
from analytics.methods.vibration_records import LEAST_RECORDS, Vibration, too_little_for, unmet, vibrations
from storage.sql.catalog import Catalog
from stream.errors import BadInput


def bandwidths(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric: of GJB by the first-order lag and by the crossing of 0.707, of JJF by the crossing."""
    for vibration in vibrations(catalog, sql):
        zero_gain, measured = vibration.scale_factor, f"scale factor measured in run {vibration.scale_run}"
        gain_1 = "the curve's at zero frequency" if zero_gain is None else measured
        lowest, zero = partial(crossing, of_lowest=True), partial(crossing, zero_gain=zero_gain)
        for standard, clause, method, gain, least_records, find in (
            ("GJB2426A", "5.13.4 (36)-(41)", "first_order", None, 1, first_order_bandwidth),
            ("GJB2426A", "5.13.4 (35)", "crossing", "lowest frequency", 1, lowest),
            ("JJF2014", "7.2.21.2 (40)-(43)", "crossing", gain_1, LEAST_RECORDS, zero),
        ):
            found, reason = _found(vibration, least_records, find)
            parameters: dict[str, Any] = {"method": method, "gain_1": gain}
            if found is not None:
                parameters["misfit"] = float(f"{found.misfit:.3g}")
                reason = too_little_for(found.value, vibration)
            yield _row(vibration, parameters, found, reason) | {"standard": standard, "clause": clause}


def output_delays(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric: the standards differ in how many records they ask for."""
    for vibration in vibrations(catalog, sql):
        for standard, clause, least_records in (
            ("GJB2426A", "5.14.4 (42)-(46)", 1),
            ("JJF2014", "7.2.22.2 (44)-(50)", LEAST_RECORDS),
        ):
            parameters: dict[str, Any] = {}
            found, reason = _found(vibration, least_records, output_delay)
            if found is not None:
                bandwidth, reason = _found(vibration, least_records, first_order_bandwidth)
                if bandwidth is None:
                    found = None
                else:
                    reason = too_little_for(bandwidth.value, vibration)
                    parameters = {"bandwidth_hz": float(f"{bandwidth.value:.6g}")}
                    parameters["misfit_rad"] = float(f"{found.misfit:.3g}")
            yield _row(vibration, parameters, found, reason, scale=1e3) | {"standard": standard, "clause": clause}


def _found(
    vibration: Vibration, least_records: int, find: Callable[[Response], DynamicResult]
) -> tuple[DynamicResult | None, str | None]:
    """The result, or why there is none."""
    if (reason := unmet(vibration, least_records)) is not None:
        return None, reason
    assert vibration.response is not None
    try:
        return find(vibration.response), None
    except BadInput as error:
        return None, str(error)


def _row(
    vibration: Vibration, parameters: Mapping[str, Any], found: DynamicResult | None, reason: str | None,
    scale: float = 1.0,
) -> dict[str, Any]:  # fmt: skip
    """Row of a metric of such a test; `scale`: from the unit of `found` to that of the metric."""
    words, records = vibration.words, [0] if vibration.response is None else vibration.response.records
    row = {name: words[name] for name in ("unit", "signal", "run")}
    row |= {"n": int(sum(records)), "steps": vibration.steps, "reason": reason}
    if found is not None:
        row |= {"standard_uncertainty": found.standard_uncertainty * scale, "freedom": found.freedom}
        row["value"] = None if reason else found.value * scale
    row["parameters"] = {
        **parameters, "position": words["position"], "axis": words["axis"], "reference": vibration.reference,
        "frequencies": 0 if vibration.response is None else len(records), "records": int(min(records)),
        "sample_rate_hz": round(vibration.sample_rate_hz, 3),
    }  # fmt: skip
    return row
