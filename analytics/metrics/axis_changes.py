"""Changes along the axes of a unit, before and after a shock or vibration, and the largest of them."""

from collections.abc import Iterator
from typing import Any

from analytics.metrics.largest_magnitude import largest_magnitudes
from storage.sql.catalog import Catalog

_CHANGES = """
with told as (
  select *, list_filter(['X', 'Y', 'Z'], lambda each: not list_contains(axes, each)) as absent,
    unnest([axis, 'largest']) as shown
  from ({changes})
)
select unit, signal, run, "procedure", repeat, shown, axis, change as difference, u, freedom,
  case when shown = 'largest' then (sum(n) over test)::bigint else n end as n,
  [run] as runs,
  case when shown = 'largest' then list_sort(flatten(list(steps) over (test
    order by axis rows between unbounded preceding and unbounded following))) else steps end as steps,
  case when shown = 'largest' and len(absent) > 0 then
    'axis ' || array_to_string(absent, ', ') || ' was not tested: the clause asks for X, Y and Z'
    else lack end as reason,
  {{axis: shown, repeat: repeat, scale_factor: scale_source}} as parameters
from told
window test as (partition by unit, signal, run, "procedure", repeat, shown)
order by run, unit, signal, "procedure", repeat, shown, axis
"""


def largest_changes(catalog: Catalog, changes: str) -> Iterator[dict[str, Any]]:
    """Magnitude of a change along each axis, and the largest of X, Y and Z; JJF 2014-2022 7.2.18 and its like.

    Parameters
    ----------
    catalog: Of the store.
    changes: Statement that gives `unit, signal, run, procedure, repeat, axis, change, u, freedom, n, steps,
        scale_source, lack` and `axes`, which axes the test has.
    """
    rows = catalog.reader(_CHANGES.format(changes=changes)).read_all().to_pylist()
    yield from largest_magnitudes(rows, ["run", "unit", "signal", "procedure", "repeat", "shown"], of="axis")
