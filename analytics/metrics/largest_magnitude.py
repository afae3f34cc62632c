"""The largest in magnitude of several measured differences, with limits that hold for a maximum.

Tests ask for the largest over temperatures or over axes. The largest of several noisy magnitudes is too large by
nature, the more so the more there are: value -+ t * u would promise too much. Here every difference has limits that
hold for all together (Bonferroni); the largest true magnitude is between the largest of their lower and upper ends.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from scipy import stats

from analytics.metrics.limits_of_value import CONFIDENCE
from stream.batch import FloatArray

_TOLD = ("unit", "signal", "run", "n", "runs", "steps", "reason", "standard", "clause")


def largest_magnitudes(
    rows: Iterable[Mapping[str, Any]], keys: Sequence[str], *, of: str, signed: bool = False
) -> Iterator[dict[str, Any]]:
    """One row of a metric for each group of differences.

    Parameters
    ----------
    rows: Differences in the order of their groups: `difference`, `u`, `freedom`, and what a metric's row says, with
        `parameters`. A group whose rows have a `reason` has no value.
    keys: Columns that tell the groups apart.
    of: Column that names a difference in its group; told in the parameters.
    signed: Whether a group of one difference keeps its sign.

    Examples
    --------
    >>> both = [{"unit": "U1", "axis": axis, "difference": d, "u": 0.1, "freedom": 1e6, "reason": None,
    ...          "parameters": {}} for axis, d in (("X", 1.0), ("Y", -2.0))]
    >>> (found,) = largest_magnitudes(both, ["unit"], of="axis")
    >>> found["value"], found["parameters"], round(found["lo"], 3), round(found["hi"], 3)
    (2.0, '{"axis_of_largest":"Y"}', 1.776, 2.224)
    """
    for _, group in groupby(rows, key=lambda row: [row[name] for name in keys]):
        members = list(group)
        row = {name: members[0].get(name) for name in _TOLD}
        parameters = dict(members[0]["parameters"])
        row["reason"] = next((each["reason"] for each in members if each["reason"] is not None), None)
        if row["reason"] is None and all(each["difference"] is not None for each in members):
            row |= _largest(members, signed=signed)
            if len(members) > 1:
                parameters[f"{of}_of_largest"] = max(members, key=lambda each: abs(each["difference"]))[of]
        yield row | {"parameters": json_text(parameters)}


def _largest(members: list[Mapping[str, Any]], *, signed: bool) -> dict[str, Any]:
    difference, u, freedom = (
        np.array([np.nan if each[name] is None else each[name] for each in members], np.float64)
        for name in ("difference", "u", "freedom")
    )
    at = int(np.argmax(np.abs(difference)))
    half = joint_half_widths(u, freedom)
    if signed and len(members) == 1:
        value = float(difference[0])
        lo, hi = value - float(half[0]), value + float(half[0])
        return {"value": value, "lo": lo, "hi": hi, "standard_uncertainty": float(u[0]), "freedom": float(freedom[0])}
    return {
        "value": float(np.abs(difference[at])),
        "lo": float(np.max(np.maximum(np.abs(difference) - half, 0.0))),
        "hi": float(np.max(np.abs(difference) + half)),
        "standard_uncertainty": float(u[at]),
        "freedom": float(freedom[at]),
    }


def joint_half_widths(u: FloatArray, freedom: FloatArray, independent: int | None = None) -> FloatArray:
    """Half widths of limits that hold for all values together: t at 1 - (1 - confidence)/(2 m), times u.

    m is the number of values, or of those that are `independent`.
    """
    tail = (1 - CONFIDENCE) / 2 / (independent or len(u))
    return np.asarray(stats.t.isf(tail, np.maximum(np.nan_to_num(freedom, nan=1.0), 1.0)) * u, dtype=np.float64)


def json_text(parameters: Mapping[str, Any]) -> str:
    """Parameters of a metric as they stand in its column.

    Examples
    --------
    >>> json_text({"kind": "all", "power_ons": 6})
    '{"kind":"all","power_ons":6}'
    """
    return json.dumps(parameters, ensure_ascii=False, separators=(",", ":"))
