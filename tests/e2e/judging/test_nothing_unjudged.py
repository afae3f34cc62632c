"""What a file calls by a name of its own is judged all the same, or said to be left out."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from analytics.evaluation.evaluation import define_views
from analytics.step_records.step_table import step_means
from gyrofleet import main
from ingest.procedures.file import ready_names
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.quantities import conversion

NAMES = (
    "power_cycling",
    "range_soak",
    "rates_none",
    "threshold_soak",
    "visual_then_still",
    "resolution_of_adc",
    "ranging",
)
HEADS = {
    "U-DPS": "rate[dps]",
    "U-MDPS": "rate[mdps]",
    "U-MV": "rate[mV]",
    "U-OUT": "output[mV]",
    "U-COUNT": "sensor[count]",
    "U-LSB": "gyro_z[LSB]",
}


@pytest.fixture(scope="module")
def ask(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Result]:
    """One file for each name of a procedure, one for each way to write the output; 5 deg/h where that is a rate."""
    here = tmp_path_factory.mktemp("unjudged")
    rng = np.random.default_rng(3)

    def ask(*words: object, code: int = 0) -> Result:
        done = CliRunner().invoke(main, [*(str(word) for word in words), "--store", str(here / "S")])
        assert done.exit_code == code, (done.output, done.exception)
        return done

    def written(name: str, head: str, factor: float, procedure: str) -> Path:
        values = factor * (5 + rng.normal(0, 0.1, 300))
        rows = [f"{name},{i},{value!r},{15.0 + i / 7},{procedure}" for i, value in enumerate(values.tolist())]
        text = "\n".join([f"unit,time[s],{head},reference_rate[deg/s],procedure", *rows])
        (here / f"{name}.csv").write_text(text + "\n")
        return here / f"{name}.csv"

    paths = [written(f"U-{name}", "rate[deg/h]", 1.0, name) for name in NAMES]
    for name, head in HEADS.items():
        unit = head.partition("[")[2][:-1]
        factor = 1.0 if unit in {"mV", "count", "LSB"} else conversion("deg/h", unit)[0]
        paths.append(written(name, head, factor, "static_bias"))
    ask("import", *paths)
    return ask


@pytest.fixture(scope="module")
def biases(ask: Callable[..., Result]) -> dict[str, dict[str, Any]]:
    rows = json.loads(ask("metrics", "--metric", "bias", "--json").stdout)
    return {row["unit"]: row for row in rows if row["signal"].startswith("rate")}


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_only_begins_like_a_procedure_is_no_procedure(biases: dict[str, Any], name: str) -> None:
    assert biases[f"U-{name}"]["value"] == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize("unit", ["U-DPS", "U-MDPS"])
def test_degrees_per_second_may_be_written_dps(biases: dict[str, Any], unit: str) -> None:
    assert biases[unit]["value"] == pytest.approx(5.0, abs=0.1)


def test_an_output_without_a_scale_factor_has_a_reason(biases: dict[str, Any]) -> None:
    assert "no scale factor for an output in mV" in biases["U-MV"]["reason"]


def test_an_output_in_counts_may_be_called_gyro(ask: Callable[..., Result]) -> None:
    (found,) = json.loads(ask("metrics", "--unit", "U-LSB", "--metric", "bias", "--json").stdout)
    assert found["signal"] == "gyro_z"
    assert "no scale factor for an output in LSB" in found["reason"]


@pytest.mark.long
def test_a_reference_is_no_gyro(ask: Callable[..., Result]) -> None:
    (found,) = json.loads(
        ask("sql", "select count(*) as n from unit_metrics where signal = 'reference_rate'", "--json").stdout
    )
    assert found["n"] == 0


@pytest.mark.long
def test_a_signal_that_is_not_taken_for_an_output_is_said(ask: Callable[..., Result]) -> None:
    rows = json.loads(ask("sql", "select distinct unit, reason from unused_steps order by unit", "--json").stdout)
    assert [row["unit"] for row in rows] == ["U-COUNT", "U-OUT"]
    assert rows[1]["reason"].startswith("signal output in mV is not taken for the output of a gyro: call it rate")
    reported = ask("metrics", "--unit", "U-OUT")
    assert "not judged: 1 step of U-OUT: signal output in mV" in reported.stderr
    assert "not judged" not in ask("metrics", "--unit", "U-DPS").stderr


@pytest.fixture
def catalog(tmp_path: Path) -> Iterator[Catalog]:
    store = Store.create(tmp_path / "S")
    with Catalog(store) as catalog:
        define_views(catalog, step_means(catalog))
        yield catalog


def test_the_programs_own_procedures_are_known_by_name(catalog: Catalog) -> None:
    asked = {name: catalog.rows("select is_no_bias_procedure($name)", {"name": name})[0][0] for name in ready_names()}
    # their steps at rest are records of a bias
    assert {name for name, known in asked.items() if not known} == {
        "static_bias", "allan_variance", "bias_repeatability", "bias_repeatability_days",
    }  # fmt: skip
