"""The simulated units of the laws of metrics, all in one evaluation: its cost is that of its statements, not of units.

One unit went through everything, the tests of one were cut short, the output of one is in mV and no scale factor is
known for it. Further units repeat the first one: at a station that states its standards, and with another output.
"""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from analytics.evaluation.evaluation import define_views, evaluate
from analytics.metric_registry.registry import metrics
from analytics.specifications.entering import add_specification
from analytics.step_records.step_table import step_means
from ingest.measurement_standards import QUANTITIES
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.bench.metric_steps import DAY_NS, START_NS, Unit, records_of

Records = list[dict[str, Any]]
Rows = list[dict[str, Any]]
OWN = ("U1", "U2", "U3")
STATED = "stated"
PRODUCT = (
    '[product."FOG-70"]\nmax_rate_deg_per_s = 100.0\nnonlinearity_ppm = 500.0\nexpected_threshold_deg_per_h = 3.0\n'
)


class Simulated(NamedTuple):
    """A store that holds a specification only, records of steps of three units, their metrics, and those of others."""

    store: Store
    records: Records
    table: pa.Table
    listed: Rows
    others: Rows

    def rows(self, metric: str, unit: str | None = None) -> Rows:
        return [row for row in self.listed if row["metric"] == metric and unit in {None, row["unit"]}]

    def rows_of_other(self, unit: str) -> Rows:
        return [row for row in self.others if row["unit"] == unit]


def simulated_units(folder: Path) -> Simulated:
    """Evaluate every metric of all units at once."""
    store = Store.create(folder / "store")
    path = folder / "specification.toml"
    path.write_text(f'revision = "A"\n{PRODUCT}')
    add_specification(store, path)
    records = [each | {"product": "FOG-70"} for each in campaign()]
    further = [*at_a_station_that_states()]
    for name, (plain, changed) in outputs(records).items():
        further += [each | {"unit": f"{name}, plain"} for each in plain]
        further += [each | {"unit": f"{name}, changed"} for each in changed]
    table = evaluated(store, [*records, *further])
    is_own = pa.compute.is_in(table["unit"], pa.array(OWN))
    own, others = table.filter(is_own), table.filter(pa.compute.invert(is_own))
    return Simulated(store, records, own, own.to_pylist(), others.to_pylist())


@cache
def campaign() -> tuple[dict[str, Any], ...]:
    rng = np.random.default_rng(20)
    whole = records_of([Unit("U1")], rng)
    short = records_of([Unit("U2")], rng, cut=1)
    scaleless = [each | {"unit_of_measure": "mV"} for each in records_of([Unit("U3")], rng, cut=7)]
    return (*whole, *short, *scaleless)


def at_a_station_that_states() -> Iterator[dict[str, Any]]:
    """The unit that went through everything, without a product, in runs of its own."""
    for each in campaign():
        if each["unit"] == "U1":
            yield each | {"unit": STATED, "run": f"{STATED}-{each['run']}", "latitude_deg": 40.0}


def evaluated(store: Store, records: Records) -> pa.Table:
    with Catalog(store) as catalog:
        catalog._unfilled.clear()  # else it would fill itself with what the store holds
        define_views(catalog, pa.Table.from_pylist(records, schema=step_means(catalog).schema))
        runs = sorted({each["run"] for each in records if each["unit"] == STATED})
        said = {"standards": standards(), "time_zone": "UTC", "t_ns": START_NS, "recorded_ns": START_NS}
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


def outputs(records: Records) -> dict[str, tuple[Records, Records]]:
    """By what is changed of an output: records of the unit that went through everything, as they are and changed.

    The Earth's rate, which is not scaled, is not known.
    """
    whole = [each | {"latitude_deg": None} for each in records if each["unit"] == "U1"]
    scaleless = [each for each in whole if not is_scale_factor(each)]
    times = ("t_start_ns", "t_from_ns", "t_to_ns")
    later = [
        each if is_scale_factor(each) else each | {name: each[name] + 100 * DAY_NS for name in times} for each in whole
    ]
    signed = [each for each in whole if each["procedure"] in {"static_bias", "polarity"}]
    return {
        "doubled": (scaleless, scaled(scaleless, 2.0)),
        "calibrated": (later, scaled(later, 1.25)),
        "reversed": (signed, [each | {"mean": -each["mean"]} for each in signed]),
    }


def is_scale_factor(record: dict[str, Any]) -> bool:
    return "scale_factor" in record["procedure"]


def scaled(records: Records, factor: float) -> Records:
    """Records of an output that is so many times as large; powers of 2 are exact."""
    linear = ("mean", "sd", "standard_uncertainty", "sd_1s", "sd_10s", "sd_100s")
    square = ("white", "flicker", "walk")

    def times(each: dict[str, Any], names: tuple[str, ...], by: float) -> dict[str, Any]:
        return {name: None if each[name] is None else each[name] * by for name in names}

    return [each | times(each, linear, factor) | times(each, square, factor**2) for each in records]
