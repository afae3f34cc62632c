"""What can be asked in SQL: tables are reported, examples run, the catalogue opens in any DuckDB and from Python."""

import json
import math
import re
import shutil
from importlib.resources import files
from pathlib import Path
from typing import Any

import duckdb
import msgspec
import numpy as np
import polars as pl
import pyarrow as pa
import pytest
from click.testing import CliRunner

from storage import open_store
from storage.commands.sql import sql
from storage.specifications.chain import append_document, read_chain
from storage.sql.catalog import Catalog, known_tables, layers
from storage.sql.tables import column_texts, columns_of, described_tables, examples, export_catalogue, read_texts
from storage.sql.views import VIEWS
from storage.store import Store
from stream.errors import BadInput, NotFound, QueryError
from stream.events import EstimatePoint, EstimatePublished, SpecificationAction, SpecificationEntered, new_uid
from tests.analytics.conftest import SECOND_NS, START_NS

GUIDE = Path(__file__).parents[3] / "docs" / "how-to" / "sql.md"
SPECIFICATION = """
name = "FOG"
revision = "A"
valid_from = 2020-01-01
[product.FOG-70]
max_rate_deg_per_s = 300.0
[[limit]]
metric = "bias"
lower = -1.0
upper = 1.0
unit_of_measure = "deg/h"
"""


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the store lies that most tests only read."""
    return tmp_path_factory.mktemp("shared") / "store"


@pytest.fixture
def store(tested: Any, shared: Path) -> Store:
    """Two units of a lot at rest for an hour on two days, one of them at four temperatures."""
    if not shared.exists():
        fill(tested)
        shutil.copytree(tested.store.folder, shared)
    return Store.open(shared)


def fill(tested: Any) -> None:
    rng = np.random.default_rng(1)
    tested.product(SPECIFICATION)
    for day in range(2):
        run, t_ns = f"d{day}", START_NS + day * 86_400 * SECOND_NS
        tested.run(run, t_ns=t_ns, procedure="static_bias")
        for i, unit in enumerate(("FOG-0231", "FOG-0232")):
            tested.mount(run, unit, t_ns=t_ns, product="FOG-70", lot="L7", slot=f"S{i}", fixture="F1")
            tested.power_on(run, unit, t_ns)
            values = 0.3 + i + 0.1 * rng.standard_normal(3600)
            tested.step(run, unit, {"rate": (values, "deg/h"), "temperature": (np.full(60, 296.15), "K")}, t0_ns=t_ns,
                        dt_ns=SECOND_NS, procedure="static_bias", position="IRA_east")  # fmt: skip
    t_ns = START_NS + 3 * 86_400 * SECOND_NS
    tested.run("t", t_ns=t_ns, procedure="bias_temperature_sensitivity")
    for degrees in (-40.0, 0.0, 20.0, 60.0):
        t_ns = tested.step("t", "FOG-0231", 0.01 * degrees + 0.1 * rng.standard_normal(600), t0_ns=t_ns,
                           dt_ns=SECOND_NS, procedure="bias_temperature_sensitivity",
                           temperature_command_deg_c=degrees)  # fmt: skip
    points = tuple(
        EstimatePoint(value=0.1 / tau, lo=0.05 / tau, hi=0.2 / tau, n=10, edf=5.0, tau_s=tau) for tau in (1.0, 2.0)
    )
    for final, n in ((False, 1800), (True, 3600)):
        tested.document(
            EstimatePublished(
                run="d0", t_ns=START_NS + n * SECOND_NS, unit="FOG-0231", signal="rate", estimator="allan_deviation",
                unit_of_measure="deg/h", confidence=0.95, samples=n, missing=0, sample_interval_s=1.0, final=final,
                points=points if final else points[:1],
            )
        )  # fmt: skip
    tested.catalog().close()


def test_every_table_says_what_it_is(store: Store) -> None:
    with Catalog(store) as catalog:
        reported = {row["table"]: row["what"] for row in described_tables(catalog)}
    assert list(reported) == [*VIEWS, *(table for layer in layers() for table in layer.tables)]
    assert [name for name, what in reported.items() if not what or "cannot be computed" in str(what)] == []


@pytest.mark.long
def test_every_column_says_what_it_holds(store: Store) -> None:
    with Catalog(store) as catalog:
        for table in known_tables():
            columns = columns_of(catalog, table)
            assert columns
            assert [row["column"] for row in columns if not row["what"]] == [], table
            assert all(row["type"] for row in columns)


@pytest.mark.long
def test_words_are_of_tables_and_columns_that_there_are(store: Store) -> None:
    """A column that was renamed takes its words with it."""
    written = [
        read_texts(files("storage.sql").joinpath("schema", "columns.toml")),
        *(layer.columns for layer in layers()),
    ]
    with Catalog(store) as catalog:
        names = (*known_tables(), "adev")
        columns = {name: {row["column"] for row in columns_of(catalog, name)} for name in names}
    for words in written:
        for table, reported in words.items():
            held = set().union(*columns.values()) if table == "every" else columns[table]
            assert set(reported) - held - {"confidence"} == set(), table


@pytest.mark.long
def test_every_example_runs(store: Store) -> None:
    with Catalog(store) as catalog:
        for question, statement in examples().items():
            reader = catalog.reader(statement)
            assert reader.schema.names
            rows = reader.read_all().num_rows
            assert rows > 0 or "where" in statement, question


@pytest.mark.long
def test_the_examples_of_the_views_answer(store: Store) -> None:
    with Catalog(store) as catalog:
        found = dict(catalog.rows(examples()["Mean output in deg/h"]))
        assert found["FOG-0232"] == pytest.approx(1.3, abs=0.01)
        assert [row[1] for row in catalog.rows(examples()["Allan deviation of a unit"])] == [1.0, 2.0]
        days = catalog.rows(examples()["Bias by day"])
        assert [(row[0], str(row[1])) for row in days if row[0] == "FOG-0232"] == [
            ("FOG-0232", "2025-11-21"),
            ("FOG-0232", "2025-11-22"),
        ]
        fleet = catalog.rows(examples()["The fleet's 100 s bias stability"])
        assert {unit for unit, _ in fleet} == {"FOG-0231", "FOG-0232"}


def test_a_table_that_is_not_there_is_told(store: Store) -> None:
    with (
        Catalog(store) as catalog,
        pytest.raises(NotFound, match="there is no table 'lake_samples'; tables are samples"),
    ):
        columns_of(catalog, "lake_samples")


@pytest.mark.long
def test_the_command_tells_tables_and_columns(store: Store) -> None:
    runner = CliRunner()
    shown = runner.invoke(sql, ["--tables", "--store", str(store.folder)], catch_exceptions=False)
    assert shown.exit_code == 0
    assert all(name in shown.output for name in ("samples", "unit_metrics", "Bias by day", "adev('UNIT', 'SIGNAL')"))
    shown = runner.invoke(sql, ["--tables", "steps", "--json", "--store", str(store.folder)], catch_exceptions=False)
    rows = {row["column"]: row for row in json.loads(shown.output)}
    assert rows["rate_command"] == {
        "column": "rate_command",
        "type": "DOUBLE",
        "what": "commanded rate of the table, deg/s",
    }
    assert runner.invoke(sql, ["--tables", "nothing", "--store", str(store.folder)]).exit_code != 0


QUESTIONS = (
    "select unit, signal, run, samples from signals order by all",
    "select unit, count(*), round(sum(value), 6) from samples where signal = 'rate' group by unit order by unit",
    "select metric, unit, signal, run, value, lo, hi, reason, parameters, standard from unit_metrics order by all",
    "select unit, day, bias from bias_by_day order by all",
    "select unit, temperature, bias from temperature_curve order by all",
    "select run, tau_s, value from adev('FOG-0231', 'rate') order by all",
    "select deg_per_h(1.0, 'deg/s'), deg_c(300.15, 'K')",
    "select unit, bucket from (select unit, t_ns // 10000000000 as bucket from rollup_10s) order by all limit 5",
    "select * from unit_verdicts order by all",
    "select * from yield_by order by all",
)


@pytest.mark.long
def test_the_exported_catalogue_answers_alike_in_any_duckdb(store: Store, tmp_path: Path) -> None:
    path = tmp_path / "catalogue.duckdb"
    export_catalogue(store, path)
    assert list(tmp_path.glob("catalogue.duckdb*")) == [path]
    with Catalog(store) as catalog, duckdb.connect(str(path), read_only=True) as plain:
        for question in QUESTIONS:
            assert plain.sql(question).to_arrow_table().to_pylist() == catalog.reader(question).read_all().to_pylist()
        shown = plain.sql(
            "select comment from duckdb_columns() where table_name = 'samples' and column_name = 'counts'"
        )
        assert shown.fetchall() == [("raw counts of the device; null if it gives none",)]
        reported = plain.sql(
            "select table_name || '.' || column_name from duckdb_columns() "
            f"where table_name in {tuple(known_tables())} and comment is null"
        )
        assert reported.fetchall() == []
    export_catalogue(store, path)  # once more, over the one that is there


def test_a_catalogue_that_cannot_be_written_is_told(store: Store, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"cannot write .*give --catalogue a file in a folder you can write"):
        export_catalogue(store, tmp_path / "nowhere" / "catalogue.duckdb")


def test_python_asks_and_gets_polars_and_arrow(store: Store) -> None:
    with open_store(store.folder) as opened:
        answer = opened.sql(
            "select unit, value from unit_metrics where metric = $metric and run = 'd0' order by unit",
            {"metric": "bias"},
        )
        frame = answer.polars()
        assert isinstance(frame, pl.DataFrame)
        assert sorted(set(frame["unit"])) == ["FOG-0231", "FOG-0232"]
        assert isinstance(answer.arrow(), pa.Table)
        assert answer.rows() == frame.to_dicts()
        with pytest.raises(QueryError, match="is refused"):
            opened.sql("create table x as select 1")


def test_units_of_measure_are_turned_by_macros(store: Store) -> None:
    with Catalog(store) as catalog:
        ((rate, rates, kelvin, fahrenheit, none, null),) = catalog.rows(
            "select deg_per_h(2.0, 'deg/s'), deg_per_h(1.0, 'rad/s'), deg_c(273.15, 'K'), deg_c(212.0, 'degF'), "
            "deg_per_h(1.0, 'V'), deg_per_h(null, 'deg/s')"
        )
        assert rate == 7200.0
        assert rates == pytest.approx(math.degrees(3600), rel=1e-12)
        assert kelvin == pytest.approx(0.0, abs=1e-9)
        assert fahrenheit == pytest.approx(100.0, rel=1e-12)
        assert (none, null) == (None, None)
        # a unit of measure that is in the store, of every row
        ((least, most),) = catalog.rows(
            "select min(deg_c(value, unit_of_measure)), max(deg_c(value, unit_of_measure)) from samples "
            "where signal = 'temperature'"
        )
        assert least == most == pytest.approx(23.0, abs=1e-9)


def test_adev_says_that_it_is_the_estimate_of_live_data(store: Store) -> None:
    with Catalog(store) as catalog:
        assert set(catalog.rows("select final, overlap from adev('FOG-0231', 'rate')")) == {(True, "strided")}
        texts = {row["column"]: str(row["what"]) for row in columns_of(catalog, "adev")}
    assert "about 1 % from the value with every window" in texts["overlap"]
    assert all(texts.values())


def test_adev_is_the_last_estimate_of_each_run(store: Store) -> None:
    with Catalog(store) as catalog:
        rows = catalog.rows("select run, tau_s, value, lo, hi, n from adev('FOG-0231', 'rate')")
        assert rows == [("d0", 1.0, 0.1, 0.05, 0.2, 10), ("d0", 2.0, 0.05, 0.025, 0.1, 10)]
        assert catalog.rows("select * from adev('FOG-0232', 'rate')") == []


@pytest.mark.long
def test_a_layer_that_cannot_be_made_harms_no_other_table(store: Store, tmp_path: Path) -> None:
    shutil.copytree(store.folder, tmp_path / "broken")
    store = Store.open(tmp_path / "broken")
    broken = SpecificationEntered(
        run="", t_ns=START_NS, action=SpecificationAction.ADDED, name="broken", revision="A", by="Li",
        previous=read_chain(store).head,
        content="revision = 'A'\n[product.FOG-70]\nmax_rate_deg_per_s = 'fast'\n",
    )  # fmt: skip
    append_document(store, broken)
    with Catalog(store) as catalog:
        for _ in range(2):  # it stays so, and stays reported
            with pytest.raises(BadInput, match=r"broken-A\.toml.*max_rate_deg_per_s"):
                catalog.rows("select count(*) from unit_metrics")
        ((samples,),) = catalog.rows("select sum(samples) from signals where signal = 'rate'")
        assert samples == 4 * 3600 + 4 * 600
        reported = {row["table"]: str(row["what"]) for row in described_tables(catalog)}
        assert reported["samples"].startswith("every sample")
        assert "cannot be computed: " in reported["unit_metrics"]
        assert "broken-A.toml" in reported["unit_metrics"]
        assert columns_of(catalog, "samples")
    withdrawn = msgspec.structs.replace(
        broken, action=SpecificationAction.WITHDRAWN, content="", previous=read_chain(store).head, rejudges=True
    )
    append_document(store, msgspec.structs.replace(withdrawn, uid=new_uid()))
    with Catalog(store) as catalog:
        ((metrics,),) = catalog.rows("select count(*) from unit_metrics")  # mended, it is made
        assert metrics > 0


def test_words_of_a_table_go_before_those_of_every(store: Store) -> None:
    assert column_texts("unit_metrics")["n"] == "how many single results it rests on"
    assert column_texts("rate_steps")["n"] == "samples in the evaluated part"
    assert column_texts("estimates")["n"] == "number of averaged terms"


@pytest.mark.long
def test_what_the_guide_asks_runs(store: Store) -> None:
    section = GUIDE.read_text(encoding="utf-8")
    statements = re.findall(r'gyrofleet sql "(.*?)"\n', section, re.DOTALL)
    assert len(statements) > 10
    with Catalog(store) as catalog:
        for statement in statements:
            assert catalog.reader(statement).schema.names
    (code,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    found: dict[str, Any] = {}
    exec(code.replace('"gyrofleet-data"', repr(str(store.folder))), found)
    assert found["frame"].columns == ["unit", "value", "lo", "hi"]
    assert found["table"].num_rows > 0
    reported = set(re.findall(r"`(\w+)`", section.split("| tables | what |")[1].split("\n\n")[0]))
    assert set(known_tables()) - reported == set()
