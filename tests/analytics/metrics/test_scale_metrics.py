"""The scale-factor family against NumPy and SciPy straight from the samples, against the truth, and on bad input."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from scipy import stats

from analytics.evaluation.evaluation import define_views, evaluate, keep_scale_factors
from analytics.metric_registry.registry import metrics
from analytics.step_records.step_table import step_means

RATES = (4.0, 6.3, 10.0, 16.0, 25.0, 40.0, 63.0, 100.0, 160.0, 250.0, 300.0)
BOTH = tuple(sign * rate for rate in RATES for sign in (1, -1))
SECOND_NS = 10**9
START_NS = 1_763_683_200 * SECOND_NS
Gyro = Callable[[float], float]


def rows_of(tested: Any, metric: str) -> list[dict[str, Any]]:
    """Rows of one metric over what was written, its parameters among the columns."""
    with tested.catalog() as catalog:
        steps = step_means(catalog)
        catalog._unfilled.clear()
        define_views(catalog, steps)
        found = evaluate(catalog, [metrics()[metric]]).to_pylist()
    return [json.loads(row["parameters"] or "{}") | row for row in found]


class Table:
    """A rate table on which one unit is measured; keeps the raw samples of each step."""

    def __init__(self, tested: Any, run: str, gyro: Gyro, *, seed: int = 1, unit: str = "deg/s", t_ns: int = START_NS):
        self.tested, self.run, self.gyro, self.unit, self.t_ns = tested, run, gyro, unit, t_ns
        self.rng = np.random.default_rng(seed)
        self.samples: list[tuple[float, np.ndarray]] = []

    def step(self, rate: float, *, noise: float | None = None, **words: Any) -> np.ndarray:
        deviation = noise or (1e-5 if self.unit == "V" else 1e-3)
        values = self.gyro(rate) + deviation * self.rng.standard_normal(100)
        self.t_ns = self.tested.step(
            self.run, "U1", values, t0_ns=self.t_ns, unit_of_measure=self.unit,
            rate_command_deg_per_s=rate, **words,
        )  # fmt: skip
        self.samples.append((rate, values))
        return values

    def rates(
        self, rates: Sequence[float] = BOTH, *, rests: bool = True, **words: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rest, rates and rest; the rates and the mean outputs, the rests first and last."""
        every = [0.0, *rates, 0.0] if rests else list(rates)
        names = ["rest_before", *["rate"] * len(rates), "rest_after"] if rests else ["rate"] * len(rates)
        means = [self.step(rate, step=name, **words).mean() for rate, name in zip(every, names, strict=True)]
        return np.array(every), np.array(means)


@pytest.fixture
def table(tested: Any) -> Callable[..., Table]:
    def begin(run: str = "r1", gyro: Gyro = lambda rate: rate, **options: Any) -> Table:
        tested.run(run, t_ns=options.get("t_ns", START_NS), procedure=options.pop("procedure", None))
        product = options.pop("product", None)
        if product is not None:
            tested.mount(run, "U1", product=product)
        return Table(tested, run, gyro, **options)

    return begin


def cubic(rate: float) -> float:
    """Output of a gyro, V: scale factor, zero, asymmetry and a cubic."""
    return 0.02 * rate * (1 + 30e-6 * (rate > 0)) + 0.005 + 0.02 * 300 * 50e-6 * (rate / 300) ** 3


