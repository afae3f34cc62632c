"""Scale factor, fitted zero, nonlinearity and asymmetry against NumPy, and what a test that is cut short says."""

from collections.abc import Callable, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
import pytest
from scipy import stats

from analytics.evaluation.evaluation import define_views, keep_scale_factors
from analytics.step_records.step_table import step_means
from tests.analytics.conftest import START_NS
from tests.analytics.metrics.rate_table import BOTH, Table, by_standard, cubic

# as in a file whose column of commands has measured rates
MEASURED = tuple(sign * rate - 0.25 + 0.25 * sign for rate in range(1, 21) for sign in (1, -1))


def test_line_against_numpy(tested: Any, table: Callable[..., Table]) -> None:
    rig = table(gyro=cubic, unit="V")
    rate, mean = rig.rates(procedure="scale_factor")
    k, zero = np.polyfit(rate[1:-1], mean[1:-1], 1)
    rest = (mean[0] + mean[-1]) / 2
    of = tested.metrics("scale_factor", "fitted_zero")
    found = by_standard(of["scale_factor"])
    assert set(found) == {"GJB2426A", "JJF2014"}
    for row in found.values():
        assert row["value"] == pytest.approx(k, rel=1e-9)
        assert row["unit_of_measure"] == "V/(deg/s)"
        assert row["steps"] == list(range(1, 25))
        assert row["rates"] == 22
    residuals = mean[1:-1] - k * rate[1:-1] - zero
    x = rate[1:-1] - rate[1:-1].mean()
    lack_of_fit = np.sqrt((residuals @ residuals) / 20 / (x @ x))
    row = found["GJB2426A"]
    assert row["standard_uncertainty"] >= lack_of_fit * (1 - 1e-9)
    half = stats.t.ppf(0.975, row["freedom"]) * row["standard_uncertainty"]
    assert row["hi"] - row["value"] == pytest.approx(half, rel=1e-9)
    zeros = by_standard(of["fitted_zero"])
    assert zeros["JJF2014"]["value"] == pytest.approx(zero / k * 3600, rel=1e-9)
    assert zeros["GJB2426A"]["value"] == pytest.approx((zero - rest) / k * 3600, rel=1e-9)
    assert zeros["JJF2014"]["output_unit"] == "V"


@pytest.mark.long
def test_nonlinearity_and_asymmetry_against_numpy(tested: Any, table: Callable[..., Table]) -> None:
    rig = table(gyro=cubic, unit="V")
    rate, mean = rig.rates(procedure="scale_factor")
    rest = (mean[0] + mean[-1]) / 2
    x, y = rate[1:-1], mean[1:-1]
    k, zero = np.polyfit(x, y, 1)
    residual = np.abs(y - k * x - zero).max()
    of = tested.metrics("scale_factor_nonlinearity", "scale_factor_asymmetry")
    found = by_standard(of["scale_factor_nonlinearity"])
    assert found["GJB2426A"]["value"] == pytest.approx(residual / np.abs(y - rest).max() * 1e6, rel=1e-9)
    assert found["JJF2014"]["value"] == pytest.approx(residual / (k * 600) * 1e6, rel=1e-9)
    assert all(row["lo"] <= row["value"] <= row["hi"] for row in found.values())
    plus, minus = (np.polyfit(x[side], y[side], 1)[0] for side in (x > 0, x < 0))
    found = by_standard(of["scale_factor_asymmetry"])
    assert found["GJB2426A"]["value"] == pytest.approx(abs(plus - minus) / ((plus + minus) / 2) * 1e6, rel=1e-9)
    assert found["JJF2014"]["value"] == pytest.approx(abs(plus - minus) / k * 1e6, rel=1e-9)
    # a cubic bends both sides alike, it is no part of the uncertainty of 30 ppm
    assert found["GJB2426A"]["lo"] < 30 < found["GJB2426A"]["hi"]
    assert found["GJB2426A"]["hi"] - found["GJB2426A"]["lo"] < 10


@pytest.mark.long
def test_rates_given_in_other_units_have_a_scale_factor_of_one(tested: Any, table: Callable[..., Table]) -> None:
    table(gyro=lambda rate: 3600 * (1.0001 * rate), unit="deg/h").rates(procedure="scale_factor", noise=1e-3)
    (row, _) = tested.metric("scale_factor")
    assert row["unit_of_measure"] == "1"
    assert row["value"] == pytest.approx(1.0001, rel=1e-8)


