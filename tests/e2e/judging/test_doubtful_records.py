"""Records that say less than they seem to: from a file through the commands to a verdict that claims no more."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stream.batch import FloatArray

Ask = Callable[..., Any]
PLACE = ("--start", "2026-10-01T08:00:00+08:00", "--procedure", "static_bias", "--latitude", "39.9")
LIMITS = """
revision = "A"
[[limit]]
metric = "bias"
upper = 30.0
unit_of_measure = "deg/h"
[[limit]]
metric = "bias_stability"
upper = 10.0
unit_of_measure = "deg/h"
[[limit]]
metric = "bias_repeatability"
upper = 1.0
unit_of_measure = "deg/h"
"""


def written(path: Path, time_s: FloatArray, **columns: FloatArray) -> Path:
    """A file with a column for each name; ``__`` in a name stands for the brackets of its unit."""
    heads = [f"{name.replace('__', '[')}]" if "__" in name else name for name in columns]
    table = np.column_stack([time_s, *columns.values()])
    np.savetxt(path, table, delimiter=",", header=",".join(["time[s]", *heads]), comments="", fmt="%.9g")
    return path


def of_unit(path: Path) -> Path:
    """The same file with a column that names its unit: files of several units can be imported at once."""
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([f"unit,{head}", *(f"{path.stem},{row}" for row in rows)]) + "\n")
    return path


def rates(n: int, seed: int) -> FloatArray:
    """White noise of 2 deg/h about 5 deg/h and the upright Earth's rate at 39.9 deg."""
    noise: FloatArray = 2.0 * np.random.default_rng(seed).standard_normal(n)
    return noise + 5.0 + 15.041067 * float(np.sin(np.radians(39.9)))


def parameters(row: dict[str, Any]) -> dict[str, Any]:
    """The parameters of a value."""
    found = row["parameters"]
    return dict(found if isinstance(found, dict) else json.loads(found))


def bias_of(answer: list[dict[str, Any]], unit: str) -> dict[str, Any]:
    """The judged bias of a unit without the Earth's rate."""
    values = [row for row in answer if row["unit"] == unit and row["metric"] == "bias"]
    (found,) = [row for row in values if parameters(row)["earth_rate"] == "removed"]
    return found


def test_what_has_no_interval_passes_no_limit(ask: Ask, tmp_path: Path) -> None:
    hour = np.arange(3600.0)
    frozen = np.concatenate([rates(1200, 1), np.full(2400, 14.6)])
    lost = np.where(np.random.default_rng(5).random(3600) < 0.3, 0.0, rates(3600, 5))
    wild = rates(3600, 6)
    wild[1800] = -99999.0
    most = np.random.default_rng(9).random(3600) > 0.06
    most[[0, -1]] = True
    cases = {
        "LIVE": (hour, rates(3600, 2)), "ONE": (hour[:1], rates(1, 3)), "DEAD": (hour, np.full(3600, 14.6)),
        "FROZE": (hour, frozen), "GAP": (np.append(hour[:60], 3599.0), rates(61, 4)),
        "CLIPPED": (hour, np.minimum(rates(3600, 7), 15.0)), "LOST": (hour, lost), "WILD": (hour, wild),
        "MOST": (hour[most], rates(3600, 8)[most]),
    }  # fmt: skip
    paths = [of_unit(written(tmp_path / f"{unit}.csv", at, rate__dph=values)) for unit, (at, values) in cases.items()]
    ask("import", *paths, *PLACE, "--position", "IRA_up")
    (tmp_path / "limits.toml").write_text(LIMITS)
    ask("limits", "add", tmp_path / "limits.toml")
    answer = ask("verdicts")["verdicts"]
    found = {unit: bias_of(answer, unit) for unit in cases}
    assert {unit: row["verdict"] for unit, row in found.items()} == {
        "LIVE": "PASS", "ONE": "MARGINAL", "DEAD": "MARGINAL", "FROZE": "MARGINAL", "GAP": "MARGINAL",
        "CLIPPED": "MARGINAL", "LOST": "MARGINAL", "WILD": "MARGINAL", "MOST": "PASS",
    }  # fmt: skip
    for unit in ("ONE", "DEAD", "FROZE", "CLIPPED", "LOST", "WILD"):
        assert found[unit]["lo"] is found[unit]["hi"] is None
        assert found[unit]["reason"].startswith("the value has no interval")
    stability = {row["unit"]: row["verdict"] for row in answer if row["metric"] == "bias_stability"}
    assert {stability.pop(unit) for unit in ("CLIPPED", "LOST")} == {"MARGINAL"}
    assert stability.pop("WILD") != "PASS"
    assert stability.pop("MOST") == "PASS"
    assert stability == {"LIVE": "PASS", "ONE": "NO_DATA", "DEAD": "NO_DATA", "FROZE": "MARGINAL", "GAP": "MARGINAL"}
    frozen_of = [row for row in answer if (row["unit"], row["metric"]) == ("FROZE", "bias_stability") and row["value"]]
    assert frozen_of
    assert [(row["lo"], row["hi"]) for row in frozen_of] == [(None, None)] * len(frozen_of)
    assert found["GAP"]["reason"] == "61 of 3600 samples of its record are there: a PASS needs nine tenths"
    remarks = {unit: parameters(row)["remark"] or "" for unit, row in found.items()}
    assert "all 3600 samples are alike" in remarks["DEAD"]
    assert "2400 of 3600 samples in a row are alike" in remarks["FROZE"]
    assert remarks["GAP"].startswith("61 of 3600 samples are there, as of 61 s of 3599 s; record of 61 s")
    assert not remarks["LIVE"]
    assert f"{most.sum()} of 3600 samples are there" in remarks["MOST"]
    assert "samples are at one value or two, as at 15 deg/h: clipped" in remarks["CLIPPED"]
    assert "as at 0 deg/h: clipped at an end of the range, or lost samples written as it" in remarks["LOST"]
    assert remarks["WILD"].startswith("isolated outliers (1) raise the noise ")
    assert "may move the mean by more than the noise does: it has no interval" in remarks["WILD"]


