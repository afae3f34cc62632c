"""The axis of a step is the axis that turned; the rates of one device are one triad, whatever they are called."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tests.analytics.conftest import START_NS, TestedUnits, reduced

RATES = (0.0, 60.0, -60.0)


def turned(tested: TestedUnits, names: dict[str, str], **words: str) -> None:
    """Runs in which a device turns about X, Y and Z, one after the other, at the rates of the commands."""
    rng = np.random.default_rng(5)
    t_ns = START_NS
    tested.run("r1")
    tested.power_on("r1", "U1", START_NS)
    for axis in "XYZ":
        for rate in RATES:
            signals: dict[str, Any] = {
                name: (rate * (own == axis) + rng.normal(0.0, 0.01, 600), "deg/s") for own, name in names.items()
            }
            signals["table_rate"] = (np.full(60, rate), "deg/s")
            at: dict[str, Any] = {name: word.format(axis=axis) for name, word in words.items()}
            t_ns = tested.step("r1", "U1", signals, t0_ns=t_ns, rate_command_deg_per_s=rate, **at)


@pytest.mark.long
@pytest.mark.parametrize("names", [
    {"X": "rate_x", "Y": "rate_y", "Z": "rate_z"},
    {"X": "angularratex", "Y": "angularratey", "Z": "angularratez"},
])  # fmt: skip
def test_a_signal_has_an_input_rate_where_its_own_axis_turned(tested: TestedUnits, names: dict[str, str]) -> None:
    turned(tested, names, axis="{axis}")
    for at, name in enumerate(names.values()):
        (run,) = (reduction := reduced(tested, signal=name, block_s=20.0)).runs
        own = run.slot // 9 == at
        assert len(run) == 27
        np.testing.assert_allclose(run.mean("input_rate"), np.where(own, run.mean("table_rate"), 0.0), atol=1e-9)
        np.testing.assert_allclose(run.value / 3600.0, run.mean("input_rate"), atol=0.01)
        assert not set(names.values()) & set(run.channels), "an axis of the triad is no cause of another"
        assert {"output"} & {note.what for note in reduction.notes}


def test_an_axis_that_points_down_turns_the_other_way(tested: TestedUnits) -> None:
    names = {"Z": "rate_z"}
    turned(tested, names, axis="{axis}", position="{axis}_down")
    (run,) = reduced(tested, signal="rate_z", block_s=20.0).runs
    own = run.slot // 9 == 2
    np.testing.assert_allclose(run.mean("input_rate"), np.where(own, -run.mean("table_rate"), 0.0), atol=1e-9)


def test_axes_that_say_nothing_give_no_input_rate(tested: TestedUnits) -> None:
    turned(tested, {"X": "rate"}, axis="fixture_{axis}")
    reduction = reduced(tested, block_s=20.0)
    assert "input_rate" not in reduction.runs[0].channels
    assert "the axes fixture_X, fixture_Y, fixture_Z do not define the direction of the input axis" in " ".join(
        reduction.limits
    )


@pytest.mark.long
def test_an_output_that_the_model_names_is_a_channel(tested: TestedUnits) -> None:
    turned(tested, {"X": "rate_x", "Y": "rate_y"}, axis="{axis}")
    (run,) = reduced(tested, signal="rate_x", block_s=20.0, channels=["rate_y"]).runs
    assert "rate_y" in run.channels


@pytest.mark.long
def test_sixty_degrees_a_second_about_x_are_no_input_rate_of_z(gyrofleet: Callable[..., Any], tmp_path: Path) -> None:
    """From files of a three-axis rate table to the verdict of its z axis, with names as a CAN database has them."""
    rng = np.random.default_rng(8)
    paths = []
    for number, axis in enumerate("XYZXYZ"):
        time_s = np.arange(900.0)
        rate = np.tile(np.repeat(RATES, 100), 3) * 1.0
        columns = {
            f"angularrate{own.lower()}[deg/s]": rate * (1.001 if own == axis else 2e-4) + rng.normal(0.0, 0.02, 900)
            for own in "XYZ"
        }
        paths.append(tmp_path / f"{number}-{axis}.csv")
        words = {"axis": [axis] * 900, "table_rate[deg/s]": rate, "temperature[degC]": 25.0 + 0.002 * time_s}
        pl.DataFrame({"time[s]": 86_400.0 * number + time_s, **columns, **words}).write_csv(paths[-1])
    assert gyrofleet("import", *paths, "--unit", "IMU", "--start", "2026-11-01T00:00:00Z", "--store", "S").code == 0
    model = "angularratez = bias + scale_factor*input_rate"
    found = gyrofleet("diagnose", "--unit", "IMU", "--model", model, "--store", "S", "--json").json
    assert found["model"]["coefficients"][1] == pytest.approx(3600.0 * 1.001, rel=1e-3)
    named = {each["name"] for each in (*found["effects"], *found["confounded"], *found["unreplicated"])}
    assert not any("angularrate" in name for name in named)
