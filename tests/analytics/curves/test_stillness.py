"""A stretch in which all samples are alike is named beside deviations and spectra, from a file to the answer."""

from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gyrofleet as gf
from stream.defects.stillness import Stillness


@given(st.lists(st.sampled_from([0.0, 1.0, np.nan]), min_size=1, max_size=60), st.lists(st.integers(0, 60), max_size=5))
def test_the_longest_stretch_does_not_depend_on_the_pieces(values: list[float], cuts: list[int]) -> None:
    found = Stillness()
    for piece in np.split(np.array(values), sorted(cuts)):
        found.follow(piece)
    finite = [each for each in values if np.isfinite(each)]
    assert found.longest == max((len(list(group)) for _, group in groupby(finite)), default=0)


def test_an_output_that_moves_has_no_remark() -> None:
    """In the gate without the commands, which say what the deviations say."""
    values = np.random.default_rng(4).normal(0.0, 1.0, 4000).round(6)
    assert "alike" not in (gf.allan_deviation(values, 1.0).remark or "")
    values[-150:] = 0.25
    assert "alike" not in (gf.allan_deviation(values, 1.0).remark or "")


@pytest.mark.parametrize(
    ("frozen", "said"), [(0, None), (150, None), (3000, "3,000 of 4,000 samples in a row"), (4000, "all 4,000 samples")]
)
@pytest.mark.in_gate("3000-3,000 of 4,000 samples in a row")
def test_a_frozen_output_is_named(
    tmp_path: Path, run_command: Callable[..., Any], frozen: int, said: str | None
) -> None:
    values = np.random.default_rng(4).normal(0.0, 1.0, 4000).round(6)
    values[4000 - frozen :] = 0.25
    lines = [f"{at},{value}" for at, value in enumerate(values)]
    (tmp_path / "r.csv").write_text("\n".join(["time[s],rate[deg/h]", *lines]))
    imported = run_command("import", "r.csv", "--unit", "U1", cwd=tmp_path)
    assert imported.code == 0, imported.err
    remarks = [gf.allan_deviation(values, 1.0).remark]
    for command in ("allan", "spectrum"):
        words = (command, "--unit", "U1", "--signal", "rate")
        assert run_command(*words, "--json", cwd=tmp_path).json["longest_still"] == max(1, frozen)
        remarks.append(run_command(*words, cwd=tmp_path).out)
    resampled = run_command(
        "allan", "--unit", "U1", "--signal", "rate", "--resample", "10", "--json", cwd=tmp_path
    ).json
    assert resampled["samples"] == 399, "the last block of ten is not closed by a sample after it"
    assert resampled["longest_still"] == max(1, frozen // 10 - 1)
    for each in remarks:
        text = " ".join(each.split())
        assert ("alike" in text) is (said is not None)
        assert (said or "") in text