@pytest.mark.long
def test_copies_of_a_file_are_not_several_power_ons(ask: Ask, tmp_path: Path) -> None:
    for number in range(3):
        for unit, seed in (("COPIED", 1), ("OWN", 10 + number)):
            path = written(tmp_path / f"{unit}-{number}.csv", np.arange(3600.0), rate__dph=rates(3600, seed))
            ask("import", path, "--unit", unit, *PLACE, "--position", "IRA_up")
    (tmp_path / "limits.toml").write_text(LIMITS)
    ask("limits", "add", tmp_path / "limits.toml")
    answer = ask("verdicts")["verdicts"]
    found = [row for row in answer if row["metric"] == "bias_repeatability"]
    copied, own = ([row for row in found if row["unit"] == unit] for unit in ("COPIED", "OWN"))
    same = "runs COPIED-0 and COPIED-1 have the same samples: they are one measurement, not two; leave one out"
    assert {(row["verdict"], row["value"], row["reason"]) for row in copied} == {("NO_DATA", None, same)}
    assert any(row["verdict"] == "PASS" for row in own)


@pytest.mark.long
def test_the_earths_rate_stays_in_where_the_position_names_no_axis(ask: Ask, tmp_path: Path) -> None:
    up = 15.041067 * np.sin(np.radians(39.9))
    axes = {f"rate_{axis}__dph": rates(3600, at) - (0 if axis == "z" else up) for at, axis in enumerate("xyz")}
    path = written(tmp_path / "triad.csv", np.arange(3600.0), **axes)
    for unit, position in (("IRA", "IRA_up"), ("Z", "Z_up")):
        ask("import", path, "--unit", unit, *PLACE, "--position", position)
    answer = ask("metrics", "--metric", "bias")
    rows = answer["metrics"] if isinstance(answer, dict) else answer
    removed = {(row["unit"], row["signal"]): row for row in rows if parameters(row)["earth_rate"] == "removed"}
    assert set(removed) == {("Z", "rate_z")}
    assert removed["Z", "rate_z"]["value"] == pytest.approx(5.0, abs=4 * 2.0 / 60)
    remarks = [parameters(row)["remark"] for row in rows if row["unit"] == "IRA"]
    assert len(remarks) == 3
    assert all("does not say which of the axes X, Y, Z it means" in each for each in remarks)


@pytest.mark.long
@pytest.mark.parametrize(("head", "factor", "offset"), [("°C", 1.0, 0.0), ("K", 1.0, 273.15), ("degF", 1.8, 32.0)])
def test_a_temperature_in_any_unit_is_that_of_the_step(
    head: str, factor: float, offset: float, ask: Ask, tmp_path: Path
) -> None:
    warm = np.full(600, 41.25)
    path = written(
        tmp_path / "warm.csv", np.arange(600.0), rate__dph=rates(600, 1), temperature__U=warm * factor + offset
    )
    path.write_text(path.read_text().replace("[U]", f"[{head}]"))
    ask("import", path, "--unit", "U", *PLACE, "--position", "IRA_up")
    (row,) = ask("sql", "select temperature, temperature_source from step_means where signal = 'rate'")
    assert row["temperature"] == pytest.approx(41.25, abs=1e-6)
    assert row["temperature_source"] == "unit"


@pytest.mark.long
def test_angles_under_other_names_are_said_to_be_unused(ask: Ask, tmp_path: Path) -> None:
    path = written(tmp_path / "angle.csv", np.arange(60.0), angle__arcsec=np.arange(60.0))
    ask("import", path, "--unit", "U", *PLACE, "--position", "IRA_up")
    (row,) = ask("sql", "select reason from unused_steps")
    assert row["reason"].startswith(
        "signal angle in arcsec is not taken for the output of a gyro: call an angle turned so"
    )
