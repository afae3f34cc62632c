"""Fitted zero: where the least-squares line of a scale factor crosses the rate 0; the zero may drift."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from analytics.methods.zero_drift import Sequence, Uncertainty, zero_uncertainty
from storage.sql.catalog import Catalog


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric.

    JJF 2014 subtracts no rest, so its F0 is the bias; GJB and JJF 1536 subtract F_r = (F_s + F_e)/2. F0/K is, to first
    order, a weighted sum of the outputs with the weights (d_j - c_j F0/K)/K. Its uncertainty allows for a zero that
    drifts during the test (`zero_uncertainty`). Where the axis points down and the table's rate is counted against it
    (K < 0), the sign is that of the axis.
    """
    for row in catalog.reader(sql).read_all().to_pylist():
        subtracts = row["standard"] != "JJF2014"
        zero = _zero(row, subtracts=subtracts)
        found = None if zero is None or not math.isfinite(zero) else _uncertainty(row, zero, subtracts=subtracts)
        is_turned = row["k"] is not None and row["k"] < 0 and str(row["position"] or "").endswith("_down")
        sign = -3600.0 if is_turned else 3600.0
        parameters = {
            "temperature": None if row["temperature"] is None else round(row["temperature"], 2),
            "output": None if zero is None else zero * row["k"], "output_unit": row["output_unit"],
            "remark": row["remark_on_range"],
        }  # fmt: skip
        yield row | {
            "parameters": row["words"] | parameters,
            "value": None if zero is None else sign * zero,
            "standard_uncertainty": None if found is None else found.value * 3600,
            "freedom": None if found is None else found.freedom,
        }


def _zero(row: Mapping[str, Any], *, subtracts: bool) -> float | None:
    """The input rate at which the output is 0, in deg/s; NaN where the output does not answer to the rate."""
    k, output = row["k"], row["zero"]
    if row["reason"] is not None or k is None or output is None:
        return None
    if subtracts:
        output -= row["rest_zero"]
    return float(output / k) if k else math.nan


def _uncertainty(row: Mapping[str, Any], zero: float, *, subtracts: bool) -> Uncertainty | None:
    k = row["k"]
    of_points = [(d - c * zero) / k for d, c in zip(row["zero_weights"], row["slope_weights"], strict=True)]
    steps = [point | {"weight": weight} for point, weight in zip(row["points"], of_points, strict=True)]
    taken_off = [each["index"] for each in (row["rest_before"], row["rest_after"]) if subtracts and each is not None]
    for rest in row["rests"] or []:
        own = -taken_off.count(rest["index"]) / (2 * k)
        steps.append(rest | {"rate": 0.0, "weight": own})
    steps.sort(key=lambda each: each["index"])
    columns = (
        np.array([np.nan if each[name] is None else each[name] for each in steps], np.float64)
        for name in ("output", "rate", "u", "freedom", "weight")
    )
    return zero_uncertainty(Sequence(*columns))
