"""A store with specifications, whose runs and values are what a test says."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from analytics.evaluation.evaluation import COLUMNS, define_views
from analytics.evaluation.layer import VerdictsLayer, define_metric_tables
from analytics.specifications.entering import add_specification
from analytics.step_records.step_table import step_means
from storage.sql.catalog import Catalog
from storage.store import Store

HOUR_NS = 3600 * 10**9
DAY_NS = 24 * HOUR_NS
JANUARY_NS = 1_767_225_600 * 10**9  # 2026-01-01 00:00 UTC
Rows = Sequence[Mapping[str, Any]]


class Judged:
    """A store with specifications, whose runs and values are what a test says."""

    def __init__(self, folder: Path) -> None:
        self.store = Store.create(folder / "store")
        self._folder = folder
        self._catalogs: list[Catalog] = []

    def specify(self, text: str, name: str = "fog.toml") -> None:
        path = self._folder / name
        path.write_text(text)
        add_specification(self.store, path)

    def catalog(self, runs: Rows, values: Rows) -> Catalog:
        catalog = Catalog(self.store)
        self._catalogs.append(catalog)
        catalog._unfilled.clear()  # what it would compute is what the test says
        plain = {
            "product": "X",
            "station": "S1",
            "date_known": True,
            "time_zone": "UTC",
            "t_start_ns": JANUARY_NS,
            "unit_of_measure": "deg/h",
        }
        rows = [plain | {"t_to_ns": row.get("t_start_ns", JANUARY_NS) + HOUR_NS} | dict(row) for row in runs]
        steps = pa.Table.from_pylist(rows, schema=step_means(catalog).schema)
        define_views(catalog, steps)
        catalog.put("unit_metrics", pa.Table.from_pylist([_value(row) for row in values], schema=COLUMNS))
        define_metric_tables(catalog)
        VerdictsLayer().fill(catalog)
        return catalog

    def close(self) -> None:
        for catalog in self._catalogs:
            catalog.close()


def _value(row: Mapping[str, Any]) -> dict[str, Any]:
    plain = {
        "metric": "bias", "unit": "U1", "signal": "rate", "run": "r1", "unit_of_measure": "deg/h", "n": 10,
        "standard": "GJB2426A, JJF2014", "clause": "5.12.1", "steps": [1],
    }  # fmt: skip
    reported: dict[str, Any] = plain | dict(row)
    reported.setdefault("runs", [reported["run"]])
    reported["parameters"] = json.dumps(reported.get("parameters", {}))
    return reported


def limits(*entries: str, revision: str = "A", head: str = "") -> str:
    body = "".join(f"[[limit]]\n{entry}\n" for entry in entries)
    return f'revision = "{revision}"\n{head}\n{body}'


BIAS = 'metric = "bias"\nlower = -1.0\nupper = 1.0\nunit_of_measure = "deg/h"'
