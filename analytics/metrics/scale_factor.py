"""Scale factors: the least-squares lines of every measurement, made once for all metrics that stand on them."""

from collections.abc import Iterable, Mapping
from typing import Any

import msgspec
import pyarrow as pa

from analytics.metrics.product_files import products_of
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

_LINES = "create or replace table scale_fits as select * from scale_lines('scale_sides')"
_USABLE = "select * from measured_scale_factors('scale_fits')"

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
  case standard when 'GJB2426A' then '5.8.1 (1)-(6)' when 'JJF2014' then '7.2.1 (2)-(5)' else '7.1 (10)-(15)' end
    as clause,
  lack as reason
from scale_results('scale_fits')
"""


def compute(catalog: Catalog) -> Iterable[Mapping[str, Any]]:
    """Rows of the metric, a row for each measurement and standard.

    The unit of a value is that of the output over deg/s, and 1 where the output is a rate.
    """
    keep_scale_fits(catalog)
    rows: list[dict[str, Any]] = catalog.reader(_SQL).read_all().to_pylist()
    return rows


def keep_scale_fits(catalog: Catalog) -> None:
    """Make the tables on which other metrics stand, from the ``step_means`` that are in the catalogue.

    They are ``products``, the lines ``scale_fits``, and the ``scale_factors`` that may be used from then on.
    """
    catalog.put("products", _products(catalog))
    catalog.define(_LINES)
    catalog.put("scale_factors", catalog.reader(_USABLE).read_all())


def _products(catalog: Catalog) -> pa.Table:
    """What the specifications in the store say of products."""
    numbers = ("max_rate_deg_per_s", "nonlinearity_ppm", "expected_threshold_deg_per_h")
    schema = pa.schema([("product", pa.string()), *((name, pa.float64()) for name in numbers)])
    known = products_of(catalog.store).by_name
    return pa.Table.from_pylist(
        [{"product": name} | msgspec.structs.asdict(each) for name, each in known.items()], schema
    )
