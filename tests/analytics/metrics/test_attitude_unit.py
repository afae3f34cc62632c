"""Bias and misalignments of attitude units from records of steps as laboratories bring them, and what they lack."""

import math
from typing import Any

import pytest

from tests.analytics.metrics.metric_rows import EARTH_DEG_PER_H, Rows, one

LEVEL = EARTH_DEG_PER_H * math.cos(math.radians(40.0)) * math.sin(math.radians(0.5))
PLACES = {"east_Y_north": 1, "east_Y_south": 1, "west_Y_south": -1, "west_Y_north": -1}


def at_rest(positions: dict[str, float], run: str = "r1", **words: Any) -> Rows:
    """Records of X at rest in positions, outputs in deg/h."""
    plain = {"run": run, "signal": "rate_x", "procedure": "attitude_unit_bias", "duration_s": 1800.0, "n": 18000}
    return [plain | {"position": position, "mean": mean, "sd": 1.0} | words for position, mean in positions.items()]


def four(bias: float = 6.0, level: float = LEVEL, **words: Any) -> Rows:
    return at_rest({f"X_{place}": bias + way * level for place, way in PLACES.items()}, **words)


def called(first: str, second: str, third: str, fourth: str, **words: Any) -> Rows:
    """The four positions under other names, in the order of table 2."""
    return at_rest({first: 6 + LEVEL, second: 6 + LEVEL, third: 6 - LEVEL, fourth: 6 - LEVEL}, **words)


def around(angles: list[float], bias: float = 6.0, **words: Any) -> Rows:
    """X level on a table that turns it through the given angles, from north on."""
    seen = {f"{angle:g} deg": bias + 11.5 * math.cos(math.radians(angle)) for angle in angles}
    own: dict[str, Any] = {"axis": "X", "procedure": "attitude_unit_bias_many", "duration_s": 1200.0}
    return at_rest(seen, **own | words)


def test_four_positions_in_any_order_and_under_other_names(recorded: Any) -> None:
    turned: dict[str, Any] = {"signal": "roll_rate", "procedure": "static"}
    records = [
        *four(run="plain"),
        *reversed(four(run="reversed")),
        *called("X朝东 Y朝北", "X东_Y南", "X西Y南", "X西 Y北 Z地", run="zh"),
        *called("x:e y:n", "x:e z:d", "x:w z:u", "x:w y:n", run="letters"),
        *at_rest(
            {"Roll_east_Heading_up": 6.0, "roll_east_heading_down": 6.0, "roll_west_heading_up": 6.0,
             "roll_west_heading_down": 6.0}, run="rotations", **turned,
        ),
        *four(run="gyro_x", signal="gyro_x", unit_of_measure="deg/h"),
        *four(6.0 / 3600, LEVEL / 3600, run="deg/s", unit_of_measure="deg/s"),
        *four(math.radians(6.0), math.radians(LEVEL), run="rad/h", unit_of_measure="rad/h"),
    ]  # fmt: skip
    rows = recorded(records, "attitude_unit_bias")
    assert {row["run"] for row in rows} == {record["run"] for record in records}
    for row in rows:
        assert (row["value"], row["unit_of_measure"]) == (pytest.approx(6.0, abs=1e-9), "deg/h"), row
        assert (row["method"], row["positions"], row["standard"]) == ("four positions", 4, "JJF1536")
    assert one(rows, run="rotations")["zero_of"] == "roll"
    assert one(rows, run="plain")["clause"] == "5.3, 7.2.1, 7.2.3 (16)"
    assert one(rows, run="plain")["heading_error_deg"] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.long
def test_the_uncertainty_is_that_of_the_positions_or_their_scatter(recorded: Any) -> None:
    quiet = recorded(four(standard_uncertainty=0.02, freedom=9.0), "attitude_unit_bias")[0]
    assert quiet["standard_uncertainty"] == pytest.approx(0.02 / 2)
    assert quiet["freedom"] == pytest.approx(36.0)
    # turned over, the axis gives 0.6 deg/h more: two degrees of freedom are left of four positions
    scattered = four(run="r2", standard_uncertainty=0.02)
    for record in scattered:
        record["mean"] += 0.3 if record["position"].endswith("north") else -0.3
    (row,) = [each for each in recorded(scattered, "attitude_unit_bias") if each["run"] == "r2"]
    assert (row["standard_uncertainty"], row["freedom"]) == (pytest.approx(math.sqrt(4 * 0.09 / 2) / 2), 2)


