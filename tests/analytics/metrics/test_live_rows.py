"""Metrics are of what is sealed: rows that only the log has change no value, and nothing that the store keeps."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.evaluation.kept_check import kept_findings
from analytics.step_records import FOLDER
from storage.sql.catalog import Catalog, known_tables
from storage.sql.door import SqlDoor
from storage.sql.views import VIEWS
from storage.store import Store
from tests.analytics.conftest import SECOND_NS, START_NS, TestedUnits

VALUES = "select * from unit_metrics order by all"
WARNINGS = "select * from unit_warnings order by all"
BESIDE = """
select m.unit, any_value(m.value) as bias, any_value(s.samples)::int as samples, any_value(s.live)::int as live
from signals s left join unit_metrics m on m.unit = s.unit and m.metric = 'bias' group by m.unit, s.unit order by s.unit
"""


def kept(store: Store) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((store.folder / FOLDER).iterdir())}


def step(tested: TestedUnits, unit: str, mean: float, at_s: int) -> None:
    values = mean + 0.1 * np.random.default_rng(at_s).standard_normal(600)
    t0_ns = START_NS + at_s * SECOND_NS
    tested.step("r1", unit, values, t0_ns=t0_ns, dt_ns=SECOND_NS, procedure="static_bias", position="IRA_east_west")


@pytest.mark.long
def test_live_rows_stand_beside_metrics_and_change_none(tested: TestedUnits, tmp_path: Path) -> None:
    tested.run("r1", procedure="static_bias")
    step(tested, "G-1", 3.0, 0)
    with tested.catalog() as catalog:
        values = catalog.table(VALUES)
        warnings = catalog.table(WARNINGS)
    assert values.num_rows
    before = kept(tested.store)

    step(tested, "G-1", 300.0, 700)
    step(tested, "G-2", 5.0, 0)
    tested._log.sync()
    with SqlDoor(tested.store) as door:

        def ask(sql: str) -> Any:
            return door.ask(sql).read_all()

        (first, second) = ask(BESIDE).to_pylist()
        assert abs(first["bias"] - 3.0) < 0.1
        assert (first["samples"], first["live"]) == (1200, 600)
        assert second == {"unit": None, "bias": None, "samples": 600, "live": 600}
        assert ask(VALUES).equals(values)
        assert ask(WARNINGS).equals(warnings)
        assert ask("select count(*)::int as n from step_means").to_pylist() == [{"n": 1}]
        assert ask("select count(*)::int as n from steps").to_pylist() == [{"n": 3}]
        assert ask(VALUES).equals(values)
        for table in known_tables():
            ask(f"select (select count(*) from {table}) as n, (select count(*) from signals) as signals")
        assert sorted(ask("show tables")["name"].to_pylist()) == sorted(VIEWS)
    assert kept(tested.store) == before
    assert kept_findings(tested.store) == []

    with tested.catalog() as catalog:
        assert catalog.rows("select unit, count(*) from step_means group by unit order by unit") == [
            ("G-1", 2),
            ("G-2", 1),
        ]
    with Catalog(tested.store, live=True) as catalog:
        rows = catalog.user_reader(BESIDE).read_all().to_pylist()
        assert [(row["unit"], row["live"]) for row in rows] == [("G-1", 0), ("G-2", 0)]


@pytest.mark.long
def test_metrics_that_are_not_kept_yet_are_computed_beside_live_rows(tested: TestedUnits) -> None:
    tested.run("r1", procedure="static_bias")
    step(tested, "G-1", 3.0, 0)
    tested.catalog().close()
    step(tested, "G-1", 300.0, 700)
    tested._log.sync()
    with SqlDoor(tested.store) as door:
        (row,) = door.ask(BESIDE).read_all().to_pylist()
    assert abs(row["bias"] - 3.0) < 0.1
    assert row["live"] == 600
    assert kept_findings(tested.store) == []