@pytest.mark.long
@pytest.mark.parametrize(
    ("rates", "rests", "gjb", "jjf"),
    [
        (BOTH, False, "no record of the table at rest before and after", None),
        (BOTH[:14], True, "7 rates measured forwards and 7 backwards, 11", "7 rates measured forwards and 7 backwards"),
        (BOTH[:-1], True, "the rates are not symmetric: 300 deg/s forwards only", "not symmetric: 300 deg/s forwards"),
        (MEASURED, True, "11, 12, ... (20) deg/s forwards only and 1.5, 2.5, ", "12.5, ... (20) deg/s backwards only"),
    ],
)
def test_what_is_missing_is_said(
    tested: Any, table: Callable[..., Table], rates: Sequence[float], rests: bool, gjb: str | None, jjf: str | None
) -> None:
    table(gyro=cubic, unit="V").rates(rates, rests=rests, procedure="scale_factor")
    for metric in ("scale_factor", "fitted_zero", "scale_factor_nonlinearity", "scale_factor_asymmetry", "range"):
        found = by_standard(tested.metric(metric))
        for standard, reason in (("GJB2426A", gjb), ("JJF2014", jjf)):
            if reason is not None:
                assert found[standard]["value"] is None, metric
                assert reason in found[standard]["reason"]
            elif metric != "range":
                assert found[standard]["value"] is not None
                assert found[standard]["reason"] is None


@pytest.mark.long
def test_largest_rate_of_the_product_is_asked_for(tested: Any, table: Callable[..., Table]) -> None:
    tested.product("[product.FOG-70]\nmax_rate_deg_per_s = 400.0")
    table(product="FOG-70").rates(procedure="scale_factor")
    reasons = {row["reason"] for row in tested.metric("scale_factor") if row["standard"] != "informative"}
    assert reasons == {"the largest rate is 300 deg/s, that of product FOG-70 is 400 deg/s and must be among them"}


