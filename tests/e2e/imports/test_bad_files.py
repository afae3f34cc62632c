"""Files that cannot be imported, and places that cannot be written, are named in words and leave no trace."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from tests.e2e.imports.test_import import table

PARQUET = {"time[s]": [0.0, 1.0, 2.0], "rate[deg/s]": [1.0, 2.0, 3.0]}
BAD_FILES: dict[str, tuple[object, tuple[str, ...]]] = {
    "no_signal.csv": ("time[s]\n1\n2\n", ("no_signal.csv",)),
    "no_unit_of_measure.csv": ("time[s],rate\n0,1\n", ("rate", "[deg/s]")),
    "text.csv": ("time[s],rate[deg/s]\n0,one\n1,two\n", ("line 2", "rate[deg/s]", "one")),
    "unknown_unit.csv": ("time[s],rate[dge/s]\n0,1\n", ("dge/s", "did you mean deg/s")),
    "decreasing.csv": ("time[s],rate[deg/s]\n0,1\n2,1\n1,1\n", ("line 4",)),
    "duplicate.csv": ("time[s],rate[deg/s]\n0,1\n1,1\n1,1\n", ("line 4",)),
    "nan.csv": ("time[s],rate[deg/s]\n0,1\n1,nan\n", ("line 3", "nan")),
    "infinity.csv": ("time[s],rate[deg/s]\n0,1\n1,inf\n", ("line 3", "inf")),
    "empty.csv": ("", ("empty",)),
    "header_only.csv": ("time[s],rate[deg/s]\n", ("header_only.csv",)),
    "no_time.csv": ("rate[deg/s]\n1\n", ("time[s]", "--sample-rate")),
    "nan.parquet": ({**PARQUET, "rate[deg/s]": [1.0, float("nan"), 3.0]}, ("row 2", "nan")),
    "text.parquet": ({**PARQUET, "rate[deg/s]": ["a", "b", "c"]}, ("rate[deg/s]",)),
    "garbage.parquet": ("not parquet at all", ("garbage.parquet",)),
    "table.xlsx": ("x", (".parquet",)),
}


@pytest.mark.in_gate(
    "unknown_unit.csv", "text.csv", "decreasing.csv", "empty.csv", "no_time.csv", "nan.parquet", "garbage.parquet"
)
@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_is_refused_in_words_and_leaves_no_trace(
    gyrofleet: Callable[..., Any], tmp_path: Path, name: str
) -> None:
    content, wanted = BAD_FILES[name]
    if isinstance(content, dict):
        pl.DataFrame(content).write_parquet(tmp_path / name)
    else:
        (tmp_path / name).write_text(str(content))
    table(tmp_path / "good.csv")
    refused = gyrofleet("import", "good.csv", name, "--unit", "U1")
    assert refused.code == 1
    assert refused.err.startswith("error: ")
    assert all(word in refused.err for word in (name, *wanted)), refused.err
    assert not (tmp_path / "gyrofleet-data").exists()
    as_json = gyrofleet("import", "good.csv", name, "--unit", "U1", "--json")
    assert as_json.code == 1
    assert name in as_json.json["error"]["message"]


def test_a_truncated_parquet_file_is_refused(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    path = table(tmp_path / "a.parquet")
    path.write_bytes(path.read_bytes()[:-100])
    refused = gyrofleet("import", path, "--unit", "U1")
    assert refused.code == 1
    assert "a.parquet" in refused.err


def test_a_missing_unit_missing_file_and_foreign_folder_are_said_so(
    gyrofleet: Callable[..., Any], tmp_path: Path
) -> None:
    path = table(tmp_path / "a.csv")
    assert "--unit" in gyrofleet("import", path).err
    assert "no such file" in gyrofleet("import", "b.csv", "--unit", "U1").err
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "text.txt").write_text("x")
    refused = gyrofleet("import", path, "--unit", "U1", "--store", "thesis")
    assert refused.code == 1
    assert "not a gyrofleet store" in refused.err
    assert [each.name for each in (tmp_path / "thesis").iterdir()] == ["text.txt"]


def test_a_store_on_an_unwritable_place_is_said_so(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv")
    refused = gyrofleet("import", path, "--unit", "U1", "--store", "/proc/gyrofleet")
    assert refused.code == 1
    assert "cannot write the store /proc/gyrofleet" in refused.err
