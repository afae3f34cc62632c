"""Limits on sensitivities with a sign, and the Earth's rate in a sensitivity to acceleration."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gyrofleet import main
from tests.analytics.verdicts.few_metrics import computing
from tests.e2e.judging.conftest import Ask
from tests.e2e.judging.step_files import Steps

EARTH_DEG_PER_H = 15.041067 * math.sin(math.radians(40.0))
SENSITIVITY = {"X": 0.4, "Y": -2.0, "Z": 0.1}  # deg/h/g
LIMIT = 'revision = "A"\n[[limit]]\nmetric = "bias_acceleration_sensitivity"\nunit_of_measure = "deg/h/g"\n'


@pytest.fixture(autouse=True)
def _only_its_metric() -> Iterator[None]:
    with computing("bias_acceleration_sensitivity"):
        yield


@pytest.fixture
def enter(ask: Ask, tmp_path: Path) -> Callable[[str], Any]:
    def enter(text: str, name: str = "fog") -> Any:
        path = tmp_path / f"{name}.toml"
        path.write_text(text)
        return ask("limits", "add", path)

    return enter


@pytest.fixture
def flipped(ask: Ask, tmp_path: Path) -> Callable[..., Any]:
    """A gyro about Y with the Earth's rate of latitude 40 along it, in the six positions."""
    steps = Steps("rate_y[deg/h]")
    for axis, size in SENSITIVITY.items():
        for side, way in ((1, "up"), (-1, "down")):
            rate = 5 + side * (size + EARTH_DEG_PER_H * (axis == "Y"))
            steps.step([rate], procedure="bias_acceleration_sensitivity", position=f"{axis}_{way}", axis=axis)
    steps.write(tmp_path / "G.csv")

    def take(*words: str) -> Any:
        return ask("import", tmp_path / "G.csv", "--start", "2026-01-05T08:00:00Z", *words)

    return take


def judged(ask: Ask) -> dict[tuple[str, str], dict[str, Any]]:
    found = ask("verdicts", "--unit", "G")["verdicts"]
    return {(row["parameters"]["axis"], row["parameters"]["earth_rate"]): row for row in found}


@pytest.mark.long
def test_an_upper_limit_alone_is_one_of_the_magnitude(ask: Ask, enter: Callable[..., Any], flipped: Any) -> None:
    """-2 deg/h/g passed a limit of 1."""
    flipped("--latitude", "40")
    text = 'parameters = {{ axis = "Y", earth_rate = "removed" }}\nupper = {}\n'
    said = enter(LIMIT + text.format(1.0))["doubts"]
    assert said == [
        "bias_acceleration_sensitivity (axis = Y, earth_rate = removed): upper limits the magnitude: judged as -1 ... 1"
    ]
    row = judged(ask)["Y", "removed"]
    assert (row["verdict"], row["lower"], row["upper"]) == ("FAIL", -1.0, 1.0)
    assert row["value"] == pytest.approx(-2.0, abs=1e-3)
    assert row["conformity"] == pytest.approx(0.0, abs=1e-6)
    assert ask("limits", "show", "fog-A")["limits"][0]["lower"] == -1.0


@pytest.mark.long
def test_a_limit_that_is_wide_enough_passes_on_either_side(ask: Ask, enter: Callable[..., Any], flipped: Any) -> None:
    flipped("--latitude", "40")
    enter(LIMIT + "upper = 2.5\n")
    found = judged(ask)
    assert {row["verdict"] for row in found.values()} == {"PASS"}
    # with the Earth's rate in it the value along Y is 7.67: it is reported, and not judged
    assert sorted(found) == [("X", "none"), ("Y", "removed"), ("Z", "none"), ("largest", "removed")]
    raw = [row for row in ask("metrics") if row["parameters"]["earth_rate_in_it"]]
    assert {row["parameters"]["axis"]: row["value"] for row in raw} == {
        "Y": pytest.approx(EARTH_DEG_PER_H - 2, abs=1e-3), "largest": pytest.approx(EARTH_DEG_PER_H - 2, abs=1e-3),
    }  # fmt: skip
    assert raw[0]["parameters"]["earth_rate_in_it"] == f"{EARTH_DEG_PER_H:.4g} deg/h/g"


@pytest.mark.in_gate("simple_acceptance")
@pytest.mark.parametrize("rule", ["interval", "simple_acceptance"])
def test_without_a_latitude_nothing_passes_or_fails_with_the_earths_rate_in_it(
    ask: Ask, enter: Callable[..., Any], flipped: Any, rule: str
) -> None:
    flipped()
    enter(LIMIT + f'upper = 2.5\ndecision_rule = "{rule}"\n')
    found = judged(ask)
    for axis in ("Y", "largest"):
        assert found[axis, "none"]["verdict"] == "MARGINAL"
        assert "up to 15.04 deg/h/g" in found[axis, "none"]["reason"]
        assert found[axis, "removed"]["verdict"] == "NO_DATA"
        for kind in ("none", "removed"):
            assert "import the file again with --latitude" in found[axis, kind]["reason"]
    assert (found["Y", "none"]["lo"], found["Y", "none"]["conformity"]) == (None, None)
    assert (found["X", "none"]["verdict"], found["Z", "none"]["verdict"]) == ("PASS", "PASS")
    flipped("--latitude", "40")
    assert ask("verdicts")["units"][0]["verdict"] == "PASS"


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("lower = -1.0\n", "by lower alone every value above it passes: write upper too, as lower = -1, upper = 1"),
        ("upper = -1.0\n", "upper alone limits the magnitude, and -1 is below 0"),
    ],
)
def test_a_limit_that_says_nothing_of_a_magnitude_is_refused(tmp_path: Path, body: str, said: str) -> None:
    path = tmp_path / "fog.toml"
    path.write_text(LIMIT + body)
    done = CliRunner().invoke(main, ["limits", "add", str(path), "--store", str(tmp_path / "S")])
    assert done.exit_code == 1
    assert said in " ".join(done.output.split())


def test_a_limit_with_one_side_on_a_bias_is_named(enter: Callable[..., Any]) -> None:
    (said,) = enter('revision = "A"\n[[limit]]\nmetric = "bias"\nupper = 5.0\nunit_of_measure = "deg/h"\n')["doubts"]
    assert said == (
        "warning: bias: by upper = 5 alone every value below it passes, however far: where its magnitude is meant, "
        "write lower = -5 too"
    )


def test_a_limit_that_no_magnitude_has_is_as_it_is_meant(enter: Callable[..., Any]) -> None:
    assert enter('revision = "A"\n[[limit]]\nmetric = "bias"\nlower = 5.0\nunit_of_measure = "deg/h"\n')["doubts"] == []
