"""A unit whose last run has no step: its verdict says that it is of runs before it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest


@pytest.mark.parametrize("has_step", [True, False])
@pytest.mark.in_gate("False")
def test_a_run_that_nothing_judges_is_named(run_command: Callable[..., Any], tmp_path: Path, has_step: bool) -> None:
    rng = np.random.default_rng(1)
    for name, bias in (("first", 2.0), ("second", 20.0)):
        rows = "\n".join(f"{at},{bias + 0.5 * rng.standard_normal():.5f}" for at in range(4000))
        (tmp_path / f"{name}.csv").write_text(f"time[s],rate[deg/h]\n{rows}\n")
    step = ("--procedure", "static_bias", "--position", "IRA_up")
    for name, day, words in (("first", 1, step), ("second", 2, step if has_step else ())):
        at = ("--unit", "U", "--start", f"2026-03-0{day}T12:00:00Z", *words, "--store", "s")
        assert run_command("import", f"{name}.csv", *at, cwd=tmp_path).code == 0
    said = run_command("verdicts", "--store", "s", cwd=tmp_path)
    assert said.code == 0, said.err
    text = " ".join((said.out + said.err).split())
    assert ("its last run, second, has no completed step" in text) is not has_step
