"""A file that comes again under another name is imported with a warning; the same command again is not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest


def write(path: Path, seed: int) -> None:
    rows = [f"{i},{value:.4f}" for i, value in enumerate(np.random.default_rng(seed).normal(0, 1, 200))]
    path.write_text("\n".join(["time[s],rate[deg/h]", *rows]) + "\n")


@pytest.mark.long
def test_content_that_is_stored_under_another_name_is_warned_of(
    run_command: Callable[..., Any], tmp_path: Path
) -> None:
    def warnings(*arguments: str) -> list[str]:
        done = run_command("import", *arguments, "--store", "s", "--json", cwd=tmp_path)
        assert done.code == 0
        remarks = [remark for each in done.json["files"] for remark in each["remarks"] if "very content" in remark]
        return [remark.partition("content as ")[2].partition(" too")[0] for remark in remarks]

    write(tmp_path / "one.csv", 1)
    write(tmp_path / "two.csv", 2)
    (tmp_path / "copy.csv").write_bytes((tmp_path / "one.csv").read_bytes())
    assert warnings("one.csv", "two.csv", "--unit", "A") == []
    assert warnings("one.csv", "two.csv", "--unit", "A") == []
    assert warnings("copy.csv", "--unit", "B", "--run", "one") == ["unit A, run one (one.csv)"]
    assert warnings("two.csv", "copy.csv", "--unit", "A") == ["unit A, run one (one.csv), unit B, run one (copy.csv)"]


def test_a_file_of_several_units_and_runs_is_no_copy_of_itself(run_command: Callable[..., Any], tmp_path: Path) -> None:
    rows = [
        f"{i},{unit},{run},{i / 8}" for run, units in (("r1", "AB"), ("r2", "C")) for unit in units for i in range(99)
    ]
    (tmp_path / "all.csv").write_text("\n".join(["time[s],unit,run,rate[deg/h]", *rows]) + "\n")
    done = run_command("import", "all.csv", "--store", "s", "--json", cwd=tmp_path)
    assert done.code == 0
    assert not [remark for remark in done.json["files"][0]["remarks"] if "very content" in remark]


def test_samples_that_are_stored_under_another_name_are_named(run_command: Callable[..., Any], tmp_path: Path) -> None:
    """As of a file that was imported before names such as Temperature were unified; a constant is no evidence."""

    def named(rows: int, *arguments: str) -> list[str]:
        lines = [f"{i},{i * 7 % 11},{20 + i % 5},1\n" for i in range(rows)]
        (tmp_path / "a.csv").write_text("time[s],rate[deg/h],Temperature (degC),valid[1]\n" + "".join(lines))
        done = run_command("import", "a.csv", "--unit", "A", *arguments, "--store", "s", "--json", cwd=tmp_path)
        assert done.code == 0
        return [remark for remark in done.json["files"][0]["remarks"] if "under both names" in remark]

    before = ("--rename", "Temperature=Temperature", "--rename", "valid=ok")
    assert named(90, *before) == []
    assert named(90, *before) == []
    (remark,) = named(99)  # it has grown
    assert remark.startswith("warning: unit A, run a: the store has the samples of temperature as Temperature already")
    assert named(99) == []
    assert named(99, "--run", "r2") == []
