"""Scale factors: the least-squares lines of every measurement, made once for all metrics that stand on them."""

from collections.abc import Iterable, Mapping
from typing import Any

from storage.catalog import Catalog

HEADER = """\
-- id:        scale_factor
-- en:        Scale factor
-- zh:        标度因数
-- unit:      1
-- better:    neither
-- grain:     unit, signal, run, position, temperature, repeat
-- source:    GJB 2426A-2004 5.8.1 (1)-(6); JJF 2014-2022 7.2.1 (2)-(5); JJF 1536-2015 7.1 (10)-(15)
-- needs:     at least 11 rates in each direction, the largest input rate among them; GJB: rests before and after
-- limits:    t
-- equation:  K from the least-squares line F_j = K Omega_j + F0 + v_j
"""

# A table, which the other metrics of the family stand on.
_LINES = "create or replace table scale_fits as select * from scale_lines('scale_sides')"

# What is subtracted at rest moves F0 and not K: the standards differ only in what they ask for.
_SQL = """
select
  unit, signal, run,
  case when lack is null then k end as value,
  k_unit as unit_of_measure,
  u_k as standard_uncertainty,
  freedom_k as freedom,
  n,
  to_json(struct_insert(words, temperature := round(temperature, 2), rates := n_points,
    largest_rate_deg_per_s := largest_rate))::varchar as parameters,
  [run] as runs, steps, standard,
  case standard when 'GJB2426A' then '5.8.1 (1)-(6)' when 'JJF2014' then '7.2.1 (2)-(5)' else '7.1 (10)-(15)' end as clause,
  lack as reason
from scale_results('scale_fits')
"""


def compute(catalog: Catalog) -> Iterable[Mapping[str, Any]]:
    """Rows of the metric, a row for each measurement and standard; leaves the table ``scale_fits``.

    The unit of a value is that of the output over deg/s, and 1 where the output is a rate.
    """
    catalog.define(_LINES)
    rows: list[dict[str, Any]] = catalog.reader(_SQL).read_all().to_pylist()
    return rows
