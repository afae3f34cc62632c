"""What temperature, acceleration, shock, vibration and time do to a scale factor, against NumPy from the samples."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.analytics.conftest import SECOND_NS, START_NS
from tests.analytics.metrics.rate_table import BOTH, Gyro, Table, cubic


def scaled(gyro: Gyro, factor: float) -> Gyro:
    """A gyro with an output so many times as large."""
    return lambda rate: factor * gyro(rate)


def test_temperature_sensitivity(tested: Any, table: Callable[..., Table]) -> None:
    rig = table(gyro=cubic, unit="V")
    slopes: dict[float, float] = {}
    for temperature in (23.0, -40.0, 0.0, 60.0):
        rig.gyro = scaled(cubic, 1 + 5e-6 * (temperature - 23))
        words: dict[str, Any] = {"room": True} if temperature == 23.0 else {}
        rate, mean = rig.rates(
            procedure="scale_factor_temperature_sensitivity", temperature_command_deg_c=temperature, **words
        )
        slopes[temperature] = np.polyfit(rate[1:-1], mean[1:-1], 1)[0]
    room = slopes.pop(23.0)
    expected = max(abs((k - room) / (room * (t - 23.0))) for t, k in slopes.items()) * 1e6
    found = tested.metric("scale_factor_temperature_sensitivity")
    assert [row["value"] for row in found] == pytest.approx([expected, expected], rel=1e-9)
    assert {row["points"] for row in found} == {3}
    assert all(row["lo"] < 5.0 < row["hi"] for row in found)


@pytest.mark.long
def test_room_temperature_point_is_needed(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    for temperature in (-40.0, 60.0):
        rig.rates(procedure="scale_factor_temperature_sensitivity", temperature_command_deg_c=temperature)
    for row in tested.metric("scale_factor_temperature_sensitivity"):
        assert row["value"] is None
        assert "room-temperature point is missing" in row["reason"]
        assert "40.0 degC from it" in row["reason"]


@pytest.mark.long
@pytest.mark.parametrize("sign", [1, -1])
def test_acceleration_sensitivity(tested: Any, table: Callable[..., Table], sign: int) -> None:
    rig = table(unit="V")
    slopes = []
    for position, k, direction in (("IRA_up", 0.02 * (1 + 3e-6), 1), ("IRA_down", 0.02 * (1 - 3e-6), sign)):
        rig.gyro = scaled(lambda rate: rate, direction * k)
        rate, mean = rig.rates(
            rests=False, noise=1e-5, procedure="scale_factor_acceleration_sensitivity", position=position
        )
        slopes.append(abs(np.polyfit(rate, mean, 1)[0]))
    (row,) = tested.metric("scale_factor_acceleration_sensitivity")
    assert row["value"] == pytest.approx((slopes[0] - slopes[1]) / 2, rel=1e-9)
    assert row["unit_of_measure"] == "V/(deg/s)/g"
    assert row["lo"] < 0.02 * 3e-6 < row["hi"]


@pytest.mark.long
def test_acceleration_sensitivity_cut_short(tested: Any, table: Callable[..., Table]) -> None:
    table().rates(rests=False, procedure="scale_factor_acceleration_sensitivity", position="IRA_up")
    (row,) = tested.metric("scale_factor_acceleration_sensitivity")
    assert row["value"] is None
    assert "not measured with the IRA down" in row["reason"]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["shock", "vibration"])
def test_changes_by_shock_and_vibration(tested: Any, table: Callable[..., Table], kind: str) -> None:
    rig = table(unit="V")
    slopes: dict[tuple[str, str], float] = {}
    for axis, change in (("X", 1e-6), ("Y", -20e-6), ("Z", 5e-6)):
        for phase in ("before", "after"):
            rig.gyro = scaled(cubic, 1 + change * (phase == "after"))
            rate, mean = rig.rates(rests=False, procedure=f"scale_factor_{kind}", axis=axis, phase=phase)
            slopes[axis, phase] = np.polyfit(rate, mean, 1)[0]
    found = {row["axis"]: row for row in tested.metric(f"scale_factor_{kind}_change")}
    changes = {axis: abs(slopes[axis, "after"] - slopes[axis, "before"]) for axis in "XYZ"}
    for axis in "XYZ":
        assert found[axis]["value"] == pytest.approx(changes[axis], rel=1e-8)
    assert found["largest"]["value"] == pytest.approx(max(changes.values()), rel=1e-8)
    assert found["largest"]["axis_of_largest"] == "Y"
    assert found["largest"]["lo"] < 0.02 * 20e-6 < found["largest"]["hi"]
    # a nonlinearity of 50 ppm is common to both
    assert found["largest"]["hi"] - found["largest"]["lo"] < 0.02 * 5e-6


@pytest.mark.long
def test_change_without_after_and_without_axes(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    rig.rates(rests=False, procedure="scale_factor_shock", axis="X", phase="before")
    found = {row["axis"]: row for row in tested.metric("scale_factor_shock_change")}
    assert found["X"]["reason"] == "axis X: not measured after it"
    assert found["largest"]["value"] is None
    assert tested.metric("scale_factor_vibration_change") == []


@pytest.mark.long
def test_repeatability(tested: Any, table: Callable[..., Table]) -> None:
    scatter = (0.0, 4e-6, -3e-6, 1e-6, -5e-6, 2e-6)
    day_ns = 86_400 * SECOND_NS
    slopes = []
    for i, each in enumerate(scatter):
        rig = table(
            f"r{i}", lambda rate, e=each: 0.02 * rate * (1 + e), seed=i, t_ns=START_NS + (i // 2) * day_ns + i * 10**12
        )
        rate, mean = rig.rates(procedure="scale_factor")
        slopes.append(np.polyfit(rate[1:-1], mean[1:-1], 1)[0])
    k = np.array(slopes)
    relative = k / k.mean() * 1e6
    days = relative.reshape(3, 2)
    within = np.sqrt(((days - days.mean(axis=1, keepdims=True)) ** 2).sum() / 3)
    expected = {"run_to_run": within, "day_to_day": days.mean(axis=1).std(ddof=1)}
    found = {(row["standard"], row["kind"]): row for row in tested.metric("scale_factor_repeatability")}
    for standard in ("GJB2426A", "JJF2014"):
        for kind, value in expected.items():
            assert found[standard, kind]["run"] is None
            if (standard, kind) != ("GJB2426A", "day_to_day"):
                assert found[standard, kind]["value"] == pytest.approx(value, rel=1e-7)
        own = found[standard, "run_to_run"]
        # of 22 means of 100 samples of 0.001 deg/s; their uncertainty allows for correlation
        of_white_noise = 1e-4 / (np.array([*BOTH]).std() * np.sqrt(len(BOTH))) / 0.02 * 1e6
        assert 0.9 < own["uncertainty_of_means"] / of_white_noise < 1.5
        beyond = np.sqrt(max(within**2 - own["uncertainty_of_means"] ** 2, 0.0))
        assert own["beyond_uncertainty"] == pytest.approx(beyond, rel=1e-7)
        component = found[standard, "within_day_component"]
        assert component["value"] == pytest.approx(beyond, rel=1e-7)
        assert component["lo"] < own["lo"], "what is noise in the scatter is not known either"
        assert "6 scale factors of 3 days, several of one" in found[standard, "all"]["reason"]
    # as of the bias, days count from day to day
    assert found["GJB2426A", "day_to_day"]["reason"] == "scale factors of 3 days, 6 or more are asked for"
    assert len(found) == 10


@pytest.mark.long
def test_rates_of_other_tests_make_no_rows_of_repeatability(tested: Any, table: Callable[..., Table]) -> None:
    """Each run of two other procedures with a few rates had ten rows without a value beside those of scale factors."""
    for i in range(2):
        table(f"r{i}", t_ns=START_NS + i * 10**13).rates(procedure="scale_factor")
    for i in range(3):
        rig = table(f"o{i}", t_ns=START_NS + (i + 3) * 10**13)
        for procedure in ("vibration_survey", "rate_check"):
            rig.rates((10.0, -10.0, 20.0, -20.0), procedure=procedure)
    rows = tested.metric("scale_factor_repeatability")
    assert {(row["run"], *row["runs"]) for row in rows} == {(None, "r0", "r1")}
    assert [row["kind"] for row in rows if row["value"] is not None] == ["all", "run_to_run", "within_day_component"]


@pytest.mark.long
def test_repeatability_of_five_is_too_few_for_one_standard(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    for repeat in range(1, 6):
        rig.rates(procedure="scale_factor_repeatability", repeat=repeat)
    found = {(row["standard"], row["kind"]): row for row in tested.metric("scale_factor_repeatability")}
    assert found["GJB2426A", "all"]["reason"] == "5 scale factors measured, 6 or more are asked for"
    assert found["JJF2014", "all"]["value"] > 0
    assert "of one day" in found["JJF2014", "day_to_day"]["reason"]
