"""The table of benchmarks: its form, and that a bar that is missed is not hidden."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.bench import table, table_rows

ROOT = Path(__file__).parents[1]
FIELDS = {"work", "unit", "ours", "peer", "ratio", "bar", "holds"}


@pytest.mark.long
def test_the_command_prints_a_row_as_json() -> None:
    command = [sys.executable, "tests/bench/table.py", "--only", "to the first row", "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    (row,) = json.loads(done.stdout)
    assert row.keys() == FIELDS
    assert 0.0 < row["ours"] < 60.0
    assert done.returncode == (0 if row["holds"] else 1)


def test_a_row_that_cannot_be_measured_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> table_rows.Measured:
        raise ModuleNotFoundError("No module named 'chdb'")

    row = table.measured(table_rows.Row("work", "s", "<= 1", fails))
    assert (row["ours"], row["holds"]) == (None, None)
    assert "chdb" in str(row["reason"])
    assert "not measured" in table.line(row)


def test_a_ratio_is_ours_by_the_peers() -> None:
    row = table.measured(table_rows.Row("work", "s", "<= 1", lambda: table_rows.Measured(3.0, 2.0, False)))
    assert row["ratio"] == 1.5
    assert table.line(row).endswith("MISSED")


def test_every_row_has_a_name_of_its_own() -> None:
    names = [row.work for row in table_rows.ROWS]
    assert len(set(names)) == len(names) > 20
