"""A clock that was set back while a file was written is named once, with its size, and so are the rows left out."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


@pytest.mark.parametrize("epoch", [0, 1_793_577_600])
def test_a_clock_that_goes_back_is_named_once(run_command: Callable[..., Any], tmp_path: Path, epoch: int) -> None:
    rows = [f"{epoch + i - (90 if i >= 200 else 0)},{i % 7 / 8}" for i in range(400)]
    (tmp_path / "jump.csv").write_text("\n".join(["time[s],rate[deg/h]", *rows]) + "\n")
    words = ("import", "jump.csv", "--unit", "U", "--store", "s", "--json")
    message = run_command(*words, cwd=tmp_path).json["error"]["message"]
    first, last = ("2026-11-02T00:01:50Z", "2026-11-02T00:03:19Z") if epoch else ("110 s", "199 s")
    named = f"the clock goes back by 90 s at line 202: 90 rows from {first} to {last} lie at or before times that the"
    assert f"90 rows do not keep the import contract; {named} file has already; correct the file, or leave" in message
    assert message.count("expected a time after") == 3
    (file,) = run_command(*words, "--skip-bad", cwd=tmp_path).json["files"]
    (remark,) = [each for each in file["remarks"] if "clock" in each]
    assert remark == f"warning: {named} file has already; they are left out"
    assert (file["signals"][0]["added"], file["bad_row_count"]) == (310, 90)


def test_rows_in_disorder_are_no_clock(run_command: Callable[..., Any], tmp_path: Path) -> None:
    times = [i + (-2 if i % 10 == 9 else 0) for i in range(100)]
    (tmp_path / "a.csv").write_text("\n".join(["time[s],rate[deg/h]", *(f"{each},1.5" for each in times)]) + "\n")
    done = run_command("import", "a.csv", "--unit", "U", "--store", "s", "--json", cwd=tmp_path)
    message = done.json["error"]["message"]
    assert "clock" not in message
    assert message.count("expected a time after") == 10
