"""A file that grew between two imports: the step that it is goes on with it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from storage.sql.catalog import Catalog
from storage.store import Store


def rows(count: int, *, with_words: bool) -> str:
    rng = np.random.default_rng(1)
    rates = 0.5 * rng.standard_normal(4000) + np.where(np.arange(4000) < 2000, 2.0, 20.0)
    words = ",static_bias,IRA_up" if with_words else ""
    header = "time[s],rate[deg/h]" + (",procedure,position" if with_words else "")
    return "\n".join([header, *(f"{at},{rates[at]:.5f}{words}" for at in range(count))]) + "\n"


@pytest.mark.parametrize("counts", [(2000, 4000), (2000, 3000, 4000, 4000)], ids=["once", "again"])
@pytest.mark.parametrize("with_words", [True, False])
@pytest.mark.in_gate("True-once")
def test_a_grown_step_is_judged_as_a_whole(
    run_command: Callable[..., Any], tmp_path: Path, with_words: bool, counts: tuple[int, ...]
) -> None:
    """The second half is at 20 deg/h: the bias was that of the first half, and passed 3 deg/h."""
    step = () if with_words else ("--procedure", "static_bias", "--position", "IRA_up")
    for count in counts:
        (tmp_path / "day.csv").write_text(rows(count, with_words=with_words))
        done = run_command(
            "import", "day.csv", "--unit", "U", "--run", "day", "--start", "2026-03-01T12:00:00Z", *step, "--store",
            "s", cwd=tmp_path,
        )  # fmt: skip
        assert done.code == 0, done.err
    asked = "select count(*) as steps, min(epoch_ns(ended) - epoch_ns(started)) as ns from steps"
    with Catalog(Store.open(tmp_path / "s")) as catalog:
        assert catalog.rows(asked) == [(1, 3999 * 10**9)]
    found = run_command("metrics", "--metric", "bias", "--store", "s", "--json", cwd=tmp_path).json
    (bias,) = (row for row in found if row["value"] is not None)
    assert bias["n"] == 4000
    assert abs(bias["value"] - 11.0) < 0.1
