"""Records of more than 20,000 samples: a clipped output and lost samples are named, and a coarse output is not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stream.batch import FloatArray
from tests.e2e.judging.test_doubtful_records import PLACE, of_unit, parameters, written

Ask = Callable[..., Any]
N = 21_000
LIMITS = """
revision = "A"
[[limit]]
metric = "bias"
lower = -30.0
upper = 30.0
unit_of_measure = "deg/h"
"""


def judged(ask: Ask, folder: Path, units: dict[str, FloatArray]) -> dict[str, dict[str, Any]]:
    """The verdict on the bias of each unit, with its remark."""
    paths = [of_unit(written(folder / f"{unit}.csv", np.arange(len(rate)) / 10.0, rate__dph=rate))
             for unit, rate in units.items()]  # fmt: skip
    ask("import", *paths, *PLACE, "--position", "IRA_up")
    (folder / "limits.toml").write_text(LIMITS)
    ask("limits", "add", folder / "limits.toml")
    rows = [row for row in ask("verdicts")["verdicts"] if row["metric"] == "bias"]
    found = {row["unit"]: row for row in rows if parameters(row)["earth_rate"] == "none"}
    return {unit: row | {"remark": parameters(row)["remark"] or ""} for unit, row in found.items()}


@pytest.mark.parametrize(
    "places",
    [{"LATE": "75", "ZEROS": "0"}, pytest.param({"RAILS": "14", "RARE": "0", "FAR": "-999"}, marks=pytest.mark.long)],
)
def test_clipped_outputs_and_lost_samples_have_no_interval(places: dict[str, str], ask: Ask, tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    noise = 9.0 + 20.0 * rng.standard_normal((6, N))
    late = np.minimum(noise[2] + np.where(np.arange(N) > 0.8 * N, 60.0, 0.0), 75.0)
    lost = rng.random((3, N)) < np.array([[0.02], [0.1], [0.1]])
    rare, zeros, far = (np.where(*each) for each in zip(lost, (0.0, 0.0, -999.0), noise[3:], strict=True))
    units = {"LATE": late, "ZEROS": zeros, "RARE": rare, "FAR": far, "RAILS": np.clip(noise[1], -1.0, 14.0)}
    found = judged(ask, tmp_path, {"SOUND": noise[0]} | {unit: units[unit] for unit in places})
    assert "samples" not in found["SOUND"]["remark"]
    for unit, row in found.items():
        is_sure = unit in {"SOUND", "RARE"}  # of which 2 % are lost
        assert (row["verdict"], row["lo"] is None) == ("PASS" if is_sure else "MARGINAL", not is_sure), unit
    for unit, at in places.items():
        remark = found[unit]["remark"]
        assert f" of {N} samples are at one value or two, as at {at} deg/h: clipped at an end of the range" in remark, (
            unit
        )
        count = np.count_nonzero(np.isin(units[unit], [-1.0, 14.0] if unit == "RAILS" else [float(at)]))
        assert int(remark.split()[0]) == pytest.approx(count, abs=1)


@pytest.mark.parametrize("n", [6000, pytest.param(N, marks=pytest.mark.long)])
def test_samples_that_repeat_the_one_before_are_named(n: int, ask: Ask, tmp_path: Path) -> None:
    at = np.arange(n)
    noise = np.round(9.0 + 20.0 * np.random.default_rng(3).standard_normal(n), 2)
    units = {"SOUND": noise, "FAST": noise[at - (at % 4 == 3)], "TENTH": noise[at // 10]}
    found = judged(ask, tmp_path, units)
    assert "repeat" not in found["SOUND"]["remark"]
    for unit, share in (("FAST", 25), ("TENTH", 90)):
        said = f"at least {share} % of the samples repeat the one before, which resolution and noise do not"
        assert said in found[unit]["remark"], unit
    assert {row["verdict"] for row in found.values()} == {"PASS"}


@pytest.mark.long
def test_a_coarse_resolution_is_no_defect_and_its_rounding_is_in_the_interval(ask: Ask, tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    steps = {"C02": 0.2, "C04": 0.4, "C10": 1.0, "C30": 3.0}  # noise in steps of 50 deg/h
    # where the mean of rounded noise is the farthest off
    units = {unit: 50.0 * np.round(0.25 + sigma * rng.standard_normal(N)) for unit, sigma in steps.items()}
    short = {f"{unit}S": rate[:6000] for unit, rate in units.items()}
    for unit, row in judged(ask, tmp_path, units | short).items():
        sigma = 50.0 * steps[unit[:3]]
        assert "at one value" not in row["remark"], unit
        assert row["lo"] <= 12.5 <= row["hi"], unit
        if sigma >= 50.0:  # as wide as the noise makes it, with what may be flicker in it
            u = (row["hi"] - row["lo"]) / 4
            assert u < 4 * (sigma**2 + 50.0**2 / 12) ** 0.5 / (6000 if unit.endswith("S") else N) ** 0.5, unit
        else:
            assert row["hi"] - row["lo"] > 2 * 50.0 / np.pi * np.exp(-2 * (np.pi * sigma / 50.0) ** 2), unit
