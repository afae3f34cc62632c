"""Stores with values of metrics."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from analytics.evaluation.evaluation import COLUMNS, define_views
from analytics.step_records.step_table import step_means
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.analytics.trends.reported_values import HOUR_NS, START_NS, Reported


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.create(tmp_path / "store")


@pytest.fixture
def reported(store: Store) -> Iterator[Reported]:
    """A catalogue with these values, each of a step of a run of its own unless it says otherwise."""
    catalogs: list[Catalog] = []

    def fill(rows: Sequence[Mapping[str, Any]]) -> Catalog:
        catalog = Catalog(store)
        catalogs.append(catalog)
        catalog._unfilled.clear()  # what it would compute is what the test says
        steps: list[dict[str, Any]] = []
        values: list[dict[str, Any]] = []
        for at, row in enumerate(rows):
            run = row.get("run", f"r{at:05}")
            step = {"run": run, "unit": row["unit"], "signal": row.get("signal", "rate"), "index": row.get("step", 1)}
            t_ns = START_NS + row.get("hour", at) * HOUR_NS
            about = {name: row.get(name) for name in ("station", "lot", "fixture", "product")}
            if step not in [{name: each[name] for name in step} for each in steps[-3:]]:
                about |= {"t_start_ns": t_ns, "t_to_ns": t_ns, "date_known": row.get("dated", True)}
                steps.append(step | about | {"unit_of_measure": "deg/h"})
            values.append(
                {
                    "metric": row.get("metric", "bias"), "unit": row["unit"], "signal": step["signal"], "run": run,
                    "value": row.get("value"), "unit_of_measure": row.get("measure", "deg/h"),
                    "standard_uncertainty": 0.01, "n": 100,
                    "parameters": json.dumps(row.get("parameters", {})), "runs": [run], "steps": [step["index"]],
                    "standard": row.get("standard", "JJF2014"), "clause": "7", "reason": row.get("reason"),
                }
            )  # fmt: skip
        table = pa.Table.from_pylist(steps, schema=step_means(catalog).schema)
        define_views(catalog, table)
        catalog.put("unit_metrics", pa.Table.from_pylist(values, schema=COLUMNS))
        return catalog

    yield fill
    for each in catalogs:
        each.close()
