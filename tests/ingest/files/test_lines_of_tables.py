"""Lines of text tables: still being written, naming the delimiter, out of order; and columns with new names."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PLACE = ("--unit", "U", "--run", "r", "--start", "2026-03-01T12:00:00Z", "--store", "s", "--json")
Command = Callable[..., Any]


def stored(run: Command, folder: Path) -> list[float]:
    asked = "select value from samples where signal = 'rate' order by t_ns"
    return [row["value"] for row in run("sql", asked, "--store", "s", "--json", cwd=folder).json]


def test_a_number_without_its_last_digits_waits_for_them(run_command: Command, tmp_path: Path) -> None:
    text = "time[s],rate[deg/h]\n" + "".join(f"{at}.0,{at + 0.1234:.4f}\n" for at in range(30))
    for end in (-4, None):
        (tmp_path / "a.csv").write_text(text[:end])
        done = run_command("import", "a.csv", *PLACE, cwd=tmp_path)
        assert done.code == 0, done.err
        assert ("the last line, 31, has no end" in done.out + done.err) == (end is not None)
    assert stored(run_command, tmp_path) == [round(at + 0.1234, 4) for at in range(30)]


@pytest.mark.parametrize(("last", "is_warned"), [("29,5", True), ("29,0.5", True), ("29,0.25\n", False)])
def test_where_it_cannot_be_seen_it_is_said(run_command: Command, tmp_path: Path, last: str, is_warned: bool) -> None:
    text = "time[s],rate[deg/h]\n" + "".join(f"{at},{at / 8}\n" for at in range(29)) + last
    (tmp_path / "a.csv").write_text(text)
    done = run_command("import", "a.csv", *PLACE, cwd=tmp_path)
    assert done.code == 0, done.err
    assert ("may lack digits" in done.out + done.err) == is_warned
    assert len(stored(run_command, tmp_path)) == 30


def test_a_first_line_that_names_the_delimiter(run_command: Command, tmp_path: Path) -> None:
    rows = "".join(f"{at};{at},5\n" for at in range(30))
    (tmp_path / "a.csv").write_text(f"sep=;\ntime[s];rate[deg/h]\n{rows}", encoding="utf-8-sig")
    assert run_command("import", "a.csv", *PLACE, cwd=tmp_path).code == 0
    assert stored(run_command, tmp_path) == [at + 0.5 for at in range(30)]


def test_a_column_has_one_new_name(run_command: Command, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time[s],a\n0,1\n1,2\n")
    done = run_command("import", "a.csv", "--rename", "a=x", "--rename", "a=y", *PLACE, cwd=tmp_path)
    assert done.code != 0
    assert "--rename 'a': given twice, as 'x' and 'y'" in done.json["error"]["message"]


@pytest.mark.parametrize(
    ("title", "cells", "said"),
    [
        ("time[s]", ["0.5", "0.75", "0.6"], "found '0.6 s', expected a time after 0.75 s"),
        (
            "Timestamp",
            [f"2026-03-01T12:00:0{each}Z" for each in ("0", "1.5", "1")],
            "found '2026-03-01T12:00:01Z', expected a time after 2026-03-01T12:00:01.5Z",
        ),
    ],
)
def test_a_time_out_of_order_is_named_as_the_file_has_it(
    run_command: Command, tmp_path: Path, title: str, cells: list[str], said: str
) -> None:
    """And not in seconds from 1970."""
    (tmp_path / "a.csv").write_text(f"{title},rate[deg/h]\n" + "".join(f"{each},1\n" for each in cells))
    start = ("--start", "2026-03-01T12:00:00Z") if title == "time[s]" else ()
    done = run_command("import", "a.csv", "--unit", "U", *start, "--store", "s", cwd=tmp_path)
    assert done.code == 1
    assert said in done.err