def test_records_of_different_lengths_count_alike(recorded: Any) -> None:
    records = four()
    for record, lasts_s in zip(records, (1800.0, 600.0, 900.0, 1800.0), strict=True):
        record |= {"duration_s": lasts_s, "n": round(lasts_s)}
    (row,) = recorded(records, "attitude_unit_bias")
    assert row["value"] == pytest.approx(6.0, abs=1e-9)
    remarks = (
        "records of 600 s: the clause has 1800 s",
        "600 to 1800 s",
        "0.998 samples/s: 7.2.1 asks for at least 10",
    )
    assert all(remark in row["remark"] for remark in remarks)


@pytest.mark.long
@pytest.mark.parametrize("left_out", sorted(PLACES))
def test_three_of_four_positions_are_refused_with_the_missing_one(recorded: Any, left_out: str) -> None:
    records = [record for record in four() if record["position"] != f"X_{left_out}"]
    (row,) = recorded(records, "attitude_unit_bias")
    assert row["value"] is None
    assert row["reason"].startswith(f"not measured in this run: X_{left_out}; ")


def test_equal_angles_around_the_circle(recorded: Any) -> None:
    twelve = [30.0 * i for i in range(12)]
    records = [
        *around(twelve, run="twelve"), *around([0, 120, 240], run="three"), *around([10, 100, 190, 280], run="shifted"),
        *around([*twelve[6:], *twelve[:6]], run="reordered"),
        *around(twelve[:-1], run="eleven"), *around([0, 180], run="two"), *around([0, 30, 90, 180, 275], run="uneven"),
        *around(twelve, run="no axis", axis=None),
    ]  # fmt: skip
    rows = {row["run"]: row for row in recorded(records, "attitude_unit_bias")}
    for run in ("twelve", "three", "shifted", "reordered"):
        assert rows[run]["value"] == pytest.approx(6.0, abs=1e-9), run
        assert rows[run]["level_rate_deg_per_h"] == pytest.approx(11.5)
    assert rows["eleven"]["reason"].startswith("not measured: 330 deg: ")
    assert rows["two"]["reason"].startswith("2 angles were measured, at least 3")
    assert rows["uneven"]["reason"].startswith("the angles are not equally spaced: steps of 30, 60, 90, 95, 85 deg")
    assert rows["no axis"]["reason"].startswith("position 0 deg: no word says which axis is level")


def test_other_axes_of_the_device_and_dead_ones_have_reasons(recorded: Any) -> None:
    records = [
        *four(axis="X"), *[record | {"signal": "rate_y"} for record in four(axis="X")],
        *[record | {"mean": 0.0, "sd": 0.0} for record in four(run="dead")],
        *[record | {"mean": 6.0, "sd": 0.0} for record in four(run="stuck")],
        *four(run="volts", unit_of_measure="V"), *at_rest({"X_up": 1.0}, run="up"),
        *at_rest({"X_east_Y_west": 1.0}, run="impossible"), *four(run="letters", signal="pitch_rate"),
    ]  # fmt: skip
    rows = recorded(records, "attitude_unit_bias")
    assert one(rows, run="r1", signal="rate_x")["value"] == pytest.approx(6.0)
    assert "Y_east_Z_north, Y_east_Z_south" in one(rows, signal="rate_y")["reason"]
    assert one(rows, run="dead")["reason"].startswith("the output is 0 in every sample")
    assert one(rows, run="stuck")["remark"].endswith("see that the axis answers")
    assert one(rows, run="volts")["reason"].startswith("no scale factor for an output in V")
    assert "X_east_Y_north, X_east_Y_south" in one(rows, run="up")["reason"]
    assert "not perpendicular" in one(rows, run="impossible")["reason"]
    assert one(rows, run="letters")["reason"].startswith(
        "position X_east_Y_north names X, Y, Z, and the output is of PITCH"
    )


