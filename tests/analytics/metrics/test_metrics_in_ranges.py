"""Metrics computed for ranges of units, and one metric alone, are those that are computed for all at once."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from analytics.evaluation import kept_metrics, ranges
from analytics.evaluation.evaluation import COLUMNS
from analytics.evaluation.ranges import in_order
from analytics.metric_registry.registry import metrics
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.analytics.conftest import TestedUnits
from tests.analytics.metrics.test_incremental_metrics import START_NS, Bench, table_of


def fill(tested: Any) -> None:
    """Three units with tests of several kinds, two of them fed by one supply."""
    for grow in Bench(tested).grown():
        grow()
    tested.run("p", t_ns=START_NS, procedure="power_consumption")
    for unit in ("U1", "U3"):
        tested.mount("p", unit, t_ns=START_NS, product="FOG-70")
        tested.step("p", unit, np.array([1.0, 1.5, 1.2]), t0_ns=START_NS)
    for signal, measure in (("supply_voltage", "V"), ("supply_current", "A")):
        tested.samples("p", "PSU", signal, np.array([5.0, 5.1, 5.2]), t0_ns=START_NS, unit_of_measure=measure)


@pytest.fixture
def filled(tested: Any) -> Any:
    """A store of the units."""
    fill(tested)
    return tested


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Store, pa.Table]]:
    """A store of the units that is only read, and all its metrics."""
    made = TestedUnits(tmp_path_factory.mktemp("whole") / "store")
    fill(made)
    yield made.store, table_of(made)
    made.release()


@pytest.mark.long
def test_ranges_of_units_have_the_rows_of_one_pass(
    whole: tuple[Store, pa.Table], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, every = whole
    with Catalog(store) as catalog:
        steps = catalog.table("from step_means order by all")
        static = catalog.table("from static_steps order by all")
    assert len(set(every["unit"].to_pylist())) == 3
    monkeypatch.setattr(ranges, "RANGE_RECORDS", 1)  # each unit is a range
    with Catalog(store, kept=tmp_path) as catalog:
        assert catalog.table("from unit_metrics").equals(every)
        assert catalog.table("from step_means order by all").equals(steps)
        assert catalog.table("from static_steps order by all").equals(static)
    with Catalog(store, kept=tmp_path) as catalog:  # as kept
        assert catalog.table("from unit_metrics").equals(every)


@pytest.mark.long
def test_a_supply_of_two_units_is_one_also_where_one_of_them_changed(filled: Any) -> None:
    def of_power() -> pa.Table:
        with filled.catalog() as catalog:
            return catalog.table("from unit_metrics where metric = 'power'")

    before = of_power()
    reasons = before["reason"].to_pylist()
    assert [reason.startswith("supply PSU fed 2 units at once") for reason in reasons] == [True, True]
    Bench(filled).still("later", 5, ("U1",), power_ons=1)
    assert of_power().equals(before)


@pytest.mark.in_gate("power")
@pytest.mark.parametrize("metric", sorted(metrics()))
def test_a_metric_alone_is_the_one_among_all(whole: tuple[Store, pa.Table], tmp_path: Path, metric: str) -> None:
    store, every = whole
    expected = every.filter(pa.compute.equal(every["metric"], metric))
    with Catalog(store, kept=tmp_path) as catalog, catalog.suspended_layers():
        kept_metrics.unit_metrics(catalog, wanted=[metric])
        assert catalog.table("from unit_metrics").equals(expected)


def test_rows_are_sorted_by_all_keys_also_where_the_first_ones_are_equal(tmp_path: Path) -> None:
    rng = np.random.default_rng(21)
    n = 3000

    def some(texts: list[str | None]) -> list[str | None]:
        return [texts[at] for at in rng.integers(len(texts), size=n)]

    columns = {
        "unit": some(["U1", "U10", "U2", "é"]), "metric": some(["bias", "power"]), "signal": some([None, "rate", "a"]),
        "run": some([None, "r1", "R1"]), "parameters": some([None, "{}", '{"a":1}']),
        "standard": some(["JJF2014", "A"]),
        "clause": some(["1", "2", "10"]), "reason": some([None, "few"]),
        "steps": [[int(each)] for each in rng.integers(3, size=n)], "runs": [[], ["r1"], ["r1", "r2"]] * (n // 3),
        "value": rng.normal(size=n),
    }  # fmt: skip
    rows = pa.table({field.name: pa.array(columns.get(field.name, [None] * n), field.type) for field in COLUMNS})
    with Catalog(Store.create(tmp_path / "store")) as catalog, catalog.suspended_layers():
        found = in_order(catalog, rows)
        statement = "select * from given_rows order by {}, value"
        keys = (
            "unit, metric, signal nulls first, run nulls first, parameters nulls first, standard, clause, steps, runs"
        )
        expected = catalog.table(statement.format(f"{keys}, reason"), rows)
    places = [name for name in COLUMNS.names if name != "value"]  # equal in all keys, rows may come in either order
    assert found.select(places).equals(expected.select(places).cast(found.select(places).schema))
    assert sorted(found["value"].to_pylist()) == sorted(rows["value"].to_pylist())
