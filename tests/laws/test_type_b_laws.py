"""Laws of type B: where the station states every quantity, each value of a metric has U, or says what is lacking."""

import json
import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from analytics.evaluation.evaluation import define_views, evaluate
from analytics.evaluation.type_b import NO_SENSITIVITY
from analytics.metric_registry.registry import metrics
from analytics.step_records.step_table import step_means
from ingest.measurement_standards import QUANTITIES
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.bench.metric_steps import START_NS, Unit, records_of

NAMES = tuple(name for name, metric in metrics().items() if metric.header.influences)


@pytest.fixture(scope="module")
def stated(tmp_path_factory: pytest.TempPathFactory) -> pa.Table:
    """Every metric of a unit that went through everything, at a station that states every quantity."""
    records = [each | {"latitude_deg": 40.0} for each in records_of([Unit("U1")], np.random.default_rng(20))]
    with Catalog(Store.create(Path(tmp_path_factory.mktemp("stated")) / "store")) as catalog:
        catalog._unfilled.clear()  # else it would fill itself with what the store holds
        define_views(catalog, pa.Table.from_pylist(records, schema=step_means(catalog).schema))
        runs = sorted({record["run"] for record in records})
        said = {"standards": standards(), "time_zone": "UTC", "t_ns": START_NS}
        catalog.put("run_standards", pa.Table.from_pylist([{"run": run} | said for run in runs]))
        return evaluate(catalog, list(metrics().values()))


def standards() -> str:
    """A station whose standards state 1 of each quantity, as U of k = 2."""
    quantities = [
        {
            "quantity": name, "stated": 1.0, "divisor": 2.0, "u": 0.5, "unit": quantity.unit, "distribution": "normal",
            "freedom": None,
        }
        for name, quantity in QUANTITIES.items()
    ]  # fmt: skip
    return json.dumps([{"name": "station", "kind": "", "serial": "S-1", "quantities": quantities}])


@pytest.mark.parametrize("name", NAMES)
def test_a_value_has_u_where_every_standard_is_stated(stated: pa.Table, name: str) -> None:
    for row in stated.to_pylist():
        if row["metric"] != name or row["value"] is None:
            continue
        assert NO_SENSITIVITY not in (row["uncertainty_reason"] or ""), row
        assert (row["U"] is None) == (row["uncertainty_reason"] is not None), row
        if row["U"] is not None:
            combined = math.hypot(row["u_type_a"], row["u_type_b"])
            assert math.isclose(row["U"], row["k"] * combined, rel_tol=1e-12)
            assert row["k"] >= 2.0 - 1e-9