ELEMENTS = {"YX": 0.003, "ZX": 0.0015, "XY": 0.002, "ZY": -0.0025, "XZ": -0.001, "YZ": -0.002}


def turned(rate: float = 100.0, run: str = "r1", axes: str = "XYZ", **words: Any) -> Rows:
    """Records of ten turns each way about X, Y, Z at 10 Hz, outputs in deg/s with biases."""
    found: Rows = []
    for axis in axes:
        for way in (1, -1):
            for own, bias in (("X", 6.0), ("Y", -3.0), ("Z", 1.5)):
                seen = 1.0 if own == axis else ELEMENTS[own + axis]
                found.append(
                    {"run": run, "signal": f"rate_{own.lower()}", "procedure": "attitude_unit_misalignment",
                     "position": f"{axis}_up", "axis": axis, "rate_command": way * rate, "input_rate": way * rate,
                     "input_rate_source": "command", "unit_of_measure": "deg/s", "n": 360, "duration_s": 35.9,
                     "sd": 0.1, "mean": way * rate * seen + bias / 3600, "standard_uncertainty": 2e-4,
                     "index": len(found) // 3 + 1} | words
                )  # fmt: skip
    return found


def arcmin(element: str) -> float:
    return ELEMENTS[element] * 180 / math.pi * 60


def test_six_elements_with_their_uncertainty(recorded: Any) -> None:
    rows = {row["element"]: row for row in recorded(turned(), "attitude_unit_misalignment")}
    assert len(rows) == 6
    for element in ELEMENTS:
        row = rows[f"L_{element.lower()}"]
        assert row["value"] == pytest.approx(arcmin(element), rel=1e-9)
        assert row["standard_uncertainty"] == pytest.approx(2e-4 * math.sqrt(2) / 200 * 180 / math.pi * 60)
        assert (row["signal"], row["turned_axis"]) == (f"rate_{element[0].lower()}", element[1])
        assert (row["turns"], row["turns_by"]) == (10, "command")


def test_turns_as_laboratories_bring_them(recorded: Any) -> None:
    """X down, axes by rotation, a record with the acceleration in it, two speeds, the table's own rate."""
    down = [record | {"position": record["position"].replace("up", "down")} for record in turned(run="down")]
    for record in down:  # the table's positive rate is negative about an axis that points down
        record["mean"] -= 2 * (record["mean"] - {"x": 6.0, "y": -3.0, "z": 1.5}[record["signal"][-1]] / 3600)
    names = {"X": "pitch", "Y": "roll", "Z": "heading"}
    by_rotation = [
        record
        | {"signal": f"{names[record['signal'][-1].upper()]}_rate", "axis": names[record["axis"]], "position": None}
        for record in turned(run="rotations")
    ]
    # 10 turns, and 4 s of speeding up and down: the mean rate is 90 deg/s, as the turned axis tells
    ramped = turned(90.0, run="ramped", rate_command=None, duration_s=39.9, n=400)
    for record in ramped:
        record["rate_command"] = record["input_rate"] = math.copysign(100.0, record["input_rate"])
    table = turned(run="table", input_rate_source="table")
    for record in table:
        record["input_rate"], record["mean"] = record["input_rate"] * 1.001, record["mean"] * 1.001
    records = [*down, *by_rotation, *ramped, *table, *turned(50.0, run="speeds"), *turned(20.0, run="speeds")]
    rows = recorded(records, "attitude_unit_misalignment")
    for row in rows:
        assert row["value"] is not None, row
    for run in ("down", "ramped", "table"):
        assert one(rows, run=run, element="L_yx")["value"] == pytest.approx(arcmin("YX"), rel=1e-3), run
    assert one(rows, run="ramped", element="L_yx")["turns_by"] == "own axis"
    assert one(rows, run="rotations", element="L_roll_pitch")["value"] == pytest.approx(arcmin("YX"), rel=1e-9)
    assert [row["rate_deg_per_s"] for row in rows if row["run"] == "speeds" and row["element"] == "L_yx"] == [
        20.0,
        50.0,
    ]


def test_turns_that_lack_something_say_what(recorded: Any) -> None:
    records = [
        *turned(run="two axes", axes="XY"),
        *[record for record in turned(run="one way") if record["rate_command"] > 0],
        *turned(run="part", duration_s=37.0, n=371), *turned(run="no axis", axis=None, position=None),
        *[each | {"mean": 0.0, "sd": 0.0} if each["signal"] == "rate_y" else each for each in turned(run="dead")],
        *turned(run="volts", unit_of_measure="V"),
    ]  # fmt: skip
    rows = recorded(records, "attitude_unit_misalignment")
    lacking = [row for row in rows if row["run"] == "two axes" and row["value"] is None]
    assert sorted(row["element"] for row in lacking) == ["L_xz", "L_yz"]
    assert {row["reason"] for row in lacking} == {"not measured in this run: turns about Z (7.3.1)"}
    assert one(rows, run="one way", element="L_yx")["reason"].startswith("turns about X in one direction only")
    assert one(rows, run="part", element="L_yx")["reason"].startswith("10.306 turns about X at 100 deg/s were recorded")
    assert one(rows, run="no axis", element="L_yx")["reason"].startswith("no word says which axis was turned")
    assert one(rows, run="dead", element="L_yx")["reason"].startswith("the output is 0 in every sample")
    assert one(rows, run="dead", element="L_zx")["value"] == pytest.approx(arcmin("ZX"))
    assert one(rows, run="volts", element="L_zx")["reason"].startswith("no scale factor for an output in V")


@pytest.mark.long
def test_the_earths_vertical_rate_is_taken_off_equal_angles_where_it_can_be(recorded: Any) -> None:
    """(5): Y sees L_yx of X, which points up at every angle; a latitude of 40 deg."""
    vertical = EARTH_DEG_PER_H * math.sin(math.radians(40.0)) * ELEMENTS["YX"]

    def many(run: str, mount: str = "Y_east_Z_north ", **words: Any) -> Rows:
        rows = around([0, 90, 180, 270], bias=6.0 + vertical, run=run, signal="rate_y", axis="Y", **words)
        return [row | {"position": f"{mount}{row['position']}"} for row in rows]

    records = [*turned(run="L"), *many("named"), *many("unnamed", mount=""), *many("other", unit="U2")]
    rows = {row["run"]: row for row in recorded(records, "attitude_unit_bias")}
    assert rows["named"]["value"] == pytest.approx(6.0, abs=1e-6)
    assert rows["named"]["vertical_rate_deg_per_h"] == pytest.approx(vertical, rel=1e-3)
    assert rows["unnamed"]["value"] == pytest.approx(6.0 + vertical, abs=1e-9)
    assert rows["unnamed"]["remark"].endswith("is in it: name the mount, as X_east_Y_north 30 deg")
    assert rows["other"]["remark"].endswith("is in it: measure L_yx (7.3)")
    # turned over it cancels, and is no scatter
    placed = [
        row | {"signal": "rate_y", "run": "four", "position": position, "mean": 6.0 + way * vertical}
        for row, (position, way) in zip(
            four(level=0.0, standard_uncertainty=0.001, freedom=9.0),
            {"Y_east_Z_north": 1, "Y_east_Z_south": -1, "Y_west_Z_south": 1, "Y_west_Z_north": -1}.items(), strict=True,
        )
    ]  # fmt: skip
    across = EARTH_DEG_PER_H * math.cos(math.radians(40.0)) * ELEMENTS["YZ"]
    for row, north in zip(placed, (1, -1, -1, 1), strict=True):
        row["mean"] += north * across
    (row,) = [each for each in recorded([*turned(run="L2"), *placed], "attitude_unit_bias") if each["run"] == "four"]
    assert row["value"] == pytest.approx(6.0, abs=1e-6)
    assert row["standard_uncertainty"] == pytest.approx(0.0005, rel=0.05)
