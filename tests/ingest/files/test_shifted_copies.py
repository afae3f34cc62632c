"""A recording that comes again at another time of its run is known by its values, in whatever form it comes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

RATES = np.round(5.0 + np.random.default_rng(3).normal(0, 1, 300), 6)
WORDS = ("--unit", "U", "--run", "r", "--procedure", "static_bias", "--position", "IRA_up")


@pytest.fixture
def ask(run_command: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    def ask(*words: object, code: int = 0) -> Any:
        done = run_command(*words, "--store", "s", "--json", cwd=tmp_path)
        assert done.code == code, done.out + done.err
        return done.json

    return ask


def written(path: Path, values: np.ndarray, *, comma: bool = False) -> Path:
    lines = [f"{i};{value:.6f};{i};{20 + i % 3}" for i, value in enumerate(values.tolist())]
    text = "\n".join(["time[s];rate[deg/h];number[1];temperature[degC]", *lines]) + "\n"
    path.write_text(text.replace(".", ",") if comma else text)
    return path


def test_another_form_at_another_time_is_refused(ask: Callable[..., Any], tmp_path: Path) -> None:
    ask("import", written(tmp_path / "a.csv", RATES), *WORDS, "--start", "2026-11-02T08:00:00Z")
    other = written(tmp_path / "other.csv", RATES, comma=True)
    refused = ask("import", other, *WORDS, "--start", "2026-11-02T08:00:00+08:00", code=1)["error"]["message"]
    assert "run r has of unit U the same 300 values of rate 8 h later; what is stored stays" in refused
    part = written(tmp_path / "part.csv", RATES[100:], comma=True)
    refused = ask("import", part, *WORDS, "--start", "2026-11-02T09:00:00Z", code=1)["error"]["message"]
    assert "has of unit U the same 200 values of rate 3500 s earlier" in refused
    # where it overlaps: a clock one minute ahead
    refused = ask("import", other, *WORDS, "--start", "2026-11-02T08:01:00Z", code=1)["error"]["message"]
    assert "The store has the same 300 values of rate 60 s earlier: the same recording" in refused
    # another recording, of which a counter and the temperatures come again
    more = written(tmp_path / "more.csv", RATES + 1.0)
    (file,) = ask("import", more, *WORDS, "--start", "2026-11-02T09:00:00Z")["files"]
    assert [signal["added"] for signal in file["signals"]] == [300] * 3


def test_values_that_come_again_and_again_are_no_copy(ask: Callable[..., Any], tmp_path: Path) -> None:
    for hour, first in ((8, 0), (9, 43)):
        path = written(tmp_path / f"{hour}.csv", np.arange(first, first + 300) % 10 / 8)
        (file,) = ask("import", path, *WORDS, "--start", f"2026-11-02T{hour:02}:00:00Z")["files"]
        assert file["signals"][0]["added"] == 300


@pytest.mark.long
def test_copies_within_a_run_are_warned_of(ask: Callable[..., Any], tmp_path: Path) -> None:
    rows = [f"{3600 * copy + i},{value},static_bias,{copy},IRA_up" for copy in (0, 1) for i, value in enumerate(RATES)]
    head = "time[s],rate[deg/h],procedure,step,position"
    (tmp_path / "twice.csv").write_text("\n".join([head, *rows]) + "\n")
    ask("import", "twice.csv", "--unit", "U", "--run", "r", "--start", "2026-11-02T08:00:00Z")
    (warning,) = ask("verdicts")["warnings"]
    assert warning["unit"] == "U"
    assert "has the same samples in several steps of run r (steps 1, 2): one measurement counts" in warning["reason"]
    assert "试验 r 的多个步骤（1、2）中采样相同" in warning["reason_zh"]
