"""A fleet store by the commands: two plants with the same units and runs, asked in SQL, by metrics and by verdicts."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gyrofleet import main
from storage.fleet_store import FleetStore
from storage.sql.catalog import Catalog, known_tables
from storage.sql.fleet.fleet_door import FleetDoor, opened_fleet_catalog

_LIMIT = """
revision = "1"
[[limit]]
product = "F70"
metric = "bias"
parameters = { earth_rate = "none" }
upper = 2.0
unit_of_measure = "deg/h"
"""
_BIAS_DEG_PER_H = {"hangzhou": 1.5, "xian": 2.5}


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """Unit FOG-1 in run r1 at two plants, 4000 s at rest each; of another product at each."""
    here = tmp_path_factory.mktemp("fleet")
    (here / "f70.toml").write_text(_LIMIT)
    for plant, bias in _BIAS_DEG_PER_H.items():
        values = np.random.default_rng(5).normal(bias, 0.5, 4000)
        with (here / "r1.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["time[s]", "rate[deg/h]", "procedure", "step"])
            writer.writerows([at, f"{value:.6f}", "static_bias", "static"] for at, value in enumerate(values))
        product = "F70" if plant == "hangzhou" else "F98"
        (here / "units.csv").write_text(f"serial,product,lot\nFOG-1,{product},L1\n")
        words = ("--unit", "FOG-1", "--units", "units.csv", "--start", "2026-01-05T08:00:00Z", "--store", plant)
        assert run_command("import", "r1.csv", *words, cwd=here).code == 0
        added = run_command("limits", "add", "f70.toml", "--store", plant, cwd=here)
        assert added.code == 0, added.err
    sources = [word for plant in _BIAS_DEG_PER_H for word in ("--from", plant)]
    first = run_command("replicate", *sources, "--to", "F", "--json", cwd=here)
    assert (first.code, first.json["added"] >= 2) == (0, True)
    second = run_command("replicate", *sources, "--to", "F", "--json", cwd=here)
    assert (second.code, second.json["added"], second.json["added_bytes"]) == (0, 0, 0)
    return here / "F"


@pytest.fixture
def ask(fleet: Path) -> Callable[..., Result]:
    def run(*words: str, code: int = 0, store: Path = fleet) -> Result:
        done = CliRunner().invoke(main, [*words, "--store", str(store)])
        assert done.exit_code == code, (done.output, done.exception)
        return done

    return run


@pytest.mark.long
def test_every_row_in_sql_has_its_plant(ask: Callable[..., Result], fleet: Path) -> None:
    with FleetDoor(FleetStore.open(fleet)) as door:

        def asked(statement: str) -> list[Any]:
            return [tuple(row.values()) for row in door.ask(statement).read_all().to_pylist()]

        counts = asked("select plant, unit, run, count(*) from samples group by all order by all")
        assert counts == [(plant, "FOG-1", "r1", 4000) for plant in _BIAS_DEG_PER_H]
        mean = "round(avg(deg_per_h(value, unit_of_measure)), 1)"
        means = asked(f"select plant, {mean} from samples group by all order by all")
        assert means == list(_BIAS_DEG_PER_H.items())
        for table in ("runs", "steps", "estimates", "events", "unit_metrics", "unit_verdicts", "adev('FOG-1', 'rate')"):
            assert {plant for (plant,) in asked(f"select distinct plant from {table}")} == set(_BIAS_DEG_PER_H), table
    one = json.loads(ask("sql", "select plant, unit, verdict from unit_verdicts order by all", "--json").stdout)
    assert [row["plant"] for row in one] == list(_BIAS_DEG_PER_H)
    assert "plant" in ask("sql", "--tables", "samples").stdout


@pytest.mark.in_gate("xian")
@pytest.mark.parametrize("plant", _BIAS_DEG_PER_H)
def test_every_table_has_the_rows_of_each_plant_alone(fleet: Path, plant: str) -> None:
    with (
        opened_fleet_catalog(FleetStore.open(fleet)) as all_of_them,
        Catalog(FleetStore.open(fleet).replica(plant).store) as alone,
    ):
        for table in known_tables():
            of_plant = f"select * exclude (plant) from {table} where plant = '{plant}' order by all"
            expected = alone.table(f"select * from {table} order by all").to_pylist()
            assert all_of_them.table(of_plant).to_pylist() == expected, table


@pytest.mark.long
def test_metrics_and_verdicts_of_a_plant_are_those_of_its_store_alone(
    ask: Callable[..., Result], fleet: Path, tmp_path: Path
) -> None:
    of_fleet = json.loads(ask("metrics", "--json").stdout)
    for plant in _BIAS_DEG_PER_H:
        alone = json.loads(ask("metrics", "--json", store=fleet.parent / plant).stdout)
        assert [{"plant": plant, **row} for row in alone] == [row for row in of_fleet if row["plant"] == plant] != []
    found = json.loads(ask("verdicts", "--json").stdout)["units"]
    assert [(row["plant"], row["unit"], row["verdict"]) for row in found] == [
        ("hangzhou", "FOG-1", "PASS"),
        ("xian", "FOG-1", "NO_DATA"),  # there it is of a product without a specification
    ]
    assert "xian/FOG-1" in ask("verdicts").stdout
    assert "hangzhou/FOG-1" in ask("metrics").stdout
    ask("metrics", "--csv", str(tmp_path / "m.csv"))
    with (tmp_path / "m.csv").open(encoding="utf-8-sig", newline="") as file:
        assert {row["plant"] for row in csv.DictReader(file)} == set(_BIAS_DEG_PER_H)
    ask("metrics", "--unit", "FOG-9", code=1)
    ask("metrics", "--annex-a", "FOG-1", code=1)


@pytest.mark.long
def test_a_copy_agrees_with_what_its_plant_has_attested(fleet: Path, run_command: Callable[..., Any]) -> None:
    words = ("attest", "--store", "xian", "--out", "xian.json", "--key", "key.pem")
    assert run_command(*words, cwd=fleet.parent).code == 0
    copy = fleet / "plants" / "xian"
    assert (copy / "products" / "f70-1.toml").read_text() == _LIMIT
    found = run_command("verify", "--store", copy, "--against", "xian.json", "--json", cwd=fleet.parent)
    assert (found.code, found.json["findings"]) == (0, [])


@pytest.mark.long
def test_one_serial_with_two_products_is_reported_and_not_merged(ask: Callable[..., Result], fleet: Path) -> None:
    (conflict,) = [
        each for each in json.loads(ask("verify", "--json").stdout)["findings"] if each["kind"] == "identity_conflict"
    ]
    assert conflict["where"] == "FOG-1"
    assert "hangzhou: F70; xian: F98" in conflict["what"]
    words = ["replicate", "--from", str(fleet.parent / "xian"), "--to", str(fleet), "--json"]
    found = json.loads(CliRunner().invoke(main, words).stdout)
    assert [(each["unit"], each["field"]) for each in found["conflicts"]] == [("FOG-1", "product")]


@pytest.mark.long
def test_a_statement_on_a_fleet_store_reads_and_does_nothing_else(ask: Callable[..., Result], tmp_path: Path) -> None:
    for statement in (f"copy (select 1) to '{tmp_path / 'x'}'", "from read_text('/etc/passwd')", "drop view samples"):
        ask("sql", statement, code=2)
    ask("sql", "--catalogue", str(tmp_path / "x.duckdb"), code=1)
    assert not list(tmp_path.iterdir())
