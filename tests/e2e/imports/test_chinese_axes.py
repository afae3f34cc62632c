"""The axis of a gyro by the name of its column, in English and Chinese: the Earth's rate is on the axis that is up."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EARTH = 15.041067 * np.sin(np.radians(39.9))
BIASES = (0.1, 0.2, 0.3)


def stored(gyrofleet: Callable[..., Any], path: Path, names: list[str]) -> None:
    """A record at rest with Z up: `BIASES`, and the Earth's rate on the last output."""
    rng = np.random.default_rng(5)
    values = np.array([*BIASES, 0.0]) + EARTH * np.array([0, 0, 1, 0]) + rng.normal(0.0, 0.05, (400, 4))
    rows = [[str(at), *(f"{each:.5f}" for each in row[: len(names)])] for at, row in enumerate(values)]
    titles = ["时间(s)", *(f"{name}(°/h)" for name in names)]
    path.write_text("\n".join(",".join(row) for row in [titles, *rows]), encoding="utf-8")
    done = gyrofleet(
        "import", path.name, "--unit", "U", "--start", "2026-11-03T08:05:00+08:00", "--latitude", "39.9",
        "--station", "s", "--time-zone", "Asia/Shanghai", "--procedure", "static_bias", "--position", "Z_up",
        "--store", "S",
    )  # fmt: skip
    assert done.code == 0, done.err


def biases(gyrofleet: Callable[..., Any]) -> dict[tuple[str, str], Any]:
    rows = gyrofleet("metrics", "--metric", "bias", "--store", "S", "--json").json
    return {(row["signal"], row["parameters"]["earth_rate"]): row for row in rows}


@pytest.mark.parametrize(
    "pattern",
    [
        "{}陀螺",
        "{}轴角速率",
        "{}轴陀螺输出",
        "陀螺{}",
        "角速率{}",
        "陀螺输出{}轴",
        "gyro_{}",
        "陀螺_{}",
        "陀螺({}轴)",
        "{}ジャイロ",
    ],
)
@pytest.mark.in_gate("{}陀螺", "陀螺{}", "陀螺({}轴)")
def test_earths_rate_is_taken_off_the_axis_that_is_up(
    pattern: str, tmp_path: Path, gyrofleet: Callable[..., Any]
) -> None:
    names = [pattern.format(axis.lower() if pattern == "陀螺_{}" else axis) for axis in "XYZ"]
    stored(gyrofleet, tmp_path / "r.csv", names)
    found = biases(gyrofleet)
    assert {signal for signal, earth_rate in found if earth_rate == "removed"} == {names[2]}
    assert found[names[2], "removed"]["value"] == pytest.approx(BIASES[2], abs=0.02)
    for name, bias in itertools.islice(zip(names, BIASES, strict=True), 2):
        assert found[name, "none"]["value"] == pytest.approx(bias, abs=0.02)


def test_an_axis_that_no_name_says_is_a_reason(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    stored(gyrofleet, tmp_path / "r.csv", ["东向陀螺", "北向陀螺", "天向陀螺"])
    found = biases(gyrofleet)
    assert len(found) == 6
    for (_, earth_rate), row in found.items():
        assert (row["value"] is None) == (earth_rate == "removed")
    assert "its axis is not known" in found["天向陀螺", "removed"]["reason"]
    assert "name it gyro_x, or X轴" in found["天向陀螺", "removed"]["reason"]


@pytest.mark.parametrize("name", ["陀螺(X)", "X轴陀螺"])
def test_the_only_output_has_the_axis_of_its_name(name: str, tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    stored(gyrofleet, tmp_path / "r.csv", [name])
    found = biases(gyrofleet)
    assert [signal for signal, earth_rate in found if earth_rate == "removed"] == []
    assert found[name, "none"]["value"] == pytest.approx(BIASES[0], abs=0.02)


def test_the_only_output_is_of_z(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    stored(gyrofleet, tmp_path / "r.csv", ["陀螺输出"])
    assert biases(gyrofleet)["陀螺输出", "removed"]["value"] == pytest.approx(BIASES[0] - EARTH, abs=0.02)


@pytest.mark.parametrize(
    ("names", "is_one"),
    [
        (["rate", "rate_compensated", "rate_filtered"], True),
        (["gyro_1", "gyro_2"], False),
        (["rate_a", "rate_b"], False),
        (["gyro_x1", "gyro_y1"], False),  # perhaps the axes, perhaps not
        (["Gx_raw"], False),
        (["gyro_east", "gyro_north", "gyro_up"], False),
        (["陀螺_东", "陀螺_北"], False),
        (["陀螺输出", "陀螺输出_滤波后"], True),
    ],
)
def test_forms_of_one_output_have_its_axis(
    tmp_path: Path, gyrofleet: Callable[..., Any], names: list[str], is_one: bool
) -> None:
    stored(gyrofleet, tmp_path / "r.csv", names)
    found = biases(gyrofleet)
    assert {row["value"] is not None for (_, earth_rate), row in found.items() if earth_rate == "removed"} == {is_one}
    assert len(found) == 2 * len(names)


def test_rates_of_the_case_are_no_outputs(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    stored(gyrofleet, tmp_path / "r.csv", ["rate", "rate_o", "rate_s"])
    assert biases(gyrofleet)["rate", "removed"]["value"] == pytest.approx(BIASES[0] - EARTH, abs=0.02)
    assert {signal for signal, _ in biases(gyrofleet)} == {"rate"}
