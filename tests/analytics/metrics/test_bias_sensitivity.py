"""Sensitivity of the bias to temperature and acceleration, its change by shock and vibration, and incomplete tests."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from scipy import stats

from tests.analytics.conftest import Recorded
from tests.analytics.metrics.metric_rows import EARTH_DEG_PER_H, Rows, exact, one


def curve(biases: Mapping[float, float], **words: Any) -> Rows:
    return [
        {"procedure": "bias_temperature_sensitivity", "position": "IRA_tilted_south", "mean": bias,
         "temperature_command": temperature, "temperature": temperature + 0.25} | words
        for temperature, bias in biases.items()
    ]  # fmt: skip


def test_temperature_sensitivity(recorded: Recorded) -> None:
    u, freedom = np.array([0.01, 0.02, 0.03, 0.01, 0.05, 0.02]), np.array([30.0, 12.0, 5.0, 8.0, 3.0, 20.0])
    biases = np.array([4.0, 3.2, 3.9, 4.1, 4.9, 4.5])
    temperature = np.array([23.4, -39.8, -19.9, 0.1, 40.3, 60.2])
    rows: Rows = [
        {"procedure": "bias_temperature_sensitivity", "mean": float(b), "standard_uncertainty": float(s),
         "freedom": float(f), "temperature": float(t), "temperature_command": round(float(t), -1), "room": i == 0}
        for i, (b, s, f, t) in enumerate(zip(biases, u, freedom, temperature, strict=True))
    ]  # fmt: skip
    rows[0]["temperature_command"] = None
    row = one(recorded(rows, "bias_temperature_sensitivity"))
    apart = temperature[1:] - temperature[0]
    slope = (biases[1:] - biases[0]) / apart
    assert row["value"] == exact(np.abs(slope).max())
    assert row["temperature_deg_c_of_largest"] == 40.3
    su = np.sqrt(u[1:] ** 2 + u[0] ** 2) / np.abs(apart)
    nu = (u[1:] ** 2 + u[0] ** 2) ** 2 / (u[1:] ** 4 / freedom[1:] + u[0] ** 4 / freedom[0])
    half = stats.t.isf(0.025 / 5, nu) * su
    assert row["hi"] == exact((np.abs(slope) + half).max())
    assert row["lo"] == exact(np.maximum(np.abs(slope) - half, 0).max())
    assert (row["n"], row["steps"]) == (6 * 36_000, [1, 2, 3, 4, 5, 6])


def test_a_frozen_thermometer_gives_no_sensitivity(recorded: Recorded) -> None:
    """One that stopped gave a wrong value, and one that never moved "only the room was measured"."""
    biases = {20.0: 2.0, 40.0: 2.2, 60.0: 2.4, -20.0: 1.6}
    metric = "bias_temperature_sensitivity"
    assert one(recorded(curve(biases), metric))["value"] == exact(0.01)
    for reading, steps in ((40.25, slice(1, None)), (20.25, slice(None))):
        rows = curve(biases)
        for row in rows[steps]:
            row["temperature"] = reading
        found = one(recorded(rows, metric))
        assert found["value"] is None
        assert f"the thermometer reads {reading:.2f} degC at each of several steps" in found["reason"]
        assert "-20 to 60 degC: it is frozen" in found["reason"]


@pytest.mark.long
def test_room_temperature_is_the_step_that_says_so_else_the_one_nearest_to_20_degc(recorded: Recorded) -> None:
    metric = "bias_temperature_sensitivity"
    named = recorded(curve({-40.0: 1.0, 25.0: 2.0, 60.0: 3.0}), metric)
    assert one(named)["value"] == exact(1 / 35)
    assert one(named)["room_temperature_deg_c"] == 25.25
    missing = recorded(curve({-40.0: 1.0, 0.0: 2.0, 60.0: 3.0}), metric)
    assert "the room-temperature point is missing" in one(missing)["reason"]
    assert "20.0 degC from it" in one(missing)["reason"]
    # files bring other names, or none; the unit warms itself: what was set tells the room
    own = curve({20.0: 2.0, 0.0: 1.0}, procedure=None)
    for row in own:
        row["temperature"] += 15
    assert one(recorded(own, metric))["value"] == exact(1 / 20)
    # 15 and 25 degC are as near: the one that was measured first is the room, the other a point
    for temperatures in ((15.0, 25.0), (25.0, 15.0)):
        row = one(recorded(curve(dict(zip((*temperatures, 60.0), (1.0, 2.0, 1.0), strict=True))), metric))
        assert (row["value"], row["points"]) == (exact(0.1), 2)
        assert row["room_temperature_deg_c"] == temperatures[0] + 0.25
    alone = recorded(curve({20.0: 2.0}), metric)
    assert "no other temperature" in one(alone)["reason"]
    # too near to the room to divide by
    near = recorded(curve({20.0: 2.0, 20.5: 9.0, 40.0: 3.0}), metric)
    assert (one(near)["value"], one(near)["points"]) == (exact(1 / 20), 1)
    assert one(near)["temperature_deg_c_of_largest"] == 40.25  # a budget asks how far the room is
    again = curve({20.0: 2.0, 40.0: 3.0}, repeat=1) + curve({20.0: 2.0, 40.0: 4.0}, repeat=2)
    assert [row["value"] for row in recorded(again, metric)] == [exact(1 / 20), exact(2 / 20)]


@pytest.mark.long
def test_limits_of_a_largest_slope_hold_though_a_maximum_is_too_large(recorded: Recorded) -> None:
    rng = np.random.default_rng(14)
    points = {20.0: 0.0, -40.0: 0.6, 0.0: -0.1, 40.0: 0.2, 60.0: 0.4}
    truth = max(abs(bias / (t - 20)) for t, bias in points.items() if t != 20)
    rows: Rows = []
    for unit in range(500):
        for row in curve(points, unit=f"U{unit:03d}"):
            u = 0.1 * math.sqrt(rng.chisquare(8) / 8)
            rows.append(row | {"mean": row["mean"] + rng.normal(0, 0.1), "standard_uncertainty": u, "freedom": 8.0})
    found = recorded(rows, "bias_temperature_sensitivity")
    assert len(found) == 500
    assert np.mean([row["value"] for row in found]) > truth  # biased by nature
    held = sum(row["lo"] <= truth <= row["hi"] for row in found)
    assert held >= stats.binom.ppf(0.001, 500, 0.95)


def flips(means: Mapping[str, tuple[float, float]], **words: Any) -> Rows:
    return [
        {"procedure": "bias_acceleration_sensitivity", "axis": axis, "position": f"{axis}_{way}", "mean": mean} | words
        for axis, pair in means.items()
        for way, mean in zip(("up", "down"), pair, strict=True)
    ]


@pytest.mark.long
def test_acceleration_sensitivity(recorded: Recorded) -> None:
    means = {"X": (15.0, -6.0), "Y": (2.0, 1.0), "Z": (-3.0, 2.0)}
    found = recorded(flips(means, signal="rate_x"), "bias_acceleration_sensitivity")
    earth = EARTH_DEG_PER_H * math.sin(math.radians(40.0))
    raw = {row["axis"]: row for row in found if row["earth_rate"] == "none"}
    assert {axis: row["value"] for axis, row in raw.items()} == {
        "X": exact(10.5), "Y": exact(0.5), "Z": exact(-2.5), "largest": exact(10.5)
    }  # fmt: skip
    assert one(found, axis="X", earth_rate="removed")["value"] == exact(10.5 - earth)
    largest = one(found, axis="largest", earth_rate="removed")
    assert (largest["value"], largest["axis_of_largest"]) == (exact(2.5), "Z")
    assert largest["earth_rate_unknown"] == ["Y", "Z"]
    u = math.sqrt(2) * 0.01 / 2
    assert raw["Y"]["standard_uncertainty"] == exact(u)
    assert raw["Y"]["hi"] == exact(0.5 + stats.t.isf(0.025, 60) * u)
    assert raw["largest"]["hi"] == exact(10.5 + stats.t.isf(0.025 / 3, 60) * u)
    short = recorded(flips(means)[:3], "bias_acceleration_sensitivity")
    assert "measured only with it up" in one(short, axis="Y")["reason"]
    assert "no flip of axis Z" in one(short, axis="largest")["reason"]
    assert {row["earth_rate"] for row in short} == {"none"}  # X and Y up leave the input axis of `rate` level


@pytest.mark.long
def test_z_up_of_a_gyro_with_one_axis_is_its_input_axis(recorded: Recorded) -> None:
    # JJF 2014-2022 figure 2: the input reference axis is o'z'
    earth = EARTH_DEG_PER_H * math.sin(math.radians(40.0))
    means = {"X": (0.5, -0.5), "Y": (1.0, -1.0), "Z": (1.2 + earth, -1.2 - earth)}
    found = recorded(flips(means), "bias_acceleration_sensitivity")
    assert one(found, axis="Z", earth_rate="none")["value"] == exact(1.2 + earth)
    assert one(found, axis="Z", earth_rate="removed")["value"] == exact(1.2)
    assert one(found, axis="largest", earth_rate="removed")["value"] == exact(1.2)


@pytest.mark.long
@pytest.mark.parametrize(("cause", "other"), [("shock", "vibration"), ("vibration", "shock")])
def test_changes_by_shock_and_vibration(recorded: Recorded, cause: str, other: str) -> None:
    means = {"X": (15.0, 14.0), "Y": (2.0, 2.5), "Z": (-3.0, 2.0)}
    rows = [
        {"procedure": f"bias_{cause}", "axis": axis, "phase": phase, "mean": mean, "freedom": 9.0}
        for axis, pair in means.items()
        for phase, mean in zip(("before", "after"), pair, strict=True)
    ]
    found = recorded(rows, f"bias_{cause}_change")
    assert {row["axis"]: row["value"] for row in found} == {
        "X": exact(1.0), "Y": exact(0.5), "Z": exact(5.0), "largest": exact(5.0)
    }  # fmt: skip
    assert one(found, axis="largest")["axis_of_largest"] == "Z"
    u = math.sqrt(2) * 0.01
    assert one(found, axis="X")["lo"] == exact(1.0 - stats.t.isf(0.025, 18) * u)
    assert recorded(rows, f"bias_{other}_change") == []
    cut = recorded(rows[:5], f"bias_{cause}_change")
    assert one(cut, axis="X")["value"] == exact(1.0)
    assert f"measured only before the {cause}" in one(cut, axis="Z")["reason"]
    assert "measured only before" in one(cut, axis="largest")["reason"]
    two = recorded(rows[:4], f"bias_{cause}_change")
    assert "axis Z was not tested" in one(two, axis="largest")["reason"]