@pytest.mark.long
def test_steps_of_other_tests_are_no_scale_factor(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    rig.step(100.0, procedure="misalignment", position="ox_up")
    rig.step(-100.0, position="OY_up")
    rig.step(100.0, procedure="startup_time", step="power_on_at_rate")
    rig.step(10.0, procedure="polarity")
    rig.step(0.0)
    assert tested.metric("scale_factor") == []


@pytest.mark.long
def test_a_file_may_call_the_procedure_as_it_likes(tested: Any, table: Callable[..., Table]) -> None:
    table().rates(procedure="my rate table")
    assert [row["value"] for row in tested.metric("scale_factor")] == pytest.approx([1.0, 1.0], rel=1e-5)


@pytest.mark.long
def test_attitude_units_need_seven_rates_and_the_axis_that_is_up(tested: Any, table: Callable[..., Table]) -> None:
    tested.run("r1")
    rng = np.random.default_rng(1)
    t_ns = START_NS
    for rate, name in [(0.0, "rest_before"), *((r, "rate") for r in (10, -10, 40, -40, 100, -100, 70)), (0.0, "x")]:
        noise = 1e-3 * rng.standard_normal((2, 200))  # 7.1.1 d: 20 s
        signals = {"rate_x": (1.01 * rate + noise[0], "deg/s"), "rate_y": (noise[1], "deg/s")}
        t_ns = tested.step(
            "r1", "U1", signals, t0_ns=t_ns, procedure="attitude_unit_scale_factor", axis="X", position="X_up",
            step=name, rate_command_deg_per_s=float(rate),
        )  # fmt: skip
    (row,) = tested.metric("scale_factor")
    assert (row["standard"], row["signal"]) == ("JJF1536", "rate_x")
    assert row["value"] == pytest.approx(1.01, rel=1e-4)


@pytest.mark.long
def test_more_rates_than_the_clause_has_are_stated_as_a_deviation(tested: Any) -> None:
    """7.1.1 c: 7 to 11 rates; more do no harm to K, and are another method."""
    tested.run("r1")
    rng = np.random.default_rng(1)
    t_ns = START_NS
    rates = [way * rate for rate in (10.0, 20.0, 30.0, 50.0, 70.0, 100.0) for way in (1, -1)]
    for rate in (0.0, *rates, 0.0):
        noise = 1e-3 * rng.standard_normal(200)
        t_ns = tested.step(
            "r1", "U1", {"rate_x": (1.01 * rate + noise, "deg/s")}, t0_ns=t_ns, axis="X", position="X_up",
            procedure="attitude_unit_scale_factor", rate_command_deg_per_s=rate,
        )  # fmt: skip
    (row,) = tested.metric("scale_factor")
    assert row["value"] == pytest.approx(1.01, rel=1e-4)
    assert row["remark"] == "12 rates: the clause has 7 to 11 (7.1.1 c)"


@pytest.mark.long
def test_attitude_units_are_refused_short_records_and_dead_axes(tested: Any) -> None:
    """7.1.1 d: at least 20 s at each rate; an axis that gives one value at every rate has no scale factor of 0."""
    tested.run("r1")
    rng = np.random.default_rng(1)
    t_ns = START_NS
    for axis in "XY":
        for rate in (0.0, 10.0, -10.0, 40.0, -40.0, 100.0, -100.0, 70.0, 0.0):
            seconds = 10 if rate == 40.0 else 20
            noise = 1e-3 * rng.standard_normal((2, 10 * seconds))
            signals = {"rate_x": (rate * (axis == "X") + noise[0], "deg/s"), "rate_y": (0.0 * noise[1], "deg/s")}
            t_ns = tested.step(
                "r1", "U1", signals, t0_ns=t_ns, procedure="attitude_unit_scale_factor", axis=axis,
                position=f"{axis}_up", rate_command_deg_per_s=rate,
            )  # fmt: skip
    rows = {row["signal"]: row for row in tested.metric("scale_factor") if row["standard"] == "JJF1536"}
    asked = "10 s recorded at 40 deg/s, at least 20 s at each rate are asked for (7.1.1 d)"
    assert (rows["rate_x"]["value"], rows["rate_x"]["reason"]) == (None, asked)
    assert rows["rate_y"]["value"] is None
    assert rows["rate_y"]["reason"].startswith("the output is 0 at every rate: the axis does not answer")


@pytest.mark.long
def test_a_run_cut_short_after_one_rate_says_so(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    rig.step(0.0, procedure="scale_factor", step="rest_before")
    for metric in ("scale_factor", "fitted_zero", "scale_factor_nonlinearity", "scale_factor_asymmetry", "range"):
        for row in tested.metric(metric):
            assert row["value"] is None
            assert "0 rates measured forwards and 0 backwards, 11" in row["reason"]
    rig.step(4.0, procedure="scale_factor", step="rate")
    found = by_standard(tested.metric("scale_factor"))
    assert "1 rates measured forwards" in found["JJF2014"]["reason"]
    assert "no record of the table at rest after the rates" in found["GJB2426A"]["reason"]


@pytest.mark.long
def test_the_scale_factors_that_others_may_use(tested: Any, table: Callable[..., Table]) -> None:
    rig = table(unit="V", gyro=lambda rate: 0.02 * rate)
    rig.rates(rests=False, procedure="scale_factor_jjf2014")
    first_ns = rig.t_ns
    rig.rates(procedure="scale_factor_temperature_sensitivity", temperature_command_deg_c=-40.0)
    rig.rates(BOTH[:10], procedure="scale_factor", repeat=2)
    with tested.catalog() as catalog:
        steps = step_means(catalog)
        catalog._unfilled.clear()
        define_views(catalog, steps)
        keep_scale_factors(catalog)
        found = catalog.rows("select unit, signal, run, value, t_to_ns from internal.scale_factors")
    ((unit, signal, run, value, t_to_ns),) = found
    assert (unit, signal, run) == ("U1", "rate", "r1")
    assert value == pytest.approx(0.02, rel=1e-5)
    assert t_to_ns < first_ns


@pytest.mark.parametrize("name", ["scale_fits", "scale_factors"])
@pytest.mark.in_gate("scale_fits")
def test_without_rates_the_tables_have_the_same_columns(tested: Any, table: Callable[..., Table], name: str) -> None:
    table(gyro=cubic, unit="V").rates(procedure="scale_factor")
    script = files("analytics.evaluation").joinpath("without_rates", f"{name}.sql").read_text(encoding="utf-8")
    described, counted = f"describe internal.{name}", f"select count(*) from internal.{name}"
    with tested.catalog() as catalog:
        steps = step_means(catalog)
        catalog._unfilled.clear()
        define_views(catalog, steps)
        keep_scale_factors(catalog)
        columns = catalog.rows(described)
        assert catalog.rows(counted) == [(1,)]
        catalog.create(name, script)
        assert catalog.rows(described) == columns
        assert catalog.rows(counted) == [(0,)]


@pytest.mark.long
@pytest.mark.parametrize("rates", [BOTH[:6], (50.0, -50.0)])
def test_fewer_rates_than_the_clauses_ask_for_have_an_informative_value(
    tested: Any, table: Callable[..., Table], rates: Sequence[float]
) -> None:
    rig = table(gyro=cubic, unit="V")
    rate, mean = rig.rates(rates, procedure="scale_factor")
    found = by_standard(tested.metric("scale_factor"))
    assert set(found) == {"GJB2426A", "JJF2014", "informative"}
    assert [found[each]["value"] for each in ("GJB2426A", "JJF2014")] == [None, None]
    row = found["informative"]
    assert row["value"] == pytest.approx(np.polyfit(rate[1:-1], mean[1:-1], 1)[0], rel=1e-9)
    assert row["lo"] < row["value"] < row["hi"]
    assert f"GJB2426A: {len(rates) // 2} rates measured forwards" in row["remark"]
    # others do not stand on it
    rig.step(0.0, procedure="static_bias")
    assert "no scale factor" in tested.metric("bias")[0]["reason"]


@pytest.mark.long
def test_a_whole_measurement_has_no_informative_value(tested: Any, table: Callable[..., Table]) -> None:
    table(gyro=cubic, unit="V").rates(procedure="scale_factor")
    assert "informative" not in by_standard(tested.metric("scale_factor"))