def by_standard(rows: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    return {row["standard"]: row for row in rows}


def test_line_against_numpy(tested: Any, table: Callable[..., Table]) -> None:
    rig = table(gyro=cubic, unit="V")
    rate, mean = rig.rates(procedure="scale_factor")
    k, zero = np.polyfit(rate[1:-1], mean[1:-1], 1)
    rest = (mean[0] + mean[-1]) / 2
    found = by_standard(rows_of(tested, "scale_factor"))
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
    zeros = by_standard(rows_of(tested, "fitted_zero"))
    assert zeros["JJF2014"]["value"] == pytest.approx(zero / k * 3600, rel=1e-9)
    assert zeros["GJB2426A"]["value"] == pytest.approx((zero - rest) / k * 3600, rel=1e-9)
    assert zeros["JJF2014"]["output_unit"] == "V"


def test_nonlinearity_and_asymmetry_against_numpy(tested: Any, table: Callable[..., Table]) -> None:
    rig = table(gyro=cubic, unit="V")
    rate, mean = rig.rates(procedure="scale_factor")
    rest = (mean[0] + mean[-1]) / 2
    x, y = rate[1:-1], mean[1:-1]
    k, zero = np.polyfit(x, y, 1)
    residual = np.abs(y - k * x - zero).max()
    found = by_standard(rows_of(tested, "scale_factor_nonlinearity"))
    assert found["GJB2426A"]["value"] == pytest.approx(residual / np.abs(y - rest).max() * 1e6, rel=1e-9)
    assert found["JJF2014"]["value"] == pytest.approx(residual / (k * 600) * 1e6, rel=1e-9)
    assert all(row["lo"] <= row["value"] <= row["hi"] for row in found.values())
    plus, minus = (np.polyfit(x[side], y[side], 1)[0] for side in (x > 0, x < 0))
    found = by_standard(rows_of(tested, "scale_factor_asymmetry"))
    assert found["GJB2426A"]["value"] == pytest.approx(abs(plus - minus) / ((plus + minus) / 2) * 1e6, rel=1e-9)
    assert found["JJF2014"]["value"] == pytest.approx(abs(plus - minus) / k * 1e6, rel=1e-9)
    # a cubic bends both sides alike, it is no part of the uncertainty of 30 ppm
    assert found["GJB2426A"]["lo"] < 30 < found["GJB2426A"]["hi"]
    assert found["GJB2426A"]["hi"] - found["GJB2426A"]["lo"] < 10


def test_rates_given_in_other_units_have_a_scale_factor_of_one(tested: Any, table: Callable[..., Table]) -> None:
    table(gyro=lambda rate: 3600 * (1.0001 * rate), unit="deg/h").rates(procedure="scale_factor", noise=1e-3)
    (row, _) = rows_of(tested, "scale_factor")
    assert row["unit_of_measure"] == "1"
    assert row["value"] == pytest.approx(1.0001, rel=1e-8)


@pytest.mark.in_gate(
    "rates1-True-7 rates measured forwards and 7 backwards, 11-7 rates measured forwards and 7 backwards"
)
@pytest.mark.parametrize(
    ("rates", "rests", "gjb", "jjf"),
    [
        (BOTH, False, "no record of the table at rest before and after", None),
        (BOTH[:14], True, "7 rates measured forwards and 7 backwards, 11", "7 rates measured forwards and 7 backwards"),
        (BOTH[:-1], True, "the rates are not symmetric: 300 deg/s forwards only", "not symmetric: 300 deg/s forwards"),
    ],
)
def test_what_is_missing_is_said(
    tested: Any, table: Callable[..., Table], rates: Sequence[float], rests: bool, gjb: str | None, jjf: str | None
) -> None:
    table(gyro=cubic, unit="V").rates(rates, rests=rests, procedure="scale_factor")
    for metric in ("scale_factor", "fitted_zero", "scale_factor_nonlinearity", "scale_factor_asymmetry", "range"):
        found = by_standard(rows_of(tested, metric))
        for standard, reason in (("GJB2426A", gjb), ("JJF2014", jjf)):
            if reason is not None:
                assert found[standard]["value"] is None, metric
                assert reason in found[standard]["reason"]
            elif metric != "range":
                assert found[standard]["value"] is not None
                assert found[standard]["reason"] is None


def test_largest_rate_of_the_product_is_asked_for(tested: Any, table: Callable[..., Table]) -> None:
    tested.product("[product.FOG-70]\nmax_rate_deg_per_s = 400.0")
    table(product="FOG-70").rates(procedure="scale_factor")
    reasons = {row["reason"] for row in rows_of(tested, "scale_factor") if row["standard"] != "informative"}
    assert reasons == {"the largest rate is 300 deg/s, that of product FOG-70 is 400 deg/s and must be among them"}


def test_steps_of_other_tests_are_no_scale_factor(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    rig.step(100.0, procedure="misalignment", position="ox_up")
    rig.step(-100.0, position="OY_up")
    rig.step(100.0, procedure="startup_time", step="power_on_at_rate")
    rig.step(10.0, procedure="polarity")
    rig.step(0.0)
    assert rows_of(tested, "scale_factor") == []


def test_a_file_may_call_the_procedure_as_it_likes(tested: Any, table: Callable[..., Table]) -> None:
    table().rates(procedure="my rate table")
    assert [row["value"] for row in rows_of(tested, "scale_factor")] == pytest.approx([1.0, 1.0], rel=1e-5)


def test_attitude_units_need_seven_rates_and_the_axis_that_is_up(tested: Any, table: Callable[..., Table]) -> None:
    tested.run("r1")
    rng = np.random.default_rng(1)
    t_ns = START_NS
    for rate, name in [(0.0, "rest_before"), *((r, "rate") for r in (10, -10, 40, -40, 100, -100, 70)), (0.0, "x")]:
        noise = 1e-3 * rng.standard_normal((2, 100))
        signals = {"rate_x": (1.01 * rate + noise[0], "deg/s"), "rate_y": (noise[1], "deg/s")}
        t_ns = tested.step(
            "r1", "U1", signals, t0_ns=t_ns, procedure="attitude_unit_scale_factor", axis="X", position="X_up",
            step=name, rate_command_deg_per_s=float(rate),
        )  # fmt: skip
    (row,) = rows_of(tested, "scale_factor")
    assert (row["standard"], row["signal"]) == ("JJF1536", "rate_x")
    assert row["value"] == pytest.approx(1.01, rel=1e-4)


def test_temperature_sensitivity(tested: Any, table: Callable[..., Table]) -> None:
    rig = table(gyro=cubic, unit="V")
    slopes: dict[float, float] = {}
    for temperature in (23.0, -40.0, 0.0, 60.0):
        rig.gyro = lambda rate, t=temperature: cubic(rate) * (1 + 5e-6 * (t - 23))  # type: ignore[misc]
        words: dict[str, Any] = {"room": True} if temperature == 23.0 else {}
        rate, mean = rig.rates(
            procedure="scale_factor_temperature_sensitivity", temperature_command_deg_c=temperature, **words
        )
        slopes[temperature] = np.polyfit(rate[1:-1], mean[1:-1], 1)[0]
    room = slopes.pop(23.0)
    expected = max(abs((k - room) / (room * (t - 23.0))) for t, k in slopes.items()) * 1e6
    found = rows_of(tested, "scale_factor_temperature_sensitivity")
    assert [row["value"] for row in found] == pytest.approx([expected, expected], rel=1e-9)
    assert {row["points"] for row in found} == {3}
    assert all(row["lo"] < 5.0 < row["hi"] for row in found)


def test_room_temperature_point_is_needed(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    for temperature in (-40.0, 60.0):
        rig.rates(procedure="scale_factor_temperature_sensitivity", temperature_command_deg_c=temperature)
    for row in rows_of(tested, "scale_factor_temperature_sensitivity"):
        assert row["value"] is None
        assert "room-temperature point is missing" in row["reason"]
        assert "40.0 degC from it" in row["reason"]


@pytest.mark.in_gate("-1")
@pytest.mark.parametrize("sign", [1, -1])
def test_acceleration_sensitivity(tested: Any, table: Callable[..., Table], sign: int) -> None:
    rig = table(unit="V")
    slopes = []
    for position, k, direction in (("IRA_up", 0.02 * (1 + 3e-6), 1), ("IRA_down", 0.02 * (1 - 3e-6), sign)):
        rig.gyro = lambda rate, k=k, s=direction: s * k * rate  # type: ignore[misc]
        rate, mean = rig.rates(
            rests=False, noise=1e-5, procedure="scale_factor_acceleration_sensitivity", position=position
        )
        slopes.append(abs(np.polyfit(rate, mean, 1)[0]))
    (row,) = rows_of(tested, "scale_factor_acceleration_sensitivity")
    assert row["value"] == pytest.approx((slopes[0] - slopes[1]) / 2, rel=1e-9)
    assert row["unit_of_measure"] == "V/(deg/s)/g"
    assert row["lo"] < 0.02 * 3e-6 < row["hi"]


def test_acceleration_sensitivity_cut_short(tested: Any, table: Callable[..., Table]) -> None:
    table().rates(rests=False, procedure="scale_factor_acceleration_sensitivity", position="IRA_up")
    (row,) = rows_of(tested, "scale_factor_acceleration_sensitivity")
    assert row["value"] is None
    assert "not measured with the IRA down" in row["reason"]


@pytest.mark.in_gate("vibration")
@pytest.mark.parametrize("kind", ["shock", "vibration"])
def test_changes_by_shock_and_vibration(tested: Any, table: Callable[..., Table], kind: str) -> None:
    rig = table(unit="V")
    slopes: dict[tuple[str, str], float] = {}
    for axis, change in (("X", 1e-6), ("Y", -20e-6), ("Z", 5e-6)):
        for phase in ("before", "after"):
            rig.gyro = lambda rate, c=change * (phase == "after"): cubic(rate) * (1 + c)  # type: ignore[misc]
            rate, mean = rig.rates(rests=False, procedure=f"scale_factor_{kind}", axis=axis, phase=phase)
            slopes[axis, phase] = np.polyfit(rate, mean, 1)[0]
    found = {row["axis"]: row for row in rows_of(tested, f"scale_factor_{kind}_change")}
    changes = {axis: abs(slopes[axis, "after"] - slopes[axis, "before"]) for axis in "XYZ"}
    for axis in "XYZ":
        assert found[axis]["value"] == pytest.approx(changes[axis], rel=1e-8)
    assert found["largest"]["value"] == pytest.approx(max(changes.values()), rel=1e-8)
    assert found["largest"]["axis_of_largest"] == "Y"
    assert found["largest"]["lo"] < 0.02 * 20e-6 < found["largest"]["hi"]
    # a nonlinearity of 50 ppm is common to both
    assert found["largest"]["hi"] - found["largest"]["lo"] < 0.02 * 5e-6


def test_change_without_after_and_without_axes(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    rig.rates(rests=False, procedure="scale_factor_shock", axis="X", phase="before")
    found = {row["axis"]: row for row in rows_of(tested, "scale_factor_shock_change")}
    assert found["X"]["reason"] == "axis X: not measured after it"
    assert found["largest"]["value"] is None
    assert rows_of(tested, "scale_factor_vibration_change") == []


def test_repeatability(tested: Any, table: Callable[..., Table]) -> None:
    scatter = (0.0, 4e-6, -3e-6, 1e-6, -5e-6, 2e-6)
    day_ns = 86_400 * SECOND_NS
    slopes = []
    for i, each in enumerate(scatter):
        rig = table(f"r{i}", lambda rate, e=each: 0.02 * rate * (1 + e), t_ns=START_NS + (i // 2) * day_ns + i * 10**12)
        rate, mean = rig.rates(procedure="scale_factor")
        slopes.append(np.polyfit(rate[1:-1], mean[1:-1], 1)[0])
    k = np.array(slopes)
    relative = k / k.mean() * 1e6
    days = relative.reshape(3, 2)
    within = np.sqrt(((days - days.mean(axis=1, keepdims=True)) ** 2).sum() / 3)
    expected = {"run_to_run": within, "day_to_day": days.mean(axis=1).std(ddof=1)}
    found = {(row["standard"], row["kind"]): row for row in rows_of(tested, "scale_factor_repeatability")}
    for standard in ("GJB2426A", "JJF2014"):
        for kind, value in expected.items():
            assert found[standard, kind]["run"] is None
            if (standard, kind) != ("GJB2426A", "day_to_day"):
                assert found[standard, kind]["value"] == pytest.approx(value, rel=1e-7)
        assert found[standard, "within_day_component"]["value"] == pytest.approx(within, rel=1e-7)
        assert "6 scale factors of 3 days, several of one" in found[standard, "all"]["reason"]
    # as of the bias, days count from day to day
    assert found["GJB2426A", "day_to_day"]["reason"] == "scale factors of 3 days, 6 or more are asked for"
    assert len(found) == 10


def test_repeatability_of_five_is_too_few_for_one_standard(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    for repeat in range(1, 6):
        rig.rates(procedure="scale_factor_repeatability", repeat=repeat)
    found = {(row["standard"], row["kind"]): row for row in rows_of(tested, "scale_factor_repeatability")}
    assert found["GJB2426A", "all"]["reason"] == "5 scale factors measured, 6 or more are asked for"
    assert found["JJF2014", "all"]["value"] > 0
    assert "of one day" in found["JJF2014", "day_to_day"]["reason"]


def test_range_is_where_the_nonlinearity_meets_the_limit(tested: Any, table: Callable[..., Table]) -> None:
    tested.product("[product.FOG-70]\nnonlinearity_ppm = 100.0")
    table(gyro=lambda rate: float(np.clip(rate, -170, 170)), product="FOG-70").rates(procedure="scale_factor")
    for row in rows_of(tested, "range"):
        assert (row["value"], row["lo"], row["hi"]) == (160.0, 160.0, 250.0)


def test_range_needs_a_limit(tested: Any, table: Callable[..., Table]) -> None:
    tested.product("[product.FOG-70]\nmax_rate_deg_per_s = 300.0")
    table(product="FOG-70").rates(procedure="scale_factor")
    assert {row["reason"] for row in rows_of(tested, "range")} == {
        "no limit of the nonlinearity: give nonlinearity_ppm of product FOG-70 in a specification"
    }


@pytest.mark.parametrize(("sign", "value"), [(1, 1.0), (-1, -1.0)])
def test_polarity(tested: Any, table: Callable[..., Table], sign: int, value: float) -> None:
    rig = table(gyro=lambda rate: sign * rate)
    rig.step(10.0, procedure="polarity", step="forwards")
    rig.step(-10.0, procedure="polarity", step="backwards")
    (row,) = rows_of(tested, "polarity")
    assert (row["value"], row["lo"], row["hi"]) == (value, value, value)


def test_polarity_that_cannot_be_told(tested: Any, table: Callable[..., Table]) -> None:
    rig = table(gyro=lambda rate: 0.0)
    rig.step(10.0, procedure="polarity")
    rig.step(-10.0, procedure="polarity")
    (row,) = rows_of(tested, "polarity")
    assert row["value"] is None
    assert "cannot be distinguished" in row["reason"]


def units_of(n: int, seed: int, asymmetry: float) -> list[dict[str, Any]]:
    """Records of a scale factor of `n` units with white noise whose size was estimated with 60 degrees of freedom."""
    rng = np.random.default_rng(seed)
    rows = []
    for i in range(n):
        t_ns = START_NS
        for at, rate in enumerate((0.0, *BOTH, 0.0)):
            rows.append(
                {
                    "unit": f"U{i:03d}", "index": at + 1, "procedure": "scale_factor", "unit_of_measure": "deg/s",
                    "mean": rate * (1 + asymmetry * (rate > 0)) + 0.001 + 1e-4 * rng.standard_normal(),
                    "standard_uncertainty": 1e-4 * np.sqrt(rng.chisquare(60) / 60), "freedom": 60.0, "n": 100,
                    "rate_command": rate, "input_rate": rate, "duration_s": 10.0, "t_start_ns": t_ns,
                }
            )  # fmt: skip
            t_ns += 20 * SECOND_NS
    return rows


def bounds(n: int, least: float, most: float, checks: int) -> tuple[float, float]:
    """Counts that a coverage between `least` and `most` would leave with a chance of 0.1 % over all checks."""
    chance = 1e-3 / checks
    return stats.binom.ppf(chance, n, least), stats.binom.ppf(1 - chance, n, most)


@pytest.mark.long
@pytest.mark.parametrize("asymmetry", [0.0, 40e-6])
def test_truth_lies_inside_the_limits(recorded: Any, asymmetry: float) -> None:
    rows = units_of(500, 11, asymmetry)
    x = np.array(BOTH)
    k, zero = np.polyfit(x, x * (1 + asymmetry * (x > 0)) + 0.001, 1)
    truths = {
        "scale_factor": {"GJB2426A": k},
        "fitted_zero": {"GJB2426A": (zero - 0.001) / k * 3600, "JJF2014": zero / k * 3600},
        "scale_factor_asymmetry": {
            "GJB2426A": asymmetry / (1 + asymmetry / 2) * 1e6, "JJF2014": asymmetry / k * 1e6
        },
    }  # fmt: skip
    low, high = bounds(500, 0.93, 0.98, 10)
    for metric, of_standard in truths.items():
        found = recorded(rows, metric)
        for standard, truth in of_standard.items():
            mine = [row for row in found if row["standard"] == standard]
            inside = sum(row["lo"] <= truth + 1e-12 and truth <= row["hi"] for row in mine)
            assert len(mine) == 500
            assert low <= inside, (metric, standard, inside)
            # points off the line by what the gyro is, not by noise, make the line's limits wider than they need be
            if asymmetry == 0 or metric == "scale_factor_asymmetry":
                assert inside <= high, (metric, standard, inside)


def test_limits_of_a_maximum_cover_it(recorded: Any) -> None:
    """They hold for all points together, so they cover at least; a maximum itself comes out too large."""
    rows = units_of(300, 12, 40e-6)
    x = np.array(BOTH)
    mean = x * (1 + 40e-6 * (x > 0)) + 0.001
    k, zero = np.polyfit(x, mean, 1)
    truth = np.abs(mean - k * x - zero).max() / np.abs(mean - 0.001).max() * 1e6
    found = [row for row in recorded(rows, "scale_factor_nonlinearity") if row["standard"] == "GJB2426A"]
    low, _ = bounds(300, 0.95, 1.0, 1)
    assert sum(row["lo"] <= truth <= row["hi"] for row in found) >= low
    assert np.mean([row["value"] for row in found]) > truth


@pytest.mark.parametrize("freedom", [1.0, 2.5, 4.0, 20.0, 1e6])
def test_quantiles_against_scipy(tested: Any, freedom: float) -> None:
    with tested.catalog() as catalog:
        steps = step_means(catalog)
        catalog._unfilled.clear()
        define_views(catalog, steps)
        for tail in (0.05, 0.01, 0.05 / 22):
            ((found,),) = catalog.rows("select student_quantile($tail, $freedom)", {"tail": tail, "freedom": freedom})
            assert found == pytest.approx(stats.t.isf(tail / 2, freedom), rel=2e-5)


@pytest.mark.long
def test_a_run_cut_short_after_one_rate_says_so(tested: Any, table: Callable[..., Table]) -> None:
    rig = table()
    rig.step(0.0, procedure="scale_factor", step="rest_before")
    for metric in ("scale_factor", "fitted_zero", "scale_factor_nonlinearity", "scale_factor_asymmetry", "range"):
        for row in rows_of(tested, metric):
            assert row["value"] is None
            assert "0 rates measured forwards and 0 backwards, 11" in row["reason"]
    rig.step(4.0, procedure="scale_factor", step="rate")
    found = by_standard(rows_of(tested, "scale_factor"))
    assert "1 rates measured forwards" in found["JJF2014"]["reason"]
    assert "no record of the table at rest after the rates" in found["GJB2426A"]["reason"]


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


@pytest.mark.parametrize("rates", [BOTH[:6], (50.0, -50.0)])
def test_fewer_rates_than_the_clauses_ask_for_have_an_informative_value(
    tested: Any, table: Callable[..., Table], rates: Sequence[float]
) -> None:
    rig = table(gyro=cubic, unit="V")
    rate, mean = rig.rates(rates, procedure="scale_factor")
    found = by_standard(rows_of(tested, "scale_factor"))
    assert set(found) == {"GJB2426A", "JJF2014", "informative"}
    assert [found[each]["value"] for each in ("GJB2426A", "JJF2014")] == [None, None]
    row = found["informative"]
    assert row["value"] == pytest.approx(np.polyfit(rate[1:-1], mean[1:-1], 1)[0], rel=1e-9)
    assert row["lo"] < row["value"] < row["hi"]
    assert f"GJB2426A: {len(rates) // 2} rates measured forwards" in row["remark"]
    # others do not stand on it
    rig.step(0.0, procedure="static_bias")
    assert "no scale factor" in rows_of(tested, "bias")[0]["reason"]


def test_a_whole_measurement_has_no_informative_value(tested: Any, table: Callable[..., Table]) -> None:
    table(gyro=cubic, unit="V").rates(procedure="scale_factor")
    assert "informative" not in by_standard(rows_of(tested, "scale_factor"))
