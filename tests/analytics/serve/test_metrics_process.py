"""Metrics of a large lake, computed beside the server: the same as those computed in it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from analytics.serve import shared_lake
from analytics.serve.metrics_process import MetricsProcess
from analytics.serve.shared_lake import SharedLake
from storage.sql.catalog import Catalog, NotKept
from storage.store import Store

COUNTS = [
    {"time": f"{at / 10}", "unit": f"FOG-{unit}", "rate": f"{unit + at % 7}"} for unit in (1, 2) for at in range(600)
]
VALUES = "select unit, metric, value, lo, hi, reason from unit_metrics order by all"


@pytest.fixture
def store(tmp_path: Path, run_command: Callable[..., Any]) -> Store:
    lines = ["time[s],unit,rate[deg/h]", *(",".join(row.values()) for row in COUNTS)]
    (tmp_path / "rest.csv").write_text("\n".join(lines))
    words = ("import", "rest.csv", "--run", "r1", "--procedure", "static_bias", "--start", "2026-11-21T10:00:00Z")
    done = run_command(*words, "--store", "S", cwd=tmp_path)
    assert done.code == 0, done.err
    return Store.open(tmp_path / "S")


@pytest.mark.long
def test_a_large_lake_has_the_same_metrics(store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Catalog(store, kept=tmp_path) as catalog:
        expected = catalog.rows(VALUES)
    assert expected
    with Catalog(store, frozen=True) as catalog, pytest.raises(NotKept):
        catalog.fill()
    monkeypatch.setattr(shared_lake, "LARGE_SAMPLES", len(COUNTS))
    with SharedLake(store, lambda: "0") as lake, lake.metrics.lease(lake.state()) as catalog:
        assert catalog.rows(VALUES) == expected
    with Catalog(store, frozen=True) as catalog:  # the process has kept them
        assert catalog.rows(VALUES) == expected


@pytest.mark.long
def test_a_server_that_ends_computes_nothing_more(store: Store) -> None:
    process = MetricsProcess(store)
    process.close()
    process.run()
    with Catalog(store, frozen=True) as catalog, pytest.raises(NotKept):
        catalog.fill()
