"""Which units a run has whose files come one after the other."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ingest.importing.tested_units import is_instrument_name
from storage.sql.catalog import Catalog
from storage.store import Store

NAMES = (
    *("rate", "rate_x", "gyro_z", "table_rate", "Table", "input", "rate_table", "rate_ref", "rate_reference_x"),
    *("true_rate", "truth", "trueness", "reference", "setpoint", "set_point", "earth_rate", "chamber", "转台速率"),
    *("角速率", "温箱", "encoder", "platform", "vibration", "commanded", "ratetable", "angle_x"),
)


def write(folder: Path, unit: str, signal: str, interval_s: float = 0.1) -> None:
    rng = np.random.default_rng(len(unit) + ord(unit[0]))
    rows = [f"{i * interval_s:.1f},{unit},R-9,{value:.4f}" for i, value in enumerate(rng.normal(0, 1, 200))]
    (folder / f"{unit}.csv").write_text("\n".join([f"time[s],unit,run,{signal}", *rows]) + "\n")


@pytest.mark.parametrize(
    "imports",
    [
        ["A", "table", "chamber C"],
        pytest.param(["A", "B", "chamber", "table", "C", "B"], marks=pytest.mark.long),
        pytest.param(["A B chamber table C"], marks=pytest.mark.long),
    ],
    ids=["few", "each", "together"],
)
def test_each_file_of_a_run_brings_its_units(
    run_command: Callable[..., Any], tmp_path: Path, imports: list[str]
) -> None:
    for unit in ("A", "B"):
        write(tmp_path, unit, "rate[deg/s]")
    write(tmp_path, "chamber", "temperature[degC]", 5.0)
    write(tmp_path, "table", "table_rate[deg/s]")
    write(tmp_path, "C", "output[count]")
    for names in imports:
        files = [f"{name}.csv" for name in names.split()]
        assert run_command("import", *files, "--store", "s", cwd=tmp_path).code == 0
    with Catalog(Store.open(tmp_path / "s")) as catalog:
        found = catalog.rows("select unit from units order by 1")
    assert [unit for (unit,) in found] == sorted({"A", "B", "C"} & set(" ".join(imports).split()))


def test_files_and_tables_know_instruments_by_the_same_names(tmp_path: Path) -> None:
    with Catalog(Store.create(tmp_path / "s")) as catalog:
        catalog.rows("select * from unused_steps")  # whose layer has the macro
        found = catalog.rows("select name, is_instrument_name(name) from unnest($names) t(name)", {"names": NAMES})
    assert {name: is_instrument_name(name) for name in NAMES} == dict(found)
