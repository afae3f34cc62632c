"""The bias family against NumPy and SciPy on the samples, and what it says of tests that were cut short."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from scipy import stats

from analytics.methods.repeatability import Variance, between, beyond, means_noise, scatter
from stream.estimators.noise.normalised_random_walk import angle_random_walk_normalised
from stream.events import NoiseFitted

START_NS = 1_763_683_200 * 10**9  # 2025-11-21 00:00 UTC
SECOND_NS = 10**9
DAY_NS = 86_400 * SECOND_NS
EARTH_DEG_PER_H = 15.041067
DT_NS = SECOND_NS // 4
HOUR = 14_400  # samples
Rows = list[dict[str, Any]]
Recorded = Callable[[Sequence[Mapping[str, Any]], str], Rows]


def exact(value: Any) -> Any:
    return pytest.approx(value, rel=1e-9)


def drifting(rng: np.random.Generator, n: int = HOUR, mean: float = 5.0) -> np.ndarray:
    return rng.normal(mean, 3.0, n) + np.cumsum(rng.normal(0, 0.02, n))


def one(rows: Rows, **words: Any) -> dict[str, Any]:
    found = [row for row in rows if all(row.get(name) == value for name, value in words.items())]
    assert len(found) == 1, (words, rows)
    return found[0]


def test_static_records_are_those_of_the_samples(tested: Any) -> None:
    rng = np.random.default_rng(11)
    volts = drifting(rng) * -2.9222e-3 / 3600 * 1000
    tested.product(
        '[product."FOG-70"]\nscale_factor = -2.9222\nscale_factor_unit = "mV"\naverage_s = 30.0\n'
        '[product."FOG-50"]\nscale_factor = -2.9222\nscale_factor_unit = "mV"\naverage_s = 2.5\n'
    )
    tested.run("r1", procedure="static_bias", latitude_deg=40.0)
    for unit, product in (("U1", "FOG-70"), ("U2", "FOG-50")):
        tested.mount("r1", unit, product=product)
        tested.step("r1", unit, volts, t0_ns=START_NS, dt_ns=DT_NS, unit_of_measure="mV", position="IRA_up")
    rates = volts * 3600 / -2.9222

    bias = [row for row in tested.metric("bias") if row["unit"] == "U1"]
    earth = EARTH_DEG_PER_H * math.sin(math.radians(40.0))
    assert one(bias, earth_rate="none")["value"] == exact(rates.mean())
    assert one(bias, earth_rate="removed")["value"] == exact(rates.mean() - earth)
    half = stats.t.isf(0.025, bias[0]["freedom"]) * bias[0]["standard_uncertainty"]
    assert one(bias, earth_rate="none")["hi"] == exact(rates.mean() + half)

    stability = one(tested.metric("bias_stability"), unit="U1")
    assert stability["value"] == exact(rates.std(ddof=1))
    assert stability["n"] == HOUR
    assert 0 < stability["lo"] < stability["value"] < stability["hi"]

    averaged = tested.metric("bias_stability_averaged")
    for unit, average_s in (("U1", 1.0), ("U1", 10.0), ("U1", 100.0), ("U1", 30.0), ("U2", 2.5), ("U2", 1.0)):
        means = rates[: HOUR - HOUR % round(average_s * 4)].reshape(-1, round(average_s * 4)).mean(axis=1)
        row = one(averaged, unit=unit, average_s=average_s)
        assert (row["value"], row["n"]) == (exact(means.std(ddof=1)), len(means))
        freedom = row["freedom"]
        assert row["lo"] == exact(row["value"] * math.sqrt(freedom / stats.chi2.isf(0.025, freedom)))
        assert row["hi"] == exact(row["value"] * math.sqrt(freedom / stats.chi2.ppf(0.025, freedom)))
        # of 1 s they are nearly white, over 100 s the walk makes neighbours alike
        assert freedom < len(means) - 1
    assert len(averaged) == 8


def test_a_short_record_is_flagged_an_empty_one_has_a_reason_and_the_others_go_on(recorded: Recorded) -> None:
    rows: Rows = [
        {"mean": 1.0, "sd": 2.0, "sd_freedom": 900.0, "procedure": "static_bias"},
        {"mean": 1.0, "sd": 2.0, "sd_freedom": 900.0, "duration_s": 600.0, "unit": "U2"},
        {"n": 0, "unit": "U3"},
        {"mean": 1.0, "unit": "U4", "unit_of_measure": "mV"},
        {"mean": 1.0, "unit": "U5", "rate_command": 0.0, "procedure": "own"},
        {"mean": 9.0, "unit": "U5", "rate_command": 9.0, "procedure": "own"},
        {"mean": 1.0, "unit": "U6", "phase": "before"},
        {"mean": 9.0, "unit": "U7", "input_rate": 10.0, "input_rate_source": "table"},
    ]
    found = recorded(rows, "bias_stability")
    assert (one(found, unit="U1")["value"], one(found, unit="U1")["remark"]) == (2.0, None)
    # by the note of JJF 2014-2022 7.2.13.1 the user chooses the time
    assert one(found, unit="U2")["value"] == 2.0
    assert one(found, unit="U2")["remark"] == "record of 600 s: the clauses ask for one hour as a rule"
    assert one(found, unit="U3")["reason"] == "no sample in the evaluated part of the step"
    assert "no scale factor for an output in mV" in one(found, unit="U4")["reason"]
    assert {row["unit"] for row in found} == {"U1", "U2", "U3", "U4"}
    averaged = recorded(rows[:1], "bias_stability_averaged")
    assert [row["reason"] for row in averaged] == [
        f"0 averages of {s} s in the record, at least 2 are needed" for s in (1, 10, 100)
    ]
    for row in found + averaged:
        assert (row["value"] is None) == (row["reason"] is not None)


def power_ons(biases: np.ndarray, **words: Any) -> Rows:
    """Steps of as many days as there are rows, each with so many power-ons."""
    return [
        {
            "run": f"r{day}", "procedure": "bias_repeatability", "position": "IRA_east_west", "repeat": at + 1,
            "index": at + 1, "epoch": f"e{day}-{at}", "mean": float(bias),
            "t_start_ns": START_NS + day * DAY_NS + at * 2 * 3600 * SECOND_NS,
        } | words
        for day, of_day in enumerate(biases)
        for at, bias in enumerate(of_day)
    ]  # fmt: skip


def test_repeatability_and_its_components(recorded: Recorded) -> None:
    rng = np.random.default_rng(12)
    biases = 3 + rng.normal(0, 0.3, (7, 1)) + rng.normal(0, 0.1, (7, 4))
    found = recorded(power_ons(biases), "bias_repeatability")
    whole = [row for row in found if row["run"] is None]
    assert {row["kind"] for row in whole} == {
        "all", "run_to_run", "day_to_day", "within_day_component", "between_day_component"
    }  # fmt: skip
    within = biases.var(axis=1, ddof=1).mean()
    mean_square = 4 * biases.mean(axis=1).var(ddof=1)
    # each mean has an uncertainty of 0.01 with 30 degrees of freedom, which is taken off
    expected = {
        "run_to_run": (within, 21, 1e-4, 28 * 30),
        "day_to_day": (biases.mean(axis=1).var(ddof=1), 6, 1e-4 / 4, 28 * 30),
        "within_day_component": (within, 21, 1e-4, 28 * 30),
    }
    for kind, (variance, freedom, noise, noise_freedom) in expected.items():
        row = one(whole, kind=kind)
        assert row["value"] == exact(math.sqrt(variance - noise))
        assert (row["scatter"], row["uncertainty_of_means"]) == (exact(math.sqrt(variance)), exact(math.sqrt(noise)))
        for side, tail in (("lo", 0.025), ("hi", 0.975)):
            left = variance - noise * stats.f.isf(tail, freedom, noise_freedom)
            assert row[side] == exact(math.sqrt(freedom * left / stats.chi2.isf(tail, freedom)))
        assert row["standard_uncertainty"] == pytest.approx(row["value"] / math.sqrt(2 * freedom), rel=0.02)
    # power-ons of one day share its effect: a deviation of all would be neither
    assert "28 power-ons of 7 days, several of one" in one(whole, kind="all")["reason"]
    row = one(whole, kind="between_day_component")
    assert row["value"] == exact(math.sqrt((mean_square - within) / 4))
    lo = 6 * (mean_square - within * stats.f.isf(0.025, 6, 21)) / (4 * stats.chi2.isf(0.025, 6))
    hi = 6 * (mean_square - within * stats.f.ppf(0.025, 6, 21)) / (4 * stats.chi2.ppf(0.025, 6))
    assert (row["lo"], row["hi"]) == (exact(math.sqrt(lo)), exact(math.sqrt(hi)))
    assert row["runs"] == [f"r{day}" for day in range(7)]
    # a run of its own has four power-ons: GJB 2426A asks for six
    own = [row for row in found if row["run"] == "r2" and row["kind"] == "all"]
    assert one(own, standard="JJF2014")["value"] == exact(math.sqrt(biases[2].var(ddof=1) - 1e-4))
    assert one(own, standard="GJB2426A")["reason"] == "4 power-ons measured, the clause asks for 6 or more"


def test_the_same_day_is_that_of_the_station(recorded: Recorded) -> None:
    biases = np.array([[1.0, 2.0, 4.0, 8.0]])
    late = power_ons(biases, t_start_ns=START_NS)
    for at, row in enumerate(late):
        row["t_start_ns"] = START_NS + (20 + 3 * at) * 3600 * SECOND_NS  # 20:00, 23:00, 02:00, 05:00 UTC
    in_london = recorded(late, "bias_repeatability")
    assert one(in_london, kind="day_to_day", standard="JJF2014")["scatter"] == exact(np.std([1.5, 6.0], ddof=1))
    in_shanghai = recorded([row | {"time_zone": "Asia/Shanghai"} for row in late], "bias_repeatability")
    assert one(in_shanghai, kind="day_to_day")["reason"] == "all 4 power-ons are of one day, 2 days are needed"
    undated = recorded([row | {"date_known": False} for row in late], "bias_repeatability")
    assert one(undated, kind="run_to_run", standard="JJF2014")["scatter"] == exact(np.std(biases, ddof=1))
    assert "the date is unknown" in one(undated, kind="day_to_day")["reason"]


def test_repeatability_of_too_few_power_ons(recorded: Recorded) -> None:
    found = recorded(power_ons(np.array([[1.0]])), "bias_repeatability")
    assert {row["reason"] for row in found} == {"1 power-on measured, at least 2 are needed, 6 by GJB 2426A"}
    # steps of one power-on are one bias; a single static run is no test of repeatability
    same = recorded(power_ons(np.array([[1.0, 2.0]]), epoch="e"), "bias_repeatability")
    assert one(same, kind="all")["power_ons"] == 1
    assert recorded([{"mean": 1.0, "procedure": "static_bias"}], "bias_repeatability") == []
    daily = [
        {"mean": float(day), "procedure": "static_bias", "run": f"r{day}", "t_start_ns": START_NS + day * DAY_NS}
        for day in range(6)
    ]
    found = recorded(daily, "bias_repeatability")
    assert one(found, kind="day_to_day")["value"] == exact(math.sqrt(np.var(np.arange(6.0), ddof=1) - 1e-4))
    assert one(found, kind="all")["value"] == one(found, kind="day_to_day")["value"]
    assert one(found, kind="all")["remark"] == "6 power-ons are not recorded: each run is taken for one"
    assert (one(found, kind="all")["power_ons"], one(found, kind="all")["power_ons_recorded"]) == (6, 0)
    assert "each of the 6 power-ons is of another day" in one(found, kind="run_to_run")["reason"]


def test_raw_and_corrected_biases_are_never_in_one_repeatability(recorded: Recorded) -> None:
    rows = power_ons(np.arange(6.0)[:, np.newaxis], position="IRA_up")
    unknown = [{**row, "unit": "U2", "latitude_deg": None if at == 0 else 40.0} for at, row in enumerate(rows)]
    east = [{**row, "unit": "U3", "latitude_deg": None, "position": "IRA_east"} for row in rows]
    found = recorded([*rows, *unknown, *east], "bias_repeatability")
    found = [row for row in found if row["kind"] == "all" and row["run"] is None]
    whole = math.sqrt(np.var(np.arange(6.0), ddof=1) - 1e-4)
    assert one(found, unit="U1")["value"] == pytest.approx(whole)
    assert one(found, unit="U1")["earth_rate"] == "removed"
    assert one(found, unit="U2", earth_rate="none")["value"] == pytest.approx(whole)
    assert "no latitude of the station" in one(found, unit="U2", earth_rate="removed")["reason"]
    assert (one(found, unit="U3")["earth_rate"], one(found, unit="U3")["value"]) == ("removed", pytest.approx(whole))


def test_the_scatter_of_short_records_is_their_noise(recorded: Recorded) -> None:
    """Seven records of 52 s: the means scatter by 2.9, each is uncertain by 3.0."""
    rng = np.random.default_rng(16)
    biases = rng.normal(0, 1, (1, 7))
    biases *= 2.9 / biases.std(ddof=1)
    rows = power_ons(biases, standard_uncertainty=3.01, freedom=12.0, duration_s=52.0)
    found = recorded(rows, "bias_repeatability")
    row = one(found, kind="all")
    assert (row["value"], row["lo"]) == (0.0, 0.0)
    assert row["hi"] < 6.0
    assert (row["scatter"], row["uncertainty_of_means"]) == (exact(2.9), exact(3.01))
    assert row["remark"] == "7 of 7 records are of 52 s: the clauses ask for an hour as a rule"
    assert row["power_ons_recorded"] == 7
    # longer records of the same unit would show it
    rows = power_ons(biases, standard_uncertainty=0.3, freedom=12.0)
    assert one(recorded(rows, "bias_repeatability"), kind="all")["lo"] > 1.8
    # one whose uncertainty is unknown lets nothing be taken off
    rows[0]["standard_uncertainty"] = None
    unknown = one(recorded(rows, "bias_repeatability"), kind="all")
    assert (unknown["value"], unknown["uncertainty_of_means"]) == (exact(2.9), None)


@pytest.mark.parametrize("sigma", [0.0, 0.3, 1.0, 3.0])
def test_the_limits_of_what_is_left_of_a_scatter_hold(sigma: float) -> None:
    rng = np.random.default_rng(17)
    trials, n, u, freedom = 2000, 8, 1.0, 9
    held = 0
    for _ in range(trials):
        values = rng.normal(0, math.hypot(sigma, u), n)
        reported = u * np.sqrt(rng.chisquare(freedom, n) / freedom)
        noise = means_noise(reported.tolist(), [freedom] * n, ["a"] * n)
        found = beyond(Variance(values.var(ddof=1), n - 1), noise.square)
        held += found.lo <= sigma <= found.hi
    assert held >= stats.binom.ppf(0.001 / 4, trials, 0.95)


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.5])
def test_the_limits_of_the_component_between_days_hold(sigma: float) -> None:
    rng = np.random.default_rng(13)
    sizes = (3, 5, 2, 6, 4, 3)
    days = [day for day, size in enumerate(sizes) for _ in range(size)]
    held = 0
    for _ in range(2000):
        values = rng.normal(0, sigma, len(sizes))[days] + rng.normal(0, 0.3, len(days))
        found = between(scatter(values.tolist(), days))
        held += found.lo <= sigma <= found.hi
    # they hold at least at 95 %: the bound of 2000 trials at 99.9 %, one-sided, three checks together
    assert held >= stats.binom.ppf(0.001 / 3, 2000, 0.95)


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
    again = curve({20.0: 2.0, 40.0: 3.0}, repeat=1) + curve({20.0: 2.0, 40.0: 4.0}, repeat=2)
    assert [row["value"] for row in recorded(again, metric)] == [exact(1 / 20), exact(2 / 20)]


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


def test_z_up_of_a_gyro_with_one_axis_is_its_input_axis(recorded: Recorded) -> None:
    # JJF 2014-2022 figure 2: the input reference axis is o'z'
    earth = EARTH_DEG_PER_H * math.sin(math.radians(40.0))
    means = {"X": (0.5, -0.5), "Y": (1.0, -1.0), "Z": (1.2 + earth, -1.2 - earth)}
    found = recorded(flips(means), "bias_acceleration_sensitivity")
    assert one(found, axis="Z", earth_rate="none")["value"] == exact(1.2 + earth)
    assert one(found, axis="Z", earth_rate="removed")["value"] == exact(1.2)
    assert one(found, axis="largest", earth_rate="removed")["value"] == exact(1.2)


def test_a_bias_is_of_the_standard_whose_attitude_it_has(recorded: Recorded) -> None:
    rows = [{"mean": 1.0, "unit": position, "position": position} for position in ("IRA_east", "IRA_up", "Z_down", "x")]
    found = {row["unit"]: row["standard"] for row in recorded(rows, "bias")}
    assert found == {"IRA_east": "GJB2426A", "IRA_up": "JJF2014", "Z_down": "JJF2014", "x": "GJB2426A, JJF2014"}


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


def coefficient(value: float, *, observable: bool = True) -> dict[str, Any]:
    reason = "" if observable else "not observable in this record: at most 9 deg/h"
    return {"value": value, "lo": value * 0.9, "hi": value * 1.1, "unit_of_measure": "deg/h", "observable": observable,
            "reason": reason}  # fmt: skip


def test_noise_coefficients(tested: Any) -> None:
    rng = np.random.default_rng(15)
    white = rng.normal(0, 6.0, HOUR)
    fast = rng.normal(0, 6.0, 12_000)
    tested.run("r1", procedure="allan_variance")
    tested.step("r1", "U1", white, t0_ns=START_NS, dt_ns=DT_NS, procedure="allan_variance")
    tested.step("r1", "U2", white, t0_ns=START_NS, dt_ns=DT_NS, procedure="allan_variance")
    keys = ("quantization_noise", "angle_random_walk", "bias_instability", "rate_random_walk", "rate_ramp")
    coefficients = {key: coefficient(i + 1.0, observable=i < 3) for i, key in enumerate(keys)}
    fit: dict[str, Any] = {**coefficients, "markov": None, "misfit": 0.0}
    tested.document(NoiseFitted(run="r1", t_ns=START_NS + DAY_NS, unit="U1", signal="rate", coefficients=fit))
    tested.run("r2", procedure="random_walk")
    tested.step("r2", "U1", fast, t0_ns=START_NS, dt_ns=5_000_000, procedure="random_walk")
    tested.step("r2", "U2", fast[::2], t0_ns=START_NS, dt_ns=10_000_000, procedure="random_walk")

    walks = tested.metric("angle_random_walk")
    fitted = one(walks, unit="U1", method="allan")
    assert [fitted[name] for name in ("value", "lo", "hi", "record")] == [2.0, 1.8, 2.2, "run"]
    own = one(walks, unit="U2", method="allan")
    assert own["record"] == "step"
    # the Allan variance at the shortest averaging time is nearly all there is to tell white noise by
    truth = 6.0 * math.sqrt(0.25) / 60
    assert own["lo"] < truth < own["hi"]
    assert own["value"] == pytest.approx(truth, rel=5 / math.sqrt(2 * HOUR / 1.5))
    short = one(walks, unit="U1", method="normalised")
    seconds = fast.reshape(60, 200).mean(axis=1)
    halves = np.median([seconds[:30].std(ddof=1), seconds[30:].std(ddof=1)]) / 60
    assert short["value"] == exact(halves)
    assert short["hi"] == exact(angle_random_walk_normalised(fast, 0.005).coefficient.hi)  # type: ignore[union-attr]
    assert "less than 0.01 s" in one(walks, unit="U2", method="normalised")["reason"]

    assert one(tested.metric("bias_instability"), unit="U1")["value"] == 3.0
    ramp = tested.metric("rate_ramp")
    assert one(ramp, unit="U1")["reason"] == "not observable in this record: at most 9 deg/h"
    assert "no noise fit is stored" in one(ramp, unit="U2")["reason"]
    assert one(tested.metric("quantization_noise"), unit="U1")["lo"] == 0.9
    assert one(tested.metric("rate_random_walk"), unit="U1")["value"] is None
