"""The largest in magnitude of several measured differences, with bounds that hold for a maximum.

The largest of several noisy magnitudes is biased upwards, the more so the more there are: value -+ t * u would be too
narrow. Here every difference has bounds that hold for all together (Bonferroni); the largest true magnitude lies
between the largest of their lower and of their upper bounds.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from analytics.methods.confidence_bounds import joint_half_widths
from storage.sql.catalog import Catalog

_COPIED = ("unit", "signal", "run", "n", "runs", "steps", "reason", "standard", "clause")
_CHANGES = """
with changes as (
  select *, list_filter(['X', 'Y', 'Z'], lambda each: not list_contains(axes, each)) as absent,
    unnest([axis, 'largest']) as shown
  from internal.bias_changes where cause = $cause
)
select unit, signal, run, "procedure", repeat, shown, axis, change as difference, u, freedom,
  case when shown = 'largest' then (sum(n) over test)::bigint else n end as n,
  [run] as runs,
  case when shown = 'largest' then list_sort(flatten(list(steps) over (test
    order by axis rows between unbounded preceding and unbounded following))) else steps end as steps,
  case when shown = 'largest' and len(absent) > 0 then
    'axis ' || array_to_string(absent, ', ') || ' was not tested: the clause asks for X, Y and Z'
    else lack end as reason,
  {axis: shown, repeat: repeat, scale_factor: scale_source} as parameters
from changes
window test as (partition by unit, signal, run, "procedure", repeat, shown)
order by run, unit, signal, "procedure", repeat, shown, axis
"""


def bias_changes(catalog: Catalog, cause: str) -> Iterator[dict[str, Any]]:
    """Magnitude of the bias change along each axis, and the largest of X, Y and Z; JJF 2014-2022 7.2.18, 7.2.19."""
    rows = catalog.reader(_CHANGES, {"cause": cause}).read_all().to_pylist()
    yield from largest_magnitudes(rows, ["run", "unit", "signal", "procedure", "repeat", "shown"], of="axis")


def largest_magnitudes(
    rows: Iterable[Mapping[str, Any]], keys: Sequence[str], *, of: str, signed: bool = False
) -> Iterator[dict[str, Any]]:
    """One row of a metric for each group of differences.

    `rows` stand in the order of their groups, which the columns `keys` identify: `difference`, `u`, `freedom`, and a
    metric row's columns, with `parameters`. A group whose rows have a `reason` has no value. `of`: the column that
    names a difference in its group; that of the largest goes into the parameters. `signed`: a group of one difference
    keeps its sign.

    >>> both = [{"unit": "U1", "axis": axis, "difference": d, "u": 0.1, "freedom": 1e6, "reason": None,
    ...          "parameters": {}} for axis, d in (("X", 1.0), ("Y", -2.0))]
    >>> (found,) = largest_magnitudes(both, ["unit"], of="axis")
    >>> found["value"], found["parameters"], round(found["lo"], 3), round(found["hi"], 3)
    (2.0, {'axis_of_largest': 'Y'}, 1.776, 2.224)
    """
    for _, group in groupby(rows, key=lambda row: [row[name] for name in keys]):
        members = list(group)
        row = {name: members[0].get(name) for name in _COPIED}
        parameters = dict(members[0]["parameters"])
        row["reason"] = next((each["reason"] for each in members if each["reason"] is not None), None)
        if row["reason"] is None and all(each["difference"] is not None for each in members):
            row |= _largest(members, signed=signed)
            if len(members) > 1:
                parameters[f"{of}_of_largest"] = max(members, key=lambda each: abs(each["difference"]))[of]
        yield row | {"parameters": parameters}


def _largest(members: list[Mapping[str, Any]], *, signed: bool) -> dict[str, Any]:
    difference, u, freedom = (
        np.array([np.nan if each[name] is None else each[name] for each in members], np.float64)
        for name in ("difference", "u", "freedom")
    )
    half = joint_half_widths(u, freedom)
    size = np.abs(difference)
    at = int(np.argmax(size))
    if signed and len(members) == 1:
        value, lo, hi = difference[0], difference[0] - half[0], difference[0] + half[0]
    else:
        value, lo, hi = size[at], np.max(np.maximum(size - half, 0.0)), np.max(size + half)
    found = {"value": value, "lo": lo, "hi": hi, "standard_uncertainty": u[at], "freedom": freedom[at]}
    return {name: float(each) for name, each in found.items()}
